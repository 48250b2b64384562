"""Limits of the parameters of attacks and corruptions: they stand beside each parameter, and are checked in one place.

>>> @dataclass(frozen=True)
... class Example(Checked):
...     share: Share = 0.3
>>> Example(1.5)
Traceback (most recent call last):
ValueError: share must lie in [0, 1], got 1.5
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import NoneType
from typing import Annotated, Any, Literal, Protocol, get_args, get_origin, get_type_hints

import numpy as np

MAX_BUDGET = 1_000_000_000
"""The largest budget; more than any wedge holds."""


class Limit(Protocol):
    """Anything that a parameter must keep to."""

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError that names the parameter unless ``value`` keeps to it."""
        ...


@dataclass(frozen=True, slots=True)
class Between:
    """``low`` ≤ value ≤ ``high``; of a tuple, each of its values."""

    low: float
    high: float

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError unless ``value`` lies between the ends."""
        for one in value if isinstance(value, tuple) else (value,):
            if not self.low <= one <= self.high:
                raise ValueError(f"{name} must lie in [{self.low:g}, {self.high:g}], got {one}")


@dataclass(frozen=True, slots=True)
class Ascending:
    """A pair, ``low`` ≤ first ≤ second ≤ ``high``."""

    low: float
    high: float = np.inf

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError unless the pair ascends between the ends."""
        first, second = value
        Between(self.low, second).check(f"{name}[0]", first)
        Between(first, self.high).check(f"{name}[1]", second)


@dataclass(frozen=True, slots=True)
class OneOf:
    """One of some words."""

    known: tuple[str, ...]

    def check(self, name: str, value: Any) -> None:
        """Raise a ValueError unless ``value`` is among them."""
        if value not in self.known:
            raise ValueError(f"{name} must be one of {', '.join(self.known)}, got {value!r}")


class _Finite:
    def check(self, name: str, value: Any) -> None:
        if not np.isfinite(value):
            raise ValueError(f"{name} must be finite, in radians, got {value}")


class _WholeNumber:
    def check(self, name: str, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value <= MAX_BUDGET:
            raise ValueError(f"{name} must be a whole number of returns in [0, {MAX_BUDGET}], got {value!r}")


Budget = Annotated[int | None, _WholeNumber()]
"""Most returns that an attacker touches; None for all that it reaches."""

Points = Annotated[int, _WholeNumber()]
"""The same where there is no all: of points that may lie anywhere."""

Azimuth = Annotated[float | None, _Finite()]
"""Radians in the sensor's frame, or None for one that is found anew for each sweep."""

Angle = Annotated[float, _Finite()]

Sector = Annotated[float, Between(0.01, 360.0)]
"""Width in degrees."""

Share = Annotated[float, Between(0.0, 1.0)]

Range = Annotated[float, Between(0.5, 1000.0)]
"""Meters from the sensor."""


class Checked:
    """A dataclass whose fields must keep to the limits in their annotations; a ``Literal`` is one, too."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Raise a ValueError that names the first field that does not."""
        kind: Any = type(self)
        for name, limit, optional in _limits_of(kind):
            value = getattr(self, name)
            if not (optional and value is None):
                limit.check(name, value)


@cache
def _limits_of(kind: type) -> tuple[tuple[str, Limit, bool], ...]:
    """Return the limits of a dataclass: the field's name, its limit, and whether it may be None."""
    limits: list[tuple[str, Limit, bool]] = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if get_origin(hint) is Literal:
            limits.append((name, OneOf(get_args(hint)), False))
        elif get_origin(hint) is Annotated:
            value_type, *found = get_args(hint)
            limits += [(name, limit, NoneType in get_args(value_type)) for limit in found]
    return tuple(limits)
