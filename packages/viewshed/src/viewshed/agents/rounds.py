"""Reports as they come in, put together round by round: what a center makes of a stream of several agents.

A round holds one report of each agent, all of about the same time by the center's clock. Clocks of agents differ: what
a clock is ahead is the most that its reports were ahead of their arrival lately, for delays only make that less, and is
taken off. A clock that is behind by no more than half of ``slop_s`` may be right and its reports delayed: it counts as
right. A longer delay that never varies looks like a clock that is behind: such a report is matched by the time that it
states where that of no open round is its own. No report gets a time after its arrival, so that whoever sets its clock
makes its own reports late and nobody else's.

A round ends with the last of the agents that were heard lately, when most of them have reported of a later time, or by
the center's clock. Who was heard lately and is not in it is *missing*: an alarm, for others can contradict a liar only
where they are heard.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from viewshed.agents.joint_fov import JointFov, joint_fov
from viewshed.agents.kinematics import Kinematics
from viewshed.agents.many import LEAST_TRUST, CommandCenter, CommonPicture
from viewshed.agents.report import FAR_M, AgentReport
from viewshed.agents.trust import QUESTIONS, trust_limits
from viewshed.arrays import Mask
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid

APART_M = 2.0 * FAR_M
"""Agents farther apart report no object in common."""

SLOP_S = 0.1
"""Reports farther apart in time than this are of two rounds."""

DELAY_S = 0.5
"""Time that a round waits, after all its reports were made, for those that are under way."""

HEARD_S = 1.5
"""A round waits for agents that were heard so lately."""

CLOCK_S = 5.0
"""How far a clock is ahead is known from the reports of this time."""

MOST_AGENTS = 16
"""More agents are refused: the work of a round grows with their square."""

SILENT_S = 10.0
"""An agent that is silent for this time gives its place to another; half of its record has faded by then."""

MOST_OPEN = 64
"""Most rounds that wait at once: an agent that reports one time again and again fills no memory."""

MOST_CELLS, COARSEST = 512, 4.0
"""Most cells along a side of a joint field of view, and how much larger they are than those of the views at most."""

WHY = {
    "reports": "its reports contradict the others",
    "opened": "its view opened at once",
    "misplaced": "its surfaces do not lie on those of others",
    "through": "it sees through surfaces of others",
    "withheld": "it no longer reports what it had reported",
}
"""What an accusation says, by the question of :data:`QUESTIONS` that speaks most against an agent."""

NO_OBJECTS = "no agent reports an object: only views can contradict each other"
"""Said of a round without objects."""

FALSE_RATE = 0.01
"""Share of benign scenes in which somebody is accused, where the shipped limits support so small a one."""


@dataclass(frozen=True, eq=False)
class Round:
    """What a center makes of the reports of one time."""

    picture: CommonPicture  # joint tracks, and what is believed of them and of the agents
    accused: Mask  # (A,) bool, agents that lie by the shipped limits
    disputed: Mask  # (A,) bool, agents of which one lies; it is unknown which
    missing: tuple[str, ...] = ()  # agents that were heard lately and have no report in the round
    # reports of each agent that were refused so far, for poses that no vehicle can have; no entry for none
    refused: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(
        cls, picture: CommonPicture, missing: tuple[str, ...] = (), refused: Mapping[str, int] | None = None
    ) -> Round:
        """Return the round of a picture, with who is accused and who is disputed."""
        return cls(picture, *judged(picture), missing, refused or {})

    @property
    def reports(self) -> tuple[AgentReport, ...]:
        """Of the agents that reported, their poses put right."""
        return self.picture.reports

    @property
    def t_ns(self) -> int:
        """Its time by the center's clock in nanoseconds."""
        return round(1e9 * self.picture.t_s)

    @cached_property
    def joint(self) -> JointFov:
        """The joint field of view, about the middle of the agents; each counts by how far it is trusted.

        Who is accused counts as little as one that nobody trusts, whether by its reports or by its view. Middle and
        size of cells are medians, and what lies too far from there is left out: one agent alone sets neither.
        """
        places = np.array([report.world_from_level.translation for report in self.reports])
        grids = [report.estimate.grid for report in self.reports]
        middle, cell_m = np.median(places, axis=0), sorted(grid.cell_m for grid in grids)[(len(grids) - 1) // 2]
        half_m = max(grid.half_extent_m for grid in grids) + float(np.abs(places - middle).max())
        half_m = min(half_m, COARSEST * MOST_CELLS * cell_m / 2)
        grid = BevGrid(min(MOST_CELLS, round(2 * half_m / cell_m)), half_m)
        weights = np.where(self.accused, LEAST_TRUST, self.picture.verdicts.trust)
        trust = dict(zip(self.picture.agents, weights.tolist(), strict=True))
        return joint_fov(
            [report.estimate for report in self.reports], grid, Rigid(np.eye(3), middle),
            np.array([trust[report.agent] for report in self.reports]),
        )  # fmt: skip

    def reasons(self) -> dict[str, str]:
        """Return what speaks most against each agent that is accused, by its name."""
        picture = self.picture
        most = trust_limits().beyond(picture.verdicts.answers, picture.elevated).argmax(axis=1)
        return {picture.agents[n]: WHY[QUESTIONS[most[n]]] for n in np.flatnonzero(self.accused).tolist()}

    def sentences(self) -> list[str]:
        """Return who is accused and why, disputed or missing, and who is alone, a sentence each; none for nobody."""
        disputed = ", ".join(np.array(self.picture.agents)[self.disputed])
        lies = [f"{agent} is accused: {why}; it counts little" for agent, why in self.reasons().items()]
        lies += [f"{disputed}: one of them lies, and no third view says which"] if disputed else []
        if self.missing:
            lies.append(f"{self._those_missing} heard lately and missing: they contradict nobody")
        return lies + self.gaps()

    def gaps(self) -> list[str]:
        """Return why nobody can contradict an agent: it is alone or far away, or no agent reports an object."""
        gaps = []
        if len(self.reports) == 1:
            gaps.append(f"{self.reports[0].agent} alone is heard: nobody contradicts it")
        elif apart := ", ".join(self._far_from_all()):
            gaps.append(f"{apart}: farther than {APART_M:g} m from all others, so that nobody contradicts it")
        return gaps if any(len(report.detections) for report in self.reports) else [*gaps, NO_OBJECTS]

    def _far_from_all(self) -> list[str]:
        """Return the agents of the round whose views overlap with nobody else's."""
        places = np.array([report.world_from_level.translation[:2] for report in self.reports]).reshape(-1, 2)
        away = np.linalg.norm(places[:, None] - places, axis=2) + np.diag(np.full(len(places), np.inf))
        far = away.min(axis=1, initial=np.inf) > APART_M
        return [report.agent for report, is_far in zip(self.reports, far, strict=True) if is_far and len(places) > 1]

    @property
    def _those_missing(self) -> str:
        """Who is missing, and how many reports of each were refused so far."""
        return ", ".join(
            f"{agent} ({self.refused[agent]} reports refused)" if self.refused.get(agent) else agent
            for agent in self.missing
        )

    def numbers(self) -> dict[str, Any]:
        """Return the numbers of the round as plain values."""
        picture, tracks, verdicts = self.picture, self.picture.tracks, self.picture.verdicts
        agents = {
            agent: {
                "trust": round(float(verdicts.trust[n]), 4), "evidence": round(float(verdicts.evidence[n]), 3),
                "accused": bool(self.accused[n]), "disputed": bool(self.disputed[n]),
                "refused": self.refused.get(agent, 0),
                "answers": dict(zip(QUESTIONS, verdicts.answers[n].round(3).tolist(), strict=True)),
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
        return {
            "t_s": round(picture.t_s, 6), "agents": agents, "missing": list(self.missing),
            "doubt": round(verdicts.doubt, 3), "objects": objects, "notes": self.sentences(),
        }  # fmt: skip


def judged(picture: CommonPicture) -> tuple[Mask, Mask]:
    """Return who is accused and who is disputed (A,), at the smallest rate of the shipped limits, 1 % at least."""
    limits, verdicts = trust_limits(), picture.verdicts
    rate = max(FALSE_RATE, limits.least_rate)
    accused = limits.accused(verdicts.answers, picture.elevated, rate)
    return accused, limits.disputed(verdicts, accused, rate)


@dataclass(slots=True)
class _Heard:
    """What is remembered of an agent that was heard."""

    since_s: float  # since when it has not been silent for :data:`HEARD_S`
    last_s: float  # when it was heard last
    # how far its reports of the last :data:`CLOCK_S` were ahead of the center's clock, and when they came
    ahead_s: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=256))
    kinematics: Kinematics = field(default_factory=Kinematics)  # of its poses

    def corrected_s(self, t_s: float, arrived_s: float, slack_s: float) -> float:
        """Return a time of its clock by the center's clock."""
        self.ahead_s.append((arrived_s, t_s - arrived_s))
        while abs(self.ahead_s[0][0] - arrived_s) > CLOCK_S:
            self.ahead_s.popleft()
        ahead_s = max(each for _, each in self.ahead_s)
        return t_s - (ahead_s if ahead_s > 0.0 else min(ahead_s + slack_s, 0.0))


@dataclass(slots=True, eq=False)
class _OpenRound:
    """Reports of one time, while more may come."""

    reports: dict[str, AgentReport] = field(default_factory=dict)  # report of each agent
    # of each agent, by the center's clock and as it states it
    times_s: list[tuple[float, float]] = field(default_factory=list)
    passed: set[str] = field(default_factory=set)  # agents of which no report of this time will come any more

    @property
    def t_s(self) -> float:
        """The median time of its reports by the center's clock: no single agent moves it far."""
        return float(np.median([t_s for t_s, _ in self.times_s]))

    @property
    def stated_s(self) -> float:
        """The median time that its agents state."""
        return float(np.median([stated_s for _, stated_s in self.times_s]))


@dataclass(slots=True)
class Rounds:
    """Gathers reports and hands each round to a center.

    At most :data:`MOST_AGENTS` agents have a place; one that is silent for :data:`SILENT_S` gives it to another that
    comes in, and begins at the prior when it returns. Named agents always have one.

    Args:
        agents: names of all that may report; others are refused. Empty where they are learned from what comes.
        slop_s: reports farther apart in time than this are of two rounds.

    Raises:
        ValueError: there are too many agents.
    """

    agents: tuple[str, ...] = ()
    slop_s: float = SLOP_S
    notes: list[str] = field(default_factory=list)
    """What was refused, left out or missing in the last call, and who came in, a sentence each."""
    _center: CommandCenter | None = field(default=None, repr=False)
    _open: list[_OpenRound] = field(default_factory=list, repr=False)
    _heard: dict[str, _Heard] = field(default_factory=dict, repr=False)
    _now_s: float = field(default=-np.inf, repr=False)
    _last_s: float = field(default=-np.inf, repr=False)
    _last_agents: tuple[str, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        if len(self.agents) > MOST_AGENTS:
            raise ValueError(
                f"agents must be at most {MOST_AGENTS}, got {len(self.agents)}; give the others a center of their own"
            )

    def add(self, t_s: float, report: AgentReport, arrived_s: float | None = None) -> list[Round]:
        """Return the rounds that a report ends: none, one, or several.

        A round that fails is left out with a note; the next ones go on.

        Args:
            t_s: time of the report by its agent's clock.
            report: of one agent.
            arrived_s: when it came, by the center's clock. None where that is not known, as in a file: all clocks
                are taken for right then.

        Raises:
            ValueError: a time is not finite.
        """
        now_s = t_s if arrived_s is None else arrived_s
        if not (np.isfinite(t_s) and np.isfinite(now_s)):
            raise ValueError(f"t_s and arrived_s must be finite, got {t_s} and {now_s}; leave the report out")
        self.notes = []
        if now_s < self._now_s - 10.0 * self.slop_s:
            self.notes.append("time went back: the center begins anew")
            self._center, self._open, self._heard, self._now_s = None, [], {}, -np.inf
            self._last_s, self._last_agents = -np.inf, ()
        self._now_s = max(self._now_s, now_s)
        out = self._ended()
        heard = self._place_of(report.agent)
        if heard is not None:
            corrected_s = heard.corrected_s(t_s, now_s, self.slop_s / 2)
            if self._is_possible(t_s, now_s, report):
                self._gather(corrected_s, t_s, report)
            else:
                for each in self._open:
                    each.passed |= {report.agent} if abs(each.t_s - corrected_s) <= self.slop_s else set()
        return out + self._ended()

    def together(self, t_s: float, reports: Sequence[AgentReport]) -> Round | None:
        """Return the round of reports that are of one time already; None where none is taken, or it fails.

        Args:
            t_s: their time, later than that of all before.
            reports: one of each agent.
        """
        self.notes, self._now_s = [], max(self._now_s, t_s)
        possible = {
            report.agent: report
            for report in reports
            if self._place_of(report.agent) is not None and self._is_possible(t_s, t_s, report)
        }
        return self._end(_OpenRound(possible, [(t_s, t_s)])) if possible else None

    def close(self, now_s: float | None = None) -> list[Round]:
        """Return rounds that no report has ended yet.

        Args:
            now_s: the center's clock: those that need not wait any longer. None: all of them.
        """
        self.notes = []
        if now_s is not None:
            self._now_s = max(self._now_s, now_s)
            return self._ended()
        rest, self._open = self._open, []
        return [done for each in rest if (done := self._end(each)) is not None]

    def _place_of(self, agent: str) -> _Heard | None:
        """Return what is remembered of an agent that is heard now; None where it has no place, with a note."""
        if self.agents and agent not in self.agents:
            self.notes.append(f"{agent}: is none of {', '.join(self.agents)}, its report is left out")
            return None
        heard = self._heard.get(agent)
        if heard is None:
            if len(self._heard) >= MOST_AGENTS:
                longest = min(self._heard, key=lambda name: self._heard[name].last_s)
                if self._now_s - self._heard[longest].last_s < SILENT_S:
                    self.notes.append(
                        f"{agent}: agents must be at most {MOST_AGENTS}, got one more; its report is left out until one"
                        f" of them is silent for {SILENT_S:g} s; give it a center of its own"
                    )
                    return None
                del self._heard[longest]
                self.notes.append(f"{longest}: was silent for {SILENT_S:g} s, {agent} has its place")
            heard = self._heard[agent] = _Heard(self._now_s, self._now_s)
        if self._now_s - heard.last_s >= HEARD_S:
            heard.since_s = self._now_s
        heard.last_s = self._now_s
        return heard

    def _is_possible(self, t_s: float, now_s: float, report: AgentReport) -> bool:
        """Return whether a vehicle can have the pose of a report; a note where not."""
        problem = self._heard[report.agent].kinematics.problem_of(t_s, now_s, report)
        if problem is not None:
            self.notes.append(f"{report.agent}: {problem}; its report is left out")
        return problem is None

    def _gather(self, t_s: float, stated_s: float, report: AgentReport) -> None:
        """Take a report into the open round of its time, or else of its stated time, or open a round."""
        chosen = self._nearest(report.agent, t_s, stated=False)
        # Clocks that seem to be behind may be right, and their reports delayed.
        if chosen is None and stated_s < t_s:
            chosen = self._nearest(report.agent, stated_s, stated=True)
            t_s = t_s if chosen is None else chosen.t_s
        if chosen is None:
            # Of the last round as well, where the agent was missing in it.
            if t_s <= self._last_s + (0.0 if report.agent in self._last_agents else self.slop_s / 2):
                self.notes.append(f"{report.agent}: its report is late and left out")
                return
            chosen = _OpenRound()
            self._open.append(chosen)
        chosen.reports[report.agent] = report
        chosen.times_s.append((t_s, min(stated_s, t_s)))
        self._open.sort(key=lambda each: each.t_s)
        # Reports of one agent come in order.
        for each in self._open[: self._open.index(chosen)]:
            each.passed.add(report.agent)

    def _nearest(self, agent: str, t_s: float, *, stated: bool) -> _OpenRound | None:
        """Return the nearest open round within the slop that an agent is not in, the fullest of those about as near.

        So an agent that reports often, and opens rounds, draws no others into them. How near a round is says its
        nearest report: the median of two, of which one agent sets one, would set apart who reports of one time.
        """

        def apart_s(each: _OpenRound) -> float:
            return abs((each.stated_s if stated else each.t_s) - t_s)

        def order(each: _OpenRound) -> tuple[float, int, float]:
            nearest_s = min(abs(times_s[stated] - t_s) for times_s in each.times_s)
            return max(nearest_s, self.slop_s / 2), -len(each.reports), apart_s(each)

        fitting = [each for each in self._open if agent not in each.reports and apart_s(each) <= self.slop_s]
        return min(fitting, key=order, default=None)

    def _ended(self) -> list[Round]:
        """Return the open rounds, one after the other, that wait for nobody any more."""
        out = []
        while self._open and not self._waits(self._open[0]):
            done = self._end(self._open.pop(0))
            if done is not None:
                out.append(done)
        return out

    def _waits(self, first: _OpenRound) -> bool:
        """Return whether the first of the open rounds waits for more reports."""
        if self._now_s > first.t_s + self.slop_s + DELAY_S or len(self._open) > MOST_OPEN:
            return False
        if set(self.agents) == first.reports.keys():
            return False
        # Where agents are not named, the first round ends with a report of the next one: it is unknown who is there.
        if self._last_s == -np.inf and len(self._open) == 1:
            return True
        live = {agent for agent, heard in self._heard.items() if self._now_s < heard.last_s + HEARD_S}
        later = {agent for each in self._open[1:] for agent in each.reports}
        if 2 * len(live & later) > len(live):
            return False
        return not live <= first.reports.keys() | first.passed

    def _end(self, gathered: _OpenRound) -> Round | None:
        """Return a round; None where it fails, which costs nothing but this round."""
        self._last_s, self._last_agents = max(gathered.t_s, self._last_s + 1e-3), tuple(gathered.reports)
        missing = tuple(
            sorted(
                agent for agent, heard in self._heard.items()
                if agent not in gathered.reports and heard.since_s < self._last_s < heard.last_s + HEARD_S
            )
        )  # fmt: skip
        if missing:
            self.notes.append(
                f"{', '.join(missing)}: heard lately and missing at {self._last_s:.2f} s; check clocks and links"
            )
        try:
            center = self._center_with(gathered.reports)
            picture = center.add(self._last_s, list(gathered.reports.values()))
            refused = {agent: heard.kinematics.refused for agent, heard in self._heard.items()}
            return Round.of(picture, missing, {agent: count for agent, count in refused.items() if count})
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
            self.notes.append(f"the round of {self._last_s:.2f} s fails and is left out: {problem}")
            return None

    def _center_with(self, here: Mapping[str, object]) -> CommandCenter:
        """Return the center, with those who came in and without those who gave up their places."""
        if self._center is None:
            self._center = CommandCenter(self.agents or tuple(sorted(here)))
        known = self._center.agents
        new = tuple(sorted(here.keys() - set(known)))
        stay = tuple(agent for agent in known if self.agents or agent in self._heard)
        if (*stay, *new) != known:
            self._center.regroup((*stay, *new))
        if new:
            self.notes.append(f"{', '.join(new)} came in: at the prior, the others keep their records")
        return self._center
