"""Which sweeps are wanted, and where they wait for their turn: few of each agent, and none waits longer than others."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, field
from threading import Condition
from typing import Generic, TypeVar

from viewshed.preprocess.streams import remember

Item = TypeVar("Item")


class Inbox(Generic[Item]):
    """A bounded queue by agent, between one thread that puts and one that takes.

    The agents take turns: next is the one that has waited longest since it was served, or since it came.

    Args:
        waiting: items of an agent that may wait; of more the oldest is dropped and counted.
        lossless: wait for room instead of dropping: for files, which can wait.

    Raises:
        ValueError: nothing may wait.
    """

    def __init__(self, waiting: int = 1, *, lossless: bool = False) -> None:
        if waiting < 1:
            raise ValueError(f"waiting must be 1 or more, got {waiting}")
        self._waiting, self._lossless = waiting, lossless
        self._items: OrderedDict[str, deque[Item]] = OrderedDict()  # agents with something waiting, the next one first
        self._changed = Condition()
        self._closed = False
        self.dropped = 0
        """Items that were dropped for newer ones, or came after it was closed."""

    def __contains__(self, agent: object) -> bool:
        """Return whether an agent has something waiting."""
        return agent in self._items

    def put(self, agent: str, item: Item) -> None:
        """Add an item of an agent; what is put after :meth:`close` is dropped."""
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
        """Wait for the next item and return it; None when the inbox was closed and is empty."""
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
        """Take nothing more; what waits is still handed out."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


@dataclass(slots=True)
class RateLimit:
    """Leaves out sweeps that come sooner after the one before of their agent than a rate allows."""

    rate_hz: float  # sweeps of an agent that are wanted in a second of their own time; 0 for all
    _last_ns: dict[str, int] = field(default_factory=dict, repr=False)

    def takes(self, agent: str, t_ns: int | None) -> bool:
        """Return whether a sweep is wanted; one without a time is, and so is one whose time goes back."""
        if t_ns is None:
            return True
        # A tenth sooner is no sooner: sensors do not keep time to the microsecond.
        least_ns = 0.9e9 / self.rate_hz if self.rate_hz else 0.0
        before_ns = self._last_ns.get(agent)
        if before_ns is not None and 0 < t_ns - before_ns < least_ns:
            return False
        remember(self._last_ns, agent, t_ns)
        return True
