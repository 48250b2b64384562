"""What holds for a whole process that runs pipelines, and so is not set by the pipelines themselves."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

SWITCH_INTERVAL_S = 0.0005
"""At Python's usual 5 ms a pipeline's threads wait longer for each other than they work."""

_M_ARENA_MAX = -8
"""Of glibc's ``mallopt``."""


def prepare_process() -> None:
    """Let Python's threads take turns every half millisecond, and all of them allocate from one heap.

    With a heap for each thread, memory grows by some ten megabytes as pipelines come and go: each new thread inherits a
    heap that had other work before. Where there is no glibc, heaps stay as they are.

    >>> prepare_process()
    >>> sys.getswitchinterval()
    0.0005
    """
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    if sys.platform == "linux":
        with suppress(AttributeError, OSError):
            ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
