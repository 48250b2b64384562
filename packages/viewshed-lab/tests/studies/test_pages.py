"""Pages from templates: loops, tables and pictures, and what is left out because there is nothing to show."""

from pathlib import Path
from typing import Any

import jinja2
import pytest

from viewshed_lab.studies.pages import Page, Table, fill_template

TABLE = Table(["a"], [["1"]])
TEMPLATE = """\
# A page

{{ missing }}

Seed {{ seed }}.

## First

Always here.

## Second

Before the table.

{{ table }}

Before nothing.

{{ nothing }}

Behind.

## Loop

{% for domain in domains %}

### {{ domain }}

{{ cell(domain) }}

{% else %}

{{ none }}

{% endfor %}

## Empty

All of this goes.

{{ nothing }}

### Below

{{ nothing }}
"""
FILLED = """\
# A page

Seed 3.

## First

Always here.

## Second

Before the table.

| a |
|---|
| 1 |

Behind.

## Loop

### one

one and x

## How it was made

- f: 0
"""


@pytest.fixture
def fill(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Return what fills a template, or the one above."""

    def filled(text: str = TEMPLATE, **values: Any) -> Page:
        (tmp_path / "page.md").write_text(text, encoding="utf-8")
        monkeypatch.setattr(jinja2, "PackageLoader", lambda *_: jinja2.FileSystemLoader(tmp_path))
        known = {"missing": "", "seed": 3, "table": TABLE, "nothing": None, "domains": ["one"]}
        return fill_template("page.md", cell=lambda domain: f"{domain} and x", **known | values)

    return filled


def test_texts_tables_and_loops_come_in_their_order_and_what_is_empty_is_left_out(fill: Any) -> None:
    assert fill().markdown({"f": "0"}) == FILLED
    assert "## Loop" not in fill(domains=[]).body
    assert "## Second" in fill(domains=[]).body
