"""Figures as words, and tables made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isnan
from typing import TypeVar

from viewshed._page import Table

R = TypeVar("R")

C = TypeVar("C")


def format_rate(rate: float, digits: int = 3) -> str:
    """Return a rate without its leading zero; a dash for none.

    >>> format_rate(0.12349), format_rate(0.954, 2), format_rate(1.0), format_rate(float("nan"))
    ('.123', '.95', '1.000', '–')
    """
    return "–" if isnan(rate) else f"{rate:.{digits}f}".removeprefix("0")


def format_pair(one: float, other: float) -> str:
    """Return two rates with a slash between them."""
    return f"{format_rate(one)} / {format_rate(other)}"


def format_interval(rate: float, bounds: tuple[float, float]) -> str:
    """Return a rate with its interval in brackets.

    >>> format_interval(0.5, (0.4, 0.61))
    '.500 [.400, .610]'
    """
    return f"{format_rate(rate)} [{format_rate(bounds[0])}, {format_rate(bounds[1])}]"


def format_spread(rate: float, bounds: tuple[float, float]) -> str:
    """Return a rate with half the width of its interval, or alone where there is none."""
    low, high = bounds
    return format_rate(rate) if isnan(low) else f"{format_rate(rate)} ±{format_rate((high - low) / 2)}"


def pivot(
    corner: str, rows: Mapping[str, R], columns: Mapping[str, C], value: Callable[[R, C], str], best: str = ""
) -> Table:
    """Return a table of a value for each row and column.

    Args:
        corner: heads the names of the rows.
        rows: by name, what the value is told of a row.
        columns: by name, what it is told of a column.
        value: of one cell, as words.
        best: ``row`` or ``column``: the largest figure of each is bold.
    """
    cells = [[name, *(value(row, column) for column in columns.values())] for name, row in rows.items()]
    if best == "row":
        cells = [best_of_row(line) for line in cells]
    return Table([corner, *columns], best_of_columns(cells) if best == "column" else cells)


def best_of_row(row: Sequence[str]) -> list[str]:
    """Return a row with its largest figure in bold, its name apart; cells begin with their figure.

    >>> best_of_row(["a", ".912 ±.004", ".930 ±.010", "–"])
    ['a', '.912 ±.004', '**.930 ±.010**', '–']
    """
    figures = [_figure(cell) for cell in row[1:]]
    most = max(figures, default=-1.0)
    return [*row[:1], *(f"**{c}**" if f == most >= 0 else c for c, f in zip(row[1:], figures, strict=True))]


def best_of_columns(rows: Sequence[Sequence[str]], *, ties: bool = True) -> list[list[str]]:
    """Return rows with the largest figure of each column in bold; without ``ties`` not where all are equal.

    >>> best_of_columns([["a", ".1", ".7"], ["b", ".2", ".3"]])
    [['a', '.1', '**.7**'], ['b', '**.2**', '.3']]
    """
    columns = [list(column) for column in zip(*rows, strict=True)]
    for number, column in enumerate(columns[1:], 1):
        if ties or len({_figure(cell) for cell in column}) > 1:
            columns[number] = best_of_row(["", *column])[1:]
    return [list(row) for row in zip(*columns, strict=True)]


def best_of_rates(rates: Sequence[float]) -> list[str]:
    """Return rates as words, the largest in bold; those that are equal in words may differ.

    >>> best_of_rates([0.1, 0.7001, 0.7])
    ['.100', '**.700**', '.700']
    """
    most = max((rate for rate in rates if not isnan(rate)), default=float("nan"))
    return [f"**{format_rate(rate)}**" if rate == most else format_rate(rate) for rate in rates]


def _figure(cell: str) -> float:
    word = cell.partition(" ")[0]
    return float(word) if word.replace(".", "", 1).isdecimal() else -1.0
