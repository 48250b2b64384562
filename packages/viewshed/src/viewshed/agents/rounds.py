"""Group incoming reports of several agents into rounds, and fuse each round in a command center.

A round holds at most one report of each agent, all of about the same time by the center's clock. Each agent's clock
offset is estimated as the largest lead of its recent time stamps over their arrival (network delay only shrinks the
lead), and subtracted. A clock behind by at most half of ``slop_s`` is taken as right, because the reports may be
delayed. A longer, constant delay looks like a clock that is behind: if no open round matches the corrected time of a
report, it is matched by its stated time. A corrected time is never later than the arrival, so that an agent with a
manipulated clock makes only its own reports late.

A round ends when all live agents have reported, when most of them have reported a later time, or by timeout. A live
agent without a report in it is *missing*, which is an alarm: others can expose a liar only if their reports arrive.
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
from viewshed.agents.many import MIN_TRUST, CommandCenter, CommonPicture
from viewshed.agents.report import FAR_M, AgentReport
from viewshed.agents.trust import QUESTIONS, trust_limits
from viewshed.arrays import Mask
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid

APART_M = 2.0 * FAR_M
"""Agents farther apart than this report no common object."""

SLOP_S = 0.1
"""Reports whose times differ by more than this belong to different rounds."""

DELAY_S = 0.5
"""Timeout of a round in seconds, after its slop, for reports still in transit."""

HEARD_S = 1.5
"""An agent is live for this time after its last report; a round waits for live agents."""

CLOCK_S = 5.0
"""Window of reports in seconds from which a clock offset is estimated."""

MAX_AGENTS = 16
"""Maximum number of agents; more are refused, because the work of a round grows with their square."""

MIN_GRID_M, MAX_GRID_M = 1.0, 10_000.0
"""Smallest half extent of a view's grid, and largest; places are compared in float32."""

SILENT_S = 10.0
"""An agent silent for this time may lose its place to another; half of its record has faded by then."""

MAX_OPEN = 64
"""Maximum number of open rounds, so that an agent that repeats one time cannot fill the memory."""

MAX_CELLS, MAX_COARSENING = 512, 4.0
"""Maximum number of cells per side of the joint field of view, and of their size relative to the views' cells."""

WHY = {
    "reports": "its reports contradict the others",
    "opened": "its visible area grew suddenly",
    "misplaced": "its surfaces do not match those of others",
    "through": "it sees through surfaces of others",
    "withheld": "it no longer reports objects that it reported before",
}
"""Text of an accusation, by the question of :data:`QUESTIONS` whose answer speaks most against the agent."""

NO_OBJECTS = "no agent reports an object: only views can contradict each other"
"""Note of a round without objects."""

FALSE_RATE = 0.01
"""Share of benign scenes with a false accusation, if the shipped limits support so small a share."""


