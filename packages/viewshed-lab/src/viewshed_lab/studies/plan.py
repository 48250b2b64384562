"""Base class of the plans of studies: a flat TOML file of the package, with a list of named jobs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Self

from viewshed_lab import _config
from viewshed_lab.data.presets import MAX_SEED

JobKey = tuple[str, ...]
"""Names of a job: its step, then its names within the step."""


class Plan:
    """What a study runs; each subclass is a frozen dataclass that validates its values."""

    __slots__ = ()

    FOLDER: ClassVar[str]
    """Folder of the TOML files in the package."""

    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {}
    """By key, the names that the value ``all`` stands for."""

    name: str
    """Name of the plan."""

    about: str
    """One-line description."""

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> Self:
        """Return the plan from plain values: attributes as keys, lists for tuples.

        Raises:
            ValueError: a key is missing or unknown, or a value is wrong.
        """
        return cls(**_config.from_dict(cls, table, "plan", cls.WHOLE_TABLES))

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain values, with ``all`` replaced by the names."""
        return _config.to_dict(self)

    @classmethod
    def load(cls, name: str) -> Self:
        """Return the plan called ``name``.

        Raises:
            ValueError: there is no such plan; the message lists those that exist.
        """
        return cls.from_json(_config.load_preset(cls.FOLDER, name))

    def job_keys(self) -> list[JobKey]:
        """Return the keys of all jobs, in the order in which they run."""
        raise NotImplementedError

    def check_at_least(self, minimum: int, *keys: str) -> None:
        """Raise a ValueError unless the values of some keys are at least ``minimum``."""
        for key in keys:
            if getattr(self, key) < minimum:
                raise ValueError(f"{key} must be at least {minimum}, got {getattr(self, key)}")


def check_names(key: str, names: Iterable[object], table: Iterable[object], *, once: bool = False) -> None:
    """Raise a ValueError unless all names are in a table; with ``once`` they must also be unique and not empty."""
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
