"""What every study's plan is: a flat TOML file of the package, whose jobs have names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Self

from viewshed_lab import _config
from viewshed_lab.data.presets import MAX_SEED

JobKey = tuple[str, ...]
"""Names of a job: its step, then what tells it from the others of that step."""


class Plan:
    """What a study runs: each study's plan is a frozen dataclass that checks its values when it is made."""

    __slots__ = ()

    FOLDER: ClassVar[str]
    """Of the TOML files, in the package."""

    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {}
    """By key the names that ``all`` stands for."""

    name: str
    """Of the plan."""

    about: str
    """One line for people."""

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> Self:
        """Return the plan in plain values: keys as the attributes, lists for tuples.

        Raises:
            ValueError: a key is missing or unknown, or a value is wrong.
        """
        return cls(**_config.from_dict(cls, table, "plan", cls.WHOLE_TABLES))

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain values, every name spelt out."""
        return _config.to_dict(self)

    @classmethod
    def load(cls, name: str) -> Self:
        """Return the plan called ``name``.

        Raises:
            ValueError: there is none of that name; the message lists those that exist.
        """
        return cls.from_json(_config.load_preset(cls.FOLDER, name))

    def job_keys(self) -> list[JobKey]:
        """Return the names of all jobs, in the order in which they are done."""
        raise NotImplementedError

    def check_at_least(self, least: int, *keys: str) -> None:
        """Raise a ValueError unless the numbers of some keys are large enough."""
        for key in keys:
            if getattr(self, key) < least:
                raise ValueError(f"{key} must be at least {least}, got {getattr(self, key)}")


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
