"""The detector against simulated truth, against clusters of scikit-learn, and against boxes of real recordings.

``python -m benchmarks.detector [--drives N] [--real FOLDER ...] [--page FILE]`` writes docs/results/detector.md. The
drives have seeds that neither the fit nor the table of the detector has seen. A real recording is a folder of a data
set with boxes, as its makers hand it out; only what lies within 40° of ahead is compared, which KITTI's camera saw.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from sklearn.cluster import DBSCAN, HDBSCAN

from viewshed import _core
from viewshed.detections import Detections, ObjectKind
from viewshed.grid import GRIDS
from viewshed.objects.completion import complete_boxes
from viewshed.objects.detection_table import detection_table
from viewshed.objects.detector import Detector
from viewshed.objects.matching import match_boxes
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.recordings.read import open_source
from viewshed_lab._page import facts, page, table
from viewshed_lab.data.detector_counts import FARTHEST_M, FEWEST_RETURNS, Score, score
from viewshed_lab.data.object_truth import ROAD_WORLDS, ObjectSweep, SweepObjects, road_sweeps
from viewshed_lab.studies.detection_picture import draw_detections

PAGE = Path(__file__).resolve().parents[3] / "docs" / "results" / "detector.md"

SENSORS = ("hdl64e", "hdl32e", "os1_64", "vlp16")

SEED = 200_000
"""Of the first drive; each sensor has drives of its own from there on."""

KINDS = (ObjectKind.CAR, ObjectKind.TRUCK, ObjectKind.PEDESTRIAN, ObjectKind.CYCLIST)

TARGETS = {"recall": 0.92, "precision": 0.85, "35k": 3.0, "120k": 6.0}

RETURNS_AT = (1, 5, 20, 50, 150, 100_000)

RANGE_AT_M = (0, 10, 20, 30, 40, 60)

HDBSCAN_EVERY = 4
"""HDBSCAN takes so long that it sees every fourth sweep."""

AHEAD = np.deg2rad(40.0)

_CATEGORIES = {"car", "van", "vehicle.car"}

_CELL_M, _STANDING_M = 0.2, (0.3, 3.0)

_CAR_LENGTH_M, _CAR_WIDTH_M, _CAR_TOP_M = (1.2, 6.5), (0.0, 2.6), (0.8, 2.8)

Find = Callable[[LeveledSweep], Detections]


@dataclass(slots=True)
class Result:
    """What one method did with the sweeps of one sensor."""

    scores: defaultdict[ObjectKind, Score] = field(default_factory=lambda: defaultdict(Score))
    milliseconds: list[float] = field(default_factory=list)
    points: list[int] = field(default_factory=list)


def main(words: Sequence[str] | None = None) -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.detector", description=__doc__)
    parser.add_argument("--drives", type=int, default=26, help="of each sensor, two sweeps each")
    parser.add_argument("--real", type=Path, nargs="*", default=[], help="folders of data sets with boxes")
    parser.add_argument("--page", type=Path, default=PAGE)
    chosen = parser.parse_args(words)
    load = os.getloadavg()[0]
    _core.set_threads(1)
    detector = Detector()
    methods: dict[str, tuple[Find, int]] = {
        "viewshed": (detector.detect, 1),
        "DBSCAN": (lambda leveled: _by_size(leveled, DBSCAN(eps=0.7, min_samples=3)), 1),
        "HDBSCAN": (lambda leveled: _by_size(leveled, HDBSCAN(min_cluster_size=8, copy=True)), HDBSCAN_EVERY),
    }
    results = {name: defaultdict[str, Result](Result) for name in methods}
    by_class = np.zeros((2, len(RETURNS_AT) - 1, len(RANGE_AT_M) - 1), np.int64)
    by_world: defaultdict[str, Score] = defaultdict(Score)
    for number, sensor in enumerate(SENSORS):
        for k, each in enumerate(road_sweeps(SEED + 1000 * number, chosen.drives, (sensor,))):
            for name, (find, every) in methods.items():
                if k % every == 0:
                    _run(find, each, results[name][sensor])
            found = detector.detect(each.leveled)
            _count(found, each.objects, by_class)
            by_world[each.world] += score(found, each.objects)
        print(sensor, {name: _cells(results[name][sensor].scores[ObjectKind.CAR]) for name in methods}, flush=True)
    real = [_judge(place, detector) for place in chosen.real]
    worlds = f"{chosen.drives} drives a sensor from seed {SEED} on, in {', '.join(dict.fromkeys(ROAD_WORLDS))}"
    provenance = facts(
        worlds=worlds, load=f"{load:.1f} in the minute before, on all cores",
        detector=f"fitted and its table measured on other seeds: {detection_table().about['worlds']}",
    )  # fmt: skip
    parts = (
        f"![What is found in one simulated sweep, over its true boxes]({chosen.page.stem}.png)",
        *_of_cars(results),
        *_of_kinds(results),
        *_of_classes(by_class),
        *_of_worlds(by_world),
        *_of_real(real),
    )
    picture = chosen.page.with_suffix(".png")
    picture.write_bytes(_picture(detector))
    chosen.page.write_text(page("Detector", provenance, *parts), encoding="utf-8")


def _picture(detector: Detector) -> bytes:
    """Return a picture of one sweep of an HDL-64E at a junction, with its true boxes and what is found."""
    *_, each = road_sweeps(SEED + 5000, 2, ("hdl64e",))
    seen = each.objects.take(each.objects.returns > 0)
    title = f"HDL-64E, {each.world}, simulated: found (outlines) over true boxes with returns (green)"
    return draw_detections(each.leveled, detector.detect(each.leveled), seen.boxes, title=title)


def _run(find: Find, each: ObjectSweep, result: Result) -> None:
    """Run a method on a sweep, three times, the fastest counts, and score it."""
    times = []
    for _ in range(3):
        began = time.thread_time()
        found = find(each.leveled)
        times.append(1e3 * (time.thread_time() - began))
    result.milliseconds.append(min(times))
    result.points.append(len(each.leveled.points))
    for kind in KINDS:
        result.scores[kind] += score(found, each.objects, kind)


def _by_size(leveled: LeveledSweep, clusters: DBSCAN | HDBSCAN) -> Detections:
    """Return the cars among clusters of cells: minimum rotated rectangles of a car's size, completed as ours are."""
    # 1. One point for each cell of .2 m, so that it takes seconds and not minutes; clusters of these.
    standing = (leveled.height_m >= _STANDING_M[0]) & (leveled.height_m < _STANDING_M[1])
    xy, height_m = leveled.points[standing, :2], leveled.height_m[standing]
    if len(xy) < 20:
        return Detections.none()
    _, first, cell = np.unique(np.floor(xy / _CELL_M).astype(np.int32), axis=0, return_index=True, return_inverse=True)
    label = clusters.fit_predict(xy[first])[cell.reshape(-1)]
    # 2. The rectangle of each, and its sides as the detector has them.
    sides, tops, returns = [], [], []
    for name in range(label.max() + 1):
        own = xy[label == name].astype(np.float64)
        corners = shapely.get_coordinates(shapely.oriented_envelope(shapely.multipoints(own)))
        if len(corners) != 5:
            continue
        steps = np.diff(corners, axis=0)[:2]
        long = steps[int(np.hypot(*steps[1]) > np.hypot(*steps[0]))]
        heading = np.arctan2(long[1], long[0])
        c, s = np.cos(heading), np.sin(heading)
        along, across = own @ (c, s), own @ (-s, c)
        sides.append((heading, along.min(), along.max(), across.min(), across.max(), 0.0))
        tops.append(height_m[label == name].max())
        returns.append(len(own))
    # 3. Those of a car's size; one shorter than a car is wide is an end.
    rows, top_m = np.array(sides, np.float32).reshape(-1, 6), np.array(tops, np.float32)
    length_m, width_m = rows[:, 2] - rows[:, 1], rows[:, 4] - rows[:, 3]
    limits = ((length_m, _CAR_LENGTH_M), (width_m, _CAR_WIDTH_M), (top_m, _CAR_TOP_M))
    is_car = np.logical_and.reduce([(value >= low) & (value <= high) for value, (low, high) in limits])
    middle = np.stack([rows[:, 1] + rows[:, 2], rows[:, 3] + rows[:, 4]])
    is_end = (length_m < 2.3) & (np.abs(middle[1]) > np.abs(middle[0]))
    kinds = np.full(int(is_car.sum()), ObjectKind.CAR, np.uint8)
    boxes = complete_boxes(rows[is_car], kinds, is_end[is_car], top_m[is_car])
    return Detections(boxes, kinds, np.array(returns, np.int32)[is_car])


