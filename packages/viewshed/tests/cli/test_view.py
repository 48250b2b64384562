"""``viewshed view`` and ``viewshed replay`` as a stranger types them."""

import json
import re
import socket
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import run

from viewshed import Sweep, read_sweep, write_sweep
from viewshed.cli._outputs import Named
from viewshed.cli.replay import Pacer
from viewshed.io.samples import junction_path

recordings: Any = import_module("recording_files")


def _names(page: Path) -> list[str]:
    abouts = re.findall(r'class="about">(.*?)</script>', page.read_text(encoding="utf-8"))
    return [json.loads(about)["name"] for about in abouts]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Five files of thinned sweeps."""
    sweep, folder = read_sweep(junction_path()), tmp_path_factory.mktemp("drive")
    files = [folder / f"sweep <{k}>.ply" for k in range(5)]
    for k, file in enumerate(files):
        write_sweep(sweep.select(np.arange(k, len(sweep), 20)), file)
    return files


def test_files_become_one_page(drive: list[Path], tmp_path: Path) -> None:
    page = tmp_path / "run.html"
    code, out, err = run("view", *drive, "--html", page)
    assert (code, err) == (0, "")
    *lines, last = out.splitlines()
    assert len(lines) == 5
    assert all("visible" in line and line.endswith(" kB") for line in lines)
    assert last == f"{page}: {page.stat().st_size / 1e6:.2f} MB"
    assert _names(page) == [f"sweep <{k}>" for k in range(5)]
    assert [path.name for path in tmp_path.iterdir()] == ["run.html"]


def test_some_sweeps_are_taken(drive: list[Path], tmp_path: Path) -> None:
    page = tmp_path / "run.html"
    assert run("view", *drive, "--html", page, "--step", 2)[0] == 0
    assert _names(page) == ["sweep <0>", "sweep <2>", "sweep <4>"]
    assert run("view", *drive, "--html", page, "--step", 2, "--sweeps", 2)[0] == 0
    assert _names(page) == ["sweep <0>", "sweep <2>"]


@pytest.mark.parametrize("kind", ["ros1 bag", "kitti_raw"])
def test_recordings_are_read(kind: str, tmp_path: Path) -> None:
    place = recordings.write(tmp_path / "drive", recordings.recordings()[kind])
    files = [path for path in place.iterdir() if path.suffix in {".bag", ".mcap"}]
    page = tmp_path / "run.html"
    # These bags have no poses, which is noted: nothing is wrong with them.
    code, _, err = run("view", *(files or [place]), "--html", page, *(() if files else ("--history", 2)))
    assert code == 0, err
    assert ("note: " in err) == bool(files)
    assert len(_names(page)) == 2


def test_a_bad_file_costs_a_line(drive: list[Path], tmp_path: Path) -> None:
    bad = tmp_path / "bad.bin"
    bad.write_bytes(b"\0" * 17)
    page = tmp_path / "run.html"
    code, _, err = run("view", bad, drive[0], "--html", page)
    assert code == 2
    assert err.count("\n") == 1
    assert _names(page) == ["sweep <0>"]


def test_a_file_for_rerun(drive: list[Path], tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: its files are not written")
    place = tmp_path / "run.rrd"
    code, out, err = run("view", *drive, "--rerun", place, "--step", 2)
    assert (code, err) == (0, "")
    assert len(out.splitlines()) == 4
    assert out.splitlines()[-1] == f"{place}: {place.stat().st_size / 1e6:.2f} MB"


def test_live_in_foxglove(drive: list[Path]) -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: nothing is served")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        other.listen()
        code, _, err = run("view", *drive, "--foxglove", port, "--sweeps", 2)
        assert code == 2
        assert f"port {port} of 127.0.0.1 cannot be served" in err
        assert err.count("\n") == 1
    code, out, err = run("view", *drive[:2], "--foxglove", port, "--sweeps", 2)
    assert (code, err) == (0, "")
    assert out.splitlines()[0] == f"open ws://localhost:{port} in Foxglove; Ctrl-C ends"
    assert re.match("[12] answered, [01] dropped; ", out.splitlines()[-1])


def test_a_page_shows_the_reactions_of_a_profile(tmp_path: Path) -> None:
    """After an empty sweep, an alarm, the profile keeps only what is confirmed or certified, as in a replay."""
    sweep = read_sweep(junction_path())
    for number, returns in enumerate((len(sweep), 0, len(sweep))):
        write_sweep(sweep.select(np.arange(returns)).replace(t_ns=number * 10**8), tmp_path / f"{number}.npz")
    files = [tmp_path / f"{number}.npz" for number in range(3)]
    areas = []
    for command in (("view", "--html", tmp_path / "run.html"), ("replay", "--as-fast")):
        code, out, _ = run(*command, *files, "--profile", "contested")
        assert code == 0
        areas.append(re.findall(r"visible (\d+) m²", out))
    assert areas[0] == areas[1]
    assert int(areas[0][2]) < int(areas[0][0])


def test_nothing_readable_leaves_no_page(tmp_path: Path) -> None:
    for words in ((tmp_path / "missing.bin",), (junction_path(), "--history", 2)):
        code, _, err = run("view", *words, "--html", tmp_path / "run.html")
        assert code == 2
        assert "run.html was written" in err
    assert "--history needs a pose and a time of each sweep" in err
    assert list(tmp_path.iterdir()) == []


def test_sweeps_are_handed_on_when_they_are_due(monkeypatch: pytest.MonkeyPatch) -> None:
    now, slept = [100.0], []

    def sleep(seconds: float) -> None:
        slept.append(round(seconds, 6))
        now[0] += seconds

    monkeypatch.setattr(time, "sleep", sleep)
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    sent = [(0, "a"), (10**8, "a"), (3 * 10**8, "a"), (3 * 10**8, "b"), (3 * 10**8, "b"), (10**12, "a")]
    named = (Named(Sweep(np.ones((1, 3), np.float32), t_ns=t_ns, agent=agent), "", Path()) for t_ns, agent in sent)
    pace = Pacer(rate=2.0)
    for k, _ in enumerate(pace.kept(named)):
        now[0] += 0.08 if k == 0 else 0.0  # the first estimate takes longer than the next sweep waits
    assert slept == [0.0, 0.0, 0.07, 0.0, 0.05, 1.0]  # two agents measure at once
    assert pace.time_s == pytest.approx(2.4)
