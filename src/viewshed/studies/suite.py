"""Who is compared in each block, on which grid, with which threshold, against what.

The sweeps that a study attacks, with exact truth: simulated as needed, or from an archive.

Who enters the strict block: every estimator of the table, and a second rule for beams that do not return.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from hashlib import blake2b
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets import Archive, Sample
from viewshed.datasets.presets import Preset, preset_named, preset_names
from viewshed.datasets.simulated import ScenePlan, simulate_frame
from viewshed.estimators import (
    CLASSICAL,
    PAPER_ESTIMATORS,
    PAPER_INDOOR_ESTIMATORS,
    PAPER_THRESHOLD,
    Estimator,
    EstimatorFactory,
)
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import THRESHOLD, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS, BevGrid, polar_of_cells
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.studies.statistics import Reference
from viewshed.sweep import Sweep

ROOM_M = 20.0
"""Grids with a smaller half side are indoors: the paper's indoor settings apply."""

_BESIDE: dict[str, dict[str, EstimatorFactory]] = {
    "shadow_map": {"shadow_map_unknown": partial(ShadowMap, no_return="unknown")},
}
"""By the estimator after which they stand."""

ENTRANTS: dict[str, EstimatorFactory] = dict(
    chain.from_iterable([(name, make), *_BESIDE.get(name, {}).items()] for name, make in CLASSICAL.items())
)
"""By name, in the order of the report. ``shadow_map_unknown`` counts only beams that returned, the geometric reading
of a missing return; the bar is the better of the two shadow maps."""

LABEL = "paper_label"

_RECENT = 8
"""Sweeps of which the answers are kept: a larger budget than the wedge holds, or a defense that drops nothing, leaves
the same sweep again."""

Probs = dict[str, NDArray[np.float32]]


@dataclass(frozen=True, slots=True, eq=False)
class Contestants:
    """Estimators on one grid, and what they are held against.

    Attributes:
        grid: theirs.
        threshold: probability from which a cell counts as claimed.
        estimators: by name.
        reference: the truth of the strict block, or the paper's label.
        pose: of the clean sweep's ``level`` frame in the map, or None.
    """

    grid: BevGrid
    threshold: float
    estimators: Mapping[str, Estimator]
    reference: Reference
    pose: Rigid | None
    _recent: dict[bytes, Probs] = field(init=False, repr=False, default_factory=dict)

    def probs(self, sweep: Sweep) -> Probs:
        """Return what each says of a sweep, (cells, cells) probability of visible, where the clean sweep's cells are.

        Where the sweep's pose is not the clean one, an estimate lies elsewhere in the map than the truth: each of the
        truth's cells is looked up there, and is not claimed where the estimate does not reach.
        """
        key = _fingerprint(sweep)
        if key not in self._recent:
            leveled = level(sweep, self.grid)
            found = {name: estimate_of(each, leveled, sweep) for name, each in self.estimators.items()}
            self._recent[key] = {name: self._placed(estimate) for name, estimate in found.items()}
            if len(self._recent) > _RECENT:
                del self._recent[next(iter(self._recent))]
        return self._recent[key]

    def _placed(self, estimate: FovEstimate) -> NDArray[np.float32]:
        pose = estimate.world_from_level
        if self.pose is None or pose is None or not _moved(self.pose, pose):
            return estimate.visible_prob
        centers = np.concatenate([self.grid.centers, np.zeros((*self.grid.shape, 1))], axis=-1).reshape(-1, 3)
        seen_at = (pose.inverse() @ self.pose) @ centers
        return np.nan_to_num(estimate.at(seen_at[:, :2]).reshape(self.grid.shape), nan=0.0)


def strict(sample: Sample, only: Sequence[str] = ()) -> Contestants:
    """Return all who enter (``only`` some) on the truth's grid, against exact truth of ``probe``, car."""
    grid, names = sample.truth.grid, only or tuple(ENTRANTS)
    reference = Reference.of(sample.truth.visible(), sample.known, polar_of_cells(grid)[1])
    return Contestants(grid, THRESHOLD, {name: ENTRANTS[name](grid) for name in names}, reference, _pose(sample, grid))


def paper(sample: Sample) -> Contestants:
    """Return the paper's estimators and ours on its grid, against its label: one of them on the clean sweep."""
    indoor = sample.truth.grid.half_extent_m < ROOM_M
    grid = GRIDS["paper_indoor" if indoor else "paper"]
    table = {**(PAPER_INDOOR_ESTIMATORS if indoor else PAPER_ESTIMATORS), **CLASSICAL}
    label = table[LABEL](grid).estimate(sample.sweep).visible(PAPER_THRESHOLD)
    reference = Reference.of(label, np.ones(grid.shape, np.bool_), polar_of_cells(grid)[1])
    made = {name: make(grid) for name, make in table.items()}
    return Contestants(grid, PAPER_THRESHOLD, made, reference, _pose(sample, grid))


