"""Templates of pages: loops, slots, and what is left out because there is nothing to show."""

from collections.abc import Callable
from importlib import resources

import pytest

from viewshed_lab._page import Picture, Table, to_markdown
from viewshed_lab.studies.templates import Filling, fill_text

TABLE = Table(["a"], [["1"]])
TEMPLATE = """\
# A page

{missing}

Seed {seed}.

## First

Always here.

## Second

Before the table.

{{table}}

Before nothing.

{{nothing}}

Behind.

## Loop

<!-- for domain in domains -->

### {domain}

<!-- for word in words -->

{{cell}}

<!-- end -->

<!-- end -->

## Empty

All of this goes.

{{nothing}}

### Below

{{nothing}}
"""


def _fill(domains: list[str], slots: dict[str, Callable[..., Filling]] | None = None) -> str:
    values = {"seed": 3, "missing": "", "domains": domains, "words": ["x", "y"]}
    known: dict[str, Callable[..., Filling]] = {
        "table": lambda: TABLE, "nothing": lambda: None, "cell": lambda domain, word: f"{domain} and {word}",
    }  # fmt: skip
    title, blocks = fill_text(TEMPLATE, values, known | (slots or {}))
    return to_markdown(title, {"f": "0"}, blocks)


def test_texts_tables_and_loops_come_in_their_order_and_what_is_empty_is_left_out() -> None:
    assert (
        _fill(["one", "two"])
        == """\
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

one and y

### two

two and x

two and y

## How it was made

- f: 0
"""
    )


def test_a_loop_over_nothing_leaves_its_section_out() -> None:
    assert "## Loop" not in _fill([])
    assert "## Second" in _fill([])


def test_a_slot_may_show_several_things() -> None:
    pictures = [Picture("a.png", b"", "b"), Picture("c.png", b"", "d")]
    page = _fill([], {"nothing": lambda: pictures})
    assert page.count("![b](a.png)\n\n![d](c.png)") == 3
    assert "All of this goes." in page


def test_a_slot_without_filling_and_a_loop_without_end_are_refused() -> None:
    with pytest.raises(KeyError, match="unknown"):
        fill_text("# A\n\n{{unknown}}", {}, {})
    with pytest.raises(ValueError, match="a template must end each of its loops"):
        fill_text("# A\n\n<!-- for x in xs -->\n\n{{a}}", {"xs": [1]}, {})


def test_every_template_of_the_package_is_whole() -> None:
    """Each is a title and paragraphs, and its loops end."""
    folder = resources.files("viewshed_lab.studies")
    files = [entry for entry in folder.iterdir() if entry.name.endswith(".md")]
    files += [entry for study in folder.iterdir() if study.is_dir() for entry in study.iterdir()
              if entry.name.endswith(".md")]  # fmt: skip
    assert len(files) >= 8
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert text.startswith("# ")
        assert text.count("<!-- for ") == text.count("<!-- end -->")
