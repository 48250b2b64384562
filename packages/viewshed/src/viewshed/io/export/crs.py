"""Coordinate reference systems (CRS) of the world frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from viewshed._extras import needed_for
from viewshed.geometry import Rigid

if TYPE_CHECKING:
    from rasterio.crs import CRS

_WGS84 = "OGC:CRS84"
"""Longitude and latitude in degrees, in the order of RFC 7946."""


def crs_of(name: str) -> CRS:
    """Return the reference system with a name such as ``EPSG:25832``.

    Raises:
        ValueError: the system is unknown or not projected in meters.
        ImportError: rasterio is not installed.
    """
    with needed_for("a coordinate reference system"):
        from rasterio import Env
        from rasterio.crs import CRS
        from rasterio.errors import CRSError
    try:
        with Env():  # otherwise GDAL prints its own error
            system = CRS.from_user_input(name)
    except CRSError as error:
        raise ValueError(f"crs must be a known reference system such as EPSG:25832, got {name!r}") from error
    if not system.is_projected or system.linear_units_factor[1] != 1.0:
        raise ValueError(f"crs must be a projected reference system in meters such as EPSG:25832, got {name!r}")
    return system


def crs_named(name: str, pose: Rigid | None) -> CRS:
    """Return the reference system with a name and check that ``pose`` lies in it; other errors as :func:`crs_of`.

    Raises:
        ValueError: there is no pose, or it lies outside the system.
    """
    system = crs_of(name)
    if pose is None:
        raise ValueError(
            f"an estimate in {name} must have a pose in it, got none; give --poses or an --index with"
            " world_from_sensor, or for points in map coordinates --origin"
        )
    _in_degrees(pose.translation[None, :2], system)
    return system


def degrees_at(name: str, level_m: NDArray[np.float64], pose: Rigid) -> NDArray[np.float64]:
    """Convert points (N, 2) in ``level`` to longitude and latitude (N, 2); errors as :func:`crs_named`."""
    system = crs_named(name, pose)
    return _in_degrees(level_m @ Rigid.from_yaw(pose.yaw).rotation[:2, :2].T + pose.translation[:2], system)


def to_wgs84(polygon: BaseGeometry, system: CRS) -> BaseGeometry:
    """Convert a polygon from meters of a reference system to longitude and latitude in degrees."""
    return shapely.transform(polygon, lambda xy: _in_degrees(xy, system))


def _in_degrees(xy: NDArray[np.float64], source: CRS) -> NDArray[np.float64]:
    """Convert points (N, 2) of a reference system to longitude and latitude."""
    from rasterio import Env
    from rasterio._err import CPLE_BaseError
    from rasterio.warp import transform

    try:
        with Env():
            degrees = np.column_stack(transform(source, _WGS84, xy[:, 0], xy[:, 1])) if len(xy) else xy
    except CPLE_BaseError:
        degrees = np.full((1, 2), np.nan)
    if not np.isfinite(degrees).all():
        raise ValueError(f"x {xy[0, 0]:g} m, y {xy[0, 1]:g} m lies outside of {source}; name another crs")
    return degrees
