"""Export estimates to other formats: pure functions from :class:`FovEstimate` to dictionaries or bytes.

``EXPORTERS`` lists them; :func:`write_export` writes one to a file atomically.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed._files import write_atomic
from viewshed.fov.estimate import FovEstimate
from viewshed.io.export import cpm, geojson, geotiff, nav2, osi, ros
from viewshed.io.export import npz as archive
from viewshed.io.export.cpm import claimed_by_cpm, to_cpm
from viewshed.io.export.crs import crs_of
from viewshed.io.export.geojson import to_geojson
from viewshed.io.export.geotiff import to_geotiff
from viewshed.io.export.npz import read_npz, to_npz, write_npz
from viewshed.io.export.osi import to_osi
from viewshed.io.export.ros import to_grid_map, to_occupancy_grid, to_occupancy_grids

__all__ = [
    "EXPORTERS", "Exporter", "claimed_by_cpm", "format_of_content", "format_of_path",
    "read_npz", "to_cpm", "to_geojson",
    "to_geotiff", "to_grid_map", "to_npz", "to_occupancy_grid", "to_occupancy_grids", "to_osi", "write_export",
    "write_npz",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Exporter:
    """One export format."""

    # converts an estimate to a JSON-serializable dictionary, to bytes, or to a pair: a YAML file without its first
    # line (the name of the image file), and the image
    function: Callable[..., dict[str, Any] | bytes | tuple[bytes, bytes]]
    suffix: str  # suffix of the file name
    mark: bytes  # bytes near the start of its files that no other format has
    states: str  # how the four cell states are mapped
    has_crs: bool = False  # whether ``function`` has a parameter ``crs`` (reference system of the world frame)

    def check_crs(self, crs: str | None) -> None:
        """Check that the format supports a reference system.

        Raises:
            ValueError: the format has none, or the system is unknown.
        """
        if crs is None:
            return
        if not self.has_crs:
            supported = [known for known, exporter in EXPORTERS.items() if exporter.has_crs]
            raise ValueError(f"crs goes with {' and '.join(supported)}, got {crs!r} for {self.suffix}; leave it out")
        crs_of(crs)

    def files(self, estimate: FovEstimate, name: str, crs: str | None = None) -> dict[str, bytes]:
        """Return file name → content: companion files first, the file ``name`` last.

        Raises:
            ValueError: ``crs`` is given for a format without one, or the estimate has no pose in it.
        """
        self.check_crs(crs)
        content = self.function(estimate) if crs is None else self.function(estimate, crs=crs)
        if isinstance(content, tuple):
            image = name.removesuffix(".yaml") + ".pgm"
            return {image: content[1], name: f"image: {json.dumps(image)}\n".encode() + content[0]}
        return {name: content if isinstance(content, bytes) else json.dumps(content, allow_nan=False).encode()}


EXPORTERS: dict[str, Exporter] = {
    "geojson": Exporter(to_geojson, ".geojson", b'{"type": "FeatureCollection"', geojson.STATES, has_crs=True),
    "geotiff": Exporter(to_geotiff, ".tif", b"II*\0", geotiff.STATES, has_crs=True),
    "nav2_map": Exporter(nav2.to_map, ".nav2_map.yaml", b"mode: trinary", nav2.MAP_STATES),
    "nav2_mask": Exporter(nav2.to_mask, ".nav2_mask.yaml", b"mode: raw", nav2.MASK_STATES),
    "occupancy_grid": Exporter(to_occupancy_grids, ".occupancy_grid.json", b'{"occupancy"', ros.OCCUPANCY_STATES),
    "grid_map": Exporter(to_grid_map, ".grid_map.json", b'{"header"', ros.GRID_MAP_STATES),
    "osi": Exporter(to_osi, ".osi.json", b'{"frame"', osi.STATES),
    "cpm": Exporter(to_cpm, ".cpm.json", b'{"perceptionRegionContainer"', cpm.STATES),
    "npz": Exporter(to_npz, ".npz", b"about.npy", archive.STATES),
}
"""Name → export format."""

_HEAD_BYTES = 2048


def format_of_content(path: str | Path) -> str:
    """Detect the export format of a file; return its name, or "" if it is no export or does not exist.

    Raises:
        OSError: it cannot be read.
    """
    if not Path(path).is_file():
        return ""
    with Path(path).open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return next((name for name, exporter in EXPORTERS.items() if exporter.mark in head), "")


def format_of_path(path: str | Path) -> str:
    """Return the name of the export format with the suffix of a path; ``.json`` alone is none.

    >>> format_of_path("a/sweep.cpm.json"), format_of_path("fov.geojson")
    ('cpm', 'geojson')

    Raises:
        ValueError: the suffix is unknown; the message lists the known ones.
    """
    for name, exporter in EXPORTERS.items():
        if Path(path).name.endswith(exporter.suffix):
            return name
    suffixes = ", ".join(exporter.suffix for exporter in EXPORTERS.values())
    raise ValueError(f"{path} must end in {suffixes}, or .png for a picture; the suffix chooses the format")


def write_export(estimate: FovEstimate, name: str, path: str | Path, *, crs: str | None = None) -> None:
    """Write the estimate in the format ``name`` to ``path``, atomically; an image of nav2 is written next to it.

    Args:
        estimate: the estimate.
        name: a name in :data:`EXPORTERS`.
        path: the file.
        crs: reference system of the world frame (such as ``EPSG:25832``), for GeoJSON and GeoTIFF.

    Raises:
        ValueError: the format is unknown; the message lists the known ones.
        OSError: the file cannot be written.
    """
    if name not in EXPORTERS:
        raise ValueError(f"format must be one of {', '.join(EXPORTERS)}, got {name!r}")
    main_file = Path(path)
    for file, content in EXPORTERS[name].files(estimate, main_file.name, crs).items():
        write_atomic(main_file.with_name(file), content)


def save_estimate(estimate: FovEstimate, path: Path) -> None:
    """Write the estimate in the format given by the suffix of ``path``; see :meth:`FovEstimate.save`."""
    write_export(estimate, format_of_path(path), path)
