"""A file for Rerun: read back by its own software kit."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from viewshed import load_estimator, read_sweep
from viewshed.agents.legend import ShownTracks
from viewshed.detections import Detections
from viewshed.io.samples import junction_path
from viewshed.monitor.evidence.base import SECTORS
from viewshed.monitor.report import IntegrityReport
from viewshed.objects.explained import Explanation
from viewshed.preprocess.leveling import level
from viewshed.show.view.frames import AgentTrust, Frame
from viewshed.show.view.rerun import write_rerun

needs_rerun = pytest.mark.skipif(
    find_spec("rerun") is None, reason="rerun-sdk is not installed: its files are not written"
)


@needs_rerun
def test_frames_become_a_file(tmp_path: Path) -> None:
    estimator = load_estimator("shadow_map")
    leveled = level(read_sweep(junction_path()), estimator.grid)
    suspect = np.zeros(SECTORS, np.bool_)
    suspect[10:12] = True
    report = IntegrityReport("by hand", 2.0, 1.0, suspect=suspect, reasons=("a wall stands in the air",))
    estimate = estimator.estimate(leveled)
    boxes = np.array([[9.0, 2.0, 0.8, 4.2, 1.8, 1.5, 0.3], [9.0, -8.0, 0.8, 4.2, 1.8, 1.5, 0.0]])
    tracks = ShownTracks(
        np.array([3, 8]), boxes, np.zeros((2, 2)), np.ones(2), np.array([Explanation.SEEN, Explanation.MISSING]),
        ("detected in this sweep", "missing for 1.0 s"),
    )  # fmt: skip
    found = Detections(boxes[:1], np.array([3]), np.array([40]))
    frames = [
        Frame("first", estimate, leveled, report, found, tracks),
        Frame("second", estimate, leveled, trust=(AgentTrust("car", 0.2, accused=True),), lies=("car contradicts",)),
    ]
    place = tmp_path / "run.rrd"
    assert write_rerun(place, frames, "a drive") == place.stat().st_size > 100_000
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]
    assert place.read_bytes()[:4] in {b"RRF2", b"RRF0", b"RRIO"}
    said = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", place], check=True, capture_output=True, text=True
    ).stdout
    for entity in (
        "/level/points", "/level/suspect", "/sweep/states/image", "/numbers/visible_m2", "/alarms", "/level/tracks",
        "/level/detections", "/trust/car",
    ):  # fmt: skip
        assert entity in said


@needs_rerun
def test_no_frame_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"frames must be at least one, got none; no file .*run\.rrd was written"):
        write_rerun(tmp_path / "run.rrd", [], "nothing")
    with pytest.raises(OSError, match="must lie in a folder that exists"):
        write_rerun(tmp_path / "missing" / "run.rrd", [], "nothing")
    assert list(tmp_path.iterdir()) == []
