"""Result store of a study: a folder with one Parquet file per finished job, written atomically."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import pandas as pd

from viewshed import _files
from viewshed.metrics import Scores
from viewshed_lab.studies.plan import JobKey, Plan
from viewshed_lab.studies.records import Results, Row

PLAN, JOBS = "plan.json", "jobs"
"""File of the plan, and folder of the results, one file per job."""

FORMAT = 4

P = TypeVar("P", bound=Plan)


@dataclass(frozen=True, slots=True, eq=False)
class JobResult:
    """Result of a job."""

    rows: Sequence[Row] = ()  # see :func:`row_of`
    facts: Mapping[str, Any] = field(default_factory=dict)  # plain values that are not rows


@dataclass(frozen=True, slots=True)
class ResultStore(Generic[P]):
    """Results of one plan in a folder. To merge results of several machines, copy their files into one folder."""

    folder: Path  # folder of the study
    plan: P  # plan of the results

    @classmethod
    def open(cls, folder: str | Path, plan: P) -> ResultStore[P]:
        """Return the store in a folder; create it if there is none.

        Raises:
            ValueError: the folder holds results of another plan or version.
            OSError: it cannot be read or written.
        """
        store = cls(Path(folder), plan)
        (store.folder / JOBS).mkdir(parents=True, exist_ok=True)
        bind(store.folder, plan.to_json())
        return store

    def path_of(self, key: JobKey) -> Path:
        """Return the file of a job's result."""
        return self.folder / JOBS / f"{quote(' '.join(key), safe=' ')}.parquet"

    def append(self, key: JobKey, result: JobResult, commits: Sequence[str] = ()) -> None:
        """Write the result of a job to its file.

        Raises:
            OSError: the file cannot be written.
        """
        frame = pd.DataFrame(list(result.rows))
        if "scores" in frame:
            frame["scores"] = frame["scores"].map(lambda one: json.dumps(one.to_json()), na_action="ignore")
        frame.attrs = {"facts": dict(result.facts), "commits": list(commits)}
        _files.write_atomic(self.path_of(key), frame.to_parquet(None, index=False))

    def keys(self) -> set[JobKey]:
        """Return the keys of the finished jobs."""
        return {key for key in self.plan.job_keys() if self.path_of(key).exists()}

    def results(self, *start: str) -> Results[P]:
        """Return the results of the finished jobs whose keys begin with ``start``, in the order of the plan.

        Raises:
            ValueError: a file is damaged.
        """
        done = self.keys()
        frames = {key: self._read(key) for key in self.plan.job_keys() if key in done and key[: len(start)] == start}
        facts = {key: frame.attrs.pop("facts") for key, frame in frames.items()}
        commits = {commit for frame in frames.values() for commit in frame.attrs.pop("commits")}
        return Results.of(self.plan, pd.concat(frames.values()) if frames else (), facts, commits)

    def _read(self, key: JobKey) -> pd.DataFrame:
        try:
            frame = pd.read_parquet(self.path_of(key))
            if "scores" in frame:
                frame["scores"] = frame["scores"].map(lambda one: Scores.from_json(json.loads(one)), na_action="ignore")
            if {"facts", "commits"} <= frame.attrs.keys():
                return frame
        except (ValueError, OSError) as error:
            raise self._damaged(key) from error
        raise self._damaged(key)

    def _damaged(self, key: JobKey) -> ValueError:
        return ValueError(f"{self.path_of(key)} must hold what a job found, it is damaged; delete it and run again")

    def require(self, results: Results[P]) -> None:
        """Raise a ValueError if there are no results for a page."""
        if not results.facts:
            raise ValueError(f"{self.folder} must hold results, got none; run without --no-run")


def bind(folder: Path, plan: Mapping[str, Any], unbound: str = "") -> None:
    """Write a plan and the version into a folder, or check that it holds these.

    Args:
        folder: holds the results of the plan; it is created if there is none.
        plan: plain values, those of JSON.
        unbound: pattern of results that are refused in a folder without a plan; an older version wrote them.

    Raises:
        ValueError: the folder holds results of another plan or version.
        OSError: it cannot be read or written.
    """
    path, kind = folder / PLAN, ""
    head = {"format": FORMAT, "version": metadata.version("viewshed"), "plan": plan}
    folder.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        if unbound and any(folder.glob(unbound)):
            kind = "those of an unknown plan"
        else:
            _files.write_atomic(path, json.dumps(head, indent=1).encode())
    if not kind:
        try:
            stored = json.loads(path.read_bytes())
            kind = "another version" if stored != head else ""
            if stored["plan"] != plan:
                kind = f"another plan ({_changes(stored['plan'], plan)})"
        except (ValueError, TypeError, KeyError):
            kind = "something else"
    if kind:
        raise ValueError(
            f"{folder} must hold results of this plan and version, got {kind}; give another --out or delete it"
        )


def _changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return the first three differences between two plans, as text."""
    keys = [key for key in (*before, *(set(now) - set(before))) if before.get(key) != now.get(key)]
    more = f" and {len(keys) - 3} more" if len(keys) > 3 else ""
    return (
        ", ".join(f"{key} {before.get(key, 'nothing')} there, {now.get(key, 'nothing')} now" for key in keys[:3]) + more
    )
