"""GeoTIFF: export an estimate as a raster for geographic information systems."""

from __future__ import annotations

import numpy as np

from viewshed._extras import needed_for
from viewshed.fov.estimate import FovEstimate
from viewshed.io.export.crs import crs_named

STATES = "band `state`: UNKNOWN 0, FREE 1, SURFACE 2, HIDDEN 3; bands `visible_prob` and `std`, NaN where there is none"

BANDS = ("state", "visible_prob", "std")


def to_geotiff(estimate: FovEstimate, crs: str | None = None) -> bytes:
    """Encode an estimate as a GeoTIFF of three float32 bands ``state``, ``visible_prob`` and ``std``, one pixel a cell.

    In meters of the world frame, rotated by the yaw of the pose; of ``level`` if there is no pose.

    Args:
        estimate: the estimate.
        crs: reference system of the world frame, such as ``EPSG:25832``; None writes none.

    Raises:
        ValueError: the estimate has no pose in the reference system, or that is unknown or not in meters.
        ImportError: rasterio is not installed.
    """
    with needed_for("writing a GeoTIFF"):
        from rasterio.io import MemoryFile
        from rasterio.transform import Affine
    grid, pose = estimate.grid, estimate.world_from_level
    left_m, top_m = grid.origin_m[0], grid.origin_m[1] + 2.0 * grid.half_extent_m
    world_from_pixel = np.array([[grid.cell_m, 0.0, left_m], [0.0, -grid.cell_m, top_m], [0.0, 0.0, 1.0]])
    if pose is not None:
        (x_m, y_m), c, s = pose.translation[:2], np.cos(pose.yaw), np.sin(pose.yaw)
        world_from_pixel = np.array([[c, -s, x_m], [s, c, y_m], [0.0, 0.0, 1.0]]) @ world_from_pixel
    system = None if crs is None else crs_named(crs, pose)
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=grid.cells, height=grid.cells, count=len(BANDS), dtype="float32", nodata=np.nan,
            transform=Affine(*world_from_pixel[:2].ravel().tolist()), crs=system, compress="deflate",
        ) as raster:  # fmt: skip
            for number, name in enumerate(BANDS, start=1):
                # Rows go from the largest y to the smallest, columns along x.
                raster.write(np.asarray(getattr(estimate, name), np.float32).T[::-1], number)
                raster.set_band_description(number, name)
            raster.update_tags(
                method=estimate.method, target=estimate.target.name, threshold=f"{estimate.threshold:g}",
                frame="level" if pose is None else "world", agent=estimate.agent,
                t_ns="" if estimate.t_ns is None else str(estimate.t_ns),
            )  # fmt: skip
        memory.seek(0)
        return bytes(memory.read())
