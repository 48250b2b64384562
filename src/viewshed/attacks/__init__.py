"""Attacks on a sweep: the table, the role, and the record of what was touched."""

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

__all__ = [
    "ATTACKS", "BUDGETS", "EARLIER", "FAMILY", "FINGERPRINT_RELIABILITY", "FREE_FORM", "FULL_WEDGE", "PAPER_ATTACK",
    "PAPER_INDOOR_ATTACK", "RELIABILITY", "SEVERITIES", "Attack", "AttackFactory", "Knowledge", "Spoofer", "Tampered",
    "Wedge", "at_severity",
]  # fmt: skip
