"""Real-time pipeline of threads: decoding, estimating and publishing overlap; newer sweeps replace older ones."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from threading import Event, Lock, Thread
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from viewshed.arrays import Mask
from viewshed.estimators.base import Estimator
from viewshed.estimators.temporal import SweepBuffer
from viewshed.fov.estimate import FovEstimate
from viewshed.guarantees.certificate import certify
from viewshed.guarantees.envelope import Threat
from viewshed.io import read_sweep
from viewshed.io.samples import junction_path
from viewshed.monitor.stream_monitor import StreamMonitor, StreamReport
from viewshed.pipeline.agent import Agent, Agents, Answer
from viewshed.pipeline.inbox import Inbox
from viewshed.pipeline.latency import Latencies
from viewshed.pipeline.reactions import (
    RULES,
    VEHICLE,
    Caution,
    Finding,
    ReactionRules,
    ReactionState,
    Vehicle,
    react,
    speed_for_view,
    withdraw,
)
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep, leveled_on
from viewshed.preprocess.streams import AGENTS
from viewshed.sweep import Sweep

Item = TypeVar("Item")

if TYPE_CHECKING:  # tracks need scipy, which a robot that tracks nothing does without
    from viewshed.objects.object_stream import ObjectStream, SeenObjects

REASONS = 50
"""Maximum number of distinct reasons that are counted separately; further ones are counted together."""

OTHER_REASONS = "for other reasons"

MORE_AGENTS = f"of more than {AGENTS} agents; give them a stream of their own"

STALE_AFTER_S = 0.5

REPLACED, UNRETURNED = "newer ones replaced them", "publish did not return"

_TIMEOUT_S, _PUBLISH_TIMEOUT_S = 60.0, 2.0
"""Timeouts while the pipeline closes: of one step of a sweep, and of a live ``publish``."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """Counts and latencies of a pipeline so far."""

    answered: int  # sweeps with an estimate
    dropped: int  # sweeps replaced by newer ones of their agent while waiting
    refused: dict[str, int]  # number of sweeps without an estimate, by reason
    latencies: str  # median, 99 % quantile and maximum, in words
    busy_cores: float  # mean number of cores that the process used since the first sweep
    # latency of detecting, tracking and explaining objects, and number of failures; empty without objects
    objects: str = ""
    unpublished: dict[str, int] = field(default_factory=dict)  # number of answers not published, by reason

    def line(self) -> str:
        """Return all statistics in one line."""
        lost = "".join(f", {count} refused ({reason})" for reason, count in self.refused.items())
        lost += "".join(f", {count} not published ({reason})" for reason, count in self.unpublished.items())
        counts = f"{self.answered} answered, {self.dropped} dropped{lost}"
        objects = f"; objects {self.objects}" if self.objects else ""
        return f"{counts}; {self.latencies}; {self.busy_cores:.2f} cores busy{objects}"


@dataclass(frozen=True, slots=True)
class _Step:
    """A sweep on its way through the stages, with the results so far."""

    agent: Agent
    number: int
    put_s: float
    source: Sweep | Callable[[], Sweep]
    leveled: LeveledSweep | None = None
    seen: History | None = None
    estimate: FovEstimate | None = None
    report: StreamReport | None = None
    objects: SeenObjects | None = None
    reaction: ReactionState | None = None
    speed_mps: float = 0.0
    notes: tuple[str, ...] = ()
    refused: str = ""


@dataclass(slots=True, eq=False)
class _Stage(Generic[Item]):
    """One thread of a pipeline: takes items, processes each, and passes it on."""

    name: str  # what it does, for messages
    take: Callable[[], Item | None]  # waits for the next item; None at the end
    do: Callable[[Item], Item]  # processes an item; its timeout is ``timeout_s`` once the pipeline closes
    pass_on: Callable[[Item], object]  # passes on the processed item; may block
    end: Callable[[], None] = lambda: None  # called after the last item
    timeout_s: float = _TIMEOUT_S
    begun_s: float = math.inf  # when it began with the current item; inf without one
    abandoned: bool = False  # whether it timed out, so that nobody waits for it any more
    thread: Thread = field(default_factory=Thread)


class Pipeline:
    """Answers sweeps in four threads: one decodes and levels, one estimates, one checks and reacts, one publishes.

    Without monitor and objects one thread estimates and reacts, because passing on would take longer than reacting.
    Sweeps wait in the inbox, where a new one replaces the oldest of its agent; the newest answer of each agent waits
    for ``publish``. An error fails its own sweep only. A ``BaseException`` that is no :class:`Exception`
    (``SystemExit``, say) ends the stream; :meth:`put` and :meth:`close` then raise the reason. Memory does not grow
    with the stream.

    Views become stale: if the newest view of an agent is older than ``stale_after_s`` and than two periods of its
    sweeps, ``publish`` receives its last answer again, once, with STALE caution, speed 0 and every cell UNKNOWN.

    >>> from viewshed import load_estimator
    >>> answers: list[Answer] = []
    >>> with Pipeline(load_estimator("shadow_map"), answers.append) as pipeline:
    ...     pipeline.put(lambda: read_sweep(junction_path()))
    >>> answers[0].estimate.area_m2() > 1000
    True

    Args:
        estimator: estimates each sweep.
        publish: called with each answer, in its own thread.
        history: buffer of each agent's earlier sweeps, for an estimator that uses them; None for none.
        monitor: checks the stream, or None.
        objects: detects, tracks and explains objects after each estimate, or None; if it fails, only objects are lost.
        rules: how caution rises and falls.
        certify: threat for which claims are certified: certified cells stay claimed in an alarm; None for none.
        certified_only: claim certified cells only, even without an alarm.
        vehicle: braking model for the answered speed.
        waiting: maximum number of queued sweeps of an agent.
        lossless: block :meth:`put` instead of dropping sweeps, for files; nothing becomes stale then.
        stale_after_s: age beyond which a view is stale, unless two periods (of up to 1 s) are longer; inf for never.

    Raises:
        ValueError: ``waiting`` or ``stale_after_s`` is not positive, or ``certified_only`` is set without a threat.
    """

    def __init__(
        self,
        estimator: Estimator,
        publish: Callable[[Answer], None],
        *,
        history: SweepBuffer | None = None,
        monitor: StreamMonitor | None = None,
        objects: ObjectStream | None = None,
        rules: ReactionRules = RULES,
        certify: Threat | None = None,
        certified_only: bool = False,
        vehicle: Vehicle = VEHICLE,
        waiting: int = 1,
        lossless: bool = False,
        stale_after_s: float = STALE_AFTER_S,
    ) -> None:
        if not stale_after_s > 0.0:
            raise ValueError(f"stale_after_s must be positive, got {stale_after_s}; give inf for never")
        if certified_only and certify is None:
            raise ValueError("certified_only needs a threat, got none to certify against; give one, such as window:5")
        self._estimator, self._publish, self._history, self._monitor = estimator, publish, history, monitor
        self._rules, self._vehicle, self._objects = rules, vehicle, objects
        self._threat, self._certified_only = certify, certified_only
        self._stale_after_s = math.inf if lossless else stale_after_s
        # One sweep waits between two threads: the faster one blocks, and new sweeps wait, or are dropped, in the inbox.
        self._inbox: Inbox[_Step] = Inbox(waiting, lossless=lossless)
        self._to_estimate: Inbox[_Step] = Inbox(lossless=True)
        self._to_check: Inbox[_Step] = Inbox(lossless=True)
        self._to_publish: Inbox[Answer] = Inbox(lossless=lossless)
        self._agents = Agents()
        self._reacting = Lock()
        """Guards the reaction of an agent until its answer is handed out."""
        self._lock, self._put, self._answered = Lock(), 0, 0
        """Guards the counters and the table of agents."""
        self._refused: Counter[str] = Counter()
        self._handed_out, self._published, self._unpublished = 0, 0, Counter[str]()
        self._accused: frozenset[str] = frozenset()
        self._latencies, self._objects_took, self._objects_failed = Latencies(), Latencies(), 0
        self._ended: Exception | None = None
        self._publish_failed: Exception | None = None
        self._began = (0.0, 0.0)
        self._closing_s, self._closed = math.inf, Event()
        # Warm up: load and allocate before the first sweep counts.
        sample = leveled_on(read_sweep(junction_path()), estimator.grid)
        first = estimator.estimate(sample)
        if objects is not None:
            objects.fresh().follow(sample, first)
        checks = monitor is not None or objects is not None
        self._answering: list[_Stage[_Step]] = [
            _Stage(
                "decoding", self._inbox.take, partial(self._attempt, self._level),
                partial(self._to_estimate.put, ""), self._to_estimate.close,
            ),
            _Stage(
                "estimating", self._to_estimate.take, partial(self._attempt, self._estimate),
                partial(self._to_check.put, "") if checks else self._answer, self._to_check.close,
            ),
        ]  # fmt: skip
        if checks:
            self._answering.append(
                _Stage("checking", self._to_check.take, partial(self._attempt, self._check), self._answer)
            )
        self._publishing = _Stage(
            "publish", self._to_publish.take, self._publish_one, lambda _: None,
            timeout_s=_TIMEOUT_S if lossless else _PUBLISH_TIMEOUT_S,
        )  # fmt: skip
        self._handing_out = [self._publishing]
        if self._stale_after_s < math.inf:
            self._handing_out.append(_Stage("watching", self._next_stale, lambda answer: answer, self._hand_out_stale))
        for stage in self._stages:
            stage.thread = Thread(target=self._work, args=(stage,), name=f"viewshed {stage.name}", daemon=True)
            stage.thread.start()

    @property
    def _stages(self) -> list[_Stage[Any]]:
        return [*self._answering, *self._handing_out]

    def put(self, source: Sweep | Callable[[], Sweep], agent: str = "ego") -> None:
        """Queue a sweep of an agent, or a function that decodes one (called only if the sweep is not dropped).

        Args:
            source: the sweep, which is copied, so that its arrays may be reused; or a function that returns one and
                owns the data it reads.
            agent: name of the agent.

        Raises:
            RuntimeError: the stream has ended; its cause is the error that ended it.
        """
        now_s = time.perf_counter()
        if isinstance(source, Sweep):
            source = source.copy()
        with self._lock:
            if self._put == 0:
                self._began = now_s, time.process_time()
            number, self._put = self._put, self._put + 1
            known = self._agents.heard(agent, now_s, self._new_agent, self._inbox)
        if known is not None:
            self._inbox.put(agent, _Step(known, number, now_s, source))
        if self._ended is not None:
            raise self._ended

    def begin_anew(self) -> None:
        """Begin the streams of all agents anew: the sweeps put in from now on have no past."""
        with self._lock:
            self._agents.clear()  # sweeps on their way keep the agent that they came from

    def _new_agent(self, name: str) -> Agent:
        """Return an agent with empty state."""
        history, monitor, objects = self._history, self._monitor, self._objects
        return Agent(
            name, history=history and history.fresh(), monitor=monitor and monitor.fresh(),
            objects=objects and objects.fresh(),
        )  # fmt: skip

    def _known(self) -> list[Agent]:
        """Return all agents."""
        with self._lock:
            return list(self._agents.values())

    def newest(self, agent: str = "ego") -> Answer | None:
        """Return the newest answer of an agent, marked STALE if it is too old by now; None without one."""
        known = self._agents.get(agent)
        if known is None or known.newest is None:
            return None
        if known.reaction.caution == Caution.STALE or not self._is_stale(known):
            return known.newest
        return self._withdrawn(known, known.newest)

    def accuse(self, agents: Iterable[str]) -> None:
        """Treat the whole views of these agents as inconsistent, because a center of many agents accuses them.

        From the next sweep on, only claims confirmed by earlier sweeps hold. Agents that are not named any more are
        trusted again as fast as caution falls.
        """
        self._accused = frozenset(agents)

    def statistics(self) -> Statistics:
        """Return the statistics so far."""
        began_s, began_cpu_s = self._began
        with self._lock:
            passed_s = time.perf_counter() - began_s
            busy = (time.process_time() - began_cpu_s) / passed_s if self._put else 0.0
            objects = ""
            if self._objects is not None:
                failed = f", {self._objects_failed} failed" if self._objects_failed else ""
                objects = f"{self._objects_took.line()}{failed}"
            is_abandoned = self._publishing.abandoned
            lost = self._handed_out - self._published - self._unpublished.total() if is_abandoned else 0
            replaced = 0 if is_abandoned else self._to_publish.dropped
            unpublished = self._unpublished + Counter({REPLACED: replaced, UNRETURNED: lost})
            refused = dict(self._refused)
            if self._agents.refused:
                refused[MORE_AGENTS] = self._agents.refused
            return Statistics(
                self._answered, self._inbox.dropped, refused, self._latencies.line(), busy, objects,
                dict(unpublished),
            )  # fmt: skip

    def close(self) -> Statistics:
        """Answer and publish all queued sweeps, stop, and return the statistics.

        Raises:
            RuntimeError: a ``BaseException`` that is no :class:`Exception` ended the stream; it is the cause.
            TimeoutError: ``publish`` did not return within 2 s (60 s for files), or another step within 60 s; its
                thread is abandoned, and unpublished answers are counted.
            Exception: the first error of ``publish``; the other answers were published.
        """
        self._closing_s = min(self._closing_s, time.perf_counter())
        self._inbox.close()
        self._wait_for(self._answering)
        self._closed.set()
        self._to_publish.close()
        self._wait_for(self._handing_out)
        # Stages refer to the pipeline: without this, a monitor's memory stays until Python collects cycles.
        for stage in self._stages:
            if not stage.abandoned:
                stage.take, stage.do, stage.pass_on = (lambda: None), (lambda item: item), (lambda _: None)
        if self._ended is not None:
            raise self._ended
        if self._publish_failed is not None:
            raise self._publish_failed
        return self.statistics()

    def __enter__(self) -> Pipeline:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # The threads

    def _work(self, stage: _Stage[Item]) -> None:
        """Run a stage until its last item; anything raised here ends the stream."""
        try:
            while not stage.abandoned and (item := stage.take()) is not None:
                stage.begun_s = time.perf_counter()
                item = stage.do(item)
                stage.begun_s = math.inf
                if not stage.abandoned:
                    stage.pass_on(item)
        except BaseException as error:
            ended = RuntimeError(
                f"the pipeline must run to take a sweep, its {stage.name} ended with {type(error).__name__}:"
                f" {_in_one_line(error)}; make a new one"
            )
            ended.__cause__ = error
            self._end(stage, ended)
        finally:
            stage.begun_s = math.inf
            stage.end()

    def _wait_for(self, stages: Sequence[_Stage[Any]]) -> None:
        """Wait until these stages have ended; abandon a stage whose current item times out."""
        while running := [stage.thread for stage in stages if stage.thread.is_alive() and not stage.abandoned]:
            for stage in self._stages:
                timeout_s = stage.timeout_s if self._ended is None else _PUBLISH_TIMEOUT_S
                if time.perf_counter() - max(stage.begun_s, self._closing_s) > timeout_s and not stage.abandoned:
                    why = f"{stage.name} must return within {timeout_s:g} s once the pipeline closes"
                    self._end(stage, TimeoutError(f"{why}, it did not; end what it waits for"))
            running[0].join(0.02)

    def _end(self, stage: _Stage[Any], error: Exception) -> None:
        """End the stream: accept no more sweeps and abandon the stage. Views may still become stale."""
        with self._lock:
            stage.abandoned, self._ended = True, self._ended or error
            if stage is self._publishing:
                self._unpublished += Counter({REPLACED: self._to_publish.dropped})
                self._to_publish.close()
        for inbox in (self._inbox, self._to_estimate, self._to_check):
            inbox.close()

    # Steps of a sweep

    def _attempt(self, do: Callable[[_Step], _Step], step: _Step) -> _Step:
        """Return the sweep after a step; an error in the step refuses the sweep."""
        try:
            return do(step)
        except Exception as error:
            return replace(step, estimate=None, report=None, objects=None, refused=_in_one_line(error))

    def _level(self, step: _Step) -> _Step:
        """Decode and level the sweep; the sensor of the agent's last sweep is tried first."""
        sweep = step.source() if callable(step.source) else step.source
        agent = step.agent
        if sweep.agent != agent.name:
            sweep = sweep.replace(agent=agent.name)
        note = agent.time_note(sweep.t_ns)
        leveled = leveled_on(sweep, self._estimator.grid, agent.sensor)
        agent.sensor = leveled.sensor_id
        leveled = agent.rest.hold(leveled)
        return replace(step, leveled=leveled, notes=(note,) if note else ())

    def _estimate(self, step: _Step) -> _Step:
        """Estimate, with the agent's earlier sweeps if there are any."""
        if step.leveled is None:
            return step
        history = step.agent.history
        seen = None if history is None else history.history(step.leveled)
        leveled = step.leveled if seen is None else seen.now
        estimate = self._estimator.estimate(leveled, seen)
        if not isinstance(estimate, FovEstimate):
            raise TypeError(f"an estimator must return a FovEstimate, got {type(estimate).__name__}; fix it")
        if history is not None:
            history.add(leveled)
            for agent in self._known():
                if agent.history is not None and leveled.sweep.t_ns is not None:
                    agent.history.drop_gone(leveled.sweep.t_ns)
        return replace(step, leveled=leveled, seen=seen, estimate=estimate)

    def _check(self, step: _Step) -> _Step:
        """Check the sweep with the monitor, then follow objects; an error with objects loses only them."""
        leveled, estimate = step.leveled, step.estimate
        if leveled is None or estimate is None:
            return step
        if step.agent.monitor is not None:
            report = step.agent.monitor.check(leveled)
            step = replace(step, report=report, notes=step.notes or report.notes)
        return step if step.agent.objects is None else self._follow(step.agent.objects, leveled, estimate, step)

    def _follow(self, stream: ObjectStream, leveled: LeveledSweep, estimate: FovEstimate, step: _Step) -> _Step:
        """Return the sweep with its objects; if that fails, count and note it."""
        try:
            objects = stream.follow(leveled, estimate, None if step.report is None else step.report.now)
        except Exception as error:
            with self._lock:
                self._objects_failed += 1
            return replace(step, notes=(*step.notes, f"no objects: {_in_one_line(error)}"))
        with self._lock:
            self._objects_took.add(objects.seconds)
        return replace(step, objects=objects)

    def _answer(self, step: _Step) -> None:
        """React to a sweep, update agent and counters, and hand out the answer."""
        agent = step.agent
        with self._reacting:
            agent.puts_s.append(step.put_s)
            if step.estimate is not None:
                agent.seen_s = step.put_s
            step = self._attempt(self._react, step)
            # A failed reaction leaves no view either: keep the caution, at least ASK.
            before = agent.reaction
            agent.reaction = step.reaction or replace(before, caution=max(before.caution, Caution.ASK), calm=0)
            latency_s = time.perf_counter() - step.put_s
            with self._lock:
                if step.estimate is None:
                    _count(self._refused, step.refused)
                else:
                    self._answered += 1
                    self._latencies.add(latency_s)
            agent.newest = Answer(
                agent.name, step.number, step.leveled, step.estimate, step.report, agent.reaction, step.speed_mps,
                step.notes, step.refused, latency_s, step.objects, step.put_s,
            )  # fmt: skip
            self._hand_out(agent.newest)

    def _react(self, step: _Step) -> _Step:
        """Return the sweep with its reaction, withdrawn cells and the resulting speed."""
        agent = step.agent
        finding = finding_on(step.estimate, step.report, step.objects, is_accused=agent.name in self._accused)
        if self._is_stale(agent):
            finding = replace(finding, stale=True)
            step = replace(step, notes=(*step.notes, agent.stale_note))
        reaction, estimate = react(finding, agent.reaction, self._rules), step.estimate
        if estimate is None:
            return replace(step, reaction=reaction)
        estimate, notes = claims_left(
            estimate, step.leveled, step.seen, finding, reaction, self._rules, self._threat,
            certified_only=self._certified_only,
        )  # fmt: skip
        yaw = None if step.leveled is None else step.leveled.sweep.vehicle_yaw
        is_stale = reaction.caution == Caution.STALE
        speed_mps = 0.0 if is_stale else speed_for_view(estimate, self._vehicle, yaw or 0.0)
        notes = (*step.notes, *notes)
        return replace(step, reaction=reaction, estimate=estimate, speed_mps=speed_mps, notes=notes)

    def _hand_out(self, answer: Answer) -> None:
        """Queue an answer for the publishing thread; unless lossless, a newer one of its agent may replace it."""
        with self._lock:
            self._handed_out += 1
        self._to_publish.put(answer.agent, answer)

    def _publish_one(self, answer: Answer) -> Answer:
        """Publish an answer; an error loses only this one."""
        try:
            self._publish(answer)
        except Exception as error:
            with self._lock:
                _count(self._unpublished, _in_one_line(error))
                self._publish_failed = self._publish_failed or error
        else:
            with self._lock:
                self._published += 1
        return answer

    # Stale views

    def _max_age_s(self, agent: Agent) -> float:
        """Return the age beyond which the view of an agent is stale."""
        return max(self._stale_after_s, 2.0 * agent.period_s)

    def _is_stale(self, agent: Agent) -> bool:
        """Return whether the newest view of an agent is too old."""
        return agent.age_s > self._max_age_s(agent)

    def _next_stale(self) -> Answer | None:
        """Wait until an agent's view becomes stale and return its newest answer; None once the pipeline closes."""
        wait_s = 0.0
        while not self._closed.wait(wait_s):
            wait_s = self._stale_after_s
            with self._reacting:
                for agent in self._known():
                    if agent.reaction.caution != Caution.STALE:
                        if self._is_stale(agent):
                            return agent.newest
                        wait_s = min(wait_s, self._max_age_s(agent) - agent.age_s)
        return None

    def _hand_out_stale(self, answer: Answer) -> None:
        """Hand out a stale answer again, unless a newer one was handed out meanwhile."""
        with self._reacting:
            agent = self._agents.get(answer.agent)
            if agent is not None and agent.newest is answer:
                agent.newest = self._withdrawn(agent, answer)
                agent.reaction = agent.newest.reaction
                self._hand_out(agent.newest)

    def _withdrawn(self, agent: Agent, answer: Answer) -> Answer:
        """Return the newest answer of an agent, marked as stale."""
        reaction = react(Finding(stale=True), agent.reaction, self._rules)
        estimate = None if answer.estimate is None else withdraw(answer.estimate, reaction, None, self._rules)
        return replace(answer, estimate=estimate, reaction=reaction, speed_mps=0.0, notes=(agent.stale_note,))


