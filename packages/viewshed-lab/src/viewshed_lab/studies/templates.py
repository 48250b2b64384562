"""Pages as templates: Markdown files of the package, whose slots are filled with tables, pictures and lines of text.

A template is read paragraph by paragraph. ``{name}`` in a text or a heading stands for a value; ``{{name}}`` alone is
a slot; what stands between ``<!-- for x in xs -->`` and ``<!-- end -->`` is repeated for each of the values ``xs``.
What has nothing to show is left out by itself: a text with the empty slot that follows it, and a section with all of
its texts if none of its slots has anything.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

from viewshed_lab._page import Heading, PageBlock, Picture, Table, Text

Filling = Table | Picture | str | None | Iterable[Table | Picture]
"""What a slot shows: a table, a picture, several of them, a text, or nothing."""

Slots = Mapping[str, Callable[..., Filling]]
"""By name what fills a slot; it is called with the values of the loops around the slot, the outermost first."""

_SLOT = re.compile(r"\{\{(\w+)\}\}")
_LOOP = re.compile(r"<!-- for (\w+) in (\w+) -->")
_END = "<!-- end -->"


@dataclass(frozen=True, slots=True)
class _Part:
    """A heading, a text, or a slot with all that it shows."""

    blocks: list[PageBlock]
    is_slot: bool = False
    level: int = field(default=0)


def fill_template(path: str, values: Mapping[str, Any], slots: Slots) -> tuple[str, list[PageBlock]]:
    """Return the title and the blocks of a page whose template is a file in the folder of the studies."""
    return fill_text(resources.files("viewshed_lab.studies").joinpath(path).read_text(encoding="utf-8"), values, slots)


def fill_text(text: str, values: Mapping[str, Any], slots: Slots) -> tuple[str, list[PageBlock]]:
    """Return the title and the blocks of a page.

    Args:
        text: of the template; its first line is the title.
        values: by name; those of loops are sequences.
        slots: by name.
    """
    title, *paragraphs = [paragraph.strip() for paragraph in re.split(r"\n{2,}", text.strip())]
    parts = _without_empty_sections(list(_parts(paragraphs, dict(values), slots, ())))
    return title.removeprefix("# "), list(_without_empty_slots(parts))


def _parts(paragraphs: list[str], values: dict[str, Any], slots: Slots, items: tuple[Any, ...]) -> Iterator[_Part]:
    """Yield the parts of some paragraphs; ``items`` are the values of the loops around them."""
    position = 0
    while position < len(paragraphs):
        paragraph = paragraphs[position]
        position += 1
        if loop := _LOOP.fullmatch(paragraph):
            end = _end_of_loop(paragraphs, position)
            name, several = loop.groups()
            if not values[several]:
                yield _Part([], is_slot=True)
            for item in values[several]:
                yield from _parts(paragraphs[position:end], values | {name: item}, slots, (*items, item))
            position = end + 1
        elif slot := _SLOT.fullmatch(paragraph):
            yield _Part(_blocks(slots[slot[1]](*items)), is_slot=True)
        elif paragraph.startswith("#"):
            marks, _, heading = paragraph.partition(" ")
            yield _Part([Heading(len(marks), heading.format(**values))], level=len(marks))
        elif text := paragraph.format(**values):
            yield _Part([Text(text)])


def _end_of_loop(paragraphs: list[str], start: int) -> int:
    """Return the position of the end of a loop whose first paragraph is at ``start``."""
    depth = 1
    for position in range(start, len(paragraphs)):
        depth += 1 if _LOOP.fullmatch(paragraphs[position]) else -1 if paragraphs[position] == _END else 0
        if depth == 0:
            return position
    raise ValueError(f"a template must end each of its loops with {_END}")


def _blocks(filling: Filling) -> list[PageBlock]:
    if filling is None or filling == "":
        return []
    if isinstance(filling, str):
        return [Text(filling)]
    return [filling] if isinstance(filling, Table | Picture) else list(filling)


def _without_empty_sections(parts: list[_Part]) -> list[_Part]:
    """Return the parts less the sections whose slots are all empty; sections without a slot stay."""
    kept: list[_Part] = []
    position = 0
    while position < len(parts):
        level, end = parts[position].level, position + 1
        if level:
            while end < len(parts) and not 0 < parts[end].level <= level:
                end += 1
            shown = [bool(part.blocks) for part in parts[position:end] if part.is_slot]
            if shown and not any(shown):
                position = end
                continue
        kept.append(parts[position])
        position += 1
    return kept


def _without_empty_slots(parts: list[_Part]) -> Iterator[PageBlock]:
    """Yield the blocks of the parts, less the texts that stand right above a slot with nothing to show."""
    texts: list[PageBlock] = []
    for part in parts:
        if part.is_slot or part.level:
            yield from texts if part.blocks else []
            yield from part.blocks
            texts = []
        else:
            texts += part.blocks
    yield from texts
