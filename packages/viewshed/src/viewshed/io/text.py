"""Read text files (CSV, XYZ, ASC): one point a line, with or without a header of column names."""

from __future__ import annotations

import re
from collections.abc import Iterator

from viewshed.geometry import Rigid
from viewshed.io._columns import KNOWN_COLUMNS, Columns, columns_of_table, number_columns
from viewshed.io._input import InputFile
from viewshed.sweep import MAX_POINTS

_MAX_LINE_BYTES = 4096

_MAX_HEADER_LINES = 20
"""Maximum number of lines above the points."""

_ALIASES = {"//x": "x", "#x": "x", "x_m": "x", "y_m": "y", "z_m": "z"}
"""Aliases of column names, in lower case."""

_DEFAULT_COLUMNS = ("x", "y", "z", "intensity")
"""Columns of a file without header."""


def read_text(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the sweep of a text file: meters, separated by commas, semicolons, tabs or blanks.

    A header line names the columns; without one they are x, y, z and optionally intensity.
    """
    content = source.content()
    start, names = _header(content)
    body = re.sub(rb"[,;\t]", b" ", content[start:])
    rows = body.count(b"\n") + (not body.endswith(b"\n")) - len(re.findall(rb"^[ \r]*\n", body, re.MULTILINE))
    if rows > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, got {rows} lines")
    positions = {name: index for index, name in enumerate(names) if name in KNOWN_COLUMNS}
    yield columns_of_table(number_columns(body, 0, rows, len(names), positions), frame, ours=False)


def _header(content: bytes) -> tuple[int, list[str]]:
    """Return the byte at which the points start, and the names of their columns."""
    start = 0
    names: list[str] = []
    for _ in range(_MAX_HEADER_LINES):
        end = content.find(b"\n", start, start + _MAX_LINE_BYTES)
        line = content[start : end if end >= 0 else start + _MAX_LINE_BYTES].decode("utf-8-sig", "replace").strip()
        words = [word.strip('"') for word in re.split(r"[,;\t ]+", line.strip(",; \t")) if word]
        if words and all(map(_is_number, words)) and len(words) >= 3:
            if names and not {"x", "y", "z"} <= set(names):
                raise ValueError(
                    f"text must have x, y and z among the names of its columns, got {', '.join(names)[:200]}"
                )
            if names and len(names) != len(words):
                raise ValueError(
                    f"text must have a number for each of {len(names)} names, got {len(words)} in {line[:80]!r}"
                )
            extra = [f"column {index}" for index in range(len(_DEFAULT_COLUMNS), len(words))]
            return start, names or [*_DEFAULT_COLUMNS[: len(words)], *extra]
        if end < 0:
            break
        if {"x", "y", "z"} <= set(names) and len(words) == len(names):
            bad = next(name for name, word in zip(names, words, strict=True) if not _is_number(word))
            raise ValueError(
                f"text must have numbers alone below its names, got a word in the column {bad!r}: leave it out"
            )
        lower = [_ALIASES.get(word.lower(), word.lower()) for word in words if word not in {"#", "//"}]
        is_comment = line.startswith(("#", "//"))
        names = lower if lower and ({"x", "y", "z"} <= set(lower) or not is_comment) else names
        start = end + 1
    raise ValueError(
        "text must have one point of three or more numbers per line, with or without a first line of names x, y, z"
    )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
