"""Polygons in the style of ASAM OSI: rings of Vector3d and a Timestamp.

OSI 3 has no message for a field of view (SensorViewConfiguration states only the nominal one), so this is **not** an
OSI message: it uses OSI's field names, units and right-handed axes, for tools that already read those.
"""

from __future__ import annotations

from typing import Any

import shapely

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.polygons import polygon_of_mask

STATES = "`visible`: FREE and SURFACE, by the threshold; `hidden`: HIDDEN; `unknown`: UNKNOWN"


def to_osi(estimate: FovEstimate, threshold: float | None = None) -> dict[str, Any]:
    """Return OSI-style polygons (dict): one entry a polygon, with its layer, outer ring and inner rings.

    Rings are lists of {x, y, z} in meters in ``level``, z = 0 (the ground below the sensor), not closed; outer rings
    are counter-clockwise, inner ones clockwise. ``timestamp`` is {seconds, nanos}, absent if the time is unknown.
    """
    visible = estimate.visible(threshold)
    masks = {
        "visible": visible,
        "hidden": ~visible & (estimate.state == CellState.HIDDEN),
        "unknown": ~visible & (estimate.state == CellState.UNKNOWN),
    }
    message: dict[str, Any] = {"frame": "level", "agent": estimate.agent, "method": estimate.method}
    if estimate.t_ns is not None:
        message["timestamp"] = dict(zip(("seconds", "nanos"), divmod(estimate.t_ns, 1_000_000_000), strict=True))
    message["polygons"] = [
        {"layer": layer, "outer": _vectors(part.exterior), "inner": [_vectors(ring) for ring in part.interiors]}
        for layer, mask in masks.items()
        for part in polygon_of_mask(mask, estimate.grid).geoms
    ]
    return message


def _vectors(ring: Any) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": 0.0} for x, y in shapely.get_coordinates(ring)[:-1].tolist()]
