"""Pages of results from Jinja2 templates of the package, whose expressions are tables, pictures, text, or None.

An expression that is None also removes the text blocks right above it, and a section with None that has neither table
nor picture is removed. So templates need no conditions.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jinja2

from viewshed_lab._page import page, table
from viewshed_lab._results import depth_of

_NONE = "<!-- none -->"


@dataclass(frozen=True, slots=True)
class Table:
    """A table of plain text; bold text is in asterisks."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def __str__(self) -> str:
        return table(self.header, self.rows)


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG with its file name and alternative text."""

    name: str
    png: bytes
    alt: str

    def __str__(self) -> str:
        return f"![{self.alt}]({self.name})"


@dataclass(frozen=True, slots=True)
class Page:
    """A page as Markdown, and its PNGs by file name."""

    title: str
    body: str
    pictures: Mapping[str, bytes]

    def markdown(self, provenance: Mapping[str, str]) -> str:
        """Return the page as Markdown, with its provenance."""
        return page(self.title, provenance, self.body)

    def files(self, name: str, provenance: Mapping[str, str]) -> dict[str, bytes]:
        """Return the files of the page by name: its pictures, then the Markdown as ``name``."""
        return {**self.pictures, name: self.markdown(provenance).encode()}


def fill_template(path: str, **values: Any) -> Page:
    """Return the page of a template file in the folder of the studies; its first line is the title."""
    pictures: dict[str, bytes] = {}

    def shown(value: Any) -> str:
        if value is None:
            return _NONE
        if isinstance(value, Picture):
            pictures[value.name] = value.png
        elif isinstance(value, Iterable) and not isinstance(value, str):
            return "\n\n".join(map(shown, value)) or _NONE
        return str(value)

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("viewshed_lab.studies", ""), undefined=jinja2.StrictUndefined, finalize=shown,
        trim_blocks=True,
        autoescape=False,
    )  # fmt: skip
    title, *blocks = _blocks(environment.get_template(path).render(values))
    return Page(title.removeprefix("# "), "\n\n".join(_without_empty(blocks)), pictures)


def _blocks(markdown: str) -> list[str]:
    return [block.strip() for block in re.split(r"\n\s*\n", markdown) if block.strip()]


def _without_empty(blocks: Sequence[str]) -> list[str]:
    """Return the blocks without empty sections, without empty values, and without the text right above these."""
    kept: list[str] = []
    end = 0
    for position, block in enumerate(blocks):
        if position < end:
            continue
        if block == _NONE:
            while kept and not kept[-1].startswith(("#", "|", "!")):
                kept.pop()
        elif not (depth_of(block) and _shows_nothing(section := _section(blocks[position:]))):
            kept.append(block)
        else:
            end = position + len(section)
    return kept


def _section(blocks: Sequence[str]) -> Sequence[str]:
    """Return the section that starts at the first block, a heading, up to the next heading of the same level."""
    level = depth_of(blocks[0])
    ends = (k for k, block in enumerate(blocks) if k and 0 < depth_of(block) <= level)
    return blocks[: next(ends, len(blocks))]


def _shows_nothing(section: Sequence[str]) -> bool:
    return _NONE in section and not any(block.startswith(("|", "![")) for block in section)
