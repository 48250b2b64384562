"""The log of the sealed set: date, code version, reason and methods of each opening."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from viewshed_lab._page import facts

LOG = Path("docs/results/wild_openings.md")
"""Path in a checkout; the file is committed."""

HEADER = """\
# Openings of the sealed set

The sealed styles, sensors and mountings of [the study in the wild](../simulate.md) are for final tables alone. Every
run on them adds a line here before it starts.

| date | code | reason | methods |
|---|---|---|---|
"""


@dataclass(frozen=True, slots=True)
class SetOpening:
    """One opening."""

    reason: str  # in one line
    methods: Sequence[str]  # that are run

    def __post_init__(self) -> None:
        if not self.reason.strip() or any(sign in self.reason for sign in "|\n"):
            raise ValueError(f"the reason must be one line of text without |, got {self.reason!r}")

    def log(self, path: Path = LOG) -> None:
        """Append a line to the log and flush it to the disk; create the log if there is none."""
        if not path.parent.is_dir():
            raise ValueError(
                f"{path} must lie in a checkout of viewshed, where it is committed; run there, or give its path"
            )
        now = facts()
        line = f"| {now['date']} | {now['version']} | {self.reason.strip()} | {', '.join(self.methods)} |\n"
        with path.open("a", encoding="utf-8") as file:
            file.write(line if file.tell() else HEADER + line)
            file.flush()
            os.fsync(file.fileno())
