"""Settings of a process that runs pipelines; an application sets them, pipelines do not."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

SWITCH_INTERVAL_S = 0.0005
"""With Python's default of 5 ms a pipeline's threads wait longer for each other than they work."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Parameters of glibc's ``mallopt``."""

_KEPT_BYTES, _MAPPED_BYTES = 256 << 20, 32 << 20
"""Free memory kept by the process, and the minimum size of blocks that are mapped and unmapped individually."""


def prepare_process() -> None:
    """Set Python's switch interval to 0.5 ms, and make glibc use a single heap that keeps its memory.

    With one heap per thread, memory grows by some ten megabytes as pipelines start and stop, because each new thread
    inherits a heap that served other work. A heap that returns memory after each sweep costs 500 page faults a sweep, a
    tenth of its time. Without glibc, heaps are not changed.

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
