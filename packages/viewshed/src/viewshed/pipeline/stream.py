"""Sweeps in, answers out, in real time: decoding, estimating and publishing overlap, and the newest sweep wins."""

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
"""Different reasons for refusing a sweep that are counted apart; all further ones are counted together."""

OTHER_REASONS = "for other reasons"

MORE_AGENTS = f"of more than {AGENTS} agents; give them a stream of their own"

STALE_AFTER_S = 0.5

REPLACED, UNRETURNED = "newer ones replaced them", "publish did not return"

_PATIENCE_S, _PUBLISH_PATIENCE_S = 60.0, 2.0
"""How long one step of a sweep may take while the pipeline closes, and how long a live ``publish`` may."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """What a pipeline did so far."""

    answered: int  # sweeps with an estimate
    dropped: int  # sweeps that newer ones of their agent replaced before their turn
    refused: dict[str, int]  # how many sweeps had no estimate, by reason
    latencies: str  # median, 99 % quantile and worst latency, in words
    busy_cores: float  # cores that the process kept busy on average since the first sweep
    # how long detecting, tracking and explaining objects took, and how often it failed; empty without it
    objects: str = ""
    unpublished: dict[str, int] = field(default_factory=dict)  # how many answers were not published, by reason

    def line(self) -> str:
        """Return all of it in one line."""
        lost = "".join(f", {count} refused ({reason})" for reason, count in self.refused.items())
        lost += "".join(f", {count} not published ({reason})" for reason, count in self.unpublished.items())
        counts = f"{self.answered} answered, {self.dropped} dropped{lost}"
        objects = f"; objects {self.objects}" if self.objects else ""
        return f"{counts}; {self.latencies}; {self.busy_cores:.2f} cores busy{objects}"


@dataclass(frozen=True, slots=True)
class _Step:
    """A sweep on its way: where it is from, and what has become of it so far."""

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
    """One thread of a pipeline: it takes items, does something with each, and hands it on."""

    name: str  # what it does
    take: Callable[[], Item | None]  # waits for the next item; None where there will be no more
    do: Callable[[Item], Item]  # what is done with an item; it may take ``patience_s`` once the pipeline closes
    hand_on: Callable[[Item], object]  # takes the item then; it may wait
    end: Callable[[], None] = lambda: None  # is called when no more items come
    patience_s: float = _PATIENCE_S
    begun_s: float = math.inf  # when it began with the item at hand; inf where there is none
    left: bool = False  # whether it took too long and nobody waits for it any more
    thread: Thread = field(default_factory=Thread)


class Pipeline:
    """Answers sweeps in four threads: one decodes and levels, one estimates, one checks and reacts, one publishes.

    Without monitor and objects one thread estimates and reacts: handing on would take longer than reacting. Sweeps
    wait in the inbox, where a newer one of the same agent replaces the oldest, and answers wait for ``publish``, of
    each agent the newest. An error costs its sweep and no other, whatever raises it; what is no :class:`Exception`
    (``SystemExit``, say) ends the stream, and :meth:`put` and :meth:`close` raise the reason. Memory does not grow with
    the stream.

    A view grows stale: where the newest one of an agent is older than ``stale_after_s`` and two periods of its sweeps,
    ``publish`` is given its last answer again, once, with STALE caution, speed 0 and every cell UNKNOWN.

    >>> from viewshed import load_estimator
    >>> answers: list[Answer] = []
    >>> with Pipeline(load_estimator("shadow_map"), answers.append) as pipeline:
    ...     pipeline.put(lambda: read_sweep(junction_path()))
    >>> answers[0].estimate.area_m2() > 1000
    True

    Args:
        estimator: what estimates.
        publish: is called with each answer, in its own thread.
        history: the earlier sweeps of each agent that help, for an estimator that uses them; None for none.
        monitor: what watches the stream, or None.
        objects: what detects, tracks and explains objects after each estimate, or None; its errors cost only them.
        rules: how caution rises and falls.
        certify: the threat whose certificate an alarm falls back to: what is certified stays claimed; None for none.
        certified_only: whether only certified cells are claimed, be there an alarm or not.
        vehicle: how the vehicle stops whose speed is answered.
        waiting: sweeps of an agent that may wait for their turn.
        lossless: let :meth:`put` wait for room instead of dropping sweeps, for files; nothing is stale then.
        stale_after_s: age from which a view is stale, if it is older than two periods (of up to 1 s) as well; inf for
            never.

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
            raise ValueError("certified_only needs a threat, got none to certify against; name one, window:5 say")
        self._estimator, self._publish, self._history, self._monitor = estimator, publish, history, monitor
        self._rules, self._vehicle, self._objects = rules, vehicle, objects
        self._threat, self._certified_only = certify, certified_only
        self._stale_after_s = math.inf if lossless else stale_after_s
        # Between two threads one sweep waits: who is faster waits for room, and what comes in meanwhile waits, or is
        # dropped, in the inbox.
        self._inbox: Inbox[_Step] = Inbox(waiting, lossless=lossless)
        self._to_estimate: Inbox[_Step] = Inbox(lossless=True)
        self._to_check: Inbox[_Step] = Inbox(lossless=True)
        self._to_publish: Inbox[Answer] = Inbox(lossless=lossless)
        self._agents = Agents()
        self._reacting = Lock()
        """Held while an answer follows from what is remembered of its agent, and is handed out."""
        self._lock, self._put, self._answered = Lock(), 0, 0
        """Held while something is counted."""
        self._refused: Counter[str] = Counter()
        self._handed_out, self._published, self._unpublished = 0, 0, Counter[str]()
        self._accused: frozenset[str] = frozenset()
        self._latencies, self._objects_took, self._objects_failed = Latencies(), Latencies(), 0
        self._ended: Exception | None = None
        self._publish_failed: Exception | None = None
        self._began = (0.0, 0.0)
        self._closing_s, self._closed = math.inf, Event()
        # Whatever is loaded or allocated once is there before the first sweep counts.
        sample = leveled_on(read_sweep(junction_path()), estimator.grid)
        first = estimator.estimate(sample)
        if objects is not None:
            objects.fresh().follow(sample, first)
        checks = monitor is not None or objects is not None
        self._answering: list[_Stage[_Step]] = [
            _Stage(
                "decoding", self._inbox.take, partial(self._tried, self._level),
                partial(self._to_estimate.put, ""), self._to_estimate.close,
            ),
            _Stage(
                "estimating", self._to_estimate.take, partial(self._tried, self._estimate),
                partial(self._to_check.put, "") if checks else self._answer, self._to_check.close,
            ),
        ]  # fmt: skip
        if checks:
            self._answering.append(
                _Stage("checking", self._to_check.take, partial(self._tried, self._check), self._answer)
            )
        self._publishing = _Stage(
            "publish", self._to_publish.take, self._publish_one, lambda _: None,
            patience_s=_PATIENCE_S if lossless else _PUBLISH_PATIENCE_S,
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
        """Put in a sweep of an agent, or what decodes one (it is called only if the sweep's turn comes).

        Args:
            source: the sweep, of which a copy is kept, so that its arrays may be used again; or what returns one and
                owns what it reads.
            agent: whose it is.

        Raises:
            RuntimeError: the stream has ended; the cause is what ended it.
        """
        now_s = time.perf_counter()
        if isinstance(source, Sweep):
            source = source.copy()
        with self._lock:
            if self._put == 0:
                self._began = now_s, time.process_time()
            number, self._put = self._put, self._put + 1
            heard = self._agents.heard(agent, now_s, self._begun, self._inbox)
        if heard is not None:
            self._inbox.put(agent, _Step(heard, number, now_s, source))
        if self._ended is not None:
            raise self._ended

    def _begun(self, name: str) -> Agent:
        """Return an agent of which nothing is remembered yet."""
        history, monitor, objects = self._history, self._monitor, self._objects
        return Agent(
            name, history=history and history.fresh(), monitor=monitor and monitor.fresh(),
            objects=objects and objects.fresh(),
        )  # fmt: skip

    def _known(self) -> list[Agent]:
        """Return the agents that have a place."""
        with self._lock:
            return list(self._agents.values())

    def newest(self, agent: str = "ego") -> Answer | None:
        """Return the newest answer of an agent, STALE if that is too old by now; None where there is none."""
        known = self._agents.get(agent)
        if known is None or known.newest is None:
            return None
        if known.reaction.caution == Caution.STALE or not self._is_stale(known):
            return known.newest
        return self._withdrawn(known, known.newest)

    def accuse(self, agents: Iterable[str]) -> None:
        """Take what these agents see for inconsistent as a whole, as a center of many agents does that accuses them.

        From the next sweep on only what earlier ones confirm holds of their views; agents that are not named any more
        are believed again, as fast as caution falls.
        """
        self._accused = frozenset(agents)

    def statistics(self) -> Statistics:
        """Return what was done so far."""
        began_s, began_cpu_s = self._began
        with self._lock:
            passed_s = time.perf_counter() - began_s
            busy = (time.process_time() - began_cpu_s) / passed_s if self._put else 0.0
            objects = ""
            if self._objects is not None:
                failed = f", {self._objects_failed} failed" if self._objects_failed else ""
                objects = f"{self._objects_took.line()}{failed}"
            is_left = self._publishing.left
            lost = self._handed_out - self._published - self._unpublished.total() if is_left else 0
            replaced = 0 if is_left else self._to_publish.dropped
            unpublished = self._unpublished + Counter({REPLACED: replaced, UNRETURNED: lost})
            refused = dict(self._refused)
            if self._agents.refused:
                refused[MORE_AGENTS] = self._agents.refused
            return Statistics(
                self._answered, self._inbox.dropped, refused, self._latencies.line(), busy, objects,
                dict(unpublished),
            )  # fmt: skip

    def close(self) -> Statistics:
        """Answer what waits, publish it, stop, and return what was done.

        Raises:
            RuntimeError: something ended the stream that is no :class:`Exception`; that is its cause.
            TimeoutError: ``publish`` did not return within 2 s (60 s for files), or another step within 60 s; its
                thread is left behind, and what was not published is counted.
            Exception: the first error of ``publish``; the other answers were published.
        """
        self._closing_s = min(self._closing_s, time.perf_counter())
        self._inbox.close()
        self._wait_for(self._answering)
        self._closed.set()
        self._to_publish.close()
        self._wait_for(self._handing_out)
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
        """Do what a stage does, until no more items come; what is raised here ends the stream."""
        try:
            while not stage.left and (item := stage.take()) is not None:
                stage.begun_s = time.perf_counter()
                item = stage.do(item)
                stage.begun_s = math.inf
                if not stage.left:
                    stage.hand_on(item)
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
        """Wait until some stages have ended; one at which an item takes too long is left behind."""
        while waiting := [stage.thread for stage in stages if stage.thread.is_alive() and not stage.left]:
            for stage in self._stages:
                patience_s = stage.patience_s if self._ended is None else _PUBLISH_PATIENCE_S
                if time.perf_counter() - max(stage.begun_s, self._closing_s) > patience_s and not stage.left:
                    why = f"{stage.name} must return within {patience_s:g} s once the pipeline closes"
                    self._end(stage, TimeoutError(f"{why}, it did not; end what it waits for"))
            waiting[0].join(0.02)

    def _end(self, stage: _Stage[Any], why: Exception) -> None:
        """End the stream: nothing more is taken in, and nobody waits for the stage. Views may still become stale."""
        with self._lock:
            stage.left, self._ended = True, self._ended or why
            if stage is self._publishing:
                self._unpublished += Counter({REPLACED: self._to_publish.dropped})
                self._to_publish.close()
        for inbox in (self._inbox, self._to_estimate, self._to_check):
            inbox.close()

    # What becomes of a sweep

    def _tried(self, do: Callable[[_Step], _Step], step: _Step) -> _Step:
        """Return a sweep after something was done with it; an error there refuses it."""
        try:
            return do(step)
        except Exception as error:
            return replace(step, estimate=None, report=None, objects=None, refused=_in_one_line(error))

    def _level(self, step: _Step) -> _Step:
        """Decode and level; the sensor of the agent's sweep before is looked at first."""
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
        """Estimate, with the agent's earlier sweeps where there are any."""
        if step.leveled is None:
            return step
        history = step.agent.history
        seen = None if history is None else history.history(step.leveled)
        leveled = step.leveled if seen is None else seen.now
        estimate = self._estimator.estimate(leveled, seen)
        if not isinstance(estimate, FovEstimate):
            raise TypeError(f"an estimator must return a FovEstimate, got {type(estimate).__name__}; mend it")
        if history is not None:
            history.add(leveled)
            for agent in self._known():
                if agent.history is not None and leveled.sweep.t_ns is not None:
                    agent.history.drop_gone(leveled.sweep.t_ns)
        return replace(step, leveled=leveled, seen=seen, estimate=estimate)

    def _check(self, step: _Step) -> _Step:
        """Look for what contradicts the estimate, then follow objects; what goes wrong there costs only them."""
        leveled, estimate = step.leveled, step.estimate
        if leveled is None or estimate is None:
            return step
        if step.agent.monitor is not None:
            report = step.agent.monitor.check(leveled)
            step = replace(step, report=report, notes=step.notes or report.notes)
        return step if step.agent.objects is None else self._follow(step.agent.objects, leveled, estimate, step)

    def _follow(self, stream: ObjectStream, leveled: LeveledSweep, estimate: FovEstimate, step: _Step) -> _Step:
        """Return a sweep with its objects; without, counted and noted, where they cannot be had."""
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
        """React, remember, count and hand out."""
        agent = step.agent
        with self._reacting:
            agent.puts_s.append(step.put_s)
            if step.estimate is not None:
                agent.seen_s = step.put_s
            step = self._tried(self._react, step)
            # An answer without a reaction has no view either.
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
        """Return a sweep with its reaction, without what does not hold any more, and with the speed for the rest."""
        agent = step.agent
        found = _finding(step.estimate, step.report, step.objects, is_accused=agent.name in self._accused)
        if self._is_stale(agent):
            found = replace(found, stale=True)
            step = replace(step, notes=(*step.notes, agent.stale_note))
        reaction, estimate = react(found, agent.reaction, self._rules), step.estimate
        if estimate is None:
            return replace(step, reaction=reaction)
        confirmed = certified = None
        if reaction.caution == Caution.CONFIRMED and step.seen is not None:
            confirmed = step.seen.confirmations(estimate.grid, estimate.target) > 0
        # An agent that a center accuses may well be beyond any threat that was thought of.
        counts = self._certified_only or reaction.caution >= Caution.WIDEN
        if counts and step.leveled is not None and not (found.stale or found.accused):
            certified, notes = self._certified(step.leveled, estimate)
            step = replace(step, notes=(*step.notes, *notes))
        estimate = withdraw(estimate, reaction, confirmed, self._rules, certified, certified_only=self._certified_only)
        speed_mps = 0.0 if reaction.caution == Caution.STALE else speed_for_view(estimate, self._vehicle)
        return replace(step, reaction=reaction, estimate=estimate, speed_mps=speed_mps)

    def _certified(self, leveled: LeveledSweep, estimate: FovEstimate) -> tuple[Mask | None, tuple[str, ...]]:
        """Return the cells (cells, cells) that the threat cannot have opened, and what is certified, in words."""
        if self._threat is None:
            return None, ()
        try:
            certificate = certify(leveled, estimate, self._threat)
        except ValueError as error:
            return None, (f"nothing certified: {_in_one_line(error)}",)
        return certificate.certified_visible, (certificate.line,)

    def _hand_out(self, answer: Answer) -> None:
        """Hand an answer to the thread that publishes; a newer one of its agent replaces it there, but not of files."""
        with self._lock:
            self._handed_out += 1
        self._to_publish.put(answer.agent, answer)

    def _publish_one(self, answer: Answer) -> Answer:
        """Publish an answer; an error costs this one."""
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

    # What becomes of a view that nothing follows

    def _lasts_s(self, agent: Agent) -> float:
        """Return for how long the view of an agent is believed."""
        return max(self._stale_after_s, 2.0 * agent.period_s)

    def _is_stale(self, agent: Agent) -> bool:
        """Return whether the newest view of an agent is too old by now."""
        return agent.age_s > self._lasts_s(agent)

    def _next_stale(self) -> Answer | None:
        """Wait until the view of an agent becomes stale and return its newest answer; None once the pipeline closes."""
        wait_s = 0.0
        while not self._closed.wait(wait_s):
            wait_s = self._stale_after_s
            with self._reacting:
                for agent in self._known():
                    if agent.reaction.caution != Caution.STALE:
                        if self._is_stale(agent):
                            return agent.newest
                        wait_s = min(wait_s, self._lasts_s(agent) - agent.age_s)
        return None

    def _hand_out_stale(self, answer: Answer) -> None:
        """Hand out an answer again, now that it is stale, unless a newer one was handed out meanwhile."""
        with self._reacting:
            agent = self._agents.get(answer.agent)
            if agent is not None and agent.newest is answer:
                agent.newest = self._withdrawn(agent, answer)
                agent.reaction = agent.newest.reaction
                self._hand_out(agent.newest)

    def _withdrawn(self, agent: Agent, answer: Answer) -> Answer:
        """Return the newest answer of an agent as one that is stale."""
        reaction = react(Finding(stale=True), agent.reaction, self._rules)
        estimate = None if answer.estimate is None else withdraw(answer.estimate, reaction, None, self._rules)
        return replace(answer, estimate=estimate, reaction=reaction, speed_mps=0.0, notes=(agent.stale_note,))


def _count(reasons: Counter[str], reason: str) -> None:
    """Count a reason; of too many different ones all further ones together."""
    reasons[reason if reason in reasons or len(reasons) < REASONS else OTHER_REASONS] += 1


def _finding(
    estimate: FovEstimate | None, report: StreamReport | None, objects: SeenObjects | None, *, is_accused: bool
) -> Finding:
    """Return what is reacted to: no answer is a worse view, and where nobody looks nothing is found.

    A suspicious track is a reason to ask others; an agent that a center accuses is inconsistent as a whole.
    """
    if estimate is None:
        return Finding(degraded=True)
    suspicious = objects is not None and bool((objects.shown & objects.explained.accused).any())
    if report is None:
        return Finding(suspicious, is_accused, is_accused)
    return Finding(report.now.degraded or suspicious, report.alarm or is_accused, is_accused, report.suspect)


def _in_one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
