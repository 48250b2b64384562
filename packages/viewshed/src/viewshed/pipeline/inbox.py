"""Bounded, fair queue of sweeps by agent, and a rate limit."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from threading import Condition
from typing import Generic, TypeVar

from viewshed.preprocess.streams import remember

Item = TypeVar("Item")


class Inbox(Generic[Item]):
    """A bounded queue for each agent, between one producer thread and one consumer thread.

    Round robin: next is the agent that has waited longest since it was served, or since its first item.

    Args:
        waiting: queue size of each agent; beyond it the oldest item is dropped and counted.
        lossless: block :meth:`put` instead of dropping; for files.

    Raises:
        ValueError: ``waiting`` is below 1.
    """

    def __init__(self, waiting: int = 1, *, lossless: bool = False) -> None:
        if waiting < 1:
            raise ValueError(f"waiting must be 1 or more, got {waiting}")
        self._waiting, self._lossless = waiting, lossless
        self._items: OrderedDict[str, deque[Item]] = OrderedDict()  # queues that are not empty, the next one first
        self._changed = Condition()
        self._closed = False
        self.dropped = 0
        """Number of items replaced by newer ones, or put after :meth:`close`."""

    def __contains__(self, agent: object) -> bool:
        """Return whether an agent has queued items."""
        return agent in self._items

    def put(self, agent: str, item: Item) -> None:
        """Add an item of an agent; items put after :meth:`close` are dropped."""
        with self._changed:
            if self._lossless:
                self._changed.wait_for(lambda: self._closed or len(self._items.get(agent, ())) < self._waiting)
            if self._closed:
                self.dropped += 1
                return
            items = self._items.setdefault(agent, deque())
            if len(items) == self._waiting:
                items.popleft()
                self.dropped += 1
            items.append(item)
            self._changed.notify_all()

    def take(self) -> Item | None:
        """Wait for the next item and return it; None once the inbox is closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._items)
            if not self._items:
                return None
            agent, items = next(iter(self._items.items()))
            item = items.popleft()
            self._items.move_to_end(agent)
            if not items:
                del self._items[agent]
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Accept no more items; queued ones can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


@dataclass(slots=True)
class RateLimit:
    """Drops sweeps that exceed a rate for their agent."""

    rate_hz: float  # maximum sweeps of an agent per second of their own time stamps; 0 for all
    _last_ns: dict[str, int] = field(default_factory=dict, repr=False)

    def takes(self, agent: str, t_ns: int | None) -> bool:
        """Return whether to keep a sweep; always if it has no time or its time goes back."""
        if t_ns is None:
            return True
        # Tolerance of 10 % for jitter of the sensor's period.
        min_gap_ns = 0.9e9 / self.rate_hz if self.rate_hz else 0.0
        before_ns = self._last_ns.get(agent)
        if before_ns is not None and 0 < t_ns - before_ns < min_gap_ns:
            return False
        remember(self._last_ns, agent, t_ns)
        return True
