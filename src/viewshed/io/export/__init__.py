"""Estimates in other programs' formats: pure functions from :class:`FovEstimate` to dictionaries or bytes.

``EXPORTERS`` names them; :func:`write_export` writes one to a file, whole or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed._files import write_atomic
from viewshed.fov.estimate import FovEstimate
from viewshed.io.export import cpm, geojson, osi, ros
from viewshed.io.export import npz as archive
from viewshed.io.export.cpm import claimed_by_cpm, to_cpm
from viewshed.io.export.geojson import fov_from_geojson, to_geojson
from viewshed.io.export.npz import read_npz, to_npz, write_npz
from viewshed.io.export.osi import polygons_of_osi, to_osi
from viewshed.io.export.ros import (
    fov_from_grid_map,
    fov_from_occupancy_grid,
    to_grid_map,
    to_occupancy_grid,
    to_occupancy_grids,
)

__all__ = [
    "EXPORTERS", "Exporter", "claimed_by_cpm", "format_of_path", "fov_from_geojson", "fov_from_grid_map",
    "fov_from_occupancy_grid", "polygons_of_osi", "read_npz", "to_cpm", "to_geojson", "to_grid_map", "to_npz",
    "to_occupancy_grid", "to_occupancy_grids", "to_osi", "write_export", "write_npz",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Exporter:
    """How one format is made.

    Attributes:
        function: estimate to a JSON-serializable dictionary, or to bytes.
        suffix: usual end of a file's name.
        states: how the four cell states map.
    """

    function: Callable[[FovEstimate], dict[str, Any] | bytes]
    suffix: str
    states: str

    def encode(self, estimate: FovEstimate) -> bytes:
        """Return the content of the file."""
        made = self.function(estimate)
        return made if isinstance(made, bytes) else json.dumps(made, allow_nan=False).encode()


EXPORTERS: dict[str, Exporter] = {
    "geojson": Exporter(to_geojson, ".geojson", geojson.STATES),
    "occupancy_grid": Exporter(to_occupancy_grids, ".occupancy_grid.json", ros.OCCUPANCY_STATES),
    "grid_map": Exporter(to_grid_map, ".grid_map.json", ros.GRID_MAP_STATES),
    "osi": Exporter(to_osi, ".osi.json", osi.STATES),
    "cpm": Exporter(to_cpm, ".cpm.json", cpm.STATES),
    "npz": Exporter(to_npz, ".npz", archive.STATES),
}
"""The formats by name."""


def format_of_path(path: str | Path) -> str:
    """Return the name of the format whose suffix a file's name has; ``.json`` alone is none.

    >>> format_of_path("a/sweep.cpm.json"), format_of_path("fov.geojson")
    ('cpm', 'geojson')

    Raises:
        ValueError: no format has it; the message lists those that exist.
    """
    for name, exporter in EXPORTERS.items():
        if Path(path).name.endswith(exporter.suffix):
            return name
    suffixes = ", ".join(exporter.suffix for exporter in EXPORTERS.values())
    raise ValueError(f"{path} must end in {suffixes}, or .png for a picture; the suffix chooses the format")


def write_export(estimate: FovEstimate, name: str, path: str | Path) -> None:
    """Write the estimate in the format ``name`` to ``path``, at once or not at all.

    Raises:
        ValueError: no format has this name; the message lists those that exist.
        OSError: the file cannot be written.
    """
    if name not in EXPORTERS:
        raise ValueError(f"format must be one of {', '.join(EXPORTERS)}, got {name!r}")
    write_atomic(path, EXPORTERS[name].encode(estimate))
