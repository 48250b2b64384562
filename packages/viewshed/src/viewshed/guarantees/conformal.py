"""Conformal guarantees on benign data: masks with a bounded error, and a lower bound of visibility at a point.

**Mask.** Learn then test (Angelopoulos et al., arXiv 2110.01052). A path of masks goes from strict to loose: first the
allowed standard deviation of the ground below a claim rises, then the probability threshold falls, in each range band
as far as one half of the calibration scenes allows. The other half tests each mask, the strictest first. Null
hypothesis: in more than a share δ of scenes, the false share of the claim is above α. The exact binomial test rejects
it at the level 1 - confidence; the last mask before the first non-rejection is used. So with probability ``confidence``
over the calibration, P(false share ≤ α) ≥ 1 - δ for a new scene that is exchangeable with the calibration scenes: same
kind of places, sensor, target, mounting, no attack.

**Point.** One cell is sampled from each calibration scene in every bin of probability and range band, so that samples
are independent. The Clopper-Pearson bound of their visible share holds for a cell of a new scene in that bin.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from math import lgamma
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32, F64, Mask
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.height_map import HeightMap, positions_of_cells
from viewshed.geometry import FloatArray
from viewshed.grid import BevGrid, polar_of_cells

BANDS_M = (0.0, 15.0, 30.0, 45.0, np.inf)
"""Edges of the range bands."""

THRESHOLDS = np.concatenate([np.linspace(0.5, 0.9, 17), 1.0 - np.geomspace(0.08, 1e-6, 15)]).astype(np.float32)
"""Candidate probability thresholds."""

GROUND_STDS_M = np.array([0.03, 0.05, 0.07, 0.085, 0.1, 0.125, 0.15, 0.2, 0.3, 0.5, np.inf], np.float32)
"""Candidate maximum standard deviations of the ground below a claim."""

_STRICT_LEVEL = 20
"""Index of the threshold (.99) used while the standard deviation of the ground rises."""

PLACE_EDGES = np.array([0.5, 0.6, 0.75, 0.9, 0.99, 0.999], np.float32)
"""Lower edges of the probability bins for the bound at a point."""

MIN_SCENES = 50
"""Minimum number of scenes for a recalibration."""

_STEPS = 24
_TABLE = "conformal.json"


@dataclass(frozen=True, slots=True, eq=False)
class SceneCounts:
    """Counts of one calibration scene.

    Attributes:
        right: (GROUND_STDS_M, bands, THRESHOLDS) number of known cells that are claimed and visible.
        false: the same for cells that are claimed but not visible.
        drawn: (bands, PLACE_EDGES) one cell sampled in each bin: 1 visible, 0 not visible, -1 no cell.
    """

    right: NDArray[np.int64]
    false: NDArray[np.int64]
    drawn: NDArray[np.int8]

    @classmethod
    def of(
        cls, estimate: FovEstimate, ground: HeightMap, visible: Mask, known: Mask, rng: np.random.Generator
    ) -> SceneCounts:
        """Return the counts of an estimate against the truth (cells, cells), where that is known."""
        bands, prob = band_of_cells(estimate.grid), estimate.visible_prob
        shape = (len(GROUND_STDS_M), len(BANDS_M) - 1, len(THRESHOLDS))
        # Count each claimed cell in its bin; then accumulate all bins that are as strict or stricter.
        cells = known & (prob >= THRESHOLDS[0])
        std_bin = np.searchsorted(GROUND_STDS_M, ground_std(ground, estimate.grid)[cells])
        level = np.searchsorted(THRESHOLDS, prob[cells], side="right") - 1
        index = np.ravel_multi_index((std_bin, bands[cells], level), shape)
        right, false = (
            np.bincount(index[mask], minlength=np.prod(shape)).reshape(shape)
            for mask in (visible[cells], ~visible[cells])
        )
        right, false = (counts.cumsum(axis=0)[..., ::-1].cumsum(axis=-1)[..., ::-1] for counts in (right, false))
        drawn = np.full((shape[1], len(PLACE_EDGES)), -1, np.int8)
        bins = np.searchsorted(PLACE_EDGES, prob, side="right") - 1
        for band in range(shape[1]):
            for number in range(len(PLACE_EDGES)):
                cells = np.flatnonzero(known & (bands == band) & (bins == number))
                if len(cells):
                    drawn[band, number] = visible.flat[rng.choice(cells)]
        return cls(right, false, drawn)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A calibration on scenes of one sensor, target and method.

    Attributes:
        sensor: name of the beam table or domain.
        target: name of the target.
        method: name of the estimator.
        stds: (steps,) indices into GROUND_STDS_M of the path's masks, the strictest first.
        levels: (steps, bands) indices into THRESHOLDS.
        shares: (steps, scenes) false share of the claim in each test scene.
        seen: (bands, PLACE_EDGES, 2) number of cells sampled in each bin, and number of those visible.
    """

    sensor: str
    target: str
    method: str
    stds: NDArray[np.intp]
    levels: NDArray[np.intp]
    shares: F32
    seen: NDArray[np.int64]

    @classmethod
    def fit(cls, scenes: Sequence[SceneCounts], sensor: str, target: str, method: str) -> Calibration:
        """Return the calibration on scenes: the first half fits the path, the second half tests it.

        Args:
            scenes: at least twice MIN_SCENES, in random order.
            sensor: beam table.
            target: name of the target.
            method: name of the estimator.
        """
        if len(scenes) < 2 * MIN_SCENES:
            raise ValueError(f"scenes must be {2 * MIN_SCENES} or more, got {len(scenes)}; simulate or label more")
        half = len(scenes) // 2
        return _tested(sensor, target, method, *_path(scenes[:half]), scenes[half:])

    def retested(self, scenes: Sequence[SceneCounts], sensor: str) -> Calibration:
        """Return the same path, tested on scenes of another domain, labelled by hand or by cross-view labels.

        The guarantee then holds for that domain, without importance weights, because the path was fixed beforehand.

        Raises:
            ValueError: there are fewer than 50 scenes.
        """
        if len(scenes) < MIN_SCENES:
            raise ValueError(f"recalibration needs {MIN_SCENES} scenes or more, got {len(scenes)}; label more sweeps")
        return _tested(sensor, self.target, self.method, self.stds, self.levels, scenes)

    def step(self, alpha: float, delta: float, confidence: float = 0.9) -> int:
        """Return the loosest step of the path that passes the tests; -1 if none does.

        Raises:
            ValueError: a number lies outside (0, 1).
        """
        for name, value in (("alpha", alpha), ("delta", delta), ("confidence", confidence)):
            if not 0.0 < value < 1.0:
                raise ValueError(f"{name} must lie in (0, 1), got {value:g}")
        violations, scenes = (self.shares > alpha).sum(axis=1), self.shares.shape[1]
        failed = [binomial_tail(int(count), scenes, delta) > 1.0 - confidence for count in violations]
        return int(np.argmax([*failed, True])) - 1

    def guaranteed(
        self, estimate: FovEstimate, ground: HeightMap, alpha: float = 0.05, delta: float = 0.1, confidence: float = 0.9
    ) -> Mask:
        """Return a mask (cells, cells) with a false share of at most α in a share 1 - δ of scenes; warns if empty.

        Args:
            estimate: of one sweep.
            ground: of the same sweep (``leveled.ground``).
            alpha: α.
            delta: δ.
            confidence: of the calibration.

        Raises:
            ValueError: the calibration is of another target or method, a number lies outside (0, 1), or there are too
                few scenes for that δ.
        """
        self._check(estimate)
        step = self.step(alpha, delta, confidence)
        if step < 0:
            raise ValueError(
                f"nothing is guaranteed at alpha {alpha:g}, delta {delta:g} with {self.shares.shape[1]} scenes;"
                " choose a larger one, or calibrate on more scenes"
            )
        claim: Mask = estimate.visible() & (
            estimate.visible_prob >= THRESHOLDS[self.levels[step]][band_of_cells(estimate.grid)]
        )
        std_m = GROUND_STDS_M[self.stds[step]]
        if not np.isinf(std_m):
            claim &= ground_std(ground, estimate.grid) <= std_m
        if not claim.any():
            warnings.warn(
                f"nothing of this sweep is guaranteed at alpha {alpha:g}, delta {delta:g}: no claim is certain enough",
                stacklevel=2,
            )
        return claim

    def guaranteed_at(self, estimate: FovEstimate, xy: FloatArray, confidence: float = 0.95) -> F64:
        """Return the lower bound (…,) of the probability that a target at points (…, 2+) of ``level`` is visible.

        0 where nothing is claimed, NaN outside the grid.
        """
        self._check(estimate)
        cells, inside = estimate.grid.index(xy)
        i, j = cells[..., 0], cells[..., 1]
        bins = np.searchsorted(PLACE_EDGES, np.where(estimate.visible(), estimate.visible_prob, 0.0)[i, j], "right") - 1
        bound = np.zeros((len(self.seen), len(PLACE_EDGES) + 1))  # the last bin (-1) is below all edges
        for band, number in np.ndindex(self.seen.shape[:2]):
            count, visible = self.seen[band, number].tolist()
            bound[band, number] = lower_bound(visible, count, confidence)
        bounds: F64 = np.where(inside, bound[band_of_cells(estimate.grid)[i, j], bins], np.nan)
        return bounds

    def _check(self, estimate: FovEstimate) -> None:
        if (estimate.target.name, estimate.method) != (self.target, self.method):
            raise ValueError(
                f"the calibration must be of {estimate.method} and {estimate.target.name}, got one of {self.method} and"
                f" {self.target}; fit one for it"
            )

    def to_json(self) -> dict[str, Any]:
        """Return the calibration as JSON values."""
        shares = [[round(float(share), 4) for share in step] for step in self.shares]
        arrays = {
            "stds": self.stds.tolist(),
            "levels": self.levels.tolist(),
            "shares": shares,
            "seen": self.seen.tolist(),
        }
        return {"sensor": self.sensor, "target": self.target, "method": self.method, **arrays}

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> Calibration:
        """Return the calibration from values of :meth:`to_json`."""
        arrays = {name: np.array(table[name]) for name in ("stds", "levels", "seen")}
        shares = np.array(table["shares"], np.float32)
        return cls(table["sensor"], table["target"], table["method"], shares=shares, **arrays)


