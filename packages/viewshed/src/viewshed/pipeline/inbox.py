"""Where sweeps wait for their turn: few of each agent, the newest ones, and no agent waits longer than the others."""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable
from threading import Condition
from typing import Generic, TypeVar

from viewshed.pipeline.clocks import AGENTS, UNHEARD_S

Item = TypeVar("Item")


class Inbox(Generic[Item]):
    """A bounded queue by agent, between one thread that puts and one that takes.

    The agents take turns: next is the one that has waited longest since it was served, or since it came. An agent has a
    place from its first item on; where there is none left the new one is refused, so that a flood of names holds no
    memory and takes nobody's place.

    Args:
        waiting: items of an agent that may wait; of more the oldest is dropped and counted.
        lossless: wait for room instead of dropping: for files, which can wait.
        agents: places; one whose agent has nothing waiting, and was not heard for :data:`UNHEARD_S`, is given up.
        clock: seconds that never go back.

    Raises:
        ValueError: nothing may wait.
    """

    def __init__(
        self,
        waiting: int = 1,
        *,
        lossless: bool = False,
        agents: int = AGENTS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if waiting < 1:
            raise ValueError(f"waiting must be 1 or more, got {waiting}")
        self._waiting, self._lossless, self._agents, self._clock = waiting, lossless, agents, clock
        self._items: OrderedDict[str, deque[Item]] = OrderedDict()  # agents with something waiting, the next one first
        self._heard_s: OrderedDict[str, float] = OrderedDict()  # agents with a place, the longest unheard one first
        self._changed = Condition()
        self._closed = False
        self.dropped = 0
        """Items that were dropped for newer ones, or came after it was closed."""
        self.refused = 0
        """Items of agents that had no place."""
        self.note = ""
        """Why the newest item was refused, in a sentence."""

    def put(self, agent: str, item: Item) -> bool:
        """Add an item of an agent, and return whether it was taken; what is put after :meth:`close` is dropped."""
        with self._changed:
            if not self._has_place(agent):
                self.refused += 1
                self.note = (
                    f"a stream must have at most {self._agents} agents within {UNHEARD_S:g} s, "
                    f"got {agent[:40]!r} as one more; give it a stream of its own"
                )
                return False
            if self._lossless:
                self._changed.wait_for(lambda: self._closed or len(self._items.get(agent, ())) < self._waiting)
            if self._closed:
                self.dropped += 1
                return False
            items = self._items.setdefault(agent, deque())
            if len(items) == self._waiting:
                items.popleft()
                self.dropped += 1
            items.append(item)
            self._changed.notify_all()
            return True

    def _has_place(self, agent: str) -> bool:
        """Return whether an agent that is heard now has a place, and note when."""
        now_s = self._clock()
        if agent not in self._heard_s and len(self._heard_s) >= self._agents:
            unheard = next((name for name in self._heard_s if name not in self._items), None)
            if unheard is None or now_s - self._heard_s[unheard] < UNHEARD_S:
                return False
            del self._heard_s[unheard]
        self._heard_s[agent] = now_s
        self._heard_s.move_to_end(agent)
        return True

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
