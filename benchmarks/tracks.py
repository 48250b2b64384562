"""Tracks and fusion on real sweeps: ``python -m benchmarks.tracks DATA --rig FOLDER [--page FILE]``.

DATA has an ``index.json`` of sweeps with poses and times; FOLDER has three LiDARs of one car, ``top*.pcd``,
``left*.pcd`` and ``right*.pcd``, in a folder for each place. Nobody attacked them: what is accused is a false alarm.
Writes docs/results/tracks_real.md.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import viewshed
from viewshed._page import facts, page, table
from viewshed.estimators import DEFAULT_ESTIMATOR, load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fusion.cells import SeenCells
from viewshed.fusion.explained import ExplainedTracks, Explanation
from viewshed.fusion.sensor_view import SensorView
from viewshed.fusion.single import SingleFusion
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.io import read_index, read_indexed
from viewshed.objects import Detections, ObjectKind
from viewshed.perception.detection_table import detection_table
from viewshed.perception.detector import Detector
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed.tracking.tracker import Tracker
from viewshed.tracking.views import BeamView

Floats = NDArray[np.float64]

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "tracks_real.md"

GRID = BevGrid(512, 64.0)

SEQUENCES = {
    "kitti-raw-2011_09_26-drive_0001": "KITTI drive 0001", "kitti-odometry-00": "KITTI odometry 00",
    "nuscenes-n008-2018-08-01 (v1.0-mini scene-0103)": "nuScenes scene 0103",
}  # fmt: skip

SIDES = {"left": 90.0, "right": -90.0}
"""Rough extrinsics of the rig, degrees of yaw; both are rolled by about 45°, which leveling undoes."""

GHOSTS, GHOST_WITHIN_M, REPEATS, SEED = 60, 20.0, 15, 20_261_123

_SEARCH_DEG, _SEARCH_M = np.arange(-4.0, 4.1, 1.0), np.arange(-1.5, 1.6, 0.25)


def main(words: Sequence[str] | None = None) -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tracks", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of index.json")
    parser.add_argument("--rig", type=Path, help="folder of three LiDARs, a folder for each place")
    parser.add_argument("--page", type=Path, default=PAGE)
    chosen = parser.parse_args(words)
    load = os.getloadavg()[0]
    entries = [entry for entry in read_index(chosen.data / "index.json") if entry.seq in SEQUENCES]
    rows = []
    for seq, name in SEQUENCES.items():
        sweeps = [read_indexed(entry) for entry in entries if entry.seq == seq]
        rows.append(_follow(name, sorted(sweeps, key=lambda sweep: sweep.t_ns or 0)).row())
    parts = [
        "## One sensor over time",
        "Nobody attacked these recordings, and they come without boxes: what is accused is a false alarm. *Continued*:"
        " confirmed tracks that were matched in a later sweep than their first. *Hidden* to *missed*: confirmed tracks"
        " that were not detected in a sweep, by why.",
        table(list(_HEAD), rows),
    ]
    if chosen.rig is not None:
        parts += ["## Three sensors of one car", _RIG, table(*_of_rig(sorted(chosen.rig.iterdir())))]
    about = facts(
        command="`python -m benchmarks.tracks DATA --rig FOLDER`",
        load=f"{load:.1f} in the minute before, on all cores",
        seed=str(SEED),
    )  # fmt: skip
    content = page("Tracks on real sweeps", about, *parts)
    print(content)
    chosen.page.write_text(content, encoding="utf-8")


_HEAD = (
    "recording", "sweeps", "gap, s", "detections a sweep", "confirmed tracks", "continued", "hidden", "out of view",
    "few returns", "missed", "accused",
)  # fmt: skip


@dataclass(slots=True)
class Followed:
    """What became of one recording."""

    name: str
    times: list[float] = field(default_factory=list)
    detections: list[int] = field(default_factory=list)
    confirmed: set[int] = field(default_factory=set)
    continued: set[int] = field(default_factory=set)
    accused: set[int] = field(default_factory=set)
    why: Counter[int] = field(default_factory=Counter)

    def row(self) -> list[str]:
        """Return the cells of its line."""
        gaps = np.diff(self.times)
        whys = (Explanation.HIDDEN, Explanation.OUT_OF_VIEW, Explanation.TOO_FEW_RETURNS, Explanation.MISSED)
        return [
            self.name, str(len(self.times)), f"{gaps.min():.2f} to {gaps.max():.2f}",
            f"{np.mean(self.detections):.1f}", str(len(self.confirmed)), str(len(self.continued)),
            *(str(self.why[int(why)]) for why in whys), str(len(self.accused)),
        ]  # fmt: skip


def _follow(name: str, sweeps: Sequence[Sweep]) -> Followed:
    """Track and fuse one recording."""
    tracker, fusion, found = Tracker(), SingleFusion(), Followed(name)
    for sweep in sweeps:
        leveled, t_s = level(sweep, GRID), (sweep.t_ns or 0) / 1e9
        view, detections, odds = _seen("top", leveled, t_s)
        tracks = tracker.step(t_s, detections, view.view, false_odds=odds)
        explained = fusion.explain(tracks, detections, [view])
        found.times.append(t_s)
        found.detections.append(len(detections))
        shown = explained.tracks
        is_hit = shown.detection >= 0
        found.confirmed |= set(shown.ids[shown.confirmed].tolist())
        found.continued |= set(shown.ids[shown.confirmed & is_hit & (shown.seen_s > shown.born_s)].tolist())
        found.accused |= set(shown.ids[shown.confirmed & explained.accused].tolist())
        found.why.update(explained.explanations[shown.confirmed & ~is_hit].tolist())
    return found


def _seen(name: str, leveled: LeveledSweep, t_s: float) -> tuple[SensorView, Detections, Floats]:
    """Return the view of a sweep, its detections in the frame of the tracks, and the odds that these are false."""
    estimate = load_estimator(DEFAULT_ESTIMATOR, grid=GRID).estimate(leveled)
    here = Detector().detect(leveled)
    odds = detection_table().false_odds(np.hypot(here.boxes[:, 0], here.boxes[:, 1]), here.kinds)
    pose = leveled.world_from_level or Rigid.identity()
    view = BeamView(leveled, t_s, found=detection_table().prob)
    return SensorView(name, view, pose.translation[:2], SeenCells.of(estimate), yaw=pose.yaw), here.moved(pose), odds


_RIG = (
    "A Pandar64 on the roof and two LiDARs at the sides, rolled by about 45°, one sweep of each at three places. Their"
    f" rough extrinsics (yaw alone) were aligned by the surfaces that both see, within 4° and 1.5 m. Each sweep is"
    f" given {REPEATS} times at 10 Hz, as if the car stood. {GHOSTS} boxes of cars are fabricated at random places"
    f" within {GHOST_WITHIN_M:g} m. *Honest accused*: of the confirmed tracks of the detector. *Blind*: cells within 5"
    " m that no sensor calls free or obstacle."
)


def _of_rig(places: Sequence[Path]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of what the side sensors add."""
    rows = []
    for place in places:
        top = _standing(next(place.glob("top*.pcd")), Rigid.identity())
        estimate = load_estimator(DEFAULT_ESTIMATOR, grid=GRID).estimate(top)
        sides = []
        for name, yaw_deg in SIDES.items():
            side, score = _aligned(next(place.glob(f"{name}*.pcd")), yaw_deg, estimate)
            sides.append((name, side, score))
        for names in ((), tuple(SIDES)):
            used = [(name, side) for name, side, _ in sides if name in names]
            explained, ghosts, blind = _stand(top, used)
            honest = ~ghosts & explained.tracks.confirmed & ~explained.held
            found, false = explained.accused[ghosts].sum(), explained.accused[honest].sum()
            rows.append([
                place.name, "top and sides" if names else "top", f"{blind:.2f}",
                f"{found} of {ghosts.sum()}", f"{false} of {honest.sum()}",
                ", ".join(f"{score:.2f}" for _, _, score in sides) if names else "–",
            ])  # fmt: skip
    return ["place", "views", "blind", "fabricated found", "honest accused", "surfaces that agree"], rows


