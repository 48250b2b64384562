"""Memory that arrays give back stays with the process, so that the next sweep need not ask for it page by page."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_LARGEST = (32 << 20) - (64 << 10)
"""The GNU allocator keeps up to twice what one array of at most 32 MiB gave back; it begins with 128 KiB."""


@lru_cache(maxsize=1)
def keep_freed() -> None:
    """Raise what the allocator keeps of freed memory to 64 MiB: one large array comes and goes, untouched.

    Without it each sweep of 100,000 points and more pays for about 1,500 fresh pages. Other allocators do not care.
    """
    np.empty(_LARGEST, np.uint8)
