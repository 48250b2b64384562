"""Published tables are the recorded ones, and the comparison of tables tells what is another one."""

import copy
from collections.abc import Callable
from typing import Any

import pytest
from tests.golden import parts, recorder, tables

PAGE = """# Page

- date: today

## Rates

| | F1 | ms |
|---|---|---|
| `a \\| b` | .803 [.71, .88] | 4.1 |
| c | 120 | 3.9 |

```sh
| no | table |
```

| x |
|---|
"""


def test_a_page_is_read_as_it_looks() -> None:
    rates = {"header": ["", "F1", "ms"], "rows": [[r"`a \| b`", ".803 [.71, .88]", "4.1"], ["c", "120", "3.9"]]}
    assert tables.parse(PAGE) == {"Page / Rates": [rates, {"header": ["x"], "rows": []}]}


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (".803", ".805", True), (".803", ".806", False), ("0.5", "0.50", False), ("99", "98", False),
        ("1000", "1002", True), ("1000", "1003", False), ("-.5", ".5", False), ("yes", "no", False),
        ("20.00", "20.04", True), ("20.00", "20.05", False), ("–", "0.5", False),
    ],
)  # fmt: skip
def test_cells_are_the_same_within_tolerance(one: str, other: str, same: bool) -> None:
    assert tables.same_cell(one, other) is same
    assert tables.same_cell(other, one) is same


def _change(page: dict[str, Any]) -> None:
    page["Page / Rates"][0]["rows"][1][1] = "121"


def _drop_row(page: dict[str, Any]) -> None:
    del page["Page / Rates"][0]["rows"][1]


def _rename(page: dict[str, Any]) -> None:
    page["Page / Rates"][0]["header"][1] = "recall"


def _drop_table(page: dict[str, Any]) -> None:
    del page["Page / Rates"][1]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (_change, "p: Page / Rates: the row is ['c', '121'], not ['c', '120']"),
        (_drop_row, "p: Page / Rates: 1 rows, not 2"),
        (_rename, "p: Page / Rates: the header is ['', 'recall'], not ['', 'F1']"),
        (_drop_table, "p: Page / Rates: 1 tables, not 2"),
        (dict.clear, "p: Page / Rates: 0 tables, not 2"),
    ],
)
def test_what_differs_is_one_line(change: Callable[[Any], None], line: str) -> None:
    wanted = tables.parse(PAGE)
    found = copy.deepcopy(wanted)
    change(found)
    assert list(tables.differences("p", wanted, found)) == [line]


def test_published_tables_are_the_recorded_ones() -> None:
    pages = parts.published()
    assert len(pages) >= 20
    assert parts.table_differences("published", pages) == []


def test_every_study_has_tiny_tables() -> None:
    recorded = {path.stem: parts.read_json(path) for path in (parts.TABLES / "tiny").glob("*.json")}
    assert set(recorded) == set(recorder.TINY_PAGES) | {"monitor"}
    for name, page in recorded.items():
        assert sum(len(table["rows"]) for each in page.values() for table in each) > 0, name
