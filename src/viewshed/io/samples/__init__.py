"""The sample that travels with the package: a simulated junction, made by ``tools/make_sample.py``."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def junction_path() -> Path:
    """Return the path of a simulated HDL-32E sweep of a road junction (nuScenes format, gzipped).

    >>> junction_path().name
    'junction.pcd.bin.gz'
    """
    return Path(str(resources.files("viewshed") / "io" / "samples" / "junction.pcd.bin.gz"))