def _count(found: Detections, objects: SweepObjects, by_class: NDArray[np.int64]) -> None:
    """Add the cars of a sweep to (found, all) by returns and range."""
    cars = objects.take(objects.kinds == ObjectKind.CAR)
    match = match_boxes(found.boxes[found.kinds == ObjectKind.CAR], cars.boxes)
    is_found = np.isin(np.arange(len(cars)), match)
    row = np.searchsorted(RETURNS_AT, cars.returns, "right") - 1
    column = np.searchsorted(RANGE_AT_M, cars.range_m, "right") - 1
    inside = (row >= 0) & (column < len(RANGE_AT_M) - 1)
    np.add.at(by_class[0], (row[inside & is_found], column[inside & is_found]), 1)
    np.add.at(by_class[1], (row[inside], column[inside]), 1)


@dataclass(frozen=True, slots=True)
class RealResult:
    """Cars of a real recording, within 40° of ahead."""

    name: str
    sweeps: int
    score: Score


def _judge(place: Path, detector: Detector) -> RealResult:
    """Return how the detector agrees with the annotated cars of a recording."""
    total, sweeps = Score(), 0
    for leveled, objects in _annotated(place):
        found = detector.detect(leveled)
        total += score(found.take(_is_ahead(found.boxes)), objects.take(_is_ahead(objects.boxes)))
        sweeps += 1
    return RealResult(place.name, sweeps, total)


