"""Types of arrays, by what they hold; read-only arrays and whole numbers."""

from __future__ import annotations

from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

F64 = NDArray[np.float64]

Mask = NDArray[np.bool_]


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous read-only array; a view is enough, the caller's own array stays writable."""
    view = np.ascontiguousarray(array).view()
    view.setflags(write=False)
    return view


def whole(name: str, value: Any) -> int:
    """Return a whole number, numpy's as well, as one of Python; anything else is a ValueError."""
    try:
        if not isinstance(value, bool):
            return index(value)
    except TypeError:
        pass
    raise ValueError(f"{name} must be a whole number, got {value!r}")
