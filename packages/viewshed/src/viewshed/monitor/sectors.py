"""Where: the sectors of azimuth that are suspect, at a chosen rate of false discoveries.

Each sector has a p-value among all sectors of benign scenes. A step-up test takes as many of the smallest as keep
the expected share of false ones among those taken at the chosen rate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def discoveries(p: ArrayLike, rate: float) -> NDArray[np.bool_]:
    """Return the mask (K,) of the p-values (K,) that are discoveries at a false-discovery rate.

    The rate holds if the sectors are independent or rise together (Benjamini and Hochberg, 1995), as neighbors do.

    Args:
        p: p-values; those of sectors that say nothing are 1.
        rate: expected share of false discoveries among all, in (0, 1).

    Raises:
        ValueError: a p-value or the rate lies outside its range.

    >>> discoveries([0.01, 0.2, 0.02, 0.9], 0.1)
    array([ True, False,  True, False])
    """
    values = np.asarray(p, np.float64)
    if not 0.0 < rate < 1.0:
        raise ValueError(f"a false-discovery rate must lie in (0, 1), got {rate}")
    if values.ndim != 1 or not ((values >= 0.0) & (values <= 1.0)).all():
        raise ValueError(f"p-values must be one row in [0, 1], got shape {values.shape}")
    ranks = np.arange(1, len(values) + 1)
    levels = rate * ranks / max(len(values), 1)
    passed = np.flatnonzero(np.sort(values) <= levels + 1e-12)
    largest = np.sort(values)[passed[-1]] if passed.size else -1.0
    found: NDArray[np.bool_] = values <= largest
    return found