def _is_ahead(boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.abs(np.arctan2(boxes[:, 1], boxes[:, 0])) <= AHEAD)


def _annotated(place: Path) -> Iterator[tuple[LeveledSweep, SweepObjects]]:
    """Yield the annotated sweeps of a recording, leveled, with their cars; returns are those in the boxes."""
    source = open_source(place)
    for ref in (ref for scene in source.scenes() for ref in source.refs(scene) if ref.keyframe):
        annotated = source.boxes(ref)
        if annotated is None:
            continue
        leveled = level(source.read(ref), GRIDS["road"])
        from_world = (
            leveled.level_from_sensor if leveled.world_from_level is None else leveled.world_from_level.inverse()
        )
        cars = [box for box in annotated if box.category.lower() in _CATEGORIES]
        poses = [from_world @ box.world_from_box for box in cars]
        boxes = np.array(
            [(*pose.translation, *box.size_m, pose.yaw) for pose, box in zip(poses, cars, strict=True)]
        ).reshape(-1, 7)
        kinds = np.full(len(boxes), ObjectKind.CAR, np.uint8)
        returns = np.array([_returns_in(leveled, box) for box in boxes], np.int32)
        yield leveled, SweepObjects(boxes, kinds, returns, np.arange(len(boxes)))


def _returns_in(leveled: LeveledSweep, box: NDArray[np.float64]) -> int:
    """Return how many returns from .2 m above the ground on lie in a box."""
    x, y = (leveled.points[:, :2] - box[:2]).T
    c, s = np.cos(box[6]), np.sin(box[6])
    inside = (np.abs(x * c + y * s) < box[3] / 2) & (np.abs(y * c - x * s) < box[4] / 2) & (leveled.height_m > 0.2)
    return int(inside.sum())


def _cells(total: Score) -> list[str]:
    return [f"{total.recall:.3f}", f"{total.precision:.3f}", f"{total.overlap_recall:.3f}"]


