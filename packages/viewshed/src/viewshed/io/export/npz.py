"""NPZ: lossless storage of an estimate."""

from __future__ import annotations

import io
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from viewshed._files import DAMAGED, read_arrays, write_atomic
from viewshed.fov.estimate import THRESHOLD, Basis, FovEstimate
from viewshed.fov.visibility import Target
from viewshed.geometry import Rigid
from viewshed.grid import MAX_CELLS, BevGrid

STATES = "array `state`: UNKNOWN 0, FREE 1, SURFACE 2, HIDDEN 3"

_ARRAYS = ("visible_prob", "std", "state")

_VERSION = 1

_MAX_BYTES = 4 * MAX_CELLS**2 + 4096
"""Maximum size of an array, decompressed."""


def write_npz(estimate: FovEstimate, path: str | Path) -> None:
    """Write the estimate to ``path`` (compressed NPZ), atomically and without loss; :func:`read_npz` reads it.

    Raises:
        OSError: the file cannot be written.
    """
    write_atomic(path, to_npz(estimate))


def to_npz(estimate: FovEstimate) -> bytes:
    """Encode an estimate as a compressed NPZ: visible_prob, std, state, and metadata as UTF-8 JSON in ``about``."""
    pose, target = estimate.world_from_level, estimate.target
    about = {
        "version": _VERSION,
        "grid": [estimate.grid.cells, float(estimate.grid.half_extent_m), [float(v) for v in estimate.grid.offset_m]],
        "method": estimate.method,
        "target": [target.name, target.length_m, target.width_m, target.height_m, target.min_returns],
        "world_from_level": None if pose is None else pose.as_matrix().tolist(),
        "t_ns": estimate.t_ns,
        "agent": estimate.agent,
        "threshold": estimate.threshold,
        "basis": None if estimate.basis is None else asdict(estimate.basis),
    }
    arrays: dict[str, Any] = {name: getattr(estimate, name) for name in _ARRAYS}
    file = io.BytesIO()
    np.savez_compressed(file, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)
    return file.getvalue()


def read_npz(path: str | Path) -> FovEstimate:
    """Read an estimate written by :func:`write_npz`; nothing is unpickled.

    Raises:
        ValueError: the file is not such an NPZ.
        OSError: the file cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        arrays = read_arrays(raw, _MAX_BYTES, ("about", *_ARRAYS))
        return _estimate(json.loads(arrays.pop("about").tobytes()), arrays)
    except DAMAGED as error:
        raise ValueError(f"{path} must be an NPZ of write_npz: {' '.join(str(error).split())}") from error


def _estimate(about: dict[str, Any], arrays: dict[str, Any]) -> FovEstimate:
    if about["version"] != _VERSION:
        raise ValueError(f"version must be {_VERSION}, got {about['version']}")
    cells, half_extent_m, offset = about["grid"]
    matrix, basis = about["world_from_level"], about.get("basis")
    return FovEstimate(
        BevGrid(cells, half_extent_m, (offset[0], offset[1])),
        **arrays,
        method=about["method"],
        target=Target(*about["target"]),
        world_from_level=None if matrix is None else Rigid.from_matrix(matrix),
        t_ns=about["t_ns"],
        agent=about["agent"],
        threshold=about.get("threshold", THRESHOLD),
        basis=None if basis is None else Basis(**basis),
    )
