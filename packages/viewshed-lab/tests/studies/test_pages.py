"""Pages from templates: loops, tables and pictures, and what is left out because there is nothing to show."""

from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import jinja2
import pytest

from viewshed_lab.studies.pages import Page, Picture, Table, fill_template

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


def test_an_expression_may_show_several_pictures(fill: Any) -> None:
    page = fill(nothing=[Picture("a.png", b"A", "b"), Picture("c.png", b"C", "d")])
    assert page.body.count("![b](a.png)\n\n![d](c.png)") == 3
    assert "All of this goes." in page.body
    assert list(page.files("p.md", {}).items())[:2] == [("a.png", b"A"), ("c.png", b"C")]
    assert list(page.files("p.md", {}))[-1] == "p.md"


def test_a_name_that_is_not_given_is_refused(fill: Any) -> None:
    with pytest.raises(jinja2.UndefinedError, match="unknown"):
        fill("# A\n\n{{ unknown }}")


class _Fetches(HTMLParser):
    """Remembers every tag, and every address that a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]


def test_the_html_fetches_nothing_and_hides_nothing() -> None:
    picture = Picture("a.png", b"\x89PNG", 'a "picture" & more')
    blocks = [
        "## A < B",
        "one `x_y`\nand *two*",
        "- a\n  b\n- **c**",
        Table(["n", "*m*"], [["1 & 2", "**3**"]]),
        picture,
    ]
    page = Page("T", "\n\n".join(map(str, blocks)), {"a.png": picture.png}).html({"seed": "0"})
    read = _Fetches()
    read.feed(page)
    assert read.addresses == ["data:image/png;base64,iVBORw=="]
    assert "http" not in page
    assert "url(" not in page
    for part in ("<h2>A &lt; B</h2>", "<p>one <code>x_y</code> and <i>two</i></p>", "<li>a b</li>", "<li><b>c</b></li>",
                 "<td>1 &amp; 2</td><td><b>3</b></td>", 'alt="a &quot;picture&quot; &amp; more"'):  # fmt: skip
        assert part in page
    assert read.tags.count("td") == 2
