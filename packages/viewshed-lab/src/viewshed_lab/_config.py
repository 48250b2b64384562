"""Frozen dataclasses of plain values: conversion from and to JSON and TOML, and limits as annotations of fields.

>>> @dataclass(frozen=True)
... class Example(Checked):
...     share: Share = 0.3
>>> Example(1.5)
Traceback (most recent call last):
ValueError: share must lie in [0, 1], got 1.5
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import resources
from types import NoneType
from typing import Annotated, Any, Literal, Protocol, get_args, get_origin, get_type_hints

import numpy as np

ALL = "all"
"""Stands for a whole table of names."""

_TYPES: dict[str, Any] = {"str": str, "int": int, "float": (int, float), "bool": bool}


def from_dict(
    cls: type[Any],
    table: Mapping[str, Any],
    what: str,
    whole: Mapping[str, Iterable[str]] | None = None,
    without: Iterable[str] = (),
) -> dict[str, Any]:
    """Return the fields of the dataclass ``cls`` from a table of plain values; tuples are lists there.

    Args:
        cls: dataclass whose fields are str, int, float, bool, or tuples of one of them.
        table: the plain values, by name of the field.
        what: name of such a table, for messages.
        whole: names that ``all`` stands for, by key.
        without: fields without plain values, which the caller adds.

    Raises:
        ValueError: a key is missing or unknown, or a value has the wrong type.
    """
    types = {item.name: str(item.type) for item in fields(cls) if item.name not in without}
    if table.keys() != types.keys():
        wrong = ", ".join(sorted(table.keys() ^ types.keys()))
        raise ValueError(f"a {what} must have the keys {', '.join(types)}; missing or unknown: {wrong}")
    names = whole or {}
    return {
        key: tuple(names[key]) if key in names and table[key] == ALL else _typed(key, table[key], kind)
        for key, kind in types.items()
    }


def _typed(key: str, value: Any, kind: str) -> Any:
    if kind.startswith("tuple"):
        item = kind.removeprefix("tuple[").split(",")[0]
        if not isinstance(value, list):
            raise ValueError(f"{key} must be a list, got {value!r}")
        if "..." not in kind and len(value) != 2:
            raise ValueError(f"{key} must be two numbers, got {value}")
        return tuple(_typed(key, one, item) for one in value)
    if not isinstance(value, _TYPES[kind]) or (kind != "bool" and isinstance(value, bool)):
        raise ValueError(f"{key} must be {kind}, got {value!r}")
    return float(value) if kind == "float" else value


def to_dict(flat: Any) -> dict[str, Any]:
    """Return the fields of a dataclass as a table for :func:`from_dict`."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(flat).items()}


def preset_names(folder: str) -> tuple[str, ...]:
    """Return the sorted names of the TOML files in a folder of the package."""
    entries = resources.files("viewshed_lab").joinpath(folder).iterdir()
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in entries if entry.name.endswith(".toml")))


def load_preset(folder: str, name: str) -> dict[str, Any]:
    """Return the content of a TOML file in a folder of the package, and its name as ``name``.

    A file with the key ``like`` contains only the differences from the file that it names.

    Raises:
        ValueError: there is no such file; the message lists all names.
    """
    one_of("preset", name, preset_names(folder))
    raw = resources.files("viewshed_lab").joinpath(folder, f"{name}.toml").read_text(encoding="utf-8")
    own = tomllib.loads(raw)
    like = own.pop("like", "")
    return (load_preset(folder, like) if like else {}) | {"name": name} | own


MAX_BUDGET = 1_000_000_000
"""The largest budget, more returns than any wedge has."""


class Limit(Protocol):
    """A constraint on the value of a parameter."""

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError that names the parameter unless ``value`` satisfies the constraint."""
        ...


@dataclass(frozen=True, slots=True)
class Between:
    """``low`` ≤ value ≤ ``high``, or ``low`` < value if ``open``; for a tuple, each of its values."""

    low: float
    high: float = np.inf
    open: bool = False

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError unless ``value`` lies within the bounds."""
        for one in value if isinstance(value, tuple) else (value,):
            if not self.low <= one <= self.high or (self.open and one == self.low):
                span = f"lie in {'(' if self.open else '['}{self.low:g}, {self.high:g}]"
                bound = f"be {'more than' if self.open else 'at least'} {self.low:g}"
                raise ValueError(f"{name} must {bound if np.isinf(self.high) else span}, got {one}")


@dataclass(frozen=True, slots=True)
class Ascending:
    """A pair, ``low`` ≤ first ≤ second ≤ ``high``."""

    low: float
    high: float = np.inf

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError unless the pair ascends within the bounds."""
        first, second = value
        Between(self.low, second).check(f"{name}[0]", first)
        Between(first, self.high).check(f"{name}[1]", second)


@dataclass(frozen=True, slots=True)
class OneOf:
    """One of the known words."""

    known: Iterable[str]

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError unless ``value`` is among them."""
        one_of(name, value, self.known)


def one_of(name: str, value: Any, known: Iterable[str]) -> None:
    """Raise a ValueError that lists the ``known`` words unless ``value`` is one of them."""
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}, got {value!r}")


class _Finite:
    def check(self, name: str, value: Any) -> None:
        if not np.isfinite(value):
            raise ValueError(f"{name} must be finite, in radians, got {value}")


class _WholeNumber:
    def check(self, name: str, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value <= MAX_BUDGET:
            raise ValueError(f"{name} must be a whole number of returns in [0, {MAX_BUDGET}], got {value!r}")


Budget = Annotated[int | None, _WholeNumber()]
"""Largest number of returns that an attacker changes; None for all that it can reach."""

Points = Annotated[int, _WholeNumber()]
"""The same for points that may lie anywhere, so that there is no "all"."""

Azimuth = Annotated[float | None, _Finite()]
"""Radians in the sensor's frame, or None to choose one for each sweep."""

Angle = Annotated[float, _Finite()]

Sector = Annotated[float, Between(0.01, 360.0)]
"""Width in degrees."""

Share = Annotated[float, Between(0.0, 1.0)]

Range = Annotated[float, Between(0.5, 1000.0)]
"""Meters from the sensor."""


class Checked:
    """Base of dataclasses whose fields are checked against the limits (or ``Literal``) in their annotations."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Raise a ValueError that names the first field outside its limit."""
        kind: Any = type(self)
        for name, limit, optional in _limits_of(kind):
            value = getattr(self, name)
            if not (optional and value is None):
                limit.check(name, value)


@cache
def _limits_of(kind: type) -> tuple[tuple[str, Limit, bool], ...]:
    """Return name, limit, and whether it may be None, of the limited fields of a dataclass."""
    limits: list[tuple[str, Limit, bool]] = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if get_origin(hint) is Literal:
            limits.append((name, OneOf(get_args(hint)), False))
        elif get_origin(hint) is Annotated:
            value_type, *metadata = get_args(hint)
            limits += [(name, limit, NoneType in get_args(value_type)) for limit in metadata]
    return tuple(limits)
