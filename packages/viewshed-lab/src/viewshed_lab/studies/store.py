"""An append-only file of JSON lines, one a finished job: what is there survives whatever stops the rest."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, TypeVar

from viewshed import _files
from viewshed_lab.studies.plan import JobKey, Plan
from viewshed_lab.studies.records import Record, Results, from_table, to_table

FILE = "results.jsonl"

FORMAT = 3

P = TypeVar("P", bound=Plan)


@dataclass(frozen=True, slots=True, eq=False)
class JobResult:
    """What a job found.

    Attributes:
        records: what it counted.
        facts: plain values that are no records.
    """

    records: Sequence[Record] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ResultStore(Generic[P]):
    """Results of one plan in a folder: the first line holds the plan, each other one a finished job.

    A line is written at once and synced. What a crash left of a line at the end is cut off when the store is opened.

    Attributes:
        folder: where all of the study lies.
        plan: whose results it holds.
    """

    folder: Path
    plan: P

    @classmethod
    def open(cls, folder: str | Path, plan: P) -> ResultStore[P]:
        """Return the store in a folder, begun if there is none, mended if its last line is not whole.

        Raises:
            ValueError: the folder holds results of another plan or version, or a damaged line.
            OSError: it cannot be read or written.
        """
        store = cls(Path(folder), plan)
        store.folder.mkdir(parents=True, exist_ok=True)
        head = {"format": FORMAT, "version": metadata.version("viewshed"), "plan": plan.to_json()}
        if not _files.is_begun(store.path):
            _files.append_jsonl(store.path, head)
        _, found = next(store._lines())
        if found != head:
            raise ValueError(
                f"{store.path} must hold results of this plan and version, got {_kind(found, head)}; choose another "
                "folder or delete the file"
            )
        return store

    @property
    def path(self) -> Path:
        """The file."""
        return self.folder / FILE

    def append(self, key: JobKey, result: JobResult, commits: Sequence[str] = ()) -> None:
        """Add what a job found, on the disk when this returns.

        Raises:
            OSError: it cannot be written.
        """
        facts, records = dict(result.facts), to_table(result.records)
        line = {"job": list(key), "commits": list(commits), "facts": facts, "records": records}
        _files.append_jsonl(self.path, line)

    def keys(self) -> set[JobKey]:
        """Return the names of the jobs that are there.

        Raises:
            ValueError: a line is damaged.
        """
        return {key for _, key, _ in self._jobs()}

    def results(self, *start: str) -> Results[P]:
        """Return what the finished jobs found whose names begin with ``start``; the order of lines changes nothing.

        Raises:
            ValueError: a line is damaged.
        """
        results = Results(self.plan)
        for number, key, line in self._jobs():
            if key[: len(start)] == start:
                try:
                    results.add(list(from_table(line["records"])))
                    results.facts[key] = line["facts"]
                    results.commits.update(line["commits"])
                except (TypeError, KeyError, ValueError, AttributeError) as error:
                    raise self._damaged(number) from error
        return results

    def require(self, results: Results[P]) -> None:
        """Raise a ValueError if there are no results for a page."""
        if not results.series():
            raise ValueError(f"{self.path} must hold results, got none; run without --no-run")

    def _jobs(self) -> Iterator[tuple[int, JobKey, dict[str, Any]]]:
        lines, known = self._lines(), set(self.plan.job_keys())
        next(lines)
        for number, line in lines:
            if not _is_of_a_job(line) or (key := tuple(line["job"])) not in known:
                raise self._damaged(number)
            yield number, key, line

    def _lines(self) -> Iterator[tuple[int, Any]]:
        with self.path.open("rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    yield number, json.loads(line)
                except ValueError as error:
                    raise self._damaged(number) from error

    def _damaged(self, number: int) -> ValueError:
        repair = "delete that line, its job is done again" if number > 1 else "choose another folder"
        return ValueError(f"{self.path} must hold results, line {number} is damaged; {repair}")


def _kind(found: Any, head: dict[str, Any]) -> str:
    """Return what a first line holds that is not the one expected."""
    if not isinstance(found, dict) or not {"plan", "study"} & set(found):
        return "something else"
    if found.get("format") != FORMAT:
        return "those of an older version of the study"
    return "another plan" if found.get("plan") != head["plan"] else "another version"


def _is_of_a_job(line: Any) -> bool:
    """Return whether a line has the form of what a job found."""
    if not isinstance(line, dict) or not {"job", "commits", "facts", "records"} <= set(line):
        return False
    return isinstance(line["job"], list) and all(isinstance(name, str) for name in line["job"])