@lru_cache(maxsize=1)
def shipped() -> tuple[Calibration, ...]:
    """Return all calibrations shipped with the package."""
    text = resources.files("viewshed.guarantees").joinpath(_TABLE).read_text(encoding="utf-8")
    return tuple(Calibration.from_json(table) for table in json.loads(text))


def calibration_for(sensor: str, target: str, method: str) -> Calibration:
    """Return the shipped calibration of a sensor, target and method.

    Raises:
        ValueError: there is none; the message lists those that exist.
    """
    for calibration in shipped():
        if (calibration.sensor, calibration.target, calibration.method) == (sensor, target, method):
            return calibration
    known = "; ".join(f"{one.sensor}, {one.target}, {one.method}" for one in shipped())
    raise ValueError(
        f"no calibration for {sensor}, {target}, {method}, only for: {known}; fit one on {MIN_SCENES} labeled sweeps"
        " (Calibration.retested)"
    )


@lru_cache(maxsize=8)
def band_of_cells(grid: BevGrid) -> NDArray[np.intp]:
    """Return the range band (cells, cells) of each cell."""
    bands = np.digitize(polar_of_cells(grid)[0], BANDS_M[1:-1])
    bands.setflags(write=False)
    return bands


def ground_std(ground: HeightMap, grid: BevGrid) -> F32:
    """Return the standard deviation (cells, cells) of the ground below each cell, taken from the node before it."""
    return ground.std_m.ravel()[positions_of_cells(grid, ground.half_extent_m, len(ground.std_m)).node]


