"""Checks of the parameters of attacks and corruptions: one clear line for what cannot be."""

from __future__ import annotations

import numpy as np

MAX_BUDGET = 1_000_000_000
"""The largest budget; more than any wedge holds."""


def require(name: str, value: float, low: float, high: float) -> None:
    """Raise a ValueError unless ``low`` ≤ ``value`` ≤ ``high``."""
    if not low <= value <= high:
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {value}")


def require_one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    """Raise a ValueError unless ``value`` is one of ``known``."""
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}, got {value!r}")


def require_budget(budget: int | None) -> None:
    """Raise a ValueError unless ``budget`` is a whole number of returns, or None for the whole wedge."""
    if budget is None:
        return
    if isinstance(budget, bool) or not isinstance(budget, int | np.integer) or not 0 <= budget <= MAX_BUDGET:
        raise ValueError(f"budget must be a whole number of returns in [0, {MAX_BUDGET}], got {budget!r}")


def require_azimuth(azimuth: float | None) -> None:
    """Raise a ValueError unless ``azimuth`` is a finite angle, or None for one drawn anew for each sweep."""
    if azimuth is not None and not np.isfinite(azimuth):
        raise ValueError(f"azimuth must be finite, in radians, got {azimuth}")


def require_sector(budget: int | None, azimuth: float | None, sector_deg: float, widest_deg: float = 360.0) -> None:
    """Raise a ValueError unless an attacker can touch ``budget`` beams of a sector so wide about ``azimuth``."""
    require_budget(budget)
    require_azimuth(azimuth)
    require("sector_deg", sector_deg, 0.01, widest_deg)
