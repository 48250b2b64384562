"""The page in a real browser: it opens at once, asks for nothing, and does what its keys and switches say."""

import io
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, chromium, open_browser
from matplotlib.image import imread
from numpy.typing import NDArray

from viewshed import BevGrid, CellState, FovEstimate
from viewshed.agents.legend import LEGEND, ShownTracks
from viewshed.detections import Detections
from viewshed.monitor import IntegrityReport
from viewshed.objects.explained import Explanation
from viewshed.show.plot import COLORS
from viewshed.show.view import AgentTrust, Frame, PackedFrame, pack_frame, write_page
from viewshed.show.view.html import UNKNOWN_ON_DARK

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed: pages are not opened")

GRID = BevGrid(64, 32.0)

FRAMES = 4

SHOWN = "shown !== null && shown.about === abouts[{}]"


def _frames() -> Iterator[PackedFrame]:
    """Frames by hand: ahead of the sensor FREE, far left SURFACE; behind it HIDDEN, wider in every frame."""
    for k in range(FRAMES):
        state = np.full(GRID.shape, CellState.UNKNOWN, np.uint8)
        state[32:, :32] = CellState.FREE
        state[32:, 56:] = CellState.SURFACE
        state[: 8 * (k + 1)] = CellState.HIDDEN
        visible = (state == CellState.FREE) | (state == CellState.SURFACE)
        std = np.full(GRID.shape, 0.1 * (k + 1), np.float32) if k < 2 else None
        suspect = np.zeros(GRID.shape, np.bool_)
        suspect[40:48, 8:16] = k == 3
        report = IntegrityReport(
            "by hand", 0.1 * k, 0.25, grid=GRID, suspect_cells=suspect, reasons=("a wall <b>is</b> missing",)
        )
        estimate = FovEstimate(GRID, visible * np.float32(0.9), state, std=std, t_ns=10**18 + 50_000_000 * k)
        frame = Frame(f"frame {k} </script>", estimate, None, report)
        if k == 2:
            box = np.array([[8.0, -8.0, 0.8, 8.0, 4.0, 1.5, 0.0], [-16.0, 10.0, 0.8, 8.0, 4.0, 1.5, np.pi / 2]])
            reasons = ("missing for 1.0 s <b>", "hidden")
            legend = np.array([Explanation.MISSING, Explanation.HIDDEN])
            tracks = ShownTracks(np.array([7, 9]), box, np.zeros((2, 2)), np.array([0.9, 0.8]), legend, reasons)
            found = Detections(box[:1], np.array([3]), np.array([40]))
            trust = (AgentTrust("car", 0.21, accused=True, forged=True), AgentTrust("mast", 0.98))
            frame = replace(
                frame, detections=found, tracks=tracks, trust=trust, lies=("car contradicts the others",)
            )  # fmt: skip
        yield pack_frame(frame)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "run.html"
    write_page(path, _frames(), "drive <1>")
    return path


@pytest.fixture(scope="module")
def tab() -> Iterator[Browser]:
    with open_browser() as browser:
        yield browser


@pytest.fixture
def opened(tab: Browser, page: Path) -> Browser:
    tab.window(1000, 700)
    tab.open(page.as_uri())
    tab.wait_for(SHOWN.format(0))
    return tab


def _pixel(browser: Browser, x_m: float, y_m: float) -> NDArray[np.float32]:
    """The color on the screen of a place on the ground."""
    browser.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    left, top, column, row = browser.value(
        f"(({{left, top}}) => [left, top, ...toScreen({x_m}, {y_m})])(map.getBoundingClientRect())"
    )
    image: NDArray[np.float32] = np.asarray(imread(io.BytesIO(browser.screenshot())), np.float32)
    return image[int(top + row), int(left + column), :3]


def _near(color: NDArray[np.float32], wanted: tuple[float, float, float]) -> bool:
    return bool(np.abs(color - np.array(wanted)).max() < 0.02)


