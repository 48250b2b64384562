"""The label of one sweep: what it could have seen, from the sweep and those around it in time.

The sweeps of one sensor in time order, and what those around each of them say about the ground.

The definitions themselves are counted, in whole beams, with the loops of the exact truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Generic, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from viewshed import _core
from viewshed.arrays import F32, Mask
from viewshed.fov.truth import Truth
from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS, BevGrid, polar_of_cells
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab._config import Between, Checked, OneOf
from viewshed_lab.data.labeling.beam_ends import OPEN, SURFACE, BeamEnds, beam_ends_of
from viewshed_lab.data.labeling.beam_image import BeamImage, Drift, StampedPose, beam_image, drift_of, well_spaced
from viewshed_lab.data.labeling.ground_map import NODES_PER_HALF, Lows, Patch, lows_of, patch_of
from viewshed_lab.sim.truth.beam_lines import BeamLines
from viewshed_lab.sim.truth.count import count_targets, reached_and_states
from viewshed_lab.sim.truth.definitions import BLOCKS, RETURNS, stop_limits
from viewshed_lab.sim.truth.exact import MAX_BINS

Definition = Literal["probe", "farthest", "first_blocker"]

DEFINITIONS: tuple[Definition, ...] = get_args(Definition)
"""For which of them a label can say where it is known; it holds the masks of all."""

TARGETS: tuple[Target, Target] = (CAR, PEDESTRIAN)

EGO_BOX_M, EGO_HEIGHTS_M = (_core.EGO_LENGTH_M, _core.EGO_WIDTH_M), (_core.LEAST_EGO_HEIGHT_M, _core.MOST_EGO_HEIGHT_M)
"""Half length and half width of the vehicle below the sensor, and heights of a sensor at which one is assumed."""

MANY_BEAMS = 50
"""A target that more beams reach is seen whatever the ground and the missing beams."""

GROUND_M, GROUND_PER_M, GROUND_MOST_M = 0.03, 0.03, 0.4
"""Error that the ground may have where it was seen, its growth for each meter from there, and its maximum."""

LOWS_REACH = 1.5
"""Returns help to find the ground up to so far from the sensor, in half sides of the grid."""


@dataclass(frozen=True, slots=True)
class LabelRules(Checked):
    """How sweeps are labeled.

    Raises:
        ValueError: a value is out of range.
    """

    grid: BevGrid = GRIDS["road"]  # where the cells are
    definition: Definition = "probe"  # what ``known`` is about
    target: Annotated[str, OneOf(("car", "pedestrian"))] = "car"  # what would have to be seen, for ``probe``
    # sweeps before and after one that help to label it, at most; 0 labels each sweep by itself
    neighbors: Annotated[int, Between(0, 1000)] = 20

    @property
    def node_m(self) -> float:
        """Side of the nodes on which ground is kept: 1 m on roads."""
        return self.grid.half_extent_m / NODES_PER_HALF


def lows_of_sweep(sweep: Sweep, rules: LabelRules) -> Lows:
    """Return the lowest returns of ``sweep`` in the world, or in its own ``level`` frame if it has no pose."""
    return _lows_of_level(level(sweep, rules.grid), rules)


def label_sweep(sweep: Sweep, drift: Drift, around: Sequence[Lows], rules: LabelRules) -> tuple[Truth, Mask]:
    """Return the label of a sweep and where it is trusted (cells, cells).

    The probe is counted on every beam of the sensor's pattern, over the ground of all sweeps around. It is trusted
    where the count is on the same side of the target's least number of returns whatever became of the missing beams
    and whether the ground is a little higher or lower.

    Args:
        sweep: a benign one.
        drift: how the sensor moved within it.
        around: lows of the sweeps around it, in the same world; its own are added.
        rules: how.
    """
    leveled = level(sweep, rules.grid)
    image = beam_image(sweep, leveled.level_from_sensor.rotation, drift)
    patch = patch_of(leveled, (*around, _lows_of_level(leveled, rules)), rules.grid.half_extent_m, rules.node_m)
    has_vehicle = EGO_HEIGHTS_M[0] <= leveled.sensor_height_m <= EGO_HEIGHTS_M[1]
    return _Labeling(rules, image, patch, beam_ends_of(image, patch), has_vehicle).result()


def _lows_of_level(leveled: LeveledSweep, rules: LabelRules) -> Lows:
    pose = leveled.world_from_level or Rigid.identity()
    return lows_of(leveled.points, pose, rules.node_m, LOWS_REACH * rules.grid.half_extent_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Labeling:
    """One sweep on its way to its label."""

    rules: LabelRules  # how it is labeled
    image: BeamImage  # its beams
    patch: Patch  # the ground about it
    ends: BeamEnds  # where its beams ended
    has_vehicle: bool  # whether a vehicle is assumed below the sensor

    def result(self) -> tuple[Truth, Mask]:
        """Return the label and where it is trusted."""
        grid = self.rules.grid
        ground = self.patch.at(grid.centers.reshape(-1, 2))
        lines = self._lines(self.ends.best_m)
        things = self._things()
        reached, state = reached_and_states(lines, things.reshape(-1), ground, grid, TARGETS)
        definitions, returned = self._definitions(lines, things)
        known = self._sure(reached, ground) if self.rules.definition == "probe" else returned
        return Truth(grid, reached, state, definitions), known & ~self._own()

    def _lines(self, depth_m: F32) -> BeamLines:
        """Return the beams of the sweep, which ended at depths (C, R)."""
        return BeamLines.of(self.image.origin_m, self.image.direction, depth_m, self.image.max_range_m)

    def _things(self) -> Mask:
        """Return which beams (C, R) ended on a thing that is not the own vehicle."""
        things: Mask = self.ends.thing | (self.ends.kind == SURFACE)
        if not self.has_vehicle:
            return things
        end = self.image.origin_m[..., :2] + self.image.direction[..., :2] * self.ends.best_m[..., None]
        own = np.asarray((np.abs(end) < EGO_BOX_M).all(axis=-1))
        return things & ~own

    def _definitions(self, lines: BeamLines, things: Mask) -> tuple[dict[str, Mask], Mask]:
        """Return the other definitions (cells, cells), and the cells whose azimuth bin has a return.

        Ground gives light back: a beam that nothing stopped before it counts as a return from there, though the sensor
        was too weak to get it. A bin without any return of its own is not known.
        """
        grid, kind = self.rules.grid, self.ends.kind
        bins = min(self.image.pixels.shape[0], MAX_BINS)
        stored = (self.image.returned & (kind == 0)) * np.uint8(RETURNS)
        ground = (kind == OPEN) & (self.ends.best_m < np.float32(self.image.max_range_m))
        flags = things * np.uint8(BLOCKS) + np.maximum(stored, ground * np.uint8(RETURNS))
        farthest, blocker = stop_limits(lines.lines, flags.reshape(-1), bins)
        returned = stop_limits(lines.lines, stored.reshape(-1), bins)[0] >= 0
        range_m, azimuth = polar_of_cells(grid)
        index = np.clip((azimuth + np.float32(np.pi)) * np.float32(bins / (2 * np.pi)), 0, bins - 1).astype(np.intp)
        inside = range_m <= farthest[index]
        before = inside & (range_m - np.float32(grid.cell_m) <= blocker[index])
        return {"farthest": inside, "first_blocker": before}, returned[index]

    def _sure(self, reached: dict[str, NDArray[np.uint8]], ground: F32) -> Mask:
        """Return where (cells, cells) the probe does not hang on missing beams or on the ground."""
        rules, grid = self.rules, self.rules.grid
        target = next(one for one in TARGETS if one.name == rules.target)
        counts = reached[target.name].reshape(-1)
        doubtful = counts <= max(MANY_BEAMS, 4 * target.min_returns)
        seen = self.patch.seen(grid.centers.reshape(-1, 2)).reshape(grid.shape)
        away = distance_transform_edt(~seen) * grid.cell_m if seen.any() else np.full(grid.shape, np.inf)
        wrong = np.minimum(GROUND_M + GROUND_PER_M * away, GROUND_MOST_M).astype(np.float32).reshape(-1)
        verdicts = []
        for depth in (self.ends.least_m, self.ends.most_m):
            lines = self._lines(depth)
            for height in (ground - wrong, ground + wrong):
                again = count_targets(lines, grid, height, TARGETS, doubtful)[target.name][1]
                verdicts.append((again >= target.min_returns) == (counts >= target.min_returns))
        sure: Mask = np.all(verdicts, axis=0) | ~doubtful
        return sure.reshape(grid.shape)

    def _own(self) -> Mask:
        """Return the cells (cells, cells) of the own vehicle, and those nearer than the sensor moved."""
        grid = self.rules.grid
        moved = np.sqrt((self.image.origin_m[..., :2] ** 2).sum(axis=-1).max())
        own: Mask = polar_of_cells(grid)[0] <= moved
        if self.has_vehicle:
            own = own | (np.abs(grid.centers) < np.add(EGO_BOX_M, grid.cell_m / 2)).all(axis=-1)
        return own


R = TypeVar("R")

SPACING = 1 / 20
"""Sweeps that help are at least so far apart, in half sides of the grid: 3.2 m on roads."""

READ_AHEAD = 3
"""How many sweeps are looked at for each one that may help."""


@dataclass(frozen=True, slots=True, eq=False)
class LabeledDrive(Generic[R]):
    """Sweeps of one sensor, looked through once."""

    sweep_of: Callable[[R], Sweep]  # reads one
    refs: Sequence[R]  # in time order
    rules: LabelRules  # how they are labeled
    # where and when each was measured; None where it was not looked at or could not be read
    poses: Sequence[StampedPose | None]
    lows: dict[int, Lows]  # of those that help, by their place

    @classmethod
    def of(
        cls, sweep_of: Callable[[R], Sweep], refs: Sequence[R], rules: LabelRules, span: tuple[int, int] | None = None
    ) -> LabeledDrive[R]:
        """Return the track of ``refs``, looked through as far as the labels of those in ``span`` (all) need it."""
        first, last = (0, len(refs)) if span is None else span
        ahead = READ_AHEAD * rules.neighbors
        poses: list[StampedPose | None] = [None] * len(refs)
        lows: dict[int, Lows] = {}
        last_post: StampedPose | None = None
        for index in range(max(first - ahead, 0), min(last + ahead, len(refs))):
            try:
                sweep = sweep_of(refs[index])
            except (ValueError, OSError):  # reported when it is labeled
                continue
            pose = StampedPose(sweep.world_from_sensor, sweep.t_ns)
            poses[index] = pose
            helps = well_spaced([last_post, pose], SPACING * rules.grid.half_extent_m)
            if rules.neighbors and helps and helps[-1] == 1:
                lows[index] = lows_of_sweep(sweep, rules)
                last_post = pose
        return cls(sweep_of, refs, rules, poses, lows)

    def label(self, index: int) -> tuple[Truth, Mask]:
        """Return the label of the sweep at ``place``, and where it is trusted.

        Raises:
            ValueError: the sweep is damaged.
            OSError: it cannot be read.
        """
        sweep = self.sweep_of(self.refs[index])
        now = StampedPose(sweep.world_from_sensor, sweep.t_ns)
        before = self.poses[index - 1] if index else None
        after = self.poses[index + 1] if index + 1 < len(self.refs) else None
        # The lows of the nearest posts before and after, its own left out.
        near = [k for k in self.lows if k < index][-self.rules.neighbors :]
        near += [k for k in self.lows if k > index][: self.rules.neighbors]
        near = [] if now.world_from_sensor is None else near
        drift = drift_of(before, now, after) if self.rules.neighbors else drift_of(None, now, None)
        return label_sweep(sweep, drift, [self.lows[k] for k in near], self.rules)
