"""Array types, read-only arrays, and checked integers."""

from __future__ import annotations

from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

F64 = NDArray[np.float64]

Mask = NDArray[np.bool_]


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous read-only view (a copy if not contiguous); the caller's array stays writable."""
    view = np.ascontiguousarray(array).view()
    view.setflags(write=False)
    return view


def as_int(name: str, value: Any) -> int:
    """Return a Python int for a Python or NumPy integer; anything else, bool included, raises ValueError."""
    try:
        if not isinstance(value, bool):
            return index(value)
    except TypeError:
        pass
    raise ValueError(f"{name} must be a whole number, got {value!r}")
