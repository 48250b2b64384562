"""Label a sweep: what it could have seen, from its own beams and the ground of the sweeps around it in time.

Visibility is counted in whole beams, with the loops of the exact truth.
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
"""Definitions for which ``known`` can be computed; a label holds the masks of all of them."""

TARGETS: tuple[Target, Target] = (CAR, PEDESTRIAN)

EGO_BOX_M, EGO_HEIGHTS_M = (_core.EGO_LENGTH_M, _core.EGO_WIDTH_M), (_core.MIN_EGO_HEIGHT_M, _core.MAX_EGO_HEIGHT_M)
"""Half length and half width of the vehicle below the sensor, and the sensor heights at which one is assumed."""

MANY_BEAMS = 50
"""A target that more beams reach is visible whatever the ground error and the missing beams."""

GROUND_ERROR_M, GROUND_ERROR_PER_M, MAX_GROUND_ERROR_M = 0.03, 0.03, 0.4
"""Assumed ground error where the ground was seen, its growth per meter from there, and its maximum."""

LOWS_REACH = 1.5
"""Largest range of the returns that the ground is estimated from, in half sides of the grid."""


@dataclass(frozen=True, slots=True)
class LabelRules(Checked):
    """Settings of labeling.

    Raises:
        ValueError: a value is out of range.
    """

    grid: BevGrid = GRIDS["road"]  # of the label
    definition: Definition = "probe"  # definition of visibility that ``known`` refers to
    target: Annotated[str, OneOf(("car", "pedestrian"))] = "car"  # object type of ``probe``
    # largest number of sweeps before and after a sweep that help to label it; 0 labels each sweep by itself
    neighbors: Annotated[int, Between(0, 1000)] = 20

    @property
    def node_m(self) -> float:
        """Side of the nodes of the ground lattice: 1 m on roads."""
        return self.grid.half_extent_m / NODES_PER_HALF


def lows_of_sweep(sweep: Sweep, rules: LabelRules) -> Lows:
    """Return the lowest returns of a sweep in the world frame, or in its ``level`` frame if it has no pose."""
    return _lows_of_level(level(sweep, rules.grid), rules)


def label_sweep(sweep: Sweep, drift: Drift, around: Sequence[Lows], rules: LabelRules) -> tuple[Truth, Mask]:
    """Return the label of a sweep and the mask (cells, cells) bool where it is known.

    The probe is counted on every beam of the sensor's pattern, over the ground of all sweeps around. It is known where
    the count stays on the same side of the target's minimum number of returns for all possible ends of the missing
    beams, and for ground that is a little higher or lower.

    Args:
        sweep: a benign sweep.
        drift: motion of the sensor within the sweep.
        around: lows of the sweeps around it, in the same world; the sweep's own lows are added.
        rules: settings.
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
    """Intermediate values of labeling one sweep."""

    rules: LabelRules  # settings
    image: BeamImage  # beams of the sweep
    patch: Patch  # ground around it
    ends: BeamEnds  # where its beams ended
    has_vehicle: bool  # whether a vehicle is assumed below the sensor

    def result(self) -> tuple[Truth, Mask]:
        """Return the label and the mask where it is known."""
        grid = self.rules.grid
        ground = self.patch.at(grid.centers.reshape(-1, 2))
        lines = self._lines(self.ends.best_m)
        things = self._things()
        reached, state = reached_and_states(lines, things.reshape(-1), ground, grid, TARGETS)
        definitions, returned = self._definitions(lines, things)
        known = self._is_robust(reached, ground) if self.rules.definition == "probe" else returned
        return Truth(grid, reached, state, definitions), known & ~self._own_cells()

    def _lines(self, depth_m: F32) -> BeamLines:
        """Return the beams of the sweep, ending at depths (C, R)."""
        return BeamLines.of(self.image.origin_m, self.image.direction, depth_m, self.image.max_range_m)

    def _things(self) -> Mask:
        """Return which beams (C, R) ended on a thing other than the own vehicle."""
        things: Mask = self.ends.thing | (self.ends.kind == SURFACE)
        if not self.has_vehicle:
            return things
        end = self.image.origin_m[..., :2] + self.image.direction[..., :2] * self.ends.best_m[..., None]
        own = np.asarray((np.abs(end) < EGO_BOX_M).all(axis=-1))
        return things & ~own

    def _definitions(self, lines: BeamLines, things: Mask) -> tuple[dict[str, Mask], Mask]:
        """Return the masks of the other definitions (cells, cells), and the cells whose azimuth bin has a return.

        A beam that reached the ground counts as a return from there, even if the sensor did not measure one. A bin
        without any measured return is unknown.
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

    def _is_robust(self, reached: dict[str, NDArray[np.uint8]], ground: F32) -> Mask:
        """Return the cells (cells, cells) whose probe does not depend on missing beams or the ground error."""
        rules, grid = self.rules, self.rules.grid
        target = next(one for one in TARGETS if one.name == rules.target)
        counts = reached[target.name].reshape(-1)
        doubtful = counts <= max(MANY_BEAMS, 4 * target.min_returns)
        seen = self.patch.seen(grid.centers.reshape(-1, 2)).reshape(grid.shape)
        distance_m = distance_transform_edt(~seen) * grid.cell_m if seen.any() else np.full(grid.shape, np.inf)
        error_m = np.minimum(GROUND_ERROR_M + GROUND_ERROR_PER_M * distance_m, MAX_GROUND_ERROR_M).astype(np.float32)
        heights, unchanged = (ground - error_m.reshape(-1), ground + error_m.reshape(-1)), []
        for depth in (self.ends.min_m, self.ends.max_m):
            lines = self._lines(depth)
            for height in heights:
                again = count_targets(lines, grid, height, TARGETS, doubtful)[target.name][1]
                unchanged.append((again >= target.min_returns) == (counts >= target.min_returns))
        robust: Mask = np.all(unchanged, axis=0) | ~doubtful
        return robust.reshape(grid.shape)

    def _own_cells(self) -> Mask:
        """Return the cells (cells, cells) of the own vehicle, and those closer than the sensor moved."""
        grid = self.rules.grid
        moved = np.sqrt((self.image.origin_m[..., :2] ** 2).sum(axis=-1).max())
        own: Mask = polar_of_cells(grid)[0] <= moved
        if self.has_vehicle:
            own = own | (np.abs(grid.centers) < np.add(EGO_BOX_M, grid.cell_m / 2)).all(axis=-1)
        return own


R = TypeVar("R")

SPACING = 1 / 20
"""Smallest distance between neighbors that help with a label, in half sides of the grid: 3.2 m on roads."""

READ_AHEAD = 3
"""Number of sweeps to read for each neighbor that may help."""


@dataclass(frozen=True, slots=True, eq=False)
class LabeledDrive(Generic[R]):
    """Sweeps of one sensor, with the poses and lows that their labels need."""

    sweep_of: Callable[[R], Sweep]  # reads one sweep
    refs: Sequence[R]  # in time order
    rules: LabelRules  # settings
    poses: Sequence[StampedPose | None]  # of each sweep; None where it was not read or is unreadable
    lows: dict[int, Lows]  # of the well-spaced neighbors, by index

    @classmethod
    def of(
        cls, sweep_of: Callable[[R], Sweep], refs: Sequence[R], rules: LabelRules, span: tuple[int, int] | None = None
    ) -> LabeledDrive[R]:
        """Read the sweeps that the labels of those in ``span`` (default: all) need."""
        first, last = (0, len(refs)) if span is None else span
        ahead = READ_AHEAD * rules.neighbors
        poses: list[StampedPose | None] = [None] * len(refs)
        lows: dict[int, Lows] = {}
        last_neighbor: StampedPose | None = None
        for index in range(max(first - ahead, 0), min(last + ahead, len(refs))):
            try:
                sweep = sweep_of(refs[index])
            except (ValueError, OSError):  # reported by label()
                continue
            pose = StampedPose(sweep.world_from_sensor, sweep.t_ns)
            poses[index] = pose
            helps = well_spaced([last_neighbor, pose], SPACING * rules.grid.half_extent_m)
            if rules.neighbors and helps and helps[-1] == 1:
                lows[index] = lows_of_sweep(sweep, rules)
                last_neighbor = pose
        return cls(sweep_of, refs, rules, poses, lows)

    def label(self, index: int) -> tuple[Truth, Mask]:
        """Return the label of sweep ``index`` and the mask where it is known.

        Raises:
            ValueError: the sweep is damaged.
            OSError: it cannot be read.
        """
        sweep = self.sweep_of(self.refs[index])
        now = StampedPose(sweep.world_from_sensor, sweep.t_ns)
        before = self.poses[index - 1] if index else None
        after = self.poses[index + 1] if index + 1 < len(self.refs) else None
        # The nearest well-spaced neighbors before and after, without the sweep itself.
        near = [k for k in self.lows if k < index][-self.rules.neighbors :]
        near += [k for k in self.lows if k > index][: self.rules.neighbors]
        near = [] if now.world_from_sensor is None else near
        drift = drift_of(before, now, after) if self.rules.neighbors else drift_of(None, now, None)
        return label_sweep(sweep, drift, [self.lows[k] for k in near], self.rules)