@lru_cache(maxsize=4096)
def binomial_tail(count: int, trials: int, share: float) -> float:
    """Return P(N ≤ count) of a binomial N.

    >>> round(binomial_tail(1, 50, 0.1), 4)
    0.0338
    """
    k = np.arange(count + 1)
    logs = [lgamma(trials + 1) - lgamma(n + 1) - lgamma(trials - n + 1) for n in k]
    return float(min(np.exp(np.array(logs) + k * np.log(share) + (trials - k) * np.log1p(-share)).sum(), 1.0))


def lower_bound(count: int, trials: int, confidence: float) -> float:
    """Return the one-sided Clopper-Pearson lower bound of the share ``count`` / ``trials``.

    >>> round(lower_bound(59, 59, 0.95), 3)
    0.95
    """
    if count == 0:
        return 0.0
    low, high = 0.0, 1.0
    # Bisection for the share at which P(N ≥ count) is 1 - confidence.
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (
            (middle, high) if 1.0 - binomial_tail(count - 1, trials, middle) < 1.0 - confidence else (low, middle)
        )
    return low


def _path(scenes: Sequence[SceneCounts]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return a path of masks: indices into GROUND_STDS_M (steps,) and into THRESHOLDS (steps, bands)."""
    right, false = (np.sum([getattr(scene, name)[-1] for scene in scenes], axis=0) for name in ("right", "false"))
    # In each band, the lowest threshold whose false share is at most a limit; the limit grows from step to step.
    share = false / np.maximum(right + false, 1)
    fits = share[None] <= np.geomspace(0.002, 0.5, _STEPS)[:, None, None]
    levels = np.where(fits.any(axis=-1), fits.argmax(axis=-1), len(THRESHOLDS) - 1)
    rising = np.arange(len(GROUND_STDS_M))
    stds = np.concatenate([rising, np.full(_STEPS, rising[-1])])
    return stds, np.concatenate([np.full((len(rising), levels.shape[1]), _STRICT_LEVEL), levels])


def _tested(
    sensor: str,
    target: str,
    method: str,
    stds: NDArray[np.intp],
    levels: NDArray[np.intp],
    scenes: Sequence[SceneCounts],
) -> Calibration:
    """Return the calibration of a path of masks, tested on scenes not used to fit it; an empty claim has share 0."""
    at = stds[:, None], np.arange(levels.shape[1]), levels
    right, false = (np.array([getattr(scene, name)[at].sum(axis=1) for scene in scenes]) for name in ("right", "false"))
    shares = (false / np.maximum(right + false, 1)).T.astype(np.float32)
    drawn = np.array([scene.drawn for scene in scenes])
    seen = np.stack([(drawn >= 0).sum(axis=0), (drawn == 1).sum(axis=0)], axis=-1)
    return Calibration(sensor, target, method, stds, levels, shares, seen)
