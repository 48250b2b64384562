"""The clocks of agents: what the time of a sweep says, seen from the sweep before."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

from viewshed.estimators.temporal import FORGET_S


@dataclass(slots=True)
class Clocks:
    """The time of each agent's last sweep; a stream begins anew where estimates have forgotten what came before.

    A monitor's evidence begins anew much sooner, see :class:`viewshed.integrity.stream_monitor.RecentSweeps`.

    Attributes:
        agents: how many are remembered; of more the one that was heard longest ago is forgotten.
    """

    agents: int = 64
    _last_ns: OrderedDict[str, int] = field(default_factory=OrderedDict, repr=False)

    def note(self, agent: str, t_ns: int | None) -> str:
        """Return why an agent's stream begins anew with a sweep, in a sentence; empty where it goes on.

        Raises:
            ValueError: the time is that of the sweep before.
        """
        if t_ns is None:
            return ""
        before_ns = self._last_ns.pop(agent, None)
        self._last_ns[agent] = t_ns
        while len(self._last_ns) > self.agents:
            self._last_ns.popitem(last=False)
        if before_ns is None:
            return ""
        apart_s = (t_ns - before_ns) / 1e9
        if apart_s == 0.0:
            raise ValueError("a sweep must have another time than the one before, got the same again")
        if apart_s < 0.0:
            return f"time went back by {-apart_s:.3g} s: the stream begins anew"
        return f"time jumped by {apart_s:.3g} s: the stream begins anew" if apart_s > FORGET_S else ""
