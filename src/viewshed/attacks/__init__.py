"""Attacks on a sweep: the table, the role, and the record of what was touched.

>>> from viewshed.attacks import ADAPTIVE, ATTACKS
>>> "far_wall" in ATTACKS, "adaptive_over_claim" in ADAPTIVE
(True, True)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from viewshed.attacks.paper import PAPER_ATTACK, PAPER_INDOOR_ATTACK
from viewshed.attacks.spoofer import FINGERPRINT_RELIABILITY, RELIABILITY, Spoofer
from viewshed.attacks.table import (
    ATTACKS,
    BUDGETS,
    EARLIER,
    FAMILY,
    FREE_FORM,
    FULL_WEDGE,
    SEVERITIES,
    AttackFactory,
    Knowledge,
    at_severity,
)
from viewshed.attacks.tampering import Attack, Tampered, Wedge

if TYPE_CHECKING:
    from viewshed.attacks.adaptive import ADAPTIVE, BlackBox, Searched
    from viewshed.attacks.gradient import Expectation, WhiteBox
    from viewshed.attacks.objectives import Evade, Objective, OverClaim, Trip, UnderClaim

_HOMES = {
    "ADAPTIVE": "adaptive", "BlackBox": "adaptive", "Searched": "adaptive",
    "Expectation": "gradient", "WhiteBox": "gradient",
    "Evade": "objectives", "Objective": "objectives", "OverClaim": "objectives", "Trip": "objectives",
    "UnderClaim": "objectives",
}  # fmt: skip
__all__ = [
    "ADAPTIVE", "ATTACKS", "BUDGETS", "EARLIER", "FAMILY", "FINGERPRINT_RELIABILITY", "FREE_FORM", "FULL_WEDGE",
    "PAPER_ATTACK", "PAPER_INDOOR_ATTACK", "RELIABILITY", "SEVERITIES", "Attack", "AttackFactory", "BlackBox", "Evade",
    "Expectation", "Knowledge", "Objective", "OverClaim", "Searched", "Spoofer", "Tampered", "Trip", "UnderClaim",
    "Wedge", "WhiteBox", "at_severity",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import what attackers who adapt need when it is first used; most attacks need none of it."""
    if name not in _HOMES:
        raise AttributeError(f"module 'viewshed.attacks' has no attribute {name!r}")
    return getattr(import_module(f"viewshed.attacks.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
