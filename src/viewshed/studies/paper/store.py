"""An append-only file of JSON lines, one a finished job of the study: what is there survives what stops the rest."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from viewshed import _files as journal

FILE = "results.jsonl"

FORMAT = 1

Key = tuple[str, ...]
"""Names of a job: its step, then what tells it from the others of that step."""


class Plan(Protocol):
    """What is run, in plain values."""

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain values."""
        ...


P = TypeVar("P", bound=Plan)


@dataclass(frozen=True, slots=True)
class JobStore(Generic[P]):
    """Results of one plan in a folder: the first line tells the plan, each other one a finished job.

    A line is written at once and synced. What a crash left of a line at the end is cut off when the store is opened.

    Attributes:
        folder: where all of the study lies.
        plan: whose results it holds.
    """

    folder: Path
    plan: P

    @classmethod
    def open(cls, folder: str | Path, plan: P) -> JobStore[P]:
        """Return the store in a folder, begun if there is none, mended if its last line is not whole.

        Raises:
            ValueError: the folder holds results of another plan or version, or a damaged line.
            OSError: it cannot be read or written.
        """
        store = cls(Path(folder), plan)
        store.folder.mkdir(parents=True, exist_ok=True)
        head = {"format": FORMAT, "version": metadata.version("viewshed"), "plan": plan.to_json()}
        if not journal.is_begun(store.path):
            journal.append_jsonl(store.path, head)
        found = next(store._lines())
        if found != head:
            what = "another plan" if found.get("plan") != head["plan"] else "another version"
            repair = "choose another folder or delete the file"
            raise ValueError(f"{store.path} must hold results of this plan and version, got {what}; {repair}")
        return store

    @property
    def path(self) -> Path:
        """The file."""
        return self.folder / FILE

    def append(self, key: Key, found: dict[str, Any]) -> None:
        """Add what a job found, on the disk when this returns.

        Raises:
            OSError: it cannot be written.
        """
        journal.append_jsonl(self.path, {"job": list(key), **found})

    def keys(self) -> set[Key]:
        """Return the names of the jobs that are there."""
        return {tuple(line["job"]) for line in self.jobs()}

    def jobs(self, *start: str) -> Iterator[dict[str, Any]]:
        """Yield what each finished job found whose names begin with ``start``, in the order of their end.

        Raises:
            ValueError: a line is damaged.
        """
        lines = self._lines()
        next(lines)
        yield from (line for line in lines if line["job"][: len(start)] == list(start))

    def _lines(self) -> Iterator[dict[str, Any]]:
        with self.path.open("rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    yield json.loads(line)
                except ValueError as error:
                    what = f"line {number} is damaged; delete that line, its job is done again"
                    raise ValueError(f"{self.path} must hold JSON lines, {what}") from error
