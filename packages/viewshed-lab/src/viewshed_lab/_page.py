"""A report as a list of blocks, written as Markdown with pictures beside it, or as one HTML file that needs nothing.

What a figure was measured on, and Markdown tables: every page of results begins and looks the same.
"""

from __future__ import annotations

import base64
import datetime
import hashlib
import html
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from viewshed_lab._results import result_pages, with_numbers

_HERE = Path(__file__).parents[4]
"""The checkout that this file is of."""


def facts(**more: str) -> dict[str, str]:
    """Return processor, cores, date, version, commit and command by name, then ``more``."""
    return {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": f"viewshed {metadata.version('viewshed')}, commit {commit_of(_HERE)},"
        f" Python {platform.python_version()}",
        "command": f"`{_command()}`",
        **more,
    }


def page(title: str, provenance: Mapping[str, str], *parts: str) -> str:
    r"""Return a Markdown page: title, its three numbers, the parts, and at its foot the facts as a list.

    >>> page("Areas", {"seed": "0"}, "text")
    '# Areas\n\ntext\n\n## How it was made\n\n- seed: 0\n'
    """
    known = result_pages().get(title)
    sources = sources_hash(known.sources) if known else ""
    bound = {**provenance, "sources": sources} if sources else provenance
    listed = "\n".join(f"- {name}: {value}" for name, value in bound.items())
    return with_numbers(title, listed, "\n\n".join(parts))


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    r"""Return a Markdown table.

    >>> table(["a", "b"], [["1", "2"]])
    '| a | b |\n|---|---|\n| 1 | 2 |'
    """
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "|" + "|".join(cells) + "|" if cells[0] == "---" else f"| {' | '.join(cells)} |" for cells in lines
    )


def _command() -> str:
    """The command as a reader would type it: no folder of this machine."""
    words = [Path(word).name if Path(word).is_absolute() or word.startswith("..") else word for word in sys.argv]
    module = sys.modules["__main__"].__spec__
    program = [Path(words[0]).name] if module is None else ["python", "-m", module.name.removesuffix(".__main__")]
    return shlex.join([*program, *words[1:]])


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    name = fields.get("model name", platform.processor() or platform.machine())
    return f"{name}, family {fields['cpu family']} model {fields['model']}" if "cpu family" in fields else name


def commit_of(checkout: Path) -> str:
    """Return the commit of a checkout, shortened, and whether its sources were changed since; "unknown" without one."""
    commit = _git(checkout, "rev-parse", "--short", "HEAD")
    if not commit:
        return "unknown"
    changed = _git(checkout, "status", "--porcelain", "--untracked-files=no", "--", "src")
    return f"{commit} with local changes" if changed else commit


def sources_hash(paths: Sequence[str], commit: str = "") -> str:
    """Return a hash of the tracked files at paths of the checkout, as they are or at a commit; "" where git has none.

    Contents count, names and places do not.
    """
    if commit:
        blobs = [line.split()[2] for line in _git(_HERE, "ls-tree", "-r", commit, "--", *paths).splitlines()]
    else:
        names = [name for name in _git(_HERE, "ls-files", "--", *paths).splitlines() if (_HERE / name).is_file()]
        blobs = _git(_HERE, "hash-object", "--", *names).splitlines() if paths and names else []
    return hashlib.sha256("\n".join(sorted(blobs)).encode()).hexdigest()[:12] if paths and blobs else ""


def _git(checkout: Path, *words: str) -> str:
    done = subprocess.run(["git", *words], cwd=checkout, check=False, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else ""


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading; level 2 is a chapter."""

    level: int
    text: str


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph of Markdown with `code`, *stress* and **strong stress**, or a list whose items begin with a dash."""

    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table of plain words; what is bold is in asterisks."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG with the name of its file and what it shows."""

    name: str
    png: bytes
    alt: str


PageBlock = Heading | Text | Table | Picture


def to_markdown(title: str, provenance: Mapping[str, str], blocks: Sequence[PageBlock]) -> str:
    r"""Return the report as a Markdown page; pictures are files beside it.

    >>> to_markdown("A", {"seed": "0"}, [Heading(2, "B"), Picture("c.png", b"", "d")])
    '# A\n\n## B\n\n![d](c.png)\n\n## How it was made\n\n- seed: 0\n'
    """
    return page(title, provenance, *(_markdown(block) for block in blocks))


def _markdown(block: PageBlock) -> str:
    if isinstance(block, Heading):
        return f"{'#' * block.level} {block.text}"
    if isinstance(block, Text):
        return block.text
    if isinstance(block, Table):
        return table(block.header, block.rows)
    return f"![{block.alt}]({block.name})"


def to_html(title: str, provenance: Mapping[str, str], blocks: Sequence[PageBlock]) -> str:
    """Return the report as one HTML page; pictures are in it, and nothing is fetched."""
    listed = Text("\n".join(f"- {name}: {value}" for name, value in provenance.items()))
    made: tuple[PageBlock, ...] = (Heading(2, "How it was made"), listed)
    body = "\n".join(_html(block) for block in [Heading(1, title), *blocks, *made])
    return f"<!DOCTYPE html>\n<html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>{_STYLE}\n{body}\n"


def _html(block: PageBlock) -> str:
    if isinstance(block, Heading):
        return f"<h{block.level}>{_inline(block.text)}</h{block.level}>"
    if isinstance(block, Text):
        return _prose(block.text)
    if isinstance(block, Table):
        head = "".join(f"<th>{_inline(cell)}</th>" for cell in block.header)
        rows = "".join(f"<tr>{''.join(f'<td>{_inline(cell)}</td>' for cell in row)}</tr>\n" for row in block.rows)
        return f"<div class=wide><table><tr>{head}</tr>\n{rows}</table></div>"
    data = base64.b64encode(block.png).decode()
    return f'<figure><img alt="{html.escape(block.alt)}" src="data:image/png;base64,{data}"></figure>'


def _prose(text: str) -> str:
    if text.startswith("- "):
        items = "".join(f"<li>{_inline(' '.join(item.split()))}</li>\n" for item in re.split(r"(?:^|\n)- ", text)[1:])
        return f"<ul>\n{items}</ul>"
    return f"<p>{_inline(' '.join(text.split()))}</p>"


def _inline(text: str) -> str:
    """Return Markdown's code and stress as HTML.

    >>> _inline("**a** < `b_c`")
    '<b>a</b> &lt; <code>b_c</code>'
    """
    safe = html.escape(text)
    for pattern, tag in ((r"`([^`]+)`", "code"), (r"\*\*([^*]+)\*\*", "b"), (r"\*([^*]+)\*", "i")):
        safe = re.sub(pattern, rf"<{tag}>\1</{tag}>", safe)
    return re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", safe)


_STYLE = """<style>
body{font:15px/1.45 system-ui,sans-serif;max-width:76rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;font-size:13px;font-variant-numeric:tabular-nums}
th,td{padding:.15rem .55rem;border-bottom:1px solid #ddd;text-align:right;white-space:nowrap}
th:first-child,td:first-child{text-align:left}.wide{overflow-x:auto}
img{max-width:100%}figure{margin:1rem 0}code{background:#f2f2f2;padding:0 .2em}h2{margin-top:2.5rem}
</style>"""
