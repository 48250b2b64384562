"""Hand-made tracks, views and a model, for the tests of fusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import Detections, ObjectKind
from viewshed.fov.estimate import CellState
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.monitor.report import IntegrityReport
from viewshed.objects.cells import SeenCells
from viewshed.objects.evidence import BOX_FEATURES, EvidenceModel, EvidenceTable, fit_weights
from viewshed.objects.sensor_view import SensorView
from viewshed.objects.single import cell_evidence
from viewshed.objects.tracks import Tracks

GRID = BevGrid(256, 32.0)

CAR = np.array([12.0, 2.0, 0.75, 4.0, 2.0, 1.5, 0.0])
"""A car whose near side the sensor sees."""

GHOST = np.array([8.0, -9.0, 0.75, 4.0, 2.0, 1.5, 0.0])
"""A box on free ground: an object that is not there."""


@dataclass(frozen=True)
class HandView:
    """A view with the same answer for all boxes."""

    t_s: float
    p: float = 1.0
    q: float = 0.95
    in_world: bool = True

    def visible(self, boxes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probability."""
        return np.full(len(boxes), self.p)

    def detectable(self, boxes: NDArray[np.float64], kinds: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return the probability."""
        return np.full(len(boxes), self.q)

    def false_odds(self, boxes: NDArray[np.float64], kinds: NDArray[np.uint8]) -> None:
        """Return nothing."""

    def hides_near(self, boxes: NDArray[np.float64], within_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return 0."""
        return np.zeros(len(boxes))


def cells(*, with_car: bool = True) -> SeenCells:
    """Return a view: free except the near side of ``CAR`` and its shadow; free everywhere without the car."""
    x, y = GRID.centers[..., 0], GRID.centers[..., 1]
    state = np.full(GRID.shape, CellState.FREE, np.uint8)
    inside = (np.abs(y - 2.0) < 1.0) & (x > 10.0) & with_car
    state[inside] = CellState.HIDDEN
    state[inside & (x < 10.6)] = CellState.SURFACE
    return SeenCells(GRID, state, Rigid.identity())


def view(
    t_s: float, *, p: float = 1.0, sensor: str = "top", with_cells: bool = True, report: IntegrityReport | None = None
) -> SensorView:
    """Return the view of a sensor at the origin."""
    return SensorView(sensor, HandView(t_s, p), np.zeros(2), cells() if with_cells else None, report)


def model() -> EvidenceModel:
    """Return a model fitted on ``CAR`` against ``GHOST``."""
    rng = np.random.default_rng(0)
    kinds = np.full(50, ObjectKind.CAR, np.uint8)

    def bins(box: NDArray[np.float64]) -> NDArray[np.int32]:
        boxes = np.tile(box, (50, 1))
        boxes[:, :2] += rng.normal(0.0, 0.1, (50, 2))
        return cell_evidence(boxes, kinds, view(0.0))[1]

    weights = fit_weights(bins(CAR), bins(GHOST))
    assert bins(CAR).shape[1] == len(BOX_FEATURES)
    seen = EvidenceTable((1.0, 5.0, 20.0, 100.0), (100.0, 5.0, 20.0, 50.0))
    birth = EvidenceTable((100.0, 50.0, 10.0, 1.0), (5.0, 5.0, 10.0, 100.0))
    jump = EvidenceTable((100.0, 100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0, 0, 0, 0), (1.0,) * 8 + (20.0,) * 4)
    return EvidenceModel(tuple(weights.tolist()), seen, birth, jump, (8.0, 8.0, 30.0))


def tracks(
    t_s: float, boxes: list[NDArray[np.float64]], found: list[bool], *, p: float = 1.0, ids: list[int] | None = None,
) -> tuple[Tracks, Detections]:  # fmt: skip
    """Return confirmed tracks at boxes, and the detections of those that were detected."""
    count = len(boxes)
    rows = np.array(boxes).reshape(-1, 7)
    numbers = np.array(found, bool)
    states = np.column_stack([rows[:, :2], np.zeros((count, 2))])
    kinds = np.full(count, ObjectKind.CAR, np.uint8)
    shown = Tracks(
        t_s, np.array(range(count) if ids is None else ids, np.int64), states, np.tile(np.eye(4) * 0.05, (count, 1, 1)),
        rows, np.full((count, 5), 0.1), kinds, np.full(count, 0.95), np.ones(count, bool),
        np.where(numbers, np.cumsum(numbers) - 1, -1).astype(np.int32), np.full(count, p), np.full(count, 0.95),
        np.zeros(count), np.where(numbers, t_s, 0.0), np.ones(count),
    )  # fmt: skip
    return shown, Detections(rows[numbers], kinds[numbers], np.full(int(numbers.sum()), 50))