def test_it_opens_at_once_and_asks_for_nothing(tab: Browser, page: Path) -> None:
    begun = time.monotonic()
    tab.open(page.as_uri())
    tab.wait_for(SHOWN.format(0))
    assert time.monotonic() - begun < 2.0
    assert tab.requests == [page.as_uri()]
    assert tab.problems == []
    assert tab.value("document.title") == "drive <1>"
    assert tab.value("element('name').textContent") == "frame 0 </script>"


def test_states_are_where_they_are(opened: Browser) -> None:
    assert _near(_pixel(opened, 20.5, -20.5), COLORS[CellState.FREE])  # ahead, right
    assert _near(_pixel(opened, 20.5, 28.5), COLORS[CellState.SURFACE])  # ahead, far left
    assert _near(_pixel(opened, -30.5, 10.5), COLORS[CellState.HIDDEN])  # far behind
    assert _near(_pixel(opened, -10.5, 10.5), COLORS[CellState.UNKNOWN])


def test_a_dark_system_makes_a_dark_page(opened: Browser) -> None:
    opened.window(1000, 700, dark=True)
    opened.wait_for("root.dataset.theme === 'dark'")
    assert _near(_pixel(opened, -10.5, 10.5), UNKNOWN_ON_DARK)
    opened.value("(element('theme').value = 'light', choose())")
    assert _near(_pixel(opened, -10.5, 10.5), COLORS[CellState.UNKNOWN])


def test_layers_are_switched(opened: Browser) -> None:
    free = _pixel(opened, 20.5, -20.5)
    assert not opened.value("element('if_deviation').hidden")
    for layer in ("probability", "doubt", "deviation", "none"):
        opened.value(f"document.querySelector('#bases [value={layer}]').click()")
        assert not _near(_pixel(opened, 20.5, -20.5), (free[0], free[1], free[2])), layer
    # The edge between free and unknown cells, five pixels to each side.
    for is_on in (True, False):
        opened.value("document.querySelector('#bases [value=states]').click()")
        around = [_pixel(opened, 20.5, 0.1 * k)[0] for k in (-1, 0, 1)]
        assert (min(around) < 0.3) == is_on
        opened.value("document.querySelector('#overlays [value=edge]').click()")
    assert opened.problems == []


def test_keys_step_and_play(opened: Browser) -> None:
    opened.press("ArrowRight")
    opened.wait_for(SHOWN.format(1))
    assert opened.value("element('clock').textContent") == "0.05 s of 0.15 s"
    opened.press("ArrowLeft")
    opened.wait_for(SHOWN.format(0))
    opened.press(" ", " ")
    opened.wait_for(SHOWN.format(FRAMES - 1))
    opened.wait_for("element('play').textContent === 'Play'")
    assert opened.value("element('alarms').textContent") == "inconsistent: a wall <b>is</b> missing"
    assert not _near(_pixel(opened, 12.5, -20.5), COLORS[CellState.FREE])  # suspect
    assert opened.problems == []


def test_tracks_are_drawn_in_the_color_of_their_explanation_and_trust_is_told(opened: Browser) -> None:
    assert opened.value("[...document.querySelectorAll('[data-track]')].map((item) => item.textContent)") == [
        "track: hidden", "track: missing though visible",
    ]  # fmt: skip
    opened.value("show(2)")
    opened.wait_for(SHOWN.format(2))
    for (x_m, y_m), why in (((8.5, -8.5), Explanation.MISSING), ((-16.5, 10.5), Explanation.HIDDEN)):
        state = CellState.FREE if x_m > 0 else CellState.HIDDEN
        mixed = 0.35 * np.array(LEGEND[why].color) + 0.65 * np.array(COLORS[state])
        assert _near(_pixel(opened, x_m, y_m), (mixed[0], mixed[1], mixed[2])), why
    left, top, column, row = opened.value(
        "(({left, top}) => [left, top, ...toScreen(8.5, -8.5)])(map.getBoundingClientRect())"
    )
    opened.mouse("mouseMoved", left + column, top + row)
    told = opened.value("element('tip').textContent").splitlines()
    assert told[-2:] == ["track 7: missing though visible, exists with 90 %", "missing for 1.0 s <b>"]
    assert opened.value("element('alarms').textContent") == "center: car contradicts the others"
    assert opened.value("[...element('trust').children].map((item) => item.textContent)") == [
        "car (forged)0.21 accused", "mast0.98",
    ]  # fmt: skip
    opened.value("document.querySelector('#overlays [value=tracks]').click()")
    assert _near(_pixel(opened, 8.5, -8.5), COLORS[CellState.FREE])
    opened.value("document.querySelector('#overlays [value=tracks]').click()")
    assert opened.problems == []


