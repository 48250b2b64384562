"""The estimators under test: suites that share a grid and a threshold."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from itertools import chain

import numpy as np

from viewshed.estimators import CLASSICAL, PAPER_THRESHOLD, Estimator, EstimatorFactory, paper_estimators_on
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import THRESHOLD, FovEstimate, FovEstimator
from viewshed.grid import GRIDS, BevGrid
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep
from viewshed_lab.studies.cases import ROOM_M

_BESIDE: dict[str, dict[str, EstimatorFactory]] = {
    "shadow_map": {"shadow_map_unknown": partial(ShadowMap, no_return="unknown")}
}
"""Variants, by the estimator after which they are listed."""

TESTED: dict[str, EstimatorFactory] = dict(
    chain.from_iterable([(name, make), *_BESIDE.get(name, {}).items()] for name, make in CLASSICAL.items())
)
"""The classical estimators by name, in the order of the tables. ``shadow_map_unknown`` uses only beams that returned
(a missing return says nothing); the baseline to beat is the better of the two shadow maps."""

LABEL = "paper_label"

_RECENT = 8
"""Size of the cache of estimates, beside those of the first sweep. The same sweep comes again if a budget exceeds the
beams of the wedge, or if a defense drops nothing."""

Estimates = dict[str, FovEstimate]


@dataclass(frozen=True, slots=True, eq=False)
class Changed:
    """Wraps an estimator to change its input or output."""

    estimator: FovEstimator  # wrapped estimator
    answer: Callable[[FovEstimator, Sweep], FovEstimate]  # returns the changed estimate of a sweep

    @property
    def grid(self) -> BevGrid:
        """Grid of the wrapped estimator."""
        return self.estimator.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the changed estimate."""
        return self.answer(self.estimator, sweep)


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorSuite:
    """Estimators on one grid."""

    grid: BevGrid  # of all estimators
    threshold: float  # minimum probability of a claimed cell
    estimators: Mapping[str, Estimator]  # by name
    _recent: dict[bytes, Estimates] = field(init=False, repr=False, default_factory=dict)

    def only(self, name: str) -> EstimatorSuite:
        """Return the suite of one of the estimators."""
        return replace(self, estimators={name: self.estimators[name]})

    def estimates(self, leveled: LeveledSweep) -> Estimates:
        """Return each estimator's estimate of a leveled sweep; the first and the last ones are cached."""
        key = _fingerprint(leveled.sweep)
        if key not in self._recent:
            self._recent[key] = {name: one.estimate(leveled) for name, one in self.estimators.items()}
            if len(self._recent) > _RECENT:
                del self._recent[list(self._recent)[1]]
        return self._recent[key]


def strict_suite(grid: BevGrid, names: Sequence[str] = ()) -> EstimatorSuite:
    """Return the classical estimators (or those named) on a grid of exact truth."""
    return EstimatorSuite(grid, THRESHOLD, {name: TESTED[name](grid) for name in names or TESTED})


def paper_suite(half_extent_m: float) -> EstimatorSuite:
    """Return the paper's estimators and ours on the paper's grid, indoor or road by the extent of the truth."""
    grid = GRIDS["paper_indoor" if half_extent_m < ROOM_M else "paper"]
    table = {**paper_estimators_on(grid), **CLASSICAL}
    return EstimatorSuite(grid, PAPER_THRESHOLD, {name: make(grid) for name, make in table.items()})


def _fingerprint(sweep: Sweep) -> bytes:
    """Return a hash of all fields of a sweep that estimators read."""
    pose = None if sweep.world_from_sensor is None else sweep.world_from_sensor.as_matrix()
    digest = blake2b(repr((sweep.sensor_height_m, len(sweep))).encode())
    for column in (sweep.points, sweep.ring, sweep.azimuth, sweep.time_s, sweep.intensity, sweep.attitude, pose):
        digest.update(b"-" if column is None else np.ascontiguousarray(column).tobytes())
    return digest.digest()
