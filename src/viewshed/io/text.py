"""Rows of numbers in text, as ascii PCD and PLY hold them."""

from __future__ import annotations

import io
import warnings

import numpy as np
from numpy.typing import NDArray


def number_rows(content: bytes, start: int, rows: int, width: int) -> NDArray[np.float64]:
    r"""Return (rows, width) float64 numbers from the text at ``start``.

    Raises:
        ValueError: there are fewer rows, a row has another width, or a word is not a number.

    >>> number_rows(b"1 2 nan\n", 0, 1, 3).tolist()
    [[1.0, 2.0, nan]]
    """
    if rows == 0:
        return np.empty((0, width))
    if rows * max(1, 2 * width - 1) > len(content) - start:
        raise ValueError(f"text is cut off: {rows} rows of {width} numbers need more than {len(content) - start} bytes")
    if not content[start:].strip():
        raise ValueError(f"text is cut off: {rows} rows were promised, got none")
    stream = io.TextIOWrapper(io.BytesIO(memoryview(content)[start:]), encoding="latin-1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about empty lines, which the shape shows
        table = np.loadtxt(stream, dtype=np.float64, comments=None, max_rows=rows, ndmin=2)
    if table.shape != (rows, width):
        raise ValueError(f"text must hold {rows} rows of {width} numbers, got {table.shape[0]} of {table.shape[1]}")
    return table
