"""ROS messages as plain dictionaries: nav_msgs/OccupancyGrid and grid_map_msgs/GridMap; does not need ROS."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState, FovEstimate

OCCUPANCY_STATES = (
    "`occupancy`, for costmaps: FREE 0, SURFACE 100, HIDDEN and UNKNOWN -1; "
    "`state`: FREE 0, HIDDEN 50, SURFACE 100, UNKNOWN -1; "
    "`visibility`: 0…100 % for FREE, SURFACE and HIDDEN, UNKNOWN -1"
)

GRID_MAP_STATES = "layer `state`: UNKNOWN 0, FREE 1, SURFACE 2, HIDDEN 3"

_NO_STD = -1.0


def to_occupancy_grid(estimate: FovEstimate, layer: str = "occupancy") -> dict[str, Any]:
    """Return a nav_msgs/OccupancyGrid (dict) in the ``level`` frame; ``data`` is row by row, x fastest.

    Args:
        estimate: the estimate.
        layer: ``occupancy`` (FREE 0, SURFACE 100, HIDDEN and UNKNOWN -1, for costmaps: nav2's static layer treats any
            value in between as free), or another layer of :func:`visibility_layer`, such as ``state``, which
            distinguishes HIDDEN from UNKNOWN.

    Raises:
        ValueError: the layer is unknown.
    """
    grid = estimate.grid
    values = visibility_layer(estimate, layer)
    return {
        "header": _header(estimate),
        "info": {
            "map_load_time": _stamp(estimate),
            "resolution": grid.cell_m,
            "width": grid.cells,
            "height": grid.cells,
            "origin": _pose(*grid.origin_m),
        },
        "data": values.T.ravel().tolist(),
    }


def to_occupancy_grids(estimate: FovEstimate) -> dict[str, Any]:
    """Return the three layers ``occupancy``, ``state`` and ``visibility`` as OccupancyGrid messages by name."""
    return {layer: to_occupancy_grid(estimate, layer) for layer in ("occupancy", "state", "visibility")}


_OCCUPANCY_VALUES, _STATE_VALUES = np.array([-1, 0, 100, -1], np.int8), np.array([-1, 0, 100, 50], np.int8)
"""Values of the layers ``occupancy`` and ``state`` by :class:`CellState`; only ``state`` distinguishes HIDDEN."""


def visibility_layer(estimate: FovEstimate, name: str) -> NDArray[np.int8]:
    """Return one layer (cells, cells) int8, x first, with values of an OccupancyGrid.

    Args:
        estimate: the estimate.
        name: ``visibility`` (probability in percent) or ``doubt`` (probability in percent that the likelier answer is
            wrong, 0 to 50), both -1 where UNKNOWN; ``state`` (UNKNOWN -1, FREE 0, HIDDEN 50, SURFACE 100); or
            ``occupancy`` (FREE 0, SURFACE 100, else -1).

    Raises:
        ValueError: the layer is unknown.
    """
    match name:
        case "state":
            return _STATE_VALUES[estimate.state]
        case "occupancy":
            return _OCCUPANCY_VALUES[estimate.state]
        case "visibility" | "doubt":
            prob = estimate.doubt() if name == "doubt" else estimate.visible_prob
            percent = np.rint(100.0 * prob).astype(np.int8)
            return np.where(estimate.state == CellState.UNKNOWN, np.int8(-1), percent)
    raise ValueError(f"layer must be occupancy, visibility, state or doubt, got {name!r}")


def to_grid_map(estimate: FovEstimate) -> dict[str, Any]:
    """Return a grid_map_msgs/GridMap (dict) in the ``level`` frame with layers visible_prob, state and, if known, std.

    Storage order of grid_map: index (0, 0) is the cell of largest x and y, both decrease with the index, and data are
    column-major (first dimension ``column_index``) with both start indices 0. JSON has no NaN: ``std`` is -1 in cells
    without a standard deviation, and the layer is omitted if no cell has one.
    """
    grid = estimate.grid
    layers = {"visible_prob": estimate.visible_prob, "state": estimate.state.astype(np.float32)}
    std = estimate.std
    if std is not None and np.isfinite(std).any():
        layers["std"] = np.where(np.isfinite(std), std, np.float32(_NO_STD))
    return {
        "header": _header(estimate),
        "info": {
            "resolution": grid.cell_m,
            "length_x": 2.0 * grid.half_extent_m,
            "length_y": 2.0 * grid.half_extent_m,
            "pose": _pose(*grid.offset_m),
        },
        "layers": list(layers),
        "basic_layers": ["visible_prob"],
        "data": [_multi_array(values) for values in layers.values()],
        "outer_start_index": 0,
        "inner_start_index": 0,
    }


def _multi_array(values: NDArray[np.float32]) -> dict[str, Any]:
    rows, columns = values.shape
    dim = [
        {"label": "column_index", "size": columns, "stride": rows * columns},
        {"label": "row_index", "size": rows, "stride": rows},
    ]
    return {"layout": {"dim": dim, "data_offset": 0}, "data": values[::-1, ::-1].ravel(order="F").tolist()}


def _header(estimate: FovEstimate) -> dict[str, Any]:
    return {"stamp": _stamp(estimate), "frame_id": f"{estimate.agent}/level"}


def _stamp(estimate: FovEstimate) -> dict[str, int]:
    seconds, nanoseconds = divmod(estimate.t_ns or 0, 1_000_000_000)
    return {"sec": seconds, "nanosec": nanoseconds}


def _pose(x: float, y: float) -> dict[str, dict[str, float]]:
    return {
        "position": {"x": float(x), "y": float(y), "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
