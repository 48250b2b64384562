"""Read LAS and LAZ files (surveys, handheld scanners) with laspy."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator

import numpy as np

from viewshed._extras import needed_for
from viewshed.geometry import Rigid
from viewshed.io._columns import KNOWN_COLUMNS, Columns, columns_of_table
from viewshed.io._input import InputFile, unpack_limit
from viewshed.sweep import MAX_POINTS


def read_las(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the points of a LAS or LAZ file as one sweep; coordinates stay float64 until ``frame`` is applied.

    Time is dropped: it is that of a survey, not of a revolution.
    """
    with needed_for("reading LAS and LAZ"):
        import laspy
    content = source.content()
    _check_header(content)
    with laspy.open(io.BytesIO(content)) as reader:
        header = reader.header
        count, needed = header.point_count, header.point_count * header.point_format.size
        if count > MAX_POINTS:
            raise ValueError(f"a sweep must have at most {MAX_POINTS} points, LAS header says {count}")
        available = (
            unpack_limit(len(content)) if header.are_points_compressed else len(content) - header.offset_to_point_data
        )
        if needed > available:
            raise ValueError(f"LAS data is cut off: {count} points need {needed} bytes, the file holds {available}")
        points = reader.read()
    table = {name: np.asarray(getattr(points, name), np.float64) for name in "xyz"}
    extra = {name.lower(): name for name in header.point_format.extra_dimension_names if name.lower() in KNOWN_COLUMNS}
    table |= {lower: np.asarray(points[name]) for lower, name in extra.items() if lower not in {"x", "y", "z"}}
    table.setdefault("intensity", np.asarray(points.intensity, np.float32))
    yield columns_of_table(table, frame, ours=False)


def _check_header(content: bytes) -> None:
    """Check the lengths and counts that laspy does not validate."""
    if len(content) < _HEADER_BYTES:
        raise ValueError(f"LAS header is cut off: it needs {_HEADER_BYTES} bytes, the file holds {len(content)}")
    major, minor = content[24:26]
    header, start, records = struct.unpack_from("<HII", content, 94)
    extended = struct.unpack_from("<QI", content, 235) if minor >= 4 and len(content) >= _HEADER_BYTES_14 else (0, 0)
    fits = _HEADER_BYTES <= header <= start <= len(content) and records * _RECORD_BYTES <= start - header
    if (major, minor > 4) != (1, False) or not fits or extended[1] * _RECORD_BYTES > max(len(content) - extended[0], 0):
        raise ValueError("LAS header is damaged: its version, lengths or counts are impossible")


_HEADER_BYTES, _HEADER_BYTES_14, _RECORD_BYTES = 227, 375, 54
"""Sizes of the header of LAS 1.0 to 1.2 and of LAS 1.4, and of the header of a variable length record."""
