"""Numbers in text files: one row a line, or one name a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io.source import one_line, open_source


def text_lines(place: Path) -> list[str]:
    """Return the lines of a text file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is empty, or no text.
    """
    with open_source(place) as source:
        try:
            return source.content().decode("utf-8").splitlines()
        except UnicodeDecodeError as error:
            raise source.error(f"must be text: {error}") from error


def numbers_of(text: str, count: int, where: str) -> NDArray[np.float64]:
    """Return the first ``count`` numbers of a line, (count,) float64.

    Raises:
        ValueError: there are fewer, or one is not finite; the message begins with ``where``.
    """
    try:
        numbers = np.array([float(word) for word in text.split()[:count]])
    except ValueError as error:
        raise ValueError(one_line(f"{where}: must be {count} numbers: {error}")) from error
    if len(numbers) < count or not np.isfinite(numbers).all():
        raise ValueError(one_line(f"{where}: must be {count} finite numbers, got {text[:60]!r}"))
    return numbers


def named_texts(place: Path) -> dict[str, str]:
    """Return name → what follows it, of lines ``name: …``.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is empty, or no text.
    """
    parts = (line.partition(":") for line in text_lines(place))
    return {name.strip(): rest for name, colon, rest in parts if colon}


def rigid_of(rotation: NDArray[np.float64], translation: NDArray[np.float64], where: str) -> Rigid:
    """Return the transform of a rotation (3, 3) and a translation (3,).

    Raises:
        ValueError: it is not rigid; the message begins with ``where``.
    """
    try:
        return Rigid(rotation, translation)
    except ValueError as error:
        raise ValueError(one_line(f"{where}: {error}")) from error


def rigid_of_line(text: str, where: str) -> Rigid:
    """Return the transform of a line of 12 numbers, the first three rows of its matrix.

    Raises:
        ValueError: the line is not one; the message begins with ``where``.
    """
    matrix = numbers_of(text, 12, where).reshape(3, 4)
    return rigid_of(matrix[:, :3], matrix[:, 3], where)


def rigid_named(place: Path, name: str) -> Rigid:
    """Return the transform of the line ``name: 12 numbers``.

    Raises:
        OSError: the file cannot be read.
        ValueError: it has no such line, or the line is damaged.
    """
    texts = named_texts(place)
    if name not in texts:
        raise ValueError(f"{place}: must have a line {name}: …, got {', '.join(texts)[:80] or 'none'}")
    return rigid_of_line(texts[name], f"{place}, {name}")
