"""PLY files, ascii or binary of either byte order: the element ``vertex`` with scalar properties."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._columns import KNOWN_COLUMNS, MARK, Columns, columns_of_table, number_columns, table_of_sweep
from viewshed.io._input import InputFile
from viewshed.sweep import MAX_POINTS, Sweep

_MAX_HEADER_BYTES = 65_536

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip

_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

_TYPE_NAMES = {"f4": "float", "i2": "short"}


@dataclass(slots=True)
class _Header:
    """Parsed header: byte order ("" for ascii), number of vertices, name → type, and start of the data in bytes."""

    order: str | None = None
    vertices: int | None = None
    properties: dict[str, str] = field(default_factory=dict)
    start: int = 0
    ours: bool = False
    in_vertex: bool = False


def read_ply(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the vertices of a PLY file as a sweep; elements after them are ignored."""
    content = source.content()
    header = _parse_header(content)
    yield columns_of_table(_vertices(content, header), frame, ours=header.ours)


def _parse_header(content: bytes) -> _Header:
    header = _Header()
    start = 0
    while True:
        end = content.find(b"\n", start, _MAX_HEADER_BYTES)
        if end < 0:
            raise ValueError(f"PLY header has no end_header in its first {_MAX_HEADER_BYTES} bytes")
        line = content[start:end].decode("ascii", "replace").strip()
        start = end + 1
        if line == "end_header":
            break
        _parse_line(header, line)
    if header.order is None or header.vertices is None:
        raise ValueError("PLY header must have lines 'format' and 'element vertex'")
    header.start = start
    return header


def _parse_line(header: _Header, line: str) -> None:
    words = line.split()
    match words:
        case ["format", order, _] if order in _BYTE_ORDERS:
            header.order = _BYTE_ORDERS[order]
        case ["format", *_]:
            raise ValueError(f"PLY format must be {', '.join(_BYTE_ORDERS)}, got {line!r}")
        case ["element", name, count]:
            _parse_element(header, name, count)
        case ["property", *rest] if header.in_vertex:
            _parse_property(header, rest)
        case ["comment", *_]:
            header.ours = header.ours or line == f"comment {MARK}"
        case _:
            return


def _parse_element(header: _Header, name: str, count: str) -> None:
    header.in_vertex = name == "vertex"
    if header.vertices is None and not header.in_vertex:
        raise ValueError(f"PLY element vertex must come first, got {name!r}")
    if not header.in_vertex:
        return
    if header.vertices is not None or not (count.isascii() and count.isdigit()) or len(count) > 12:
        raise ValueError(f"PLY must have one 'element vertex' with a whole number, got {count!r}")
    header.vertices = int(count)
    if header.vertices > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, PLY header says {count}")


def _parse_property(header: _Header, words: list[str]) -> None:
    if len(words) != 2 or words[0] not in _TYPES:
        raise ValueError(f"PLY vertex property must be one number of a known type, got {' '.join(words)!r}")
    name = words[1].lower()
    if name in header.properties:
        raise ValueError(f"PLY vertex property {name!r} appears twice")
    header.properties[name] = _TYPES[words[0]]


def _vertices(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    count, names = header.vertices or 0, list(header.properties)
    if not header.order:
        positions = {name: index for index, name in enumerate(names) if name in KNOWN_COLUMNS}
        return number_columns(content, header.start, count, len(names), positions)
    kind = np.dtype([(name, header.order + header.properties[name]) for name in names])
    available, needed = len(content) - header.start, count * kind.itemsize
    if available < needed:
        raise ValueError(f"PLY data is cut off: {count} vertices need {needed} bytes, the file holds {available}")
    table = np.frombuffer(content, kind, count, header.start) if count and names else np.empty(0, kind)
    return {name: table[name] for name in names if name in KNOWN_COLUMNS}


def write_ply(sweep: Sweep) -> bytes:
    """Encode a sweep as a binary little-endian PLY file, with all its columns."""
    table = table_of_sweep(sweep)
    lines = ["ply", "format binary_little_endian 1.0", f"comment {MARK}", f"element vertex {len(sweep)}"]
    lines += [f"property {_TYPE_NAMES[table.dtype[name].str[1:]]} {name}" for name in table.dtype.names or ()]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii") + table.tobytes()