def test_times_that_do_not_rise_are_a_tenth_of_a_second_apart(opened: Browser) -> None:
    times_ns = ["1700000000000000005", "1700000001000000005", "3", "null", "4", "2000000004"]
    frames = ", ".join("{t_ns: null}" if t_ns == "null" else f'{{t_ns: "{t_ns}"}}' for t_ns in times_ns)
    assert opened.value(f"timesOf([{frames}])") == pytest.approx([0.0, 1.0, 1.1, 1.2, 1.3, 3.3])


def test_the_strip_seeks(opened: Browser) -> None:
    box = opened.value("JSON.parse(JSON.stringify(strip.getBoundingClientRect()))")
    middle = box["top"] + box["height"] / 2
    opened.mouse("mousePressed", box["left"] + box["width"] - 6, middle, button="left", buttons=1, clickCount=1)
    opened.wait_for(SHOWN.format(FRAMES - 1))
    opened.mouse("mouseMoved", box["left"] + 6, middle, button="left", buttons=1)
    opened.wait_for(SHOWN.format(0))
    opened.mouse("mouseReleased", box["left"] + 6, middle, button="left", clickCount=1)


def test_the_pointer_tells_the_cell_and_the_wheel_zooms_around_it(opened: Browser) -> None:
    left, top, column, row = opened.value(
        "(({left, top}) => [left, top, ...toScreen(20.5, -20.5)])(map.getBoundingClientRect())"
    )
    opened.mouse("mouseMoved", left + column, top + row)
    told = opened.value("element('tip').textContent").splitlines()
    assert told[1:] == ["FREE, probability 88 % to 94 %", "deviation 0.100"]
    scale = opened.value("camera.scale")
    opened.mouse("mouseWheel", left + column, top + row, deltaX=0, deltaY=-300)
    opened.wait_for(f"camera.scale > 1.3 * {scale}")
    assert opened.value("toScreen(20.5, -20.5)") == pytest.approx([column, row], abs=1.0)
    opened.press("0")
    assert opened.value("camera.scale") == pytest.approx(scale)


def test_a_narrow_window_shows_map_and_controls(opened: Browser) -> None:
    opened.window(380, 800)
    opened.wait_for("map.clientWidth < 400")
    assert opened.value("document.documentElement.scrollWidth") <= 380
    assert opened.value("map.clientHeight") > 250
    assert opened.value("element('play').getBoundingClientRect().bottom") < 800


def test_a_damaged_frame_is_said_and_the_others_are_shown(tab: Browser, page: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.html"
    text = page.read_text(encoding="utf-8")
    begin = text.index('class="data">', text.index('class="data">') + 1) + len('class="data">')
    damaged.write_text(text[:begin] + "AAAA" + text[begin + 4 :], encoding="utf-8")
    tab.open(damaged.as_uri())
    tab.wait_for(SHOWN.format(0))
    tab.press("ArrowRight")
    tab.wait_for("element('problem').textContent !== ''")
    assert tab.value("element('problem').textContent").startswith("Sweep 2 cannot be decoded")
    tab.press("ArrowRight")
    tab.wait_for(SHOWN.format(2))
    assert tab.value("element('problem').textContent") == ""
