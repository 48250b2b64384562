"""GeoJSON: polygons of the visible area and of each cell state."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from shapely.affinity import affine_transform
from shapely.geometry.base import BaseGeometry

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.polygons import local_crs, polygon_of_mask
from viewshed.io.export.crs import crs_named, to_wgs84

if TYPE_CHECKING:
    from rasterio.crs import CRS

STATES = (
    "one MultiPolygon each: `free`, `surface`, `hidden`, `unknown`; and `visible`, the cells at or above the threshold"
)


def to_geojson(estimate: FovEstimate, threshold: float | None = None, *, crs: str | None = None) -> dict[str, Any]:
    """Return a GeoJSON FeatureCollection (dict) of five MultiPolygons: ``visible`` and the four cell states.

    With ``crs``, coordinates are longitude and latitude in degrees (RFC 7946). Without, they are meters in the
    ``world`` frame if the estimate has a pose (x, y and yaw are applied; ``level`` is already upright), else in
    ``level``; the member ``crs`` is then a local system, so that programs do not interpret them as degrees. The member
    ``viewshed:frame`` states the frame. The four states tile the grid; ``visible`` overlaps them. Each feature's
    properties include the fields of :class:`Basis`, the data that the estimate is based on.

    Args:
        estimate: the estimate.
        threshold: minimum probability of a visible cell; None is the threshold of the estimate.
        crs: reference system of the world frame in meters, such as ``EPSG:25832``.

    Raises:
        ValueError: the estimate has no pose in the reference system, or that is unknown or not in meters.
        ImportError: ``crs`` is given, and rasterio is not installed.
    """
    threshold = estimate.threshold if threshold is None else threshold
    pose = estimate.world_from_level
    system = None if crs is None else crs_named(crs, pose)
    masks = {"visible": estimate.visible(threshold)}
    masks |= {state.name.lower(): estimate.state == state for state in CellState}
    frame = "level" if pose is None else "world"
    unit = f"meters in {frame} frame, not WGS84" if crs is None else "degrees, WGS84"
    return {
        "type": "FeatureCollection",
        **({"crs": local_crs(frame)} if crs is None else {}),
        "viewshed:frame": {
            "name": frame,
            "coordinates": unit,
            "axes": "x forward, y left of the sensor" if pose is None else "x and y of the map",
            "crs": crs,
            "world_from_level": None if pose is None else pose.as_matrix().tolist(),
        },
        "viewshed:grid": {
            "cells": estimate.grid.cells,
            "half_extent_m": float(estimate.grid.half_extent_m),
            "offset_m": [float(value) for value in estimate.grid.offset_m],
        },
        "features": [_feature(layer, mask, estimate, threshold, system) for layer, mask in masks.items()],
    }


def _feature(layer: str, mask: Any, estimate: FovEstimate, threshold: float, system: CRS | None) -> dict[str, Any]:
    polygon = polygon_of_mask(mask, estimate.grid)
    pose = estimate.world_from_level
    geometry: BaseGeometry = polygon
    if pose is not None:
        c, s, (x_m, y_m) = float(np.cos(pose.yaw)), float(np.sin(pose.yaw)), pose.translation[:2].tolist()
        geometry = affine_transform(polygon, [c, -s, s, c, x_m, y_m])
    geometry = geometry if system is None else to_wgs84(geometry, system)
    return {
        "type": "Feature",
        "geometry": {"type": "MultiPolygon", "coordinates": shapely.geometry.mapping(geometry)["coordinates"]},
        "properties": {
            "layer": layer,
            "area_m2": float(mask.sum()) * estimate.grid.cell_area_m2,
            "threshold": threshold if layer == "visible" else None,
            "method": estimate.method,
            "target": estimate.target.name,
            "t_ns": estimate.t_ns,
            "agent": estimate.agent,
            **({} if estimate.basis is None else asdict(estimate.basis)),
        },
    }
