"""The paper's detector: flags cells whose Monte Carlo dropout deviation is larger than on benign sweeps.

It checks estimates alone, one sweep at a time. A fitted monitor can be saved and loaded.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._files import DAMAGED, read_arrays, write_atomic
from viewshed.fov.estimate import FovEstimate
from viewshed.grid import MAX_CELLS, BevGrid, polar_of_cells
from viewshed.monitor.calibration import alarm_limit, read_about
from viewshed.monitor.report import IntegrityReport, sectors_of_cells

NAME = "deviation"


@dataclass(frozen=True, slots=True)
class Rule:
    """A cell's threshold: mean plus ``sigmas`` standard deviations of its benign deviations.

    Attributes:
        sigmas: number of standard deviations.
        few: a cell with fewer benign sweeps than this uses the moments of its range ring.
        rings: number of range rings between the sensor and the grid's farthest corner.
        least: lower bound of all thresholds; smaller deviations are never suspect.

    Raises:
        ValueError: a value is out of range.
    """

    sigmas: float = 3.0
    few: int = 10
    rings: int = 48
    least: float = 0.02

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sigmas) and self.sigmas >= 0 and 0 <= self.least <= 0.5):
            raise ValueError(f"sigmas must not be negative and least lie in [0, 0.5], got {self}")
        if self.few < 2 or self.rings < 1:
            raise ValueError(f"few must be 2 or more and rings 1 or more, got {self}")


RULE = Rule()


@dataclass(frozen=True, slots=True, eq=False)
class DeviationMonitor:
    """Alarms if more cells than on benign sweeps deviate more than on benign sweeps (arXiv 2503.07375).

    A cell is watched if it had a deviation on benign sweeps, whatever its state, so that an attacker cannot choose
    what is watched. It is suspect if its deviation is above its own threshold. The score is the share of watched cells
    that are suspect.

    Attributes:
        grid: of the estimates.
        thresholds: (cells, cells) float32; +∞ for cells that are not watched.
        method: estimator of the fitted estimates; only its estimates can be checked.
        limit: score above which it alarms; None before calibration.
        false_alarm_rate: rate that the limit was chosen for, or None.
        sweeps: numbers of benign sweeps used to fit and to calibrate.
        facts: further settings of the estimator by name, stored in the file.

    Raises:
        ValueError: thresholds do not fit the grid, are negative or NaN, or watch no cell; the limit is NaN.
    """

    grid: BevGrid
    thresholds: NDArray[np.float32]
    method: str
    limit: float | None = None
    false_alarm_rate: float | None = None
    sweeps: tuple[int, int] = (0, 0)
    facts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        thresholds = np.ascontiguousarray(self.thresholds, np.float32).view()
        if thresholds.shape != self.grid.shape or not (thresholds >= 0).all():
            raise ValueError(f"thresholds must be {self.grid.shape}, not negative and not NaN, got {thresholds.shape}")
        if np.isinf(thresholds).all():
            raise ValueError(
                "thresholds must be finite in one cell at least, got none; no benign sweep has a deviation"
            )
        if self.limit is not None and np.isnan(self.limit):
            raise ValueError("limit must be a number, got NaN")
        thresholds.setflags(write=False)
        object.__setattr__(self, "thresholds", thresholds)

    @property
    def watched(self) -> NDArray[np.bool_]:
        """Mask (cells, cells) of watched cells."""
        return np.isfinite(self.thresholds)

    @classmethod
    def fit(cls, estimates: Iterable[FovEstimate], rule: Rule = RULE) -> DeviationMonitor:
        """Return a monitor fitted on benign estimates, not calibrated yet; estimates are not kept in memory.

        Args:
            estimates: of one method on one grid, with standard deviations.
            rule: computes the thresholds.

        Raises:
            ValueError: there are none, they differ in grid or method, or have no deviation.
        """
        first: FovEstimate | None = None
        moments, count = np.zeros((3, 0, 0)), 0
        for estimate in estimates:
            if first is None:
                first, moments = estimate, np.zeros((3, *estimate.grid.shape))
            std = _deviation(estimate, first.grid, first.method).astype(np.float64)
            moments += np.where(np.isfinite(std), [np.ones_like(std), std, std**2], 0.0)
            count += 1
        if first is None:
            raise ValueError("a monitor needs benign estimates, got none")
        return cls(first.grid, _thresholds(moments, first.grid, rule), first.method, sweeps=(count, 0))

    def calibrated(self, estimates: Iterable[FovEstimate], false_alarm_rate: float) -> DeviationMonitor:
        """Return the monitor with the limit that a further benign sweep exceeds with this probability at most.

        Args:
            estimates: benign, and not used to fit: scores of fitted estimates are too low.
            false_alarm_rate: in (0, 1).

        Raises:
            ValueError: there are too few for that rate, or one is not of the monitor's grid and method.
        """
        scores = [self.score(estimate) for estimate in estimates]
        limit = alarm_limit(scores, false_alarm_rate)
        return replace(self, limit=limit, false_alarm_rate=false_alarm_rate, sweeps=(self.sweeps[0], len(scores)))

    def suspect(self, estimate: FovEstimate) -> NDArray[np.bool_]:
        """Return the mask (cells, cells) of cells whose deviation is above their threshold.

        Raises:
            ValueError: the estimate is of another grid or method, or has no standard deviation.
        """
        mask: NDArray[np.bool_] = _deviation(estimate, self.grid, self.method) > self.thresholds
        return mask

    def score(self, estimate: FovEstimate) -> float:
        """Return the share of watched cells that are suspect, in [0, 1]. Raises as :meth:`suspect` does."""
        return float(self.suspect(estimate).sum()) / float(self.watched.sum())

    def check(self, estimate: FovEstimate) -> IntegrityReport:
        """Return the report on an estimate.

        Raises:
            ValueError: it is not calibrated, or as for :meth:`suspect`.
        """
        if self.limit is None:
            raise ValueError("a monitor must be calibrated before it can alarm; call calibrated()")
        suspect = self.suspect(estimate)
        score = float(suspect.sum()) / float(self.watched.sum())
        sectors = sectors_of_cells(suspect, self.grid)
        return IntegrityReport(NAME, score, self.limit, suspect=sectors, grid=self.grid, suspect_cells=suspect)


def _deviation(estimate: FovEstimate, grid: BevGrid, method: str) -> NDArray[np.float32]:
    """Return the standard deviation (cells, cells) of an estimate after checking its grid and method."""
    if estimate.grid != grid:
        raise ValueError(f"estimate must be on the monitor's grid {_size_of(grid)}, got {_size_of(estimate.grid)}")
    if estimate.method != method:
        raise ValueError(f"estimate must be of the monitor's method {method}, got {estimate.method}; fit one for it")
    std = np.asarray(estimate.std, np.float32)
    if np.isnan(std).all():
        raise ValueError(
            f"estimate must have a standard deviation, got none from {method}; use Monte Carlo dropout (mcd), and a"
            " sweep with usable returns"
        )
    return std


def _size_of(grid: BevGrid) -> str:
    x, y = grid.offset_m
    return f"{grid.cells}x{grid.half_extent_m:g}" + (f" at ({x:g}, {y:g})" if x or y else "")


def _thresholds(moments: NDArray[np.float64], grid: BevGrid, rule: Rule) -> NDArray[np.float32]:
    """Return thresholds (cells, cells) from count, sum and sum of squares (3, cells, cells) of benign deviations."""
    range_m, _ = polar_of_cells(grid)
    farthest = float(range_m.max()) + 1e-6
    ring = np.minimum((range_m / farthest * rule.rings).astype(np.intp), rule.rings - 1)
    ring_moments = np.stack([np.bincount(ring.ravel(), moment.ravel(), rule.rings) for moment in moments])[:, ring]
    used = np.where(moments[0] < rule.few, ring_moments, moments)
    count = np.maximum(used[0], 1)
    mean = used[1] / count
    std = np.sqrt(np.maximum(used[2] / count - mean**2, 0) * (count / np.maximum(count - 1, 1)))
    limits = np.maximum(mean + rule.sigmas * std, rule.least)
    return np.where(moments[0] > 0, limits, np.inf).astype(np.float32)


FORMAT_VERSION = 1

_MAX_BYTES = 4 * MAX_CELLS**2 + 4096
"""Largest array of a file, unpacked."""


def save_monitor(monitor: DeviationMonitor, path: str | Path) -> None:
    """Write a monitor to ``path`` (compressed NPZ), atomically; equal monitors give equal bytes.

    Raises:
        OSError: the file cannot be written.
    """
    grid = monitor.grid
    about = {
        "version": FORMAT_VERSION,
        "monitor": NAME,
        "grid": [grid.cells, float(grid.half_extent_m), [float(v) for v in grid.offset_m]],
        "method": monitor.method,
        "limit": monitor.limit,
        "false_alarm_rate": monitor.false_alarm_rate,
        "sweeps": list(monitor.sweeps),
        "facts": dict(monitor.facts),
    }
    file = io.BytesIO()
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez_compressed(file, about=text, thresholds=monitor.thresholds)
    write_atomic(path, file.getvalue())


def load_monitor(path: str | Path) -> DeviationMonitor:
    """Read a monitor that :func:`save_monitor` wrote; nothing is unpickled.

    Raises:
        ValueError: the file is no monitor, of another version, or damaged.
        OSError: it cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        arrays = read_arrays(raw, _MAX_BYTES)
        return _monitor(read_about(arrays, NAME, FORMAT_VERSION), arrays["thresholds"])
    except DAMAGED as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"{path} must be a whole monitor file of this version, got: {why}; make it again:"
            " viewshed monitor fit SWEEPS --out FILE"
        ) from error


def _monitor(about: dict[str, Any], thresholds: Any) -> DeviationMonitor:
    cells, half_extent_m, offset_m = about["grid"]
    return DeviationMonitor(
        BevGrid(int(cells), float(half_extent_m), (float(offset_m[0]), float(offset_m[1]))), thresholds,
        str(about["method"]), about["limit"], about["false_alarm_rate"], (about["sweeps"][0], about["sweeps"][1]),
        {str(key): str(value) for key, value in about["facts"].items()},
    )  # fmt: skip
