"""Points as text: CSV, XYZ and the like, a point a line, with the names of the columns above them or without."""

from __future__ import annotations

import re
from collections.abc import Iterator

from viewshed.geometry import Rigid
from viewshed.io._columns import WANTED, Columns, columns_of_table, number_columns
from viewshed.io._input import InputFile
from viewshed.sweep import MAX_POINTS

_LINE_BYTES = 4096

_MOST_SKIPPED = 20
"""Lines of comments above the points."""

_WORDS = {"//x": "x", "#x": "x", "x_m": "x", "y_m": "y", "z_m": "z"}
"""Other names of columns, in lower case."""

_PLAIN = ("x", "y", "z", "intensity")
"""Columns of a file that names none."""


def read_text(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the one sweep of a text file: numbers with commas, semicolons, tabs or blanks between them, in meters.

    Names above them say which is which; without names they are x, y, z and perhaps intensity.
    """
    content = source.content()
    start, names = _head(content)
    body = re.sub(rb"[,;\t]", b" ", content[start:])
    rows = body.count(b"\n") + (not body.endswith(b"\n")) - len(re.findall(rb"^[ \r]*\n", body, re.MULTILINE))
    if rows > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, got {rows} lines")
    wanted = {name: at for at, name in enumerate(names) if name in WANTED}
    yield columns_of_table(number_columns(body, 0, rows, len(names), wanted), frame, ours=False)


def _head(content: bytes) -> tuple[int, list[str]]:
    """Return where the points start, and the names of their columns."""
    start = 0
    names: list[str] = []
    for _ in range(_MOST_SKIPPED):
        end = content.find(b"\n", start, start + _LINE_BYTES)
        line = content[start : end if end >= 0 else start + _LINE_BYTES].decode("utf-8-sig", "replace").strip()
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
            extra = [f"column {at}" for at in range(len(_PLAIN), len(words))]
            return start, names or [*_PLAIN[: len(words)], *extra]
        if end < 0:
            break
        if {"x", "y", "z"} <= set(names) and len(words) == len(names):
            bad = next(name for name, word in zip(names, words, strict=True) if not _is_number(word))
            raise ValueError(
                f"text must have numbers alone below its names, got a word in the column {bad!r}: leave it out"
            )
        lower = [_WORDS.get(word.lower(), word.lower()) for word in words if word not in {"#", "//"}]
        is_comment = line.startswith(("#", "//"))
        names = lower if lower and ({"x", "y", "z"} <= set(lower) or not is_comment) else names
        start = end + 1
    raise ValueError("text must have a point of three numbers or more a line, with names x, y, z above them or without")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
