"""What every study's plan is: a flat TOML file of the package, whose jobs have names."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from viewshed.datasets.presets import MAX_SEED

JobKey = tuple[str, ...]
"""Names of a job: its step, then what tells it from the others of that step."""


class Plan(Protocol):
    """What a study runs."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain values."""
        ...

    def job_keys(self) -> list[JobKey]:
        """Return the names of all jobs, in the order in which they are done."""
        ...


def check_names(key: str, names: Iterable[object], table: Iterable[object], *, once: bool = False) -> None:
    """Raise a ValueError unless all names are in a table; with ``once`` also unless there are some, all different."""
    known, given = list(table), list(names)
    for name in given:
        if isinstance(name, bool) or name not in known:
            raise ValueError(f"{key} must be among {', '.join(map(str, known))}, got {name!r}")
    if once and (len(set(given)) != len(given) or not given):
        raise ValueError(f"{key} must be different names, got {given}")


def check_seed(key: str, seed: int) -> None:
    """Raise a ValueError unless a seed is in range."""
    if not 0 <= seed <= MAX_SEED:
        raise ValueError(f"{key} must lie in [0, {MAX_SEED}], got {seed}")