def _standing(path: Path, world_from_level: Rigid) -> LeveledSweep:
    """Return a sweep whose ``level`` frame has this pose; its attitude is that of the ground."""
    sweep = viewshed.read_sweep(path)
    pose = world_from_level @ level(sweep, GRID).level_from_sensor
    return level(sweep.replace(world_from_sensor=pose, t_ns=0), GRID)


def _aligned(path: Path, yaw_deg: float, top: FovEstimate) -> tuple[LeveledSweep, float]:
    """Return a side's sweep with the pose that brings most of its surfaces to those of the top, and their share."""
    alone = _standing(path, Rigid.identity())
    estimate = load_estimator(DEFAULT_ESTIMATOR, grid=GRID).estimate(alone)
    surface = GRID.centers[estimate.state == CellState.SURFACE]
    is_surface = top.state == CellState.SURFACE
    best, pose = -1.0, Rigid.identity()
    for turn_deg in yaw_deg + _SEARCH_DEG:
        turned = surface @ Rigid.from_yaw(np.deg2rad(turn_deg)).rotation[:2, :2].T
        for x_m in _SEARCH_M:
            for y_m in _SEARCH_M:
                cells, inside = GRID.index(turned + np.array([x_m, y_m]))
                share = float((is_surface[cells[:, 0], cells[:, 1]] & inside).mean())
                if share > best:
                    best, pose = share, Rigid.from_yaw(np.deg2rad(turn_deg), (x_m, y_m, 0.0))
    return _standing(path, pose), best


