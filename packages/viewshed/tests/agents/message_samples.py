"""Messages for tests: a small view with shadows, detections and a report."""

from typing import Any

import numpy as np

from viewshed import CAR, BevGrid, CellState, FovEstimate, Rigid
from viewshed.agents.view_message import SensorFacts, ViewMessage
from viewshed.detections import Detections
from viewshed.fov.height_map import HeightMap
from viewshed.monitor.report import IntegrityReport

NOW_NS = 1_760_000_000_000_000_000
GRID = BevGrid(64, 16.0)
POSE = Rigid.from_yaw(0.7, (601_234.5, 5_300_000.25, 12.0))


def view(grid: BevGrid = GRID, with_std: bool = False) -> FovEstimate:
    distance, angle = (
        np.hypot(*np.moveaxis(grid.centers, -1, 0)),
        np.arctan2(grid.centers[..., 1], grid.centers[..., 0]),
    )
    prob = np.clip(1.4 - distance / 14, 0, 1) * (distance > 1)
    prob = np.where((np.abs(angle - 0.5) < 0.2) & (distance > 5), 0.1, prob).astype(np.float32)
    state = np.where(prob >= 0.5, CellState.FREE, np.where(distance < 14, CellState.HIDDEN, CellState.UNKNOWN))
    std = (0.3 * np.exp(-distance)).astype(np.float32) if with_std else None
    return FovEstimate(grid, prob, state.astype(np.uint8), std, method="shadow_map", target=CAR)


def ground() -> HeightMap:
    """A slope with a step."""
    centers = BevGrid(64, GRID.half_extent_m).centers
    heights = (0.1 * centers[..., 0] + np.where(centers[..., 1] > 3.0, 2.0, 0.0)).astype(np.float32)
    return HeightMap(heights, GRID.half_extent_m, np.ones(heights.shape, bool))


def message(sequence: Any = 1, agent: Any = "car1", t_ns: Any = NOW_NS, **changes: Any) -> Any:
    """Return a message with all fields; keywords replace fields."""
    covariance = np.diag([0.04, 0.04, 0.01, 1e-4, 1e-4, 4e-4])
    covariance[0, 5] = covariance[5, 0] = 1e-3
    rng = np.random.default_rng(4)
    boxes = np.column_stack([rng.normal(0, 9, (2, 3)), rng.uniform(0.5, 4, (2, 3)), rng.normal(size=2)])
    suspect = np.zeros(72, bool)
    suspect[[0, 5, 71]] = True
    fields: dict[str, Any] = {
        "agent": agent, "sequence": sequence, "t_ns": t_ns, "frame": "map", "world_from_level": POSE,
        "pose_covariance": covariance, "sensor": SensorFacts("HDL-32E", 1.84, 70.0), "view": view(),
        "ground": ground(),
        "detections": Detections(boxes, np.array([3, 1], np.uint8), np.array([40, 7], np.int32)),
        "report": IntegrityReport("by hand", 2.0, 1.5, 0.01, True, 0.25, suspect),
        "epoch": 0,
    }  # fmt: skip
    return ViewMessage(**(fields | changes))
