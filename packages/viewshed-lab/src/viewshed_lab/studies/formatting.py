"""Formats figures as text, and builds tables from them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from math import isnan
from typing import Any, Literal, TypeVar

from scipy.stats import binomtest

from viewshed.metrics import Scores
from viewshed_lab.studies.pages import Table
from viewshed_lab.studies.records import Results

R = TypeVar("R")

C = TypeVar("C")


def format_rate(rate: float, digits: int = 3) -> str:
    """Return a rate without its leading zero; a dash for NaN.

    >>> format_rate(0.12349), format_rate(0.954, 2), format_rate(1.0), format_rate(float("nan"))
    ('.123', '.95', '1.000', '–')
    """
    return "–" if isnan(rate) else f"{rate:.{digits}f}".removeprefix("0")


def format_rates(*rates: float) -> str:
    """Return rates separated by slashes.

    >>> format_rates(0.5, 0.25)
    '.500 / .250'
    """
    return " / ".join(map(format_rate, rates))


def format_number(value: float, digits: int) -> str:
    """Return a number with its leading zero; a dash for NaN.

    >>> format_number(0.01234, 4), format_number(float("nan"), 4)
    ('0.0123', '–')
    """
    return "–" if isnan(value) else f"{value:.{digits}f}"


CALIBRATION = ("ECE", "Brier", "AURC", "AURC by deviation")
"""Calibration metrics of probabilities and deviations; lower is better."""


def calibration_of(scores: Scores) -> list[str]:
    """Return the metrics of ``CALIBRATION`` as text."""
    return [format_number(value, 4) for value in (scores.ece(), scores.brier(), scores.aurc(), scores.aurc_std())]


def mean(rates: Iterable[float]) -> float:
    """Return the mean of the rates that are not NaN; NaN without any.

    >>> mean([0.5, float("nan"), 1.0])
    0.75
    """
    known = [rate for rate in rates if not isnan(rate)]
    return sum(known) / len(known) if known else float("nan")


def format_interval(rate: float, bounds: tuple[float, float]) -> str:
    """Return a rate with its interval in brackets; dashes without an interval.

    >>> format_interval(0.5, (0.4, 0.61)), format_interval(0.5, (float("nan"), float("nan")))
    ('.500 [.400, .610]', '.500 [–, –]')
    """
    return f"{format_rate(rate)} [{format_rate(bounds[0])}, {format_rate(bounds[1])}]"


def share_interval(count: int, trials: int, method: Literal["exact", "wilson"] = "exact") -> tuple[float, float]:
    """Return the 95 % confidence interval of a share, by Clopper and Pearson (1934) or Wilson (1927)."""
    low, high = binomtest(count, trials).proportion_ci(method=method)
    return float(low), float(high)


def format_share(flags: Collection[bool], method: Literal["exact", "wilson"] = "exact") -> str:
    """Return the share of set flags with its 95 % interval; a dash without flags.

    >>> format_share([True, False, False, False])
    '.250 [.006, .806]'
    """
    count = sum(map(bool, flags))
    return format_interval(count / len(flags), share_interval(count, len(flags), method)) if len(flags) else "–"


def format_spread(rate: float, bounds: tuple[float, float]) -> str:
    """Return a rate with half the width of its interval, or alone without an interval."""
    low, high = bounds
    return format_rate(rate) if isnan(low) else f"{format_rate(rate)} ±{format_rate((high - low) / 2)}"


def commits(*results: Results[Any]) -> str:
    """Return the commits of the code that produced some results."""
    return ", ".join(sorted({commit[:7] for one in results for commit in one.commits})) or "unknown"


def pivot(
    corner: str, rows: Mapping[str, R], columns: Mapping[str, C], value: Callable[[R, C], str], best: str = ""
) -> Table:
    """Return a table with one value per row and column.

    Args:
        corner: header of the row names.
        rows: by name, the first argument of ``value``.
        columns: by name, the second argument of ``value``.
        value: returns one cell as text.
        best: ``row`` or ``column``: the largest figure of each is bold.
    """
    cells = [[name, *(value(row, column) for column in columns.values())] for name, row in rows.items()]
    if best == "row":
        cells = [best_of_row(line) for line in cells]
    return Table([corner, *columns], best_of_columns(cells) if best == "column" else cells)


def by_name(names: Iterable[str]) -> dict[str, str]:
    """Return rows or columns of a pivot whose names are their values."""
    return {name: name for name in names}


def lines(corner: str, rows: Mapping[str, R], columns: Mapping[str, Callable[[R], str]]) -> Table:
    """Return a table with one line per row and a function of the row per column; see :func:`pivot`."""
    return pivot(corner, rows, columns, lambda row, figure: figure(row))


def best_of_row(row: Sequence[str]) -> list[str]:
    """Return a row with its largest figure in bold; the first cell is a name, the others start with a figure.

    >>> best_of_row(["a", ".912 ±.004", ".930 ±.010", "–"])
    ['a', '.912 ±.004', '**.930 ±.010**', '–']
    """
    figures = [_figure(cell) for cell in row[1:]]
    largest = max(figures, default=-1.0)
    return [*row[:1], *(f"**{c}**" if f == largest >= 0 else c for c, f in zip(row[1:], figures, strict=True))]


def best_of_columns(rows: Sequence[Sequence[str]], *, ties: bool = True) -> list[list[str]]:
    """Return rows with the largest figure of each column in bold; without ``ties``, not if all are equal.

    >>> best_of_columns([["a", ".1", ".7"], ["b", ".2", ".3"]])
    [['a', '.1', '**.7**'], ['b', '**.2**', '.3']]
    """
    columns = [list(column) for column in zip(*rows, strict=True)]
    for number, column in enumerate(columns[1:], 1):
        if ties or len({_figure(cell) for cell in column}) > 1:
            columns[number] = best_of_row(["", *column])[1:]
    return [list(row) for row in zip(*columns, strict=True)]


def _figure(cell: str) -> float:
    word = cell.partition(" ")[0]
    return float(word) if word.replace(".", "", 1).isdecimal() else -1.0
