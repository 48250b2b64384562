"""Sample data of the package: a simulated junction with ground truth, made by ``tools/make_sample.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.truth import Truth
from viewshed.grid import GRIDS

_FOLDER = Path(__file__).parent


def junction_path() -> Path:
    """Return the path of a simulated HDL-32E sweep of a road junction (nuScenes format, gzipped).

    >>> junction_path().name
    'junction.pcd.bin.gz'
    """
    return _FOLDER / "junction.pcd.bin.gz"


def junction_truth_path() -> Path:
    """Return the path of the exact ground truth of that sweep, an NPZ for :func:`junction_truth`.

    >>> junction_truth_path().name
    'junction_truth.npz'
    """
    return _FOLDER / "junction_truth.npz"


def junction_truth() -> tuple[Truth, NDArray[np.bool_]]:
    """Return the ground truth of the junction for cars on the grid ``road``, and the mask of cells where it is known.

    >>> truth, known = junction_truth()
    >>> truth.visible("car").shape, bool(known.all())
    ((256, 256), True)
    """
    with np.load(junction_truth_path()) as stored:
        truth = Truth(GRIDS["road"], {"car": stored["expected_returns"]}, {"car": stored["state"]})
        return truth, stored["known"]
