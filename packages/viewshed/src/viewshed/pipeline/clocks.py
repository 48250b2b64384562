"""The clocks of agents: what the time of a sweep says, seen from the sweep before, and whether it is wanted."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TypeVar

from viewshed.estimators.temporal import FORGET_S

Value = TypeVar("Value")

AGENTS = 64
"""Agents of a stream; the newest is refused where there are as many, see :class:`viewshed.pipeline.inbox.Inbox`."""

UNHEARD_S = 10.0
"""An agent that was not heard for so long gives up its place in a stream."""


def remember(known: OrderedDict[str, Value], agent: str, value: Value, most: int = AGENTS) -> None:
    """Keep an agent's value, and forget the agent that was heard longest ago where there are too many."""
    known[agent] = value
    known.move_to_end(agent)
    while len(known) > most:
        known.popitem(last=False)


@dataclass(slots=True)
class Clocks:
    """The time of each agent's last sweep; a stream begins anew where estimates have forgotten what came before.

    A monitor's evidence begins anew much sooner, see :class:`viewshed.monitor.stream_monitor.RecentSweeps`.

    Attributes:
        agents: how many are remembered; of more the one that was heard longest ago is forgotten.
    """

    agents: int = AGENTS
    _last_ns: OrderedDict[str, int] = field(default_factory=OrderedDict, repr=False)

    def note(self, agent: str, t_ns: int | None) -> str:
        """Return why an agent's stream begins anew with a sweep, in a sentence; empty where it goes on.

        Raises:
            ValueError: the time is that of the sweep before.
        """
        if t_ns is None:
            return ""
        before_ns = self._last_ns.get(agent)
        remember(self._last_ns, agent, t_ns, self.agents)
        if before_ns is None:
            return ""
        apart_s = (t_ns - before_ns) / 1e9
        if apart_s == 0.0:
            raise ValueError("a sweep must have another time than the one before, got the same again")
        if apart_s < 0.0:
            return f"time went back by {-apart_s:.3g} s: the stream begins anew"
        return f"time jumped by {apart_s:.3g} s: the stream begins anew" if apart_s > FORGET_S else ""


@dataclass(slots=True)
class RateLimit:
    """Leaves out sweeps that come sooner after the one before of their agent than a rate allows.

    Attributes:
        rate_hz: sweeps of an agent that are wanted in a second of their own time; 0 for all.
    """

    rate_hz: float
    _last_ns: OrderedDict[str, int] = field(default_factory=OrderedDict, repr=False)

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