def _pose(sample: Sample, grid: BevGrid) -> Rigid | None:
    return level(sample.sweep, grid).world_from_level


def estimate_of(estimator: Estimator, leveled: LeveledSweep, sweep: Sweep) -> FovEstimate:
    """Return the estimate for a sweep, whose leveling is used by those who take one."""
    return estimator.estimate(leveled)


def _fingerprint(sweep: Sweep) -> bytes:
    """Return what is the same for two sweeps only if every estimator says the same of them."""
    pose = None if sweep.world_from_sensor is None else sweep.world_from_sensor.as_matrix()
    told = blake2b(repr((sweep.sensor_height_m, len(sweep))).encode())
    for column in (sweep.points, sweep.ring, sweep.azimuth, sweep.time_s, sweep.intensity, sweep.attitude, pose):
        told.update(b"-" if column is None else np.ascontiguousarray(column).tobytes())
    return told.digest()


def _moved(one: Rigid, other: Rigid) -> bool:
    """Return whether two poses differ in heading or place; a tilt alone leaves the cells where they are."""
    leveled = one.inverse() @ other
    return bool(abs(leveled.yaw) > 1e-9 or np.hypot(*leveled.translation[:2]) > 1e-6)


BEFORE_S = (2.0, 0.5)
"""How long before the sweep the earlier ones were measured."""

_GOLDEN = (5**0.5 - 1) / 2

_LOOK_BACK = 256


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """One sweep with exact truth, and what the same sensor measured before.

    Attributes:
        sample: the sweep, its truth and where that is known.
        earlier: sweeps of the same sensor about ``BEFORE_S`` before, the oldest first; fewer where there are none.
        frame: the scene and the number of the frame that was simulated, or None for a recorded sample.
    """

    sample: Sample
    earlier: tuple[Sweep, ...] = ()
    frame: tuple[ScenePlan, int] | None = None


def subject_of(domain: str, number: int, count: int, seed: int) -> Subject:
    """Return the sample ``number`` of ``count`` of a domain: a preset's name or the place of an archive.

    Of a preset each sample is from a scene of its own, made with ``seed``; agents take turns. Of an archive the
    samples are spread evenly.

    Raises:
        ValueError: an archive is damaged or has no samples.
        OSError: an archive cannot be read.
    """
    if domain in preset_names():
        return subject_of_preset(preset_named(domain), number, count, seed)
    return _recorded(_opened(domain), number, count)


def subject_of_preset(preset: Preset, number: int, count: int, seed: int) -> Subject:
    """Return the sample ``number`` of ``count`` of a preset, each from a scene of its own, made with ``seed``."""
    return _simulated(_held_out(preset, count, seed), number)


def _held_out(preset: Preset, count: int, seed: int) -> Preset:
    """Return the preset with one split of ``count`` scenes as long as those of its last split."""
    frames = preset.frames[-1] // preset.scenes[-1] * count
    return replace(preset, splits=("held_out",), scenes=(count,), frames=(frames,), seed=seed)


def _simulated(preset: Preset, number: int) -> Subject:
    scene = ScenePlan(preset, 0, number)
    steps = [max(round(before_s / preset.interval_s), 1) for before_s in BEFORE_S]
    times = scene.frames // preset.agents
    first = min(max(steps), times - 1)
    time = first + int(number * _GOLDEN % 1.0 * (times - first))
    agent = number % preset.agents
    earlier = tuple(
        simulate_frame(scene, (time - step) * preset.agents + agent).sweep for step in steps if step <= time
    )
    frame = time * preset.agents + agent
    return Subject(simulate_frame(scene, frame), earlier, (scene, frame))


@lru_cache(maxsize=4)
def _opened(place: str) -> Archive:
    archive = Archive.open(place)
    if not len(archive):
        raise ValueError(f"{place} must hold samples, got none")
    return archive


def _recorded(archive: Archive, number: int, count: int) -> Subject:
    index = number * len(archive) // count
    sample = archive[index]
    before = list(_before(archive, index, sample))
    return Subject(sample, (before[-1], before[0]) if len(before) > 1 else tuple(before))


def _before(archive: Archive, index: int, sample: Sample) -> Iterator[Sweep]:
    """Yield the earlier sweeps of the same agent and scene, up to ``BEFORE_S`` before, the newest first."""
    t_ns = sample.sweep.t_ns
    for other in range(index - 1, max(index - _LOOK_BACK, 0) - 1, -1) if t_ns is not None else ():
        before = archive[other]
        was_ns = before.measured.t_ns
        if before.scene != sample.scene or was_ns is None or t_ns is None or t_ns - was_ns > 1e9 * BEFORE_S[0] + 1e6:
            return
        if before.measured.agent == sample.sweep.agent and was_ns < t_ns:
            yield before.sweep
