"""What holds for a whole process that runs pipelines, and so is not set by the pipelines themselves."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

SWITCH_INTERVAL_S = 0.0005
"""At Python's usual 5 ms a pipeline's threads wait longer for each other than they work."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Of glibc's ``mallopt``."""

_KEPT_BYTES, _MAPPED_BYTES = 256 << 20, 32 << 20
"""Free memory that stays with the process, and the least block that comes from the system and goes back to it."""


def prepare_process() -> None:
    """Let Python's threads take turns every half millisecond, and all of them allocate from one heap that is kept.

    With a heap for each thread, memory grows by some ten megabytes as pipelines come and go: each new thread inherits a
    heap that had other work before. A heap that gives memory back after each sweep takes it page by page for the next:
    500 page faults a sweep, a tenth of its time. Where there is no glibc, heaps stay as they are.

    >>> prepare_process()
    >>> sys.getswitchinterval()
    0.0005
    """
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    if sys.platform == "linux":
        with suppress(AttributeError, OSError):
            mallopt = ctypes.CDLL(None).mallopt
            mallopt(_M_ARENA_MAX, 1)
            mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
            mallopt(_M_MMAP_THRESHOLD, _MAPPED_BYTES)
