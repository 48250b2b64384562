"""Result pages: the three key numbers on top, and the tables that the published page omits.

``result_pages.toml`` describes every page by its title. It never contains the numbers themselves, only the table cells
that hold them.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from viewshed._files import write_atomic

_BAR = re.compile(r"(?<!\\)\|")
_NUMBERS = 3
_MADE = "## How it was made"


@dataclass(frozen=True, slots=True)
class KeyNumber:
    """A number on top of a page: a cell of one of its tables."""

    of: str  # description of the number
    table: str = ""  # heading of the section, and ``#2`` for its second table
    row: str = ""  # beginning of the row, its cells joined by " | ", without stars and backticks
    column: str = ""  # header of the column

    def find(self, markdown: str) -> str | None:
        """Return the number as printed on the page, or None."""
        for address, header, rows in _tables(markdown):
            at = _position(header, self.column)
            if address != (self.table if "#" in self.table else f"{self.table} #1") or at is None:
                continue
            for row in rows:
                if _plain(" | ".join(row)).startswith(self.row) and at < len(row):
                    return _plain(row[at])
        return None


@dataclass(frozen=True, slots=True)
class ResultPage:
    """Description of one page."""

    title: str  # of the page, or of several pages that one command writes
    group: str = ""  # section of the overview
    files: Sequence[str] = ()  # names of the published pages without suffix
    numbers: Sequence[KeyNumber] = ()  # the first three that are found go on top; empty if the page has its own top
    # parts that the published page omits, as regular expressions: sections by their heading, tables as ``Heading #2``,
    # rows as ``Heading #2 | text of the row``
    left_out: Sequence[str] = ()
    sources: Sequence[str] = ()  # files and folders of the repository that its figures depend on


@cache
def result_pages() -> dict[str, ResultPage]:
    """Return the description of each page, by title."""
    text = resources.files("viewshed_lab").joinpath("result_pages.toml").read_text(encoding="utf-8")
    sources = sources_in(text)
    return {
        page["title"]: ResultPage(**{
            **page, "numbers": [KeyNumber(**number) for number in page.get("numbers", [])],
            "sources": sources[page["title"]],
        })
        for page in tomllib.loads(text)["page"]
    }  # fmt: skip


def sources_in(text: str) -> dict[str, list[str]]:
    """Return the sources of each page by title, from the text of a ``result_pages.toml``, with sets expanded."""
    settings = tomllib.loads(text)
    sets = settings.get("sets", {})
    return {
        page["title"]: [path for name in page.get("sources", []) for path in sets.get(name, [name])]
        for page in settings["page"]
    }


def with_numbers(title: str, facts: str, body: str) -> str:
    """Return a page: title, its key numbers, the body, and at its end how it was made."""
    page = result_pages().get(title)
    numbers = [(number.find(body), number.of) for number in page.numbers] if page else []
    top = "\n".join(f"- **{value}** {of}" for value, of in [number for number in numbers if number[0]][:_NUMBERS])
    ending = f"{_MADE}\n\n{facts}" if facts else ""
    return "\n\n".join(part.strip("\n") for part in (f"# {title}", top, body, ending) if part) + "\n"


def shortened(name: str, markdown: str) -> str:
    """Return a page without the parts that ``result_pages.toml`` omits, with a note that names the full page's file.

    Args:
        name: of the page without suffix.
        markdown: of the full page.
    """
    title, _, rest = markdown.partition("\n")
    page = result_pages().get(title.removeprefix("# "))
    if page is None or not page.left_out:
        return markdown
    kept: list[str] = []
    skipping = 0  # depth of the heading whose section is omitted, or 0
    heading, count = "", 0  # of the current section, and number of its tables so far
    for block in re.split(r"\n{2,}", rest.strip("\n")):
        depth = depth_of(block)
        if depth:
            heading, count = block.lstrip("# "), 0
            if depth <= skipping:
                skipping = 0
            if not skipping and _any(page.left_out, heading):
                skipping = depth
        is_table = block.startswith("|")
        count += is_table
        if skipping:
            continue
        if is_table and _any(page.left_out, f"{heading} #{count}"):
            # The paragraph between two tables describes the second one.
            if count > 1 and not kept[-1].startswith(("|", "#", "!")):
                kept.pop()
            continue
        kept.append(_without_rows(page.left_out, f"{heading} #{count}", block) if is_table else block)
    # Drop headings without content.
    kept = [
        block for block, after in zip(kept, [*kept[1:], "#"], strict=True)
        if not depth_of(block) or not depth_of(after) or depth_of(after) > depth_of(block)
    ]  # fmt: skip
    if kept == re.split(r"\n{2,}", rest.strip("\n")):
        return markdown
    note = f"The same command writes all tables to `{name}_full.md`, beside this page; that file is not published."
    at = kept.index(_MADE) if _MADE in kept else len(kept)
    return "\n\n".join([title, *kept[:at], note, *kept[at:]]) + "\n"


def page_files(name: str, markdown: str) -> dict[str, str]:
    """Return a page as ``NAME.md``, shortened, and if that omitted anything, also as ``NAME_full.md``."""
    short = shortened(name, markdown)
    return {f"{name}.md": short} | ({f"{name}_full.md": markdown} if short != markdown else {})


def write_page(path: Path, markdown: str) -> Path:
    """Write the files of :func:`page_files` beside ``path``, and return the path of the shortened page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for name, text in page_files(path.stem, markdown).items():
        write_atomic(path.parent / name, text.encode())
    return path.with_suffix(".md")


def _without_rows(patterns: Sequence[str], address: str, table: str) -> str:
    head, rule, *rows = table.splitlines()
    return "\n".join(
        [head, rule, *(row for row in rows if not _any(patterns, f"{address} | {_plain(' | '.join(cells_of(row)))}"))]
    )


def _any(patterns: Sequence[str], text: str) -> bool:
    return any(re.fullmatch(pattern, text) for pattern in patterns)


def depth_of(block: str) -> int:
    """Return the level of a Markdown heading, 0 for any other block."""
    return len(block) - len(block.lstrip("#")) if block.startswith("#") else 0


def _tables(markdown: str) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    """Yield address (heading and number), header and rows of the tables of a page."""
    heading, count = "", 0
    for block in re.split(r"\n{2,}", markdown.strip("\n")):
        if depth_of(block):
            heading, count = block.lstrip("# "), 0
        elif block.startswith("|"):
            count += 1
            header, _, *rows = [cells_of(line) for line in block.splitlines()]
            yield f"{heading} #{count}", header, rows


def cells_of(line: str) -> list[str]:
    """Return the cells of one line of a Markdown table."""
    return [cell.strip() for cell in _BAR.split(line.strip().removeprefix("|").removesuffix("|"))]


def _plain(cell: str) -> str:
    return cell.replace("\\", "").replace("*", "").replace("`", "").strip()


def _position(header: Sequence[str], name: str) -> int | None:
    plain = [_plain(cell) for cell in header]
    return plain.index(name) if name in plain else None
