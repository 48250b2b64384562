"""Report how estimates of real sweeps change where they should not, and how views that overlap agree.

``python tools/stability.py INDEX.json [OUT.md] [RIG]`` reads every sweep of an index of real sweeps; RIG is a folder of
places at which several sensors of one car measured at once: a ``.pcd`` each and their poses, ``initial_extrinsic.txt``.
"""

from __future__ import annotations

import json
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from viewshed._page import facts, page, table
from viewshed.estimators import DEFAULT_ESTIMATOR, Estimator, load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid, quaternion_from_rotation, rotation_from_quaternion
from viewshed.io import IndexEntry, read_index, read_indexed, read_sweep, read_sweeps
from viewshed.metrics import Mask
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep

SEED = 0

STATIC = ("vlp16_packets/einride_recording.bin",)
"""Files of several revolutions by a sensor that stands still."""

METHODS = tuple(dict.fromkeys([DEFAULT_ESTIMATOR, "shadow_map", "viewnet"]))

WORST = 3

_SIDES = ("left", "right")
"""Sensors of the rig beside the one on the roof, in the order of their poses."""

_INDOORS = ("indoor", "office", "room")

ROAD, INDOOR = ("road", "car"), ("indoor", "pedestrian")
"""Grid and target of a sweep outdoors and indoors."""

Views = Mapping[str, Estimator]
"""Estimators by name, all on one grid."""

_INTRODUCTION = """\
Nothing here needs a truth: a view must not change where the same sensor looks at the same scene, however it is turned,
stored or thinned. *IoU*: cells claimed in both estimates over those claimed in either. Outdoors on the grid `road` for
a car, indoors on the grid `indoor` for a pedestrian. Sweeps in which neither estimate claims a cell are left out.

- **turned by 90°**: points, firing azimuths and attitude are turned about the sensor's axis, and the estimate is turned
  back.
- **half of the points**: a random half. Half of the beams have no return then, so that far targets get too few: even a
  right estimate changes.
- **without rings**: the ring column is left out of files that have one.
- **shuffled**: the rows in random order. A cloud without a ring column loses with the order what told its rings.
- **a static sensor**: each revolution against the next, estimated each by itself or as a stream."""

ALONE, STREAM = "a static sensor", "a static sensor, as a stream"

_TARGETS = {ALONE: 0.95, STREAM: 0.95, "turned by 90°": 0.985, "half of the points": 0.95, "without rings": 0.97}
"""The median IoU that is aimed at."""

_WORST = """\
The worst were looked at:

- **Rooms** (VLP-16 of `einride_recording`, XT32, OT128): no floor is seen, or less than half of it. Whether the few low
  returns are the floor is a yes or no that a turn, a thinned cloud or the next revolution changes, and with it the
  height of the sensor (0.3 m or 1 m, OT128 0.7 m or 2.6 m) and the whole view.
- **`data_1_0000000000`**, turned: its HDL-64E is no longer recognized, so that beams without a return are not inferred.
- **nuScenes scene-0103** (the first three), without rings or thinned: a wide junction on which the ground beyond 25 m
  rests on few returns; rings that are recovered by their elevations move some of them.
- **Half of the points** costs what is seen through narrow openings, between cars and through fences: beams that are
  missing there are taken to have ended at the nearer of their neighbors."""

_OVERLAP = """\
Three sensors on one car, {places} places: one upright on the roof, two at the sides that look down by about 45°, which
they must find themselves. Their poses are rough (half a meter, some degrees). *Both speak*: cells that both views call
visible or hidden. *Contradicted*: the share of these that one calls visible and the other hidden. The sensors do not
stand at one place, so that some of it is right. *Of the side's claims*: the share that the view from the roof claims
as well. *Height*: of the side's sensor above the ground, as it was found."""


@dataclass(frozen=True, slots=True, eq=False)
class RealSweep:
    """A sweep of the index.

    Attributes:
        name: of the file.
        place: grid and target.
        sweep: what was measured.
    """

    name: str
    place: tuple[str, str]
    sweep: Sweep


def turned(sweep: Sweep, _rng: np.random.Generator) -> Sweep:
    """Return a sweep turned by 90° about the sensor's axis, counter-clockwise."""
    x, y, z = sweep.points.T
    back = Rigid.from_yaw(-np.pi / 2)
    pose, attitude, yaw = sweep.world_from_sensor, sweep.attitude, sweep.vehicle_yaw
    if attitude is not None:
        # The level axes turn with the sensor's.
        attitude = quaternion_from_rotation(back.rotation.T @ rotation_from_quaternion(attitude) @ back.rotation)
    return sweep.replace(
        points=np.stack([-y, x, z], axis=1),
        azimuth=None if sweep.azimuth is None else (sweep.azimuth + 1.5 * np.pi) % (2 * np.pi) - np.pi,
        attitude=attitude,
        world_from_sensor=None if pose is None else pose @ back,
        vehicle_yaw=None if yaw is None else yaw + np.pi / 2,
    )