@dataclass(frozen=True, eq=False)
class Round:
    """Joint picture and verdicts from the reports of one time."""

    picture: CommonPicture  # joint tracks, their existence, and the trust in the agents
    accused: Mask  # (A,) bool, agents that lie, by the shipped limits
    disputed: Mask  # (A,) bool, agents of which one lies, but it is unknown which
    missing: tuple[str, ...] = ()  # live agents without a report in the round
    # reports of each agent refused so far for an impossible pose; agents without any are left out
    refused: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(
        cls, picture: CommonPicture, missing: tuple[str, ...] = (), refused: Mapping[str, int] | None = None
    ) -> Round:
        """Return the round of a picture, with the accused and the disputed agents."""
        return cls(picture, *judged(picture), missing, refused or {})

    @property
    def reports(self) -> tuple[AgentReport, ...]:
        """Reports of the agents that reported, with corrected poses."""
        return self.picture.reports

    @property
    def t_ns(self) -> int:
        """Time by the center's clock in nanoseconds."""
        return round(1e9 * self.picture.t_s)

    @cached_property
    def joint(self) -> JointFov:
        """Joint field of view, centered on the agents; each agent is weighted by its trust.

        An accused agent gets the minimum weight. Center and cell size are medians and the extent is bounded, so that no
        single agent determines the grid.
        """
        places = np.array([report.world_from_level.translation for report in self.reports])
        grids = [report.estimate.grid for report in self.reports]
        center, cell_m = np.median(places, axis=0), sorted(grid.cell_m for grid in grids)[(len(grids) - 1) // 2]
        half_m = max(grid.half_extent_m for grid in grids) + float(np.abs(places - center).max())
        half_m = min(half_m, MAX_COARSENING * MAX_CELLS * cell_m / 2)
        grid = BevGrid(min(MAX_CELLS, round(2 * half_m / cell_m)), half_m)
        weights = np.where(self.accused, MIN_TRUST, self.picture.verdicts.trust)
        trust = dict(zip(self.picture.agents, weights.tolist(), strict=True))
        return joint_fov(
            [report.estimate for report in self.reports], grid, Rigid(np.eye(3), center),
            np.array([trust[report.agent] for report in self.reports]),
        )  # fmt: skip

    def reasons(self) -> dict[str, str]:
        """Return for each accused agent, by name, the reason that speaks most against it."""
        picture = self.picture
        reason = trust_limits().beyond(picture.verdicts.answers, picture.elevated).argmax(axis=1)
        return {picture.agents[n]: WHY[QUESTIONS[reason[n]]] for n in np.flatnonzero(self.accused).tolist()}

    def sentences(self) -> list[str]:
        """Return sentences on accused, disputed and missing agents and on gaps; empty if there are none."""
        disputed = ", ".join(np.array(self.picture.agents)[self.disputed])
        sentences = [f"{agent} is accused: {why}; its reports count little" for agent, why in self.reasons().items()]
        sentences += [f"{disputed}: one of them lies, and no third view says which"] if disputed else []
        if self.missing:
            sentences.append(f"{self._missing_text} heard recently, missing now: they contradict nobody")
        return sentences + self.gaps()

    def gaps(self) -> list[str]:
        """Return sentences on agents that no one can contradict: alone, far away, or without any reported object."""
        gaps = []
        if len(self.reports) == 1:
            gaps.append(f"{self.reports[0].agent} alone is heard: nobody contradicts it")
        elif far_agents := ", ".join(self._far_from_all()):
            gaps.append(f"{far_agents}: farther than {APART_M:g} m from all others, so that nobody contradicts it")
        return gaps if any(len(report.detections) for report in self.reports) else [*gaps, NO_OBJECTS]

    def _far_from_all(self) -> list[str]:
        """Return the agents of the round whose view overlaps with no other."""
        places = np.array([report.world_from_level.translation[:2] for report in self.reports]).reshape(-1, 2)
        distance_m = np.linalg.norm(places[:, None] - places, axis=2) + np.diag(np.full(len(places), np.inf))
        is_far = distance_m.min(axis=1, initial=np.inf) > APART_M
        return [report.agent for report, far in zip(self.reports, is_far, strict=True) if far and len(places) > 1]

    @property
    def _missing_text(self) -> str:
        """Missing agents, each with the number of its reports refused so far."""
        return ", ".join(
            f"{agent} ({self.refused[agent]} reports refused)" if self.refused.get(agent) else agent
            for agent in self.missing
        )

    def numbers(self) -> dict[str, Any]:
        """Return the numbers of the round as plain (JSON) values."""
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
    """Return masks (A,) of accused and disputed agents, at the smallest supported false-alarm rate, 1 % at least."""
    limits, verdicts = trust_limits(), picture.verdicts
    rate = max(FALSE_RATE, limits.least_rate)
    accused = limits.accused(verdicts.answers, picture.elevated, rate)
    return accused, limits.disputed(verdicts, accused, rate)


@dataclass(slots=True)
class _AgentState:
    """State of an agent that has reported."""

    since_s: float  # since when it has been live without a gap of :data:`HEARD_S`
    last_s: float  # time of its last report
    # (arrival, lead of the time stamp over it) of its reports of the last :data:`CLOCK_S`
    ahead_s: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=256))
    kinematics: Kinematics = field(default_factory=Kinematics)  # check of its poses

    def corrected_s(self, t_s: float, arrived_s: float, slack_s: float) -> float:
        """Return a time of the agent's clock by the center's clock."""
        self.ahead_s.append((arrived_s, t_s - arrived_s))
        while abs(self.ahead_s[0][0] - arrived_s) > CLOCK_S:
            self.ahead_s.popleft()
        ahead_s = max(lead_s for _, lead_s in self.ahead_s)
        return t_s - (ahead_s if ahead_s > 0.0 else min(ahead_s + slack_s, 0.0))


