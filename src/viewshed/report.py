"""What a figure was measured on, and Markdown tables: every page of results begins and looks the same."""

from __future__ import annotations

import datetime
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path


def facts(**more: str) -> dict[str, str]:
    """Return processor, cores, date, version, commit and command by name, then ``more``."""
    return {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": f"viewshed {metadata.version('viewshed')}, commit {_commit()}, Python {platform.python_version()}",
        "command": f"`{_command()}`",
        **more,
    }


def page(title: str, told: Mapping[str, str], *parts: str) -> str:
    r"""Return a Markdown page: title, the facts as a list, then the parts.

    >>> page("Areas", {"seed": "0"}, "text")
    '# Areas\n\n- seed: 0\n\ntext\n'
    """
    listed = "\n".join(f"- {name}: {value}" for name, value in told.items())
    return "\n\n".join([f"# {title}", listed, *parts]) + "\n"


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
    return shlex.join([Path(words[0]).name, *words[1:]])


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    name = fields.get("model name", platform.processor() or platform.machine())
    return f"{name}, family {fields['cpu family']} model {fields['model']}" if "cpu family" in fields else name


def _commit() -> str:
    commit = _git("rev-parse", "--short", "HEAD")
    if not commit:
        return "unknown"
    return (
        f"{commit} with local changes" if _git("status", "--porcelain", "--untracked-files=no", "--", "src") else commit
    )


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=Path(__file__).parents[2], check=False, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else ""