def _count(reasons: Counter[str], reason: str) -> None:
    """Count a reason; beyond ``REASONS`` distinct ones, count further ones together."""
    reasons[reason if reason in reasons or len(reasons) < REASONS else OTHER_REASONS] += 1


def finding_on(
    estimate: FovEstimate | None, report: StreamReport | None, objects: SeenObjects | None, *, is_accused: bool
) -> Finding:
    """Return the finding on a sweep: a missing estimate is a degraded view, a missing report no finding.

    A suspicious track degrades the view; an agent that a center accuses is inconsistent in all sectors.
    """
    if estimate is None:
        return Finding(degraded=True)
    suspicious = objects is not None and bool((objects.shown & objects.explained.accused).any())
    if report is None:
        return Finding(suspicious, is_accused, is_accused)
    return Finding(report.now.degraded or suspicious, report.alarm or is_accused, is_accused, report.suspect)


def claims_left(
    estimate: FovEstimate,
    leveled: LeveledSweep | None,
    seen: History | None,
    finding: Finding,
    reaction: ReactionState,
    rules: ReactionRules,
    threat: Threat | None,
    *,
    certified_only: bool = False,
) -> tuple[FovEstimate, tuple[str, ...]]:
    """Return the estimate after a reaction withdrew cells, and one line about the certificate if one was needed."""
    confirmed = certified = None
    notes: tuple[str, ...] = ()
    if reaction.caution == Caution.CONFIRMED and seen is not None:
        confirmed = seen.confirmations(estimate.grid, estimate.target) > 0
    # No certificate for an accused agent: its attacker may exceed the assumed threat.
    needs_certificate = certified_only or reaction.caution >= Caution.WIDEN
    if needs_certificate and leveled is not None and not (finding.stale or finding.accused):
        certified, notes = _certified(leveled, estimate, threat)
    return withdraw(estimate, reaction, confirmed, rules, certified, certified_only=certified_only), notes


def _certified(
    leveled: LeveledSweep, estimate: FovEstimate, threat: Threat | None
) -> tuple[Mask | None, tuple[str, ...]]:
    """Return the certified cells (cells, cells), or None, and one line about the certificate."""
    if threat is None:
        return None, ()
    try:
        certificate = certify(leveled, estimate, threat)
    except ValueError as error:
        return None, (f"nothing certified: {_in_one_line(error)}",)
    return certificate.certified_visible, (certificate.line,)


def _in_one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
