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
from viewshed.io._columns import MARK, WANTED, Columns, columns_of_table, number_columns, table_of_sweep
from viewshed.io._input import InputFile
from viewshed.sweep import MAX_POINTS, Sweep

_HEADER_BYTES = 65_536

_KINDS = {"F": {4, 8}, "I": {1, 2, 4, 8}, "U": {1, 2, 4, 8}}

_LZF_RATIO = 100

_SLACK_BYTES = 65_536  # the Point Cloud Library fills the last memory page

_ROW_BYTES = 1 << 20


class _Column(NamedTuple):
    """A column that is read: its type, its byte in a point, and its place in a line of text."""

    kind: str
    byte: int
    place: int


@dataclass(frozen=True, slots=True)
class _Header:
    """What the header says: the columns that are read, bytes and numbers of a point, points, where the data start."""

    columns: dict[str, _Column]
    row_bytes: int
    numbers: int
    points: int
    data: str
    start: int
    ours: bool


def read_pcd(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the one sweep of a PCD file; an organized cloud is read row by row, its NaN points are dropped later."""
    content = source.content()
    header = _parse_header(content)
    yield columns_of_table(_BODIES[header.data](content, header), frame, ours=header.ours)


def _parse_header(content: bytes) -> _Header:
    """Return the header; every number in it is checked against the file where it is used."""
    entries: dict[str, list[str]] = {}
    ours = False
    start = 0
    while "DATA" not in entries:
        end = content.find(b"\n", start, _HEADER_BYTES)
        if end < 0:
            raise ValueError(f"PCD header has no DATA line in its first {_HEADER_BYTES} bytes")
        line = content[start:end].decode("ascii", "replace").strip()
        start = end + 1
        ours = ours or line == f"# {MARK}"
        if line and not line.startswith("#"):
            key, *values = line.split()
            entries[key.upper()] = values
    data = " ".join(entries["DATA"][:1]).lower()
    if data not in _BODIES:
        raise ValueError(f"PCD DATA must be {', '.join(_BODIES)}, got {data!r}")
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
    """Return the columns that are read, the first of each name; and how many bytes and numbers a point has."""
    names, kinds = entries.get("FIELDS", []), entries.get("TYPE", [])
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(kinds) == len(counts) == len(entries.get("SIZE", [])):
        raise ValueError("PCD header lines FIELDS, SIZE, TYPE and COUNT must be of one length")
    columns: dict[str, _Column] = {}
    byte = place = 0
    for index, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        size = _number(entries, "SIZE", index)
        count = _number(entries, "COUNT", index) if "COUNT" in entries else 1
        if size not in _KINDS.get(kind.upper(), set()) or count > _HEADER_BYTES:
            raise ValueError(f"PCD field {name!r} has unknown TYPE {kind!r}, SIZE {size} or COUNT {count}")
        if count == 1 and name.lower() in WANTED:
            columns.setdefault(name.lower(), _Column(f"<{kind.lower()}{size}", byte, place))
        byte, place = byte + size * count, place + count
    if byte > _ROW_BYTES:
        raise ValueError(f"PCD points must have at most {_ROW_BYTES} bytes each, got {byte}")
    return columns, byte, place


def _ascii(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    wanted = {name: column.place for name, column in header.columns.items()}
    return number_columns(content, header.start, header.points, header.numbers, wanted)


def _binary(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    held, needed = len(content) - header.start, header.points * header.row_bytes
    if held < needed:
        raise ValueError(f"PCD data is cut off: {header.points} points need {needed} bytes, the file holds {held}")
    if held - needed > _SLACK_BYTES:
        raise ValueError(f"PCD header is wrong: {header.points} points need {needed} bytes, the file holds {held}")
    kinds, bytes_at, _ = zip(*header.columns.values(), strict=True) if header.columns else ((), (), ())
    kind = np.dtype({
        "names": list(header.columns), "formats": kinds, "offsets": bytes_at, "itemsize": header.row_bytes,
    })  # fmt: skip
    rows = np.ndarray(header.points, kind, content, header.start)
    return {name: rows[name] for name in header.columns}


def _compressed(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    """Return the columns of an LZF block that holds one field after the other."""
    held, needed = len(content) - header.start - 8, header.points * header.row_bytes
    if held < 0:
        raise ValueError("PCD data is cut off before its two sizes")
    packed, unpacked = (int(n) for n in np.frombuffer(content, "<u4", 2, header.start))
    if packed > held:
        raise ValueError(f"PCD data is cut off: it should hold {packed} compressed bytes, got {held}")
    if unpacked != needed or unpacked > _LZF_RATIO * packed:
        raise ValueError(
            f"PCD sizes do not agree: {header.points} points are {needed} bytes, got {unpacked} from {packed}"
        )
    data = np.empty(unpacked, np.uint8)
    # liblzf's stream, which the core decodes without leaving either array; -1 where it is damaged.
    written = _core.unpack_lzf(np.frombuffer(content, np.uint8, packed, header.start + 8), data)
    if written != unpacked:
        raise ValueError("PCD compressed data is damaged")
    return {
        name: np.ndarray(header.points, column.kind, data, column.byte * header.points)
        for name, column in header.columns.items()
    }


_BODIES = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}


def write_pcd(sweep: Sweep) -> bytes:
    """Return a binary PCD 0.7 file with every column that the sweep has."""
    table = table_of_sweep(sweep)
    names = table.dtype.names or ()
    kinds = [table.dtype[name] for name in names]
    header = io.StringIO()
    header.write(f"# .PCD v0.7 - Point Cloud Data file format\n# {MARK}\nVERSION 0.7\n")
    header.write(f"FIELDS {' '.join(names)}\nSIZE {' '.join(str(kind.itemsize) for kind in kinds)}\n")
    header.write(f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}\nCOUNT {' '.join('1' for _ in kinds)}\n")
    header.write(f"WIDTH {len(sweep)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(sweep)}\nDATA binary\n")
    return header.getvalue().encode("ascii") + table.tobytes()
