"""What holds of every stream of sweeps: how many agents are remembered, and when the stream of one begins anew."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TypeVar

Key = TypeVar("Key", bound=Hashable)
Memory = TypeVar("Memory")

AGENTS = 64
"""Agents that a stream remembers."""

FORGET_S = 10.0
"""Sweeps from longer before do not help: who stood there has gone. A stream without a sweep for longer begins anew."""


def remember(known: dict[Key, Memory], key: Key, memory: Memory, most: int = AGENTS) -> None:
    """Keep what is remembered of an agent, and forget the agents heard longest ago where there are too many."""
    known.pop(key, None)
    known[key] = memory
    while len(known) > most:
        del known[next(iter(known))]


def why_anew(before_ns: int | None, now_ns: int | None, jump_s: float) -> str:
    """Return why a stream begins anew with a sweep, in a sentence; empty where it goes on, or a time is not known.

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
