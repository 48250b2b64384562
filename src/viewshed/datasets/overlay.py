"""An attacked sweep as the range image that it was made from, and what an attacker made: the same rows, bit by bit."""

from __future__ import annotations

import numpy as np

from viewshed.datasets.touched import Touched
from viewshed.sweep import Sweep

COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")
"""The columns of a sweep, points first."""
MOST_MADE = 0.5
"""Where a larger share of the rows is the attacker's, points alone are shorter."""


def made_rows(attacked: Sweep, clean: Sweep, touched: Touched) -> Sweep | None:
    """Return the rows that an attacker made, where all others are those of the clean sweep, bit by bit; else None.

    Args:
        attacked: the sweep after the attack.
        clean: the sweep before.
        touched: which rows of the attacked sweep were made, and which of the clean one are gone.
    """
    made = np.count_nonzero(touched.added)
    if made > MOST_MADE * len(attacked) or len(touched.removed) != len(clean) or len(touched.added) != len(attacked):
        return None
    for name in COLUMNS:
        one, other = getattr(attacked, name), getattr(clean, name)
        if (one is None) != (other is None):
            return None
        if one is not None and one[~touched.added].tobytes() != other[~touched.removed].tobytes():
            return None
    return attacked.select(touched.added)


def with_rows(clean: Sweep, made: Sweep, touched: Touched) -> Sweep:
    """Return the attacked sweep of :func:`made_rows`; all but its rows is that of ``made``.

    Raises:
        ValueError: the three do not fit each other.
    """
    added, kept, left = (np.flatnonzero(mask) for mask in (touched.added, ~touched.added, ~touched.removed))
    if len(touched.removed) != len(clean) or len(left) != len(kept) or len(made) != len(added):
        told = f"{len(left)} of {len(touched.removed)} and {len(added)} in {len(touched.added)}"
        raise ValueError(f"touched must leave rows of {len(clean)} and add {len(made)}, got {told}")
    columns = {}
    for name in COLUMNS:
        one, other = getattr(clean, name), getattr(made, name)
        if (one is None) != (other is None):
            raise ValueError(f"what an attacker made must have {name} where the sweep has it")
        if one is not None:
            rows = columns[name] = np.empty((len(touched.added), *one.shape[1:]), one.dtype)
            rows[kept], rows[added] = one[left], other
    return made.replace(**columns)
