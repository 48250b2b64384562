"""The page as a file: whole or not there, small, and nothing in it that a file's name could do."""

import base64
import json
import re
import tracemalloc
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from viewshed import BevGrid, FovEstimate
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.io import read_sweep
from viewshed.io.samples import junction_path
from viewshed.monitor import IntegrityReport
from viewshed.preprocess.leveling import level
from viewshed.show.view import Frame, PackedFrame, pack_frame, write_page

GRID = BevGrid(16, 8.0)

HOSTILE = "</script><script>alert(1)</script><!--<img src=x onerror=alert(1)>&amp;{{script}}{{frames}}\u2028\"'"


def _frame(name: str = "a", seed: int = 0) -> PackedFrame:
    rng = np.random.default_rng(seed)
    prob, state = rng.random(GRID.shape, np.float32), rng.integers(0, 4, GRID.shape, np.uint8)
    return pack_frame(Frame(name, FovEstimate(GRID, prob, state)))


class _Elements(HTMLParser):
    """The elements of a page as a browser would see them."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.elements:
            self.texts.append((self.elements[-1][0], data))


def test_frames_are_in_the_page(tmp_path: Path) -> None:
    page = tmp_path / "run.html"
    frames = [_frame("first", 1), _frame("second", 2)]
    size = write_page(page, frames, "drive")
    text = page.read_text(encoding="utf-8")
    assert size == page.stat().st_size
    data = re.findall(r'<script type="text/plain" class="data">(.*?)</script>', text)
    about = re.findall(r'<script type="application/json" class="about">(.*?)</script>', text)
    assert [base64.b64decode(each) for each in data] == [frame.data for frame in frames]
    assert [json.loads(each) for each in about] == [dict(frame.about) for frame in frames]


def test_names_cannot_add_elements(tmp_path: Path) -> None:
    plain, hostile = tmp_path / "plain.html", tmp_path / "hostile.html"
    zeros = np.zeros(GRID.shape, np.uint8)
    estimate = FovEstimate(GRID, zeros.astype(np.float32), zeros, method=HOSTILE, agent=HOSTILE)
    write_page(plain, [_frame()], "drive")
    report = IntegrityReport(HOSTILE, 2.0, 1.0, reasons=(HOSTILE,), notes=(HOSTILE,))
    frame = pack_frame(Frame(HOSTILE, estimate, None, report))
    write_page(hostile, [frame], HOSTILE)
    assert [tag for tag, _ in _Elements(hostile).elements] == [tag for tag, _ in _Elements(plain).elements]
    assert HOSTILE in "".join(text for tag, text in _Elements(hostile).texts if tag == "h1")


def test_a_name_that_is_no_text_is_written(tmp_path: Path) -> None:
    write_page(tmp_path / "run.html", [_frame("\udcff.bin")], "\udcff.bin")
    assert "?.bin" in (tmp_path / "run.html").read_text(encoding="utf-8")


def test_the_page_names_no_address(tmp_path: Path) -> None:
    write_page(tmp_path / "run.html", [_frame()], "drive")
    page = _Elements(tmp_path / "run.html")
    assert not [(tag, attrs) for tag, attrs in page.elements if {"src", "href", "action", "data"} & set(attrs)]
    policy = next(attrs["content"] for _, attrs in page.elements if attrs.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    assert not re.search(r"https?:|url\(|@import|fetch\(|XMLHttp|WebSocket|innerHTML|eval\(", _text_of_page())


def _text_of_page() -> str:
    files = resources.files("viewshed.show.view")
    return "".join(files.joinpath(f"page.{suffix}").read_text(encoding="utf-8") for suffix in ("html", "css", "js"))


def test_no_half_page_is_left(tmp_path: Path) -> None:
    def broken() -> Iterator[PackedFrame]:
        yield _frame()
        raise RuntimeError("the recording ended")

    (tmp_path / "run.html").write_text("the page of yesterday")
    with pytest.raises(RuntimeError, match="the recording ended"):
        write_page(tmp_path / "run.html", broken(), "drive")
    with pytest.raises(ValueError, match="at least one"):
        write_page(tmp_path / "run.html", [], "drive")
    assert [path.name for path in tmp_path.iterdir()] == ["run.html"]
    assert (tmp_path / "run.html").read_text() == "the page of yesterday"


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    def peak(count: int) -> int:
        tracemalloc.start()
        write_page(tmp_path / "run.html", (_frame(seed=k) for k in range(count)), "drive")
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(1)
    assert peak(200) < peak(5) + 100_000


def test_a_hundred_sweeps_are_ten_megabytes_at_most(tmp_path: Path) -> None:
    estimator = ShadowMap(BevGrid(256, 64.0))
    leveled = level(read_sweep(junction_path()), estimator.grid)
    frame = pack_frame(Frame("junction", estimator.estimate(leveled), leveled))
    one = write_page(tmp_path / "one.html", [frame], "drive")
    two = write_page(tmp_path / "two.html", [frame, frame], "drive")
    assert one + 99 * (two - one) < 10e6
