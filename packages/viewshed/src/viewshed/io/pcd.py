"""PCD 0.7, the Point Cloud Library's format: ascii, binary and binary_compressed."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

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


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    kind: str
    size: int
    count: int
    offset: int

    @property
    def dtype(self) -> str:
        return f"<{self.kind.lower()}{self.size}"


@dataclass(frozen=True, slots=True)
class _Header:
    fields: tuple[_Field, ...]
    points: int
    data: str
    start: int
    ours: bool

    @property
    def row_bytes(self) -> int:
        return sum(field.size * field.count for field in self.fields)


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
    return _Header(_fields(entries), _point_count(entries), _data_kind(entries["DATA"]), start, ours)


def _data_kind(values: list[str]) -> str:
    kind = values[0].lower() if values else ""
    if kind not in _BODIES:
        raise ValueError(f"PCD DATA must be {', '.join(_BODIES)}, got {kind!r}")
    return kind


def _point_count(entries: dict[str, list[str]]) -> int:
    if "POINTS" in entries:
        count = _number(entries, "POINTS", 0)
    else:
        count = _number(entries, "WIDTH", 0) * _number(entries, "HEIGHT", 0)
    if count > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, PCD header says {count}")
    return count


def _number(entries: dict[str, list[str]], key: str, index: int) -> int:
    values = entries.get(key, [])
    if index >= len(values) or not values[index].isascii() or not values[index].isdigit() or len(values[index]) > 12:
        raise ValueError(f"PCD header line {key} is missing or not whole numbers")
    return int(values[index])


def _fields(entries: dict[str, list[str]]) -> tuple[_Field, ...]:
    names, kinds = entries.get("FIELDS", []), entries.get("TYPE", [])
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(kinds) == len(counts) == len(entries.get("SIZE", [])):
        raise ValueError("PCD header lines FIELDS, SIZE, TYPE and COUNT must be of one length")
    fields: list[_Field] = []
    offset = 0
    for index, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        size = _number(entries, "SIZE", index)
        count = _number(entries, "COUNT", index) if "COUNT" in entries else 1
        if size not in _KINDS.get(kind.upper(), set()) or count > _HEADER_BYTES:
            raise ValueError(f"PCD field {name!r} has unknown TYPE {kind!r}, SIZE {size} or COUNT {count}")
        fields.append(_Field(name.lower(), kind.upper(), size, count, offset))
        offset += size * count
    if offset > _ROW_BYTES:
        raise ValueError(f"PCD points must have at most {_ROW_BYTES} bytes each, got {offset}")
    return tuple(fields)


def _wanted(header: _Header) -> dict[str, _Field]:
    fields = [field for field in header.fields if field.count == 1]
    return {field.name: field for field in reversed(fields) if field.name in WANTED}


def _ascii(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    width = sum(field.count for field in header.fields)
    position = {field.name: sum(other.count for other in header.fields[:at]) for at, field in enumerate(header.fields)}
    wanted = {name: position[name] for name in _wanted(header)}
    return number_columns(content, header.start, header.points, width, wanted)


def _binary(content: bytes, header: _Header) -> Mapping[str, NDArray[Any]]:
    held, needed = len(content) - header.start, header.points * header.row_bytes
    if held < needed:
        raise ValueError(f"PCD data is cut off: {header.points} points need {needed} bytes, the file holds {held}")
    if held - needed > _SLACK_BYTES:
        raise ValueError(f"PCD header is wrong: {header.points} points need {needed} bytes, the file holds {held}")
    fields = _wanted(header)
    rows = np.ndarray(
        header.points,
        np.dtype({
            "names": list(fields),
            "formats": [field.dtype for field in fields.values()],
            "offsets": [field.offset for field in fields.values()],
            "itemsize": header.row_bytes,
        }),
        content,
        header.start,
    )  # fmt: skip
    return {name: rows[name] for name in fields}


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
        name: data[field.offset * header.points :][: field.size * header.points].view(field.dtype)
        for name, field in _wanted(header).items()
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