def _of_cars(results: dict[str, defaultdict[str, Result]]) -> Iterator[str]:
    yield (
        f"Cars with at least {FEWEST_RETURNS} returns within {FARTHEST_M:g} m: found if a car was detected within 2 m"
        " of their center. A detection within 40 m is right if it is matched with a car, however few returns that gave;"
        " the second one of a car is wrong. Overlap: share of these cars with a detected box of intersection over union"
        " of .3 from above. Milliseconds: of the processor, on one thread, median over sweeps, after leveling: what"
        " other processes take is not counted. DBSCAN and HDBSCAN (scikit-learn) group one point for each cell of .2 m;"
        " a rectangle of a car's size is a car. HDBSCAN sees every fourth sweep."
    )
    rows = []
    for name, by_sensor in results.items():
        whole = sum((result.scores[ObjectKind.CAR] for result in by_sensor.values()), Score())
        for sensor, result in by_sensor.items():
            points = f"{np.median(result.points) / 1e3:.0f}k"
            numbers = [str(result.scores[ObjectKind.CAR].wanted), *_cells(result.scores[ObjectKind.CAR])]
            rows.append([name, sensor, points, *numbers, f"{np.median(result.milliseconds):.1f}"])
        rows.append([f"**{name}**", "all", "", str(whole.wanted), *(f"**{cell}**" for cell in _cells(whole)), ""])
    yield table(["method", "sensor", "points", "cars", "recall", "precision", "overlap", "ms"], rows)
    ours = sum((result.scores[ObjectKind.CAR] for result in results["viewshed"].values()), Score())
    lines = [
        ["recall of cars", "≥ .92", f"{ours.recall:.3f}", _verdict(ours.recall >= TARGETS["recall"])],
        ["precision of cars", "≥ .85", f"{ours.precision:.3f}", _verdict(ours.precision >= TARGETS["precision"])],
    ]
    for name, sensor in (("35k", "hdl32e"), ("120k", "hdl64e")):
        median_ms = float(np.median(results["viewshed"][sensor].milliseconds))
        target = f"≤ {TARGETS[name]:g} ms"
        lines.append(
            [f"time of one core, {name} points", target, f"{median_ms:.1f} ms", _verdict(median_ms <= TARGETS[name])]
        )
    yield table(["target", "", "measured", ""], lines)


def _verdict(is_met: bool) -> str:
    return "met" if is_met else "**missed**"


def _of_kinds(results: dict[str, defaultdict[str, Result]]) -> Iterator[str]:
    yield "## Every kind"
    rows = []
    for kind in KINDS:
        whole = sum((result.scores[kind] for result in results["viewshed"].values()), Score())
        rows.append([kind.name.lower(), str(whole.wanted), *_cells(whole)])
    yield table(["kind", "objects", "recall", "precision", "overlap"], rows)


def _of_classes(by_class: NDArray[np.int64]) -> Iterator[str]:
    yield "## Cars by returns and range"
    yield "Share of the cars that were found, and how many there were."
    names = [f"{low} to {high - 1}" for low, high in pairwise(RETURNS_AT[:-1])]
    names.append(f"{RETURNS_AT[-2]} and more")
    ranges = [f"{low} to {high} m" for low, high in pairwise(RANGE_AT_M)]
    rows = [
        [name, *(f"{found / count:.2f} ({count})" if count else "–" for found, count in zip(*pair, strict=True))]
        for name, *pair in zip(names, *by_class, strict=True)
    ]
    yield table(["returns", *ranges], rows)


def _of_worlds(by_world: dict[str, Score]) -> Iterator[str]:
    yield "## Cars by kind of world"
    rows = [[world, str(one.wanted), *_cells(one)] for world, one in sorted(by_world.items())]
    yield table(["world", "cars", "recall", "precision", "overlap"], rows)


def _of_real(real: list[RealResult]) -> Iterator[str]:
    yield "## Real boxes"
    if not real:
        yield "None were given (`--real FOLDER`)."
        return
    yield (
        f"Annotated cars and vans within 40° of ahead and {FARTHEST_M:g} m, with at least {FEWEST_RETURNS} returns .2 m"
        " above the ground in their box. What nobody annotated counts as wrong."
    )
    rows = [[each.name, str(each.sweeps), str(each.score.wanted), *_cells(each.score)] for each in real]
    yield table(["recording", "sweeps", "cars", "recall", "precision", "overlap"], rows)


if __name__ == "__main__":
    main()
