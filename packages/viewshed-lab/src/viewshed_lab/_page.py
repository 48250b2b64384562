"""Provenance and Markdown tables, shared by all result pages."""

from __future__ import annotations

import datetime
import hashlib
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

from viewshed_lab._results import result_pages, with_numbers

_HERE = [*Path(__file__).parents][:5][-1]
"""Root of this file's checkout; an installed package may have fewer parent folders."""


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
    r"""Return a Markdown page: title, its key numbers, the parts, and at its end the facts as a list.

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
    """Return the command as a reader would type it, without folders of this machine."""
    module = sys.modules["__main__"].__spec__
    program = [Path(sys.argv[0]).name] if module is None else ["python", "-m", module.name.removesuffix(".__main__")]
    return shlex.join([*program, *map(_without_folder, sys.argv[1:])])


def _without_folder(word: str) -> str:
    option, sign, place = word.partition("=") if word.startswith("--") else ("", "", word)
    is_elsewhere = Path(place).is_absolute() or place.startswith("..")
    return f"{option}{sign}{Path(place).name if is_elsewhere else place}"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    name = fields.get("model name", platform.processor() or platform.machine())
    return f"{name}, family {fields['cpu family']} model {fields['model']}" if "cpu family" in fields else name


def commit_of(checkout: Path) -> str:
    """Return a checkout's short commit and whether its sources have changed since; "unknown" without a checkout."""
    commit = _git(checkout, "rev-parse", "--short", "HEAD")
    if not commit:
        return "unknown"
    changed = _git(checkout, "status", "--porcelain", "--untracked-files=no", "--", "packages")
    return f"{commit} with local changes" if changed else commit


def sources_hash(paths: Sequence[str], commit: str = "") -> str:
    """Return a hash of the contents of the tracked files at ``paths``, now or at a commit; "" if there are none.

    Names and locations of the files do not matter.
    """
    if commit:
        blobs = [line.split()[2] for line in _git(_HERE, "ls-tree", "-r", commit, "--", *paths).splitlines()]
    else:
        names = [name for name in _git(_HERE, "ls-files", "--", *paths).splitlines() if (_HERE / name).is_file()]
        blobs = _git(_HERE, "hash-object", "--", *names).splitlines() if paths and names else []
    return hashlib.sha256("\n".join(sorted(blobs)).encode()).hexdigest()[:12] if paths and blobs else ""


def _git(checkout: Path, *words: str) -> str:
    if not (checkout / ".git").exists():  # an installed package: git would find an enclosing checkout
        return ""
    try:
        done = subprocess.run(["git", *words], cwd=checkout, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()
