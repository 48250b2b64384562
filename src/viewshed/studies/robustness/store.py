"""An append-only file of JSON lines, one a job: what is finished survives whatever stops the rest."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from viewshed import _files as journal
from viewshed.studies.cases import KINDS, Case
from viewshed.studies.robustness.plan import PARTS, Study
from viewshed.studies.statistics import COUNTS

FILE = "results.jsonl"

FORMAT = 2

_SCORES = 2 * COUNTS + 1


@dataclass(frozen=True, slots=True)
class ResultStore:
    """Results of one study in a folder: the first line tells the study, each other one a finished job.

    A line is written at once and synced. What a crash left of a line at the end is cut off when the store is opened.

    Attributes:
        path: of the file.
        study: whose results it holds.
    """

    path: Path
    study: Study

    @classmethod
    def open(cls, folder: str | Path, study: Study) -> ResultStore:
        """Return the store in a folder, begun if there is none, mended if its last line is not whole.

        Raises:
            ValueError: the folder holds results of another study or version, or a damaged line.
            OSError: it cannot be read or written.
        """
        path = Path(folder) / FILE
        path.parent.mkdir(parents=True, exist_ok=True)
        store = cls(path, study)
        head = {"format": FORMAT, "version": metadata.version("viewshed"), "study": study.to_json()}
        if not journal.is_begun(path):
            store.append(head)
        found = next(store._lines())
        if found != head:
            raise ValueError(f"{path} must hold this study, got {_other(found, head)}; choose another folder")
        return store

    def append(self, line: dict[str, Any]) -> None:
        """Add a line, on the disk when this returns.

        Raises:
            OSError: it cannot be written.
        """
        journal.append_jsonl(self.path, line)

    def keys(self) -> set[tuple[str, int, str]]:
        """Return domain, number and part of the jobs that are there."""
        return {key_of(line) for line in self.jobs()}

    def jobs(self) -> Iterator[dict[str, Any]]:
        """Yield what each finished job found, in the order in which they were finished.

        Raises:
            ValueError: a line is damaged.
        """
        lines = self._lines()
        next(lines)
        for number, line in enumerate(lines, 2):
            if not _is_of_a_job(line, self.study):
                raise self._damaged(number)
            yield line

    def _lines(self) -> Iterator[dict[str, Any]]:
        with self.path.open("rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    yield json.loads(line)
                except ValueError as error:
                    raise self._damaged(number) from error

    def _damaged(self, number: int) -> ValueError:
        mend = "delete that line, its job is done again" if number > 1 else "choose another folder"
        return ValueError(f"{self.path} must hold results, line {number} is damaged; {mend}")


def key_of(line: dict[str, Any]) -> tuple[str, int, str]:
    """Return domain, number and part of a job's line."""
    domain, number, part = line["job"]
    return domain, number, part


def _other(found: Any, head: dict[str, Any]) -> str:
    """Return what a first line tells that is not the one expected."""
    if not isinstance(found, dict) or "study" not in found:
        return "something else"
    return "results of another study" if found["study"] != head["study"] else "results of another version"


def _is_of_a_job(line: Any, study: Study) -> bool:
    """Return whether a line has the form of what a job of the study found."""
    try:
        domain, number, part = key_of(line)
        job = part in PARTS and 0 <= number < study.samples[study.domains.index(domain)]
        cases = [Case(*entry["case"]) for entry in line["cases"]]
        scores = [values for entry in line["cases"] for values in entry.get("scores", {}).values()]
        lengths = {len(values) for values in scores} | {_SCORES}
        return job and all(case.kind in KINDS for case in cases) and lengths == {_SCORES} and "about" in line
    except (TypeError, KeyError, ValueError, AttributeError):
        return False
