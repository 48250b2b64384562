"""PCD 0.7, the Point Cloud Library's format: ascii, binary and binary_compressed."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.geometry import Rigid
from viewshed.io._columns import KNOWN_COLUMNS, MARK, Columns, columns_of_table, number_columns, table_of_sweep
from viewshed.io._input import InputFile
from viewshed.sweep import MAX_POINTS, Sweep

_MAX_HEADER_BYTES = 65_536

_SIZES = {"F": {4, 8}, "I": {1, 2, 4, 8}, "U": {1, 2, 4, 8}}

_MAX_LZF_RATIO = 100

_MAX_PADDING_BYTES = 65_536  # the Point Cloud Library pads to a full memory page

_MAX_POINT_BYTES = 1 << 20


class _Column(NamedTuple):
    """A column to read: its type, its byte offset in a point, and its position in a line of text."""

    kind: str
    byte: int
    position: int


@dataclass(frozen=True, slots=True)
class _Header:
    """Parsed header: columns to read, bytes and numbers a point, number of points, and start of the data in bytes."""

    columns: dict[str, _Column]
    row_bytes: int
    numbers: int
    points: int
    data: str
    start: int
    ours: bool


def read_pcd(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the sweep of a PCD file; organized clouds are flattened row by row, and NaN points dropped later."""
    content = source.content()
    header = _parse_header(content)
    yield columns_of_table(_DECODERS[header.data](content, header), frame, ours=header.ours)


def _parse_header(content: bytes) -> _Header:
    """Parse the header; its numbers are checked against the file where they are used."""
    entries: dict[str, list[str]] = {}
    ours = False
    start = 0
    while "DATA" not in entries:
        end = content.find(b"\n", start, _MAX_HEADER_BYTES)
        if end < 0:
            raise ValueError(f"PCD header has no DATA line in its first {_MAX_HEADER_BYTES} bytes")
        line = content[start:end].decode("ascii", "replace").strip()
        start = end + 1
        ours = ours or line == f"# {MARK}"
        if line and not line.startswith("#"):
            key, *values = line.split()
            entries[key.upper()] = values
    data = " ".join(entries["DATA"][:1]).lower()
    if data not in _DECODERS:
        raise ValueError(f"PCD DATA must be {', '.join(_DECODERS)}, got {data!r}")
    columns, row_bytes, numbers = _columns(entries)
    if "POINTS" in entries:
        count = _number(entries, "POINTS", 0)
    else:
        count = _number(entries, "WIDTH", 0) * _number(entries, "HEIGHT", 0)
    if count > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, PCD header says {count}")
    return _Header(columns, row_bytes, numbers, count, data, start, ours)


def _number(entries: dict[str, list[str]], key: str, index: int) -> int:
    values = entries.get(key, [])
    if index >= len(values) or not values[index].isascii() or not values[index].isdigit() or len(values[index]) > 12:
        raise ValueError(f"PCD header line {key} is missing or not whole numbers")
    return int(values[index])


def _columns(entries: dict[str, list[str]]) -> tuple[dict[str, _Column], int, int]:
    """Return the columns to read (the first of each name), and the number of bytes and of numbers of a point."""
    names, kinds = entries.get("FIELDS", []), entries.get("TYPE", [])
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(kinds) == len(counts) == len(entries.get("SIZE", [])):
        raise ValueError("PCD header lines FIELDS, SIZE, TYPE and COUNT must be of one length")
    columns: dict[str, _Column] = {}
    byte = position = 0
    for index, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        size = _number(entries, "SIZE", index)
        count = _number(entries, "COUNT", index) if "COUNT" in entries else 1
        if size not in _SIZES.get(kind.upper(), set()) or count > _MAX_HEADER_BYTES:
            raise ValueError(f"PCD field {name!r} has unknown TYPE {kind!r}, SIZE {size} or COUNT {count}")
        if count == 1 and name.lower() in KNOWN_COLUMNS:
            columns.setdefault(name.lower(), _Column(f"<{kind.lower()}{size}", byte, position))
        byte, position = byte + size * count, position + count
    if byte > _MAX_POINT_BYTES:
        raise ValueError(f"PCD points must have at most {_MAX_POINT_BYTES} bytes each, got {byte}")
    return columns, byte, position


def _ascii(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    positions = {name: column.position for name, column in header.columns.items()}
    return number_columns(content, header.start, header.points, header.numbers, positions)


def _binary(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    available, needed = len(content) - header.start, header.points * header.row_bytes
    if available < needed:
        raise ValueError(f"PCD data is cut off: {header.points} points need {needed} bytes, the file holds {available}")
    if available - needed > _MAX_PADDING_BYTES:
        raise ValueError(f"PCD header is wrong: {header.points} points need {needed} bytes, the file holds {available}")
    kinds, offsets, _ = zip(*header.columns.values(), strict=True) if header.columns else ((), (), ())
    kind = np.dtype({
        "names": list(header.columns), "formats": kinds, "offsets": offsets, "itemsize": header.row_bytes,
    })  # fmt: skip
    rows = np.ndarray(header.points, kind, content, header.start)
    return {name: rows[name] for name in header.columns}


def _compressed(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    """Return the columns of an LZF block, which stores field after field."""
    available, needed = len(content) - header.start - 8, header.points * header.row_bytes
    if available < 0:
        raise ValueError("PCD data is cut off before its two sizes")
    packed, unpacked = (int(n) for n in np.frombuffer(content, "<u4", 2, header.start))
    if packed > available:
        raise ValueError(f"PCD data is cut off: it should hold {packed} compressed bytes, got {available}")
    if unpacked != needed or unpacked > _MAX_LZF_RATIO * packed:
        raise ValueError(
            f"PCD sizes do not agree: {header.points} points are {needed} bytes, got {unpacked} from {packed}"
        )
    data = np.empty(unpacked, np.uint8)
    # The core decodes liblzf's stream with bounds checks and returns -1 if it is damaged.
    written = _core.unpack_lzf(np.frombuffer(content, np.uint8, packed, header.start + 8), data)
    if written != unpacked:
        raise ValueError("PCD compressed data is damaged")
    return {
        name: np.ndarray(header.points, column.kind, data, column.byte * header.points)
        for name, column in header.columns.items()
    }


_DECODERS = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}


def write_pcd(sweep: Sweep) -> bytes:
    """Encode a sweep as a binary PCD 0.7 file, with all its columns."""
    table = table_of_sweep(sweep)
    names = table.dtype.names or ()
    kinds = [table.dtype[name] for name in names]
    header = io.StringIO()
    header.write(f"# .PCD v0.7 - Point Cloud Data file format\n# {MARK}\nVERSION 0.7\n")
    header.write(f"FIELDS {' '.join(names)}\nSIZE {' '.join(str(kind.itemsize) for kind in kinds)}\n")
    header.write(f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}\nCOUNT {' '.join('1' for _ in kinds)}\n")
    header.write(f"WIDTH {len(sweep)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(sweep)}\nDATA binary\n")
    return header.getvalue().encode("ascii") + table.tobytes()