def _stand(
    top: LeveledSweep, sides: Sequence[tuple[str, LeveledSweep]]
) -> tuple[ExplainedTracks, NDArray[np.bool_], float]:
    """Return the tracks of a standing car with fabricated boxes, which are fabricated, and the share that is blind."""
    rng = np.random.default_rng(SEED)
    view, honest, odds = _seen("top", top, 0.0)
    others = [(name, *_seen(name, side, 0.0)) for name, side in sides]
    away, way = rng.uniform(4.0, GHOST_WITHIN_M, GHOSTS), rng.uniform(-np.pi, np.pi, GHOSTS)
    boxes = np.column_stack([
        away * np.cos(way), away * np.sin(way), np.full(GHOSTS, 0.75), np.tile([4.2, 1.8, 1.5], (GHOSTS, 1)),
        rng.uniform(-np.pi, np.pi, GHOSTS),
    ])  # fmt: skip
    # Fabricated boxes keep clear of honest ones and of each other.
    kept = list[int]()
    for k in range(GHOSTS):
        taken = np.concatenate([honest.boxes[:, :2], boxes[kept, :2]])
        if np.hypot(*(taken - boxes[k, :2]).T).min(initial=np.inf) > 5.0:
            kept.append(k)
    count = len(kept)
    both = Detections(
        np.concatenate([honest.boxes, boxes[kept]]),
        np.concatenate([honest.kinds, np.full(count, ObjectKind.CAR, np.uint8)]),
        np.concatenate([honest.returns, np.full(count, 50, np.int32)]),
    )
    tracker, fusion = Tracker(), SingleFusion()
    for k in range(REPEATS):
        t_s = 0.1 * k
        second = (_at(other[1], side, t_s) for other, (_, side) in zip(others, sides, strict=True))
        views = [_at(view, top, t_s), *second]
        tracks = tracker.step(t_s, both, views[0].view, false_odds=np.append(odds, np.full(count, 0.1)))
        explained = fusion.explain(tracks, both, views)
    near = GRID.centers[np.hypot(GRID.centers[..., 0], GRID.centers[..., 1]) < 5.0]
    known = np.zeros(len(near), np.bool_)
    for each in views:
        if each.cells is not None:
            known |= np.isin(each.cells.states_at(near), (CellState.FREE, CellState.SURFACE))
    return explained, explained.tracks.detection >= len(honest), float(1.0 - known.mean())


def _at(view: SensorView, leveled: LeveledSweep, t_s: float) -> SensorView:
    """Return the same view at another time."""
    return SensorView(
        view.sensor, BeamView(leveled, t_s, found=detection_table().prob), view.place, view.cells, yaw=view.yaw
    )


if __name__ == "__main__":
    main()
