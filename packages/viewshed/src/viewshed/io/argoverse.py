"""Argoverse 2 sweeps: Arrow IPC (feather version 2) with x, y, z, intensity, laser_number, offset_ns."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed.geometry import Rigid
from viewshed.io._columns import FILE_FRAMES, KNOWN_COLUMNS, Columns, columns_of_table
from viewshed.io._input import InputFile, unpack_limit
from viewshed.sweep import MAX_POINTS

_NANOSECONDS = re.compile(r"(\d{18})\.feather$")

_MAGIC_BYTES = 8

_MAX_BATCHES = 10_000


def read_argoverse2(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the sweep of an Argoverse 2 feather file, by default transformed from the car's frame to ``up_lidar``."""
    table = read_feather(source.content(), KNOWN_COLUMNS)
    if frame is None and "laser_number" not in table:
        raise ValueError("is no Argoverse 2 sweep (it has no laser_number); name the frame of its points")
    columns = columns_of_table(table, frame or FILE_FRAMES["argoverse2"], ours=False)
    match = _NANOSECONDS.search(source.name)
    columns.t_ns = int(match[1]) if match else None
    yield columns


def read_feather(content: bytes, numbers: Collection[str], texts: Collection[str] = ()) -> dict[str, NDArray[Any]]:
    """Read columns of an Arrow file by lower-case name; the footer of the file is not used.

    Args:
        content: the bytes of the file.
        numbers: names of numeric columns; missing ones are left out.
        texts: names of text columns; all are required.

    Raises:
        ValueError: the content is damaged, unpacks to too many bytes, or a column has another type.
    """
    with needed_for("reading Argoverse 2"):
        import pyarrow as pa

    stream = pa.py_buffer(content)[_MAGIC_BYTES:]
    try:
        _check_messages(pa, stream, unpack_limit(len(content)))
        arrow = pa.ipc.open_stream(stream).read_all()
        if arrow.num_rows > MAX_POINTS:
            raise ValueError(f"a file must have at most {MAX_POINTS} rows, got {arrow.num_rows}")
        names = [name for name in arrow.column_names if name.lower() in numbers]
        columns = {name.lower(): _numbers(pa, name, arrow.column(name)) for name in names}
        return columns | {name: np.array(arrow.column(name).to_pylist(), np.str_) for name in texts}
    except pa.ArrowException as error:
        raise ValueError(f"feather content is damaged or cut off: {error}") from error
    except (KeyError, TypeError, OSError, UnicodeError, MemoryError) as error:
        raise ValueError(f"feather content is damaged or cut off: {error or type(error).__name__}") from error


def _numbers(pa: Any, name: str, column: Any) -> NDArray[Any]:
    if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        raise ValueError(f"feather column {name} must be numbers, got {column.type}")
    column.validate(full=True)
    return np.asarray(column.to_numpy())


def _check_messages(pa: Any, stream: Any, limit: int) -> None:
    """Raise ValueError if the compressed buffers claim more than ``limit`` bytes, before Arrow allocates them."""
    claimed = 0
    batches = 0
    for message in pa.ipc.MessageReader.open_stream(stream):
        if message.type == "dictionary":
            raise ValueError("feather must hold plain number columns, got a dictionary")
        if message.type == "record batch":
            batches += 1
            if batches > _MAX_BATCHES:
                raise ValueError(f"feather must have at most {_MAX_BATCHES} record batches")
            claimed += _claimed_bytes(message.metadata.to_pybytes(), message.body.to_pybytes())
        if claimed > limit:
            raise ValueError(f"feather buffers claim {claimed} bytes, more than {limit}; refused")
    if not batches:
        raise ValueError("feather holds no rows")


def _claimed_bytes(metadata: bytes, body: bytes) -> int:
    """Return the claimed decompressed size in bytes of the buffers of a record batch.

    Layout (format/Message.fbs of Apache Arrow): Message.header is field 2; RecordBatch.buffers is field 2, a vector of
    (offset, length) int64 pairs, and RecordBatch.compression is field 3. A compressed buffer begins with its
    decompressed length as int64, -1 if it is stored uncompressed.
    """
    try:
        batch = _follow(metadata, _field(metadata, _follow(metadata, 0), 2))
        if not _field(metadata, batch, 3):
            return 0
        vector = _follow(metadata, _field(metadata, batch, 2))
        count = struct.unpack_from("<I", metadata, vector)[0]
        claimed = 0
        for offset, length in struct.iter_unpack("<qq", metadata[vector + 4 : vector + 4 + 16 * count]):
            if length:
                claimed += max(0, struct.unpack_from("<q", body, offset)[0])
    except struct.error as error:
        raise ValueError(f"feather metadata is damaged: {error}") from error
    return claimed


def _follow(data: bytes, position: int) -> int:
    return int(position + struct.unpack_from("<I", data, position)[0])


def _field(data: bytes, table: int, index: int) -> int:
    """Return the position of field ``index`` of a flatbuffer table, 0 if the table lacks it."""
    layout = table - struct.unpack_from("<i", data, table)[0]
    if layout < 0 or struct.unpack_from("<H", data, layout)[0] < 6 + 2 * index:
        return 0
    slot = int(struct.unpack_from("<H", data, layout + 4 + 2 * index)[0])
    return table + slot if slot else 0
