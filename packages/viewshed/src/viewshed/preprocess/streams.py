"""State of streams of sweeps: how many agents are kept, and when the stream of an agent restarts."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TypeVar

Key = TypeVar("Key", bound=Hashable)
Memory = TypeVar("Memory")

AGENTS = 64
"""Maximum number of agents of a stream."""

FORGET_S = 10.0
"""Maximum age of an earlier sweep; older obstacles may have moved. A stream restarts after a longer gap."""


def remember(memories: dict[Key, Memory], key: Key, memory: Memory, max_agents: int = AGENTS) -> None:
    """Store the memory of an agent as the most recent one; drop the least recent agents beyond ``max_agents``."""
    memories.pop(key, None)
    memories[key] = memory
    while len(memories) > max_agents:
        del memories[next(iter(memories))]


def why_anew(before_ns: int | None, now_ns: int | None, jump_s: float) -> str:
    """Return a sentence that says why a stream restarts with a sweep; empty if it does not, or a time is unknown.

    >>> why_anew(10**9, 10**9 + 1, 0.5), why_anew(10**9, 4 * 10**9, 0.5)
    ('', 'time jumped by 3 s: the stream begins anew')
    """
    if before_ns is None or now_ns is None:
        return ""
    apart_s = (now_ns - before_ns) / 1e9
    if apart_s == 0.0:
        return "time repeats that of the sweep before: the stream begins anew"
    if apart_s < 0.0:
        return f"time went back by {-apart_s:.3g} s: the stream begins anew"
    return f"time jumped by {apart_s:.3g} s: the stream begins anew" if apart_s > jump_s else ""
