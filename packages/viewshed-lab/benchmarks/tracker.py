"""The tracker beside Stone Soup, with and without a field of view: ``python -m benchmarks.tracker``.

Writes docs/results/tracker.md.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from importlib import metadata
from pathlib import Path

import numpy as np
from tests.objects.stone_soup import RULES, ours, scenario, theirs

from benchmarks.timing import Timing, interleaved
from viewshed import ESTIMATORS, BevGrid
from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind
from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.objects.cells import SeenCells
from viewshed.objects.detection_table import detection_table
from viewshed.objects.sensor_view import Observed, SensorView
from viewshed.objects.single import SingleFusion
from viewshed.objects.tracker import Rules, Tracker
from viewshed.objects.views import BeamView, GridView, PolygonView, SeesAll, View
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import lidar_model
from viewshed_lab._page import facts, page, table
from viewshed_lab.sim import cast, junction
from viewshed_lab.studies.tracks.published import PublishedRules

PAGE = Path(__file__).resolve().parents[3] / "docs" / "results" / "tracker.md"

SEED, TARGETS, SWEEPS, EXTENT_M, TARGET_MS = 20_261_123, 30, 20, 40.0, 1.0

FUSION, FUSION_MS = "fusion of these tracks, one agent", 2.0

INTRODUCTION = f"""\
{TARGETS} objects that cross in a square of {2 * EXTENT_M:.0f} m, 85 % of them found in a sweep, with one false
detection a sweep on average; {SWEEPS} sweeps from the first detections on. Milliseconds of one sweep: prediction,
questions to the view, assignment, update, births and deaths. All run in one process and one thread, whole recordings in
turns, in an order drawn anew each round; median, 10th and 90th percentile over rounds. The clock is that of the thread,
which leaves out what other processes of the machine took. The view's own making (leveling, the estimate) is not
counted. `textbook` has the rules under which `tests/objects/test_stone_soup.py` finds the same states, covariances and
assignments as Stone Soup."""


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tracker", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    arguments = parser.parse_args()
    rng = np.random.default_rng(SEED)
    sweeps = scenario(rng, targets=TARGETS, half_extent_m=EXTENT_M, sweeps=SWEEPS)
    jobs: dict[str, Callable[[], object]] = {
        name: partial(_follow, sweeps, rules, view) for name, (rules, view) in _trackers().items()
    }
    jobs[FUSION] = partial(_fuse, _observed(sweeps))
    jobs["textbook"] = partial(ours, sweeps, RULES)
    jobs["Stone Soup"] = partial(theirs, sweeps)
    timings = interleaved(jobs, rng, budget_s=20.0, clock=time.thread_time_ns)
    rows = [_row(name, timings[name]) for name in jobs]
    content = page(
        "Speed of the tracker",
        facts(
            command="`python -m benchmarks.tracker`",
            libraries=", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "scipy", "stonesoup")),
            load=f"{os.getloadavg()[0]:.1f} in the minute before, on all cores",
            seed=str(SEED),
        ),
        INTRODUCTION,
        table(["tracker", "median, ms (10–90 %)", "target", ""], rows),
    )
    print(content)
    arguments.page.write_text(content, encoding="utf-8")


def _street() -> tuple[LeveledSweep, FovEstimate]:
    """Return a leveled sweep at a junction, and its shadow map."""
    sweep = cast(lidar_model("hdl32e"), junction(), 1.84)
    grid = BevGrid(256, 64.0)
    leveled = level(sweep.replace(world_from_sensor=Rigid.from_yaw(0.0, (0.0, 0.0, 1.84))), grid)
    return leveled, ESTIMATORS["shadow_map"](grid).estimate(leveled.sweep)


def _trackers() -> dict[str, tuple[Rules | None, Callable[[float], View]]]:
    """Return rules and view of each measured tracker, by name."""
    leveled, estimate = _street()
    polygon = ESTIMATORS["concave_hull"](estimate.grid).estimate(leveled.sweep).polygon()
    return {
        "existence, no field of view": (None, SeesAll),
        "existence, beams and the detector's table": (None, partial(BeamView, leveled, found=detection_table().prob)),
        "existence, shadow map": (None, partial(GridView, estimate)),
        "published, overlap of boxes, polygon": (PublishedRules(), partial(PolygonView, polygon, Rigid.identity())),
        "published, distance of centers, polygon": (
            PublishedRules(cost="center"), partial(PolygonView, polygon, Rigid.identity())
        ),
    }  # fmt: skip


def _follow(sweeps: list[tuple[float, F64]], rules: Rules | None, view: Callable[[float], View]) -> None:
    """Track cars at these centers."""
    tracker = Tracker(rules)
    for t_s, centers in sweeps:
        tracker.step(t_s, _cars(centers), view(t_s))


def _cars(centers: F64) -> Detections:
    """Return cars at these centers (K, 2)."""
    boxes = np.tile([0.0, 0.0, 0.75, 4.2, 1.8, 1.5, 0.0], (len(centers), 1))
    boxes[:, :2] = centers
    return Detections(boxes, np.full(len(boxes), ObjectKind.CAR, np.uint8), np.full(len(boxes), 50, np.int32))


def _observed(sweeps: list[tuple[float, F64]]) -> list[Observed]:
    """Return the input of fusion for the same cars, in a street with its cells."""
    leveled, estimate = _street()
    tracker, observed = Tracker(), list[Observed]()
    for t_s, centers in sweeps:
        cars = _cars(centers)
        view = BeamView(leveled, t_s)
        sensor_view = SensorView("top", view, np.zeros(2), SeenCells.of(estimate))
        observed.append((tracker.step(t_s, cars, view), cars, (sensor_view,)))
    return observed


def _fuse(observed: list[Observed]) -> None:
    """Explain all tracks of a recording."""
    fusion = SingleFusion()
    for one in observed:
        fusion.explain(*one)


def _row(name: str, timing: Timing) -> list[str]:
    median, low, high = (value / SWEEPS for value in (timing.median_ms, timing.low_ms, timing.high_ms))
    max_ms = FUSION_MS if name == FUSION else TARGET_MS
    verdict = [f"≤ {max_ms:g} ms", "met" if median <= max_ms else "**missed**"]
    return [name, f"{median:.2f} ({low:.2f}–{high:.2f})", *(verdict if name != "Stone Soup" else ["–", "–"])]


if __name__ == "__main__":
    main()