def halved(sweep: Sweep, rng: np.random.Generator) -> Sweep:
    """Return a random half of a sweep, in its order."""
    return sweep.select(np.sort(rng.permutation(len(sweep))[: len(sweep) // 2]))


def without_rings(sweep: Sweep, _rng: np.random.Generator) -> Sweep | None:
    """Return a sweep without its ring column; None where it has none."""
    return None if sweep.ring is None else sweep.replace(ring=None)


def shuffled(sweep: Sweep, rng: np.random.Generator) -> Sweep:
    """Return a sweep with its rows in random order."""
    return sweep.select(rng.permutation(len(sweep)))


CHANGES: dict[str, Callable[[Sweep, np.random.Generator], Sweep | None]] = {
    "turned by 90°": turned,
    "half of the points": halved,
    "without rings": without_rings,
    "shuffled": shuffled,
}


def iou(one: Mask, other: Mask) -> float:
    """Return the cells of both masks over those of either; NaN where there are none."""
    either = np.count_nonzero(one | other)
    return np.count_nonzero(one & other) / either if either else float("nan")


def changed_ious(real: RealSweep, views: Views, rng: np.random.Generator) -> dict[tuple[str, str], float]:
    """Return the IoU of a sweep's claims with those after each change, by change and estimator."""
    before = {name: view.estimate(real.sweep).visible() for name, view in views.items()}
    found = {}
    for change, make in CHANGES.items():
        sweep = make(real.sweep, rng)
        if sweep is not None:
            for name, view in views.items():
                claimed = view.estimate(sweep).visible()
                # The first axis of a mask is x, the second y: turned back means from +y to +x.
                back = np.rot90(claimed, -1) if make is turned else claimed
                found[change, name] = iou(before[name], back)
    return found


def static_ious(sweeps: Sequence[Sweep], views: Views) -> dict[tuple[str, str], list[float]]:
    """Return the IoU of each revolution's claims with the next one's, each by itself and as a stream, by estimator."""
    masks = {(ALONE, name): [view.estimate(sweep).visible() for sweep in sweeps] for name, view in views.items()}
    for name, view in views.items():
        masks[STREAM, name] = [estimate.visible() for estimate in view.stream(sweeps)]
    return {key: [iou(one, other) for one, other in pairwise(each)] for key, each in masks.items()}


@dataclass(frozen=True, slots=True)
class Overlap:
    """How two views of one scene agree.

    Attributes:
        both_speak_m2: where both call visible or hidden.
        contradicted: share of it that one calls visible and the other hidden.
        confirmed: share of the first one's claims that the second claims as well.
        height_m: of the first one's sensor above the ground.
    """

    both_speak_m2: float
    contradicted: float
    confirmed: float
    height_m: float

    @classmethod
    def of(cls, side: FovEstimate, roof: FovEstimate, roof_from_side: Rigid, height_m: float) -> Overlap:
        """Return how a view agrees with another one, given the pose of the one's level frame in the other's."""
        grid = side.grid
        centers = np.concatenate([grid.centers, np.zeros((*grid.shape, 1))], axis=-1).reshape(-1, 3)
        cells, inside = roof.grid.index((roof_from_side @ centers)[:, :2])
        other = np.where(inside, roof.state[cells[:, 0], cells[:, 1]], CellState.UNKNOWN).reshape(grid.shape)
        claims, denies, claims_too, denies_too = (
            mask
            for state in (side.state, other)
            for mask in (np.isin(state, (CellState.FREE, CellState.SURFACE)), state == CellState.HIDDEN)
        )
        both_speak = (claims | denies) & (claims_too | denies_too)
        against = (claims & denies_too) | (denies & claims_too)
        return cls(
            float(both_speak.sum()) * grid.cell_area_m2,
            against.sum() / max(int(both_speak.sum()), 1),
            (claims & claims_too).sum() / max(int(claims.sum()), 1),
            height_m,
        )


def extrinsics_of(text: str) -> list[Rigid]:
    """Return the poses of the sensors of a rig, roof from sensor: roll, pitch and yaw in degrees, x, y and z a line."""
    poses = []
    for line in re.findall(r"^\(Roll.*?\): *(.*)$", text, re.MULTILINE):
        _, _, yaw, x, y, z = map(float, line.split())
        poses.append(Rigid.from_yaw(np.deg2rad(yaw), (x, y, z)))
    return poses


def overlaps(folder: Path, views: Views) -> dict[tuple[str, str, str], Overlap]:
    """Return how the side views of each place of a rig agree with that from the roof, by place, side and estimator."""
    found = {}
    for place in sorted(path for path in folder.iterdir() if (path / "initial_extrinsic.txt").exists()):
        poses = extrinsics_of((place / "initial_extrinsic.txt").read_text("utf-8"))
        top, *sides = (read_sweep(next(place.glob(f"{name}*.pcd"))) for name in ("top", *_SIDES))
        for method, view in views.items():
            roof = view.estimate(top)
            for name, sweep, pose in zip(_SIDES, sides, poses[1:], strict=True):
                leveled = level(sweep, view.grid)
                found[place.name, name, method] = Overlap.of(
                    view.estimate(leveled), roof, pose, leveled.sensor_height_m
                )
    return found


def real_sweeps(index: Path) -> Iterator[tuple[IndexEntry, RealSweep]]:
    """Yield the sweeps of an index that can be read, the first of each file."""
    environments = {entry["file"]: entry["environment"] for entry in json.loads(index.read_text("utf-8"))}
    folder = index.resolve().parent
    for entry in read_index(index):
        name = str(entry.file.relative_to(folder))
        inside = any(word in environments[name] for word in _INDOORS)
        try:
            yield entry, RealSweep(name, INDOOR if inside else ROAD, read_indexed(entry))
        except (ValueError, OSError) as error:
            sys.stderr.write(f"{name}: {error}\n")


def _views(place: tuple[str, str]) -> dict[str, Estimator]:
    grid, target = place
    return {name: load_estimator(name, grid=grid, target=target) for name in METHODS}


def summary(what: str, method: str, ious: Sequence[tuple[str, float]]) -> list[str]:
    """Return the line of a table: median, the worst with their names, and whether the median meets its target."""
    ranked = sorted(((value, name) for name, value in ious if not np.isnan(value)), key=lambda pair: pair[0])
    median, target = float(np.median([value for value, _ in ranked])), _TARGETS.get(what)
    worst = ", ".join(f"{value:.3f} {name}" for value, name in ranked[:WORST])
    said = "–" if target is None else "met" if median >= target else "**missed**"
    aim = "–" if target is None else f"≥ {target:g}"
    return [what, method, str(len(ranked)), f"{median:.3f}", aim, said, worst]


def report(index: Path, rig: Path | None) -> str:
    """Return the page."""
    views = {place: _views(place) for place in (ROAD, INDOOR)}
    found: dict[tuple[str, str], list[tuple[str, float]]] = defaultdict(list)
    for number, (entry, real) in enumerate(real_sweeps(index)):
        rng = np.random.Generator(np.random.PCG64([SEED, number]))
        if real.name in STATIC:
            for place in (real.place, ROAD):
                for key, ious in static_ious(list(read_sweeps(entry.file)), views[place]).items():
                    names = [f"{real.name} {k} to {k + 1}, {place[0]}" for k in range(len(ious))]
                    found[key] += zip(names, ious, strict=True)
        for key, value in changed_ious(real, views[real.place], rng).items():
            found[key].append((real.name, value))
        sys.stderr.write(f"{real.name}\n")
    changes = [ALONE, STREAM, *CHANGES]
    rows = [summary(*key, ious) for key, ious in sorted(found.items(), key=lambda item: changes.index(item[0][0]))]
    parts = [
        _INTRODUCTION,
        table(["change", "method", "pairs", "median IoU", "target", "", "worst"], rows),
        _WORST,
    ]
    if rig is not None:
        agreed = overlaps(rig, views[ROAD])
        lines = [
            [*key, f"{one.height_m:.2f}", f"{one.both_speak_m2:.0f}", f"{one.contradicted:.3f}", f"{one.confirmed:.3f}"]
            for key, one in agreed.items()
        ]
        header = ["place", "side", "method", "height, m", "both speak, m²", "contradicted", "of the side's claims"]
        places = len({place for place, _, _ in agreed})
        parts += ["## Views that overlap", _OVERLAP.format(places=places), table(header, lines)]
    return page("Stability on real sweeps", facts(seed=str(SEED), default=DEFAULT_ESTIMATOR), *parts)


def main() -> None:
    """Write the report."""
    index = Path(sys.argv[1])
    out = Path(sys.argv[2] if len(sys.argv) > 2 else "docs/results/stability.md")
    out.write_text(report(index, Path(sys.argv[3]) if len(sys.argv) > 3 else None), "utf-8")


if __name__ == "__main__":
    main()
