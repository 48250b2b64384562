"""Reports as they come in, put together round by round: what a center makes of a stream of several agents.

A round holds one report of each agent, all of about the same time. It ends with the last of the agents that were heard
lately, or when a report of another time comes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.fusion.many import LEAST_TRUST, AgentReport, CommandCenter, CommonPicture, JointFov, joint_fov
from viewshed.fusion.trust import trust_limits
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid

Mask = NDArray[np.bool_]

SLOP_S = 0.1
"""Reports farther apart in time than this are of two rounds."""

HEARD_S = 1.5
"""A round waits for agents that were heard so lately."""

MOST_AGENTS = 16
"""More agents are refused: the work of a round grows with their square."""

MOST_CELLS = 512
"""Cells along a side of a joint field of view."""

FALSE_RATE = 0.01
"""Share of benign scenes in which somebody is accused, where the limits in the box support so small a one."""


@dataclass(frozen=True, eq=False)
class Round:
    """What a center makes of the reports of one time.

    Attributes:
        picture: joint tracks, and what is believed of them and of the agents.
        accused: (A,) bool, agents that lie by the limits in the box.
        disputed: (A,) bool, agents of which one lies, and nobody knows which.
    """

    picture: CommonPicture
    accused: Mask
    disputed: Mask

    @classmethod
    def of(cls, picture: CommonPicture) -> Round:
        """Return the round of a picture, with who is accused and who is disputed."""
        return cls(picture, *judged(picture))

    @property
    def reports(self) -> tuple[AgentReport, ...]:
        """Of the agents that reported, their poses put right."""
        return self.picture.reports

    @property
    def t_ns(self) -> int:
        """Its time in nanoseconds."""
        return round(1e9 * self.picture.t_s)

    @cached_property
    def joint(self) -> JointFov:
        """The joint field of view, about the middle of the agents; each counts by how far it is trusted.

        Who is accused counts as little as one that nobody trusts, whether by its reports or by its view.
        """
        places = np.array([report.world_from_level.translation for report in self.reports])
        grids = [report.estimate.grid for report in self.reports]
        middle, extent_m = places.mean(axis=0), max(grid.half_extent_m for grid in grids)
        half_m = extent_m + float(np.abs(places - middle).max())
        grid = BevGrid(min(MOST_CELLS, round(2 * half_m / grids[0].cell_m)), half_m)
        weights = np.where(self.accused, LEAST_TRUST, self.picture.verdicts.trust)
        trust = dict(zip(self.picture.agents, weights.tolist(), strict=True))
        return joint_fov(
            [report.estimate for report in self.reports], grid, Rigid(np.eye(3), middle),
            np.array([trust[report.agent] for report in self.reports]),
        )  # fmt: skip

    def sentences(self) -> list[str]:
        """Return who is accused, and who is disputed, a sentence each; none where nobody is."""
        names = np.array(self.picture.agents)
        accused, disputed = ", ".join(names[self.accused]), ", ".join(names[self.disputed])
        lies = [f"{accused} contradicts the others: its reports count little"] if accused else []
        return lies + ([f"{disputed}: one of them lies, and no third view says which"] if disputed else [])

    def numbers(self) -> dict[str, Any]:
        """Return the numbers of the round as plain values."""
        picture, tracks, verdicts = self.picture, self.picture.tracks, self.picture.verdicts
        agents = {
            agent: {
                "trust": round(float(verdicts.trust[n]), 4), "evidence": round(float(verdicts.evidence[n]), 3),
                "suspicion": round(float(picture.suspicion[n]), 3),
                "accused": bool(self.accused[n]), "disputed": bool(self.disputed[n]),
            }
            for n, agent in enumerate(picture.agents)
        }  # fmt: skip
        objects = [
            {
                "id": int(tracks.ids[k]), "box": tracks.boxes[k].round(3).tolist(),
                "velocity_mps": tracks.states[k, 2:].round(3).tolist(),
                "existence": round(float(picture.existence[k]), 4), "believed": bool(picture.believed[k]),
                "reported_by": [picture.agents[n] for n in picture.reporters[k].nonzero()[0]],
            }
            for k in (tracks.confirmed | picture.believed).nonzero()[0]
        ]  # fmt: skip
        return {"t_s": round(picture.t_s, 6), "agents": agents, "doubt": round(verdicts.doubt, 3), "objects": objects}


def judged(picture: CommonPicture) -> tuple[Mask, Mask]:
    """Return who is accused and who is disputed (A,), at the smallest rate of the limits in the box, 1 % at least."""
    limits, verdicts = trust_limits(), picture.verdicts
    rate = max(FALSE_RATE, limits.least_rate)
    accused = limits.accused(picture.suspicion, verdicts.elevated, rate)
    return accused, limits.disputed(verdicts, accused, rate)


@dataclass(slots=True)
class Rounds:
    """Gathers reports and hands each round to a center.

    Where an agent comes in that the center does not know, the center begins anew with it: who may report is better
    named beforehand, or a liar escapes its record by another name.

    Args:
        agents: names of all that may report; others are refused. Empty where they are learned from what comes.
        slop_s: reports farther apart in time than this are of two rounds.
    """

    agents: tuple[str, ...] = ()
    slop_s: float = SLOP_S
    notes: list[str] = field(default_factory=list)
    """What was refused or begun anew since :meth:`add` was called last, a sentence each."""
    _center: CommandCenter | None = field(default=None, repr=False)
    _together: dict[str, AgentReport] = field(default_factory=dict, repr=False)
    _heard_s: dict[str, float] = field(default_factory=dict, repr=False)
    _began_s: float = field(default=0.0, repr=False)
    _last_s: float = field(default=-np.inf, repr=False)

    def add(self, t_s: float, report: AgentReport) -> list[Round]:
        """Return the rounds that a report ends: none, that before it, its own, or both."""
        self.notes = []
        if self.agents and report.agent not in self.agents:
            self.notes.append(f"{report.agent}: is none of {', '.join(self.agents)}, its report is left out")
            return []
        self._heard_s[report.agent] = t_s
        if t_s <= self._last_s or (self._together and t_s < self._began_s - self.slop_s):
            if t_s > max(self._last_s, self._began_s) - 10.0 * self.slop_s:
                self.notes.append(f"{report.agent}: its report is late and left out")
                return []
            self.notes.append("time went back: the center begins anew")
            self._center, self._together, self._last_s = None, {}, -np.inf
            self._heard_s = {report.agent: t_s}
        out = []
        if self._together and (abs(t_s - self._began_s) > self.slop_s or report.agent in self._together):
            out.append(self._end())
        if not self._together:
            self._began_s = t_s
        self._together[report.agent] = report
        # Where agents are not named, the first round ends with a report of the next one: nobody knows who is there.
        lately = {agent for agent, heard_s in self._heard_s.items() if heard_s > t_s - HEARD_S}
        is_first = self._last_s == -np.inf
        if set(self.agents) == self._together.keys() or (not is_first and lately <= self._together.keys()):
            out.append(self._end())
        return out

    def close(self) -> list[Round]:
        """Return the round that is not ended yet, if there is one."""
        return [self._end()] if self._together else []

    def _end(self) -> Round:
        reports = tuple(self._together.values())
        here = tuple(sorted(self._together))
        if self._center is None or not set(here) <= set(self._center.agents):
            known = self.agents or tuple(sorted({*here, *(() if self._center is None else self._center.agents)}))
            if len(known) > MOST_AGENTS:
                raise ValueError(f"agents must be at most {MOST_AGENTS}, got {len(known)}")
            if self._center is not None:
                self.notes.append(f"{', '.join(set(here) - set(self._center.agents))} came in: the center begins anew")
            self._center = CommandCenter(known)
        picture = self._center.add(self._began_s, reports)
        self._last_s, self._together = self._began_s, {}
        return Round.of(picture)
