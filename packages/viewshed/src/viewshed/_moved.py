"""Import paths of version 0.3 that version 0.4 still accepts: ``viewshed.integrity`` is now ``viewshed.monitor``."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType

from viewshed._extras import needs_laboratory

_OBJECTS = (
    "before", "calibration", "cells", "evidence", "explained", "jumps", "memory", "object_stream", "sensor_view",
    "single",
)  # fmt: skip
MOVED = {
    "viewshed.integrity": "viewshed.monitor",
    "viewshed.perception": "viewshed.objects",
    "viewshed.tracking": "viewshed.objects",
    "viewshed.object_metrics": "viewshed.objects.metrics",
    **{f"viewshed.fusion.{name}": f"viewshed.objects.{name}" for name in _OBJECTS},
    "viewshed.fusion": "viewshed.agents",
    "viewshed.messages": "viewshed.agents",
    **{
        f"viewshed.networks.{name}": f"viewshed_lab.training.{name}"
        for name in ("onnx_export", "quantize", "unet_torch")
    },
    "viewshed.plot": "viewshed.show.plot",
    "viewshed.view": "viewshed.show.view",
    "viewshed.datasets.recording": "viewshed.recordings.recording",
    "viewshed.datasets.recordings": "viewshed.recordings.read",
    "viewshed.datasets.recorder": "viewshed.recordings.write",
    "viewshed.datasets": "viewshed_lab.data",
    "viewshed.sim": "viewshed_lab.sim",
    "viewshed.studies": "viewshed_lab.studies",
    "viewshed.threats": "viewshed_lab.threats",
    "viewshed.training": "viewshed_lab.training",
}
"""Path in version 0.3 → current path; the longest matching prefix counts."""


class _MovedFinder(MetaPathFinder):
    """Finds a module by its former path."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        parts = name.split(".")
        for count in range(len(parts), 1, -1):
            path_now = MOVED.get(".".join(parts[:count]))
            if path_now is not None:
                return spec_from_loader(name, _MovedLoader(".".join([path_now, *parts[count:]])))
        return None


class _MovedLoader(Loader):
    """Loads a module from its current path; both names refer to the same module object."""

    def __init__(self, path: str) -> None:
        self._path = path

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        warnings.warn(f"{spec.name} is now {self._path}", DeprecationWarning, stacklevel=2)
        try:
            module = import_module(self._path)
        except ModuleNotFoundError as error:
            if error.name != "viewshed_lab":
                raise
            raise needs_laboratory(spec.name) from error
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec


def install() -> None:
    """Make former paths importable."""
    if not any(isinstance(finder, _MovedFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _MovedFinder())