@dataclass(slots=True, eq=False)
class _OpenRound:
    """Reports of one time that is still open."""

    reports: dict[str, AgentReport] = field(default_factory=dict)  # by agent
    # (time by the center's clock, stated time) of each report
    times_s: list[tuple[float, float]] = field(default_factory=list)
    passed: set[str] = field(default_factory=set)  # agents that will send no more reports of this time

    @property
    def t_s(self) -> float:
        """Median time of its reports by the center's clock; no single agent moves it far."""
        return float(np.median([t_s for t_s, _ in self.times_s]))

    @property
    def stated_s(self) -> float:
        """Median of the times that the agents state."""
        return float(np.median([stated_s for _, stated_s in self.times_s]))


@dataclass(slots=True)
class Rounds:
    """Groups reports into rounds and gives each round to a command center.

    At most :data:`MAX_AGENTS` agents have a place. An agent silent for :data:`SILENT_S` may lose it to a new one, and
    begins at the prior when it returns. Named agents keep their places.

    Args:
        agents: names of all agents that may report, others are refused; empty accepts whoever reports.
        slop_s: reports whose times differ by more than this belong to different rounds.

    Raises:
        ValueError: there are too many agents.
    """

    agents: tuple[str, ...] = ()
    slop_s: float = SLOP_S
    notes: list[str] = field(default_factory=list)
    """Notes of the last call, one sentence each: reports refused or left out, agents missing or new."""
    _center: CommandCenter | None = field(default=None, repr=False)
    _open: list[_OpenRound] = field(default_factory=list, repr=False)
    _states: dict[str, _AgentState] = field(default_factory=dict, repr=False)
    # (agent, whether its time went back) of the last reports
    _recent: deque[tuple[str, bool]] = field(default_factory=lambda: deque(maxlen=2 * MAX_AGENTS), repr=False)
    _now_s: float = field(default=-np.inf, repr=False)
    _last_s: float = field(default=-np.inf, repr=False)
    _last_agents: tuple[str, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        if len(self.agents) > MAX_AGENTS:
            raise ValueError(
                f"agents must be at most {MAX_AGENTS}, got {len(self.agents)}; give the others a center of their own"
            )

    def add(self, t_s: float, report: AgentReport, arrived_s: float | None = None) -> list[Round]:
        """Add a report and return the rounds that it ends: none, one, or several.

        A round that fails is left out with a note; later rounds are not affected.

        Args:
            t_s: time of the report by its agent's clock.
            report: of one agent.
            arrived_s: arrival time by the center's clock; None if unknown, as in a file: all clocks are then taken as
                right.

        Raises:
            ValueError: a time is not finite.
        """
        now_s = t_s if arrived_s is None else arrived_s
        if not (np.isfinite(t_s) and np.isfinite(now_s)):
            raise ValueError(f"t_s and arrived_s must be finite, got {t_s} and {now_s}; leave the report out")
        self.notes = []
        went_back = now_s < self._now_s - 10.0 * self.slop_s
        self._recent.append((report.agent, went_back))
        if went_back:
            # Without times of arrival it may be one clock that is off: a new recording is one for most agents.
            back = dict(list(self._recent)[-2 * max(len(self._states), 1) :]).values()
            if arrived_s is None and 2 * sum(back) <= len(back):
                self.notes.append(f"{report.agent}: its time went back, that of others did not; its report is left out")
                return self._ended()
            self.notes.append("time went back: the center starts over")
            self._center, self._open, self._states, self._now_s = None, [], {}, -np.inf
            self._last_s, self._last_agents = -np.inf, ()
            self._recent.clear()
        self._now_s = max(self._now_s, now_s)
        ended = self._ended()
        state = self._place_of(report.agent)
        if state is not None:
            corrected_s = state.corrected_s(t_s, now_s, self.slop_s / 2)
            if self._is_possible(t_s, now_s, report):
                self._gather(corrected_s, t_s, report)
            else:
                for open_round in self._open:
                    open_round.passed |= {report.agent} if abs(open_round.t_s - corrected_s) <= self.slop_s else set()
        return ended + self._ended()

    def together(self, t_s: float, reports: Sequence[AgentReport]) -> Round | None:
        """Return the round of reports known to be of one time; None if all are refused, or if the round fails.

        Args:
            t_s: their time, later than that of all earlier rounds.
            reports: at most one of each agent.
        """
        self.notes, self._now_s = [], max(self._now_s, t_s)
        possible = {
            report.agent: report
            for report in reports
            if self._place_of(report.agent) is not None and self._is_possible(t_s, t_s, report)
        }
        return self._end(_OpenRound(possible, [(t_s, t_s)])) if possible else None

    def close(self, now_s: float | None = None) -> list[Round]:
        """Return the rounds that no report has ended yet.

        Args:
            now_s: the center's clock, to end only the rounds whose timeout has passed; None ends all of them.
        """
        self.notes = []
        if now_s is not None:
            self._now_s = max(self._now_s, now_s)
            return self._ended()
        open_rounds, self._open = self._open, []
        return [finished for open_round in open_rounds if (finished := self._end(open_round)) is not None]

    def _place_of(self, agent: str) -> _AgentState | None:
        """Return the state of an agent that reports now; None, with a note, if it has no place."""
        if self.agents and agent not in self.agents:
            self.notes.append(f"{agent}: is not one of {', '.join(self.agents)}, its report is left out")
            return None
        state = self._states.get(agent)
        if state is None:
            if len(self._states) >= MAX_AGENTS:
                longest_silent = min(self._states, key=lambda name: self._states[name].last_s)
                if self._now_s - self._states[longest_silent].last_s < SILENT_S:
                    self.notes.append(
                        f"{agent}: agents must be at most {MAX_AGENTS}, got one more; its report is left out until one"
                        f" of them is silent for {SILENT_S:g} s; give it a center of its own"
                    )
                    return None
                del self._states[longest_silent]
                self.notes.append(f"{longest_silent}: was silent for {SILENT_S:g} s, {agent} takes its place")
            state = self._states[agent] = _AgentState(self._now_s, self._now_s)
        if self._now_s - state.last_s >= HEARD_S:
            state.since_s = self._now_s
        state.last_s = self._now_s
        return state

    def _is_possible(self, t_s: float, now_s: float, report: AgentReport) -> bool:
        """Return whether a vehicle can have the pose of a report; if not, add a note."""
        problem, grid = None, report.estimate.grid
        if grid.half_extent_m < MIN_GRID_M or max(grid.half_extent_m, *map(abs, grid.offset_m)) > MAX_GRID_M:
            problem = f"its grid must reach {MIN_GRID_M:g} to {MAX_GRID_M:g} m, got {grid.half_extent_m:g} m"
        problem = problem or self._states[report.agent].kinematics.problem_of(t_s, now_s, report)
        if problem is not None:
            self.notes.append(f"{report.agent}: {problem}; its report is left out")
        return problem is None

    def _gather(self, t_s: float, stated_s: float, report: AgentReport) -> None:
        """Add a report to the open round of its corrected time, else of its stated time, else to a new round."""
        target = self._nearest(report.agent, t_s, stated=False)
        # A clock that seems to be behind may be right and its reports delayed.
        if target is None and stated_s < t_s:
            target = self._nearest(report.agent, stated_s, stated=True)
            t_s = t_s if target is None else target.t_s
        if target is None:
            # A report up to half the slop after the last round belongs to it, if the agent was missing there.
            if t_s <= self._last_s + (0.0 if report.agent in self._last_agents else self.slop_s / 2):
                self.notes.append(f"{report.agent}: its report is late and left out")
                return
            target = _OpenRound()
            self._open.append(target)
        target.reports[report.agent] = report
        target.times_s.append((t_s, min(stated_s, t_s)))
        self._open.sort(key=lambda each: each.t_s)
        # Reports of one agent arrive in order: it will send none for earlier rounds.
        for open_round in self._open[: self._open.index(target)]:
            open_round.passed.add(report.agent)

    def _nearest(self, agent: str, t_s: float, *, stated: bool) -> _OpenRound | None:
        """Return the nearest open round within the slop that lacks an agent; of those about as near, the fullest.

        So an agent that reports often, and opens many rounds, draws no others into them. Nearness is to the nearest
        report of a round: one agent could move the median of two reports and so split honest agents.
        """

        def apart_s(open_round: _OpenRound) -> float:
            return abs((open_round.stated_s if stated else open_round.t_s) - t_s)

        def order(open_round: _OpenRound) -> tuple[float, int, float]:
            nearest_s = min(abs(times_s[stated] - t_s) for times_s in open_round.times_s)
            return max(nearest_s, self.slop_s / 2), -len(open_round.reports), apart_s(open_round)

        candidates = [each for each in self._open if agent not in each.reports and apart_s(each) <= self.slop_s]
        return min(candidates, key=order, default=None)

    def _ended(self) -> list[Round]:
        """Remove and return the open rounds, in order, that need not wait for more reports."""
        ended = []
        while self._open and not self._waits(self._open[0]):
            finished = self._end(self._open.pop(0))
            if finished is not None:
                ended.append(finished)
        return ended

    def _waits(self, first: _OpenRound) -> bool:
        """Return whether the first open round waits for more reports."""
        if self._now_s > first.t_s + self.slop_s + DELAY_S or len(self._open) > MAX_OPEN:
            return False
        if set(self.agents) == first.reports.keys():
            return False
        # Before the first round the set of agents is unknown: wait for a report of the next round.
        if self._last_s == -np.inf and len(self._open) == 1:
            return True
        live = {agent for agent, state in self._states.items() if self._now_s < state.last_s + HEARD_S}
        later = {agent for each in self._open[1:] for agent in each.reports}
        if 2 * len(live & later) > len(live):
            return False
        return not live <= first.reports.keys() | first.passed

    def _end(self, open_round: _OpenRound) -> Round | None:
        """Fuse and return a round; None if it fails, which loses only this round."""
        self._last_s, self._last_agents = max(open_round.t_s, self._last_s + 1e-3), tuple(open_round.reports)
        missing = tuple(
            sorted(
                agent for agent, state in self._states.items()
                if agent not in open_round.reports and state.since_s < self._last_s < state.last_s + HEARD_S
            )
        )  # fmt: skip
        if missing:
            self.notes.append(
                f"{', '.join(missing)}: heard recently, missing at {self._last_s:.2f} s; check clocks and links"
            )
        try:
            center = self._center_with(open_round.reports)
            picture = center.add(self._last_s, list(open_round.reports.values()))
            refused = {agent: state.kinematics.refused for agent, state in self._states.items()}
            return Round.of(picture, missing, {agent: count for agent, count in refused.items() if count})
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
            self.notes.append(f"the round of {self._last_s:.2f} s failed and is left out: {problem}")
            return None

    def _center_with(self, reporting: Mapping[str, object]) -> CommandCenter:
        """Return the center for the agents present, without those that lost their places."""
        if self._center is None:
            self._center = CommandCenter(self.agents or tuple(sorted(reporting)))
        known = self._center.agents
        new = tuple(sorted(reporting.keys() - set(known)))
        staying = tuple(agent for agent in known if self.agents or agent in self._states)
        if (*staying, *new) != known:
            self._center.regroup((*staying, *new))
        if new:
            self.notes.append(f"{', '.join(new)} joined: its trust starts at the prior, the others keep theirs")
        return self._center
