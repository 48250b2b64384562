"""Tables of Markdown pages as data, and how far two may differ.

``tables/published`` holds the tables of ``docs/results``, ``tables/tiny`` those of the studies' tiny plans: page →
title → tables of header and rows, all cells as text. Columns of timings are not stored for tiny plans and never
compared. Facts outside of tables, such as dates and commits, are ignored.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Page = dict[str, list[dict[str, Any]]]
RELATIVE = 0.002
"""Largest relative difference of numbers with decimals, and of whole numbers of 100 or more."""
LAST_DIGITS = 2
"""Largest difference of numbers with decimals, in units of the last digit, where that is more."""
_NUMBER = re.compile(r"\d*\.\d+|\d+")
_TIMING = re.compile(
    r"\bms\b|\bsecond|frames/s|sweeps/s|\btime\b|in the network|\bHz\b|GFLOP/s|two processes|\bclock\b"
)
_BAR = re.compile(r"(?<!\\)\|")


def parse(markdown: str) -> Page:
    """Return the tables of a page by their headings, joined with slashes.

    >>> parse("# Page\\n\\n## Part\\n\\n| a | b |\\n|---|---|\\n| 1 | 2 |\\n")
    {'Page / Part': [{'header': ['a', 'b'], 'rows': [['1', '2']]}]}
    """
    headings: list[str] = []
    page: Page = {}
    rows: list[list[str]] | None = None
    lines = re.sub(r"^```.*?^```", "", markdown, flags=re.MULTILINE | re.DOTALL).splitlines()
    for line in lines:
        if line.startswith("#"):
            depth = len(line) - len(line.lstrip("#"))
            headings = [*headings[: depth - 1], line.lstrip("# ")]
        if not line.startswith("|"):
            rows = None
        elif rows is None:
            rows = []
            page.setdefault(" / ".join(headings), []).append({"header": _cells(line), "rows": rows})
        elif not re.fullmatch(r"\|(:?-+:?\|)+", line.replace(" ", "")):
            rows.append(_cells(line))
    return page


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in _BAR.split(line.strip().removeprefix("|").removesuffix("|"))]


def without_timings(page: Page) -> Page:
    """Return the tables without the columns of times and speeds."""
    return {title: [_without_timings(table) for table in tables] for title, tables in page.items()}


def _without_timings(table: Mapping[str, Any]) -> dict[str, Any]:
    header = table["header"]
    kept = [k for k, name in enumerate(header) if not _TIMING.search(name)]
    return {
        "header": [header[k] for k in kept],
        "rows": [[row[k] for k in kept if k < len(row)] for row in table["rows"]],
    }


def differences(name: str, expected: Page, actual: Page) -> Iterator[str]:
    """Yield one line for each table that is missing or new, and for each header or row that differs."""
    expected, actual = without_timings(expected), without_timings(actual)
    for title in [*expected, *(title for title in actual if title not in expected)]:
        before, now = expected.get(title, []), actual.get(title, [])
        if len(before) != len(now):
            yield f"{name}: {title}: {len(now)} tables, not {len(before)}"
            continue
        for one, other in zip(before, now, strict=True):
            for line in _table_differences(one, other):
                yield f"{name}: {title}: {line}"


def _table_differences(expected: Mapping[str, Any], actual: Mapping[str, Any]) -> Iterator[str]:
    if expected["header"] != actual["header"]:
        yield f"the header is {actual['header']}, not {expected['header']}"
    elif len(expected["rows"]) != len(actual["rows"]):
        yield f"{len(actual['rows'])} rows, not {len(expected['rows'])}"
    else:
        for before, now in zip(expected["rows"], actual["rows"], strict=True):
            if not _same_row(before, now):
                yield f"the row is {now}, not {before}"


def _same_row(one: Sequence[str], other: Sequence[str]) -> bool:
    return len(one) == len(other) and all(map(same_cell, one, other))


def same_cell(one: str, other: str) -> bool:
    """Return whether two cells have the same words and numbers within tolerance.

    >>> same_cell(".803 [.71, .88]", ".802 [.71, .89]"), same_cell(".803", ".813"), same_cell("yes", "no")
    (True, False, False)
    """
    numbers, others = _NUMBER.findall(one), _NUMBER.findall(other)
    if len(numbers) != len(others) or _NUMBER.sub("0", one) != _NUMBER.sub("0", other):
        return False
    return all(map(_near, numbers, others))


def _near(one: str, other: str) -> bool:
    places = len(one.partition(".")[2])
    if places != len(other.partition(".")[2]):
        return False
    apart, size = abs(float(one) - float(other)), max(float(one), float(other))
    relative = RELATIVE * size if places or size >= 100 else 0.0
    return apart <= max(relative, LAST_DIGITS * 10.0**-places * 1.001 if places else 0.0)
