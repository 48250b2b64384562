"""Sweeps in, answers out, in real time: decoding, estimating and publishing overlap, and the newest sweep wins."""

from __future__ import annotations

import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from queue import Queue
from threading import Lock, Thread
from types import TracebackType
from typing import TYPE_CHECKING

from viewshed.estimators.base import Estimator
from viewshed.estimators.temporal import SweepBuffer
from viewshed.fov.estimate import FovEstimate
from viewshed.integrity.stream_monitor import StreamMonitor, StreamReport
from viewshed.io import read_sweep
from viewshed.io.samples import junction_path
from viewshed.pipeline.clocks import Clocks, remember
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
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

if TYPE_CHECKING:  # tracks need scipy, which a robot that tracks nothing does without
    from viewshed.fusion.object_stream import ObjectStream, SeenObjects

REASONS = 50
"""Different reasons for refusing a sweep that are counted apart; all further ones are counted together."""

OTHER_REASONS = "for other reasons"


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What became of one sweep.

    Attributes:
        agent: whose it was.
        number: of the sweep among all that were put in, from 0.
        leveled: the sweep; None where it could not be decoded.
        estimate: what it sees, without what the reaction withdraws; None where it could not be had.
        report: what the monitor says; None without one, or without an estimate.
        reaction: how far the view is trusted.
        speed_mps: from which a vehicle stops within what is seen free ahead of it; 0 without an estimate.
        notes: what was noticed on the way (a clock that jumps, say), a sentence each.
        refused: why there is no estimate; empty where there is one.
        latency_s: from putting the sweep in to its answer.
        objects: detections and explained tracks, by the estimate before anything was withdrawn; None where nobody asked
            for them, or they failed: a note says why.
    """

    agent: str
    number: int
    leveled: LeveledSweep | None
    estimate: FovEstimate | None
    report: StreamReport | None
    reaction: ReactionState
    speed_mps: float
    notes: tuple[str, ...]
    refused: str
    latency_s: float
    objects: SeenObjects | None = None


@dataclass(frozen=True, slots=True)
class Statistics:
    """What a pipeline did so far.

    Attributes:
        answered: sweeps with an estimate.
        dropped: sweeps that newer ones of their agent replaced before their turn.
        refused: how many sweeps had no estimate, by reason.
        latencies: median, 99 % quantile and worst latency, in words.
        busy_cores: cores that the process kept busy on average since the first sweep.
        objects: how long detecting, tracking and explaining objects took, and how often it failed; empty without it.
    """

    answered: int
    dropped: int
    refused: dict[str, int]
    latencies: str
    busy_cores: float
    objects: str = ""

    def line(self) -> str:
        """Return all of it in one line."""
        refused = "".join(f", {count} refused ({reason})" for reason, count in self.refused.items())
        counts = f"{self.answered} answered, {self.dropped} dropped{refused}"
        objects = f"; objects {self.objects}" if self.objects else ""
        return f"{counts}; {self.latencies}; {self.busy_cores:.2f} cores busy{objects}"


@dataclass(frozen=True, slots=True)
class _Step:
    """A sweep on its way: where it is from, and what has become of it so far."""

    agent: str
    number: int
    put_s: float
    source: Sweep | Callable[[], Sweep]
    leveled: LeveledSweep | None = None
    seen: History | None = None
    estimate: FovEstimate | None = None
    note: str = ""
    refused: str = ""


class Pipeline:
    """Answers sweeps in four threads: one decodes and levels, one estimates, one checks and reacts, one publishes.

    Without monitor and objects one thread estimates and reacts: handing on would take longer than reacting. Sweeps
    wait in the inbox alone, where a newer one of the same agent replaces the oldest. A sweep that cannot be answered
    costs that sweep and no other. Memory does not grow with the stream.

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
        vehicle: how the vehicle stops whose speed is answered.
        waiting: sweeps of an agent that may wait for their turn.
        lossless: let :meth:`put` wait for room instead of dropping sweeps, for files.
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
        vehicle: Vehicle = VEHICLE,
        waiting: int = 1,
        lossless: bool = False,
    ) -> None:
        self._estimator, self._publish, self._history, self._monitor = estimator, publish, history, monitor
        self._rules, self._vehicle, self._objects = rules, vehicle, objects
        self._checks = monitor is not None or objects is not None
        # Each thread hands on to the next through a queue of one: who is faster waits, and what comes in meanwhile
        # waits, or is dropped, in the inbox.
        self._inbox: Inbox[_Step] = Inbox(waiting, lossless=lossless)
        self._to_estimate: Queue[_Step | None] = Queue(1)
        self._to_check: Queue[_Step | None] = Queue(1)
        self._to_publish: Queue[Answer | None] = Queue(1)
        self._reactions: OrderedDict[str, ReactionState] = OrderedDict()
        self._lock, self._put, self._answered = Lock(), 0, 0
        self._refused: Counter[str] = Counter()
        self._accused: frozenset[str] = frozenset()
        self._latencies, self._objects_took, self._objects_failed = Latencies(), Latencies(), 0
        self._failure: BaseException | None = None
        self._began = (0.0, 0.0)
        # Whatever is loaded or allocated once is there before the first sweep counts.
        sample = leveled_on(read_sweep(junction_path()), estimator.grid)
        first = estimator.estimate(sample)
        if objects is not None:
            objects.follow(sample, first)
            objects.reset()
        works = [self._level_all, self._estimate_all, self._publish_all]
        works += [self._check_all] if self._checks else []
        self._threads = [Thread(target=work, daemon=True) for work in works]
        for thread in self._threads:
            thread.start()

    def put(self, source: Sweep | Callable[[], Sweep], agent: str = "ego") -> None:
        """Put in a sweep of an agent, or what decodes one (it is called only if the sweep's turn comes)."""
        now_s = time.perf_counter()
        with self._lock:
            if self._put == 0:
                self._began = now_s, time.process_time()
            number, self._put = self._put, self._put + 1
        self._inbox.put(agent, _Step(agent, number, now_s, source))

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
            return Statistics(
                self._answered, self._inbox.dropped, dict(self._refused), self._latencies.line(), busy, objects
            )

    def close(self) -> Statistics:
        """Answer what waits, stop, and return what was done.

        Raises:
            Exception: what ``publish`` raised; nothing was published after that.
        """
        self._inbox.close()
        for thread in self._threads:
            thread.join()
        if self._failure is not None:
            raise self._failure
        return self.statistics()

    def __enter__(self) -> Pipeline:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _level_all(self) -> None:
        """Decode and level what comes in; the sensor of an agent's sweep before is expected again."""
        clocks, sensors = Clocks(), OrderedDict[str, LidarModel | None]()
        while (step := self._inbox.take()) is not None:
            try:
                sweep = step.source() if callable(step.source) else step.source
                if sweep.agent != step.agent:
                    sweep = sweep.replace(agent=step.agent)
                note = clocks.note(step.agent, sweep.t_ns)
                leveled = leveled_on(sweep, self._estimator.grid, sensors.get(step.agent))
                remember(sensors, step.agent, leveled.sensor_id.model)
                step = replace(step, leveled=leveled, note=note)
            except Exception as error:
                step = replace(step, refused=_in_one_line(error))
            self._to_estimate.put(step)
        self._to_estimate.put(None)

    def _estimate_all(self) -> None:
        """Estimate; where nothing is checked or followed react as well."""
        while (step := self._to_estimate.get()) is not None:
            step = self._estimated(step)
            if self._checks:
                self._to_check.put(step)
            else:
                self._answer(step)
        (self._to_check if self._checks else self._to_publish).put(None)

    def _check_all(self) -> None:
        """Check, follow objects and react."""
        while (step := self._to_check.get()) is not None:
            self._answer(step)
        self._to_publish.put(None)

    def _estimated(self, step: _Step) -> _Step:
        """Return a leveled sweep with its estimate, made with the agent's earlier sweeps where there are any."""
        if step.leveled is None:
            return step
        try:
            seen = None if self._history is None else self._history.history(step.leveled)
            leveled = step.leveled if seen is None else seen.now
            estimate = self._estimator.estimate(leveled, seen)
            if self._history is not None:
                self._history.add(leveled)
        except Exception as error:
            return replace(step, refused=_in_one_line(error))
        return replace(step, leveled=leveled, seen=seen, estimate=estimate)

    def _answer(self, step: _Step) -> None:
        """Check an estimated sweep, follow its objects and react, count what became of it and hand it on."""
        leveled, estimate, report, refused = step.leveled, step.estimate, None, step.refused
        # 1. Look for what contradicts the estimate.
        if self._monitor is not None and leveled is not None and estimate is not None:
            try:
                report = self._monitor.check(leveled, {estimate.method: estimate})
            except Exception as error:
                estimate, refused = None, _in_one_line(error)
        # 2. Follow objects; what goes wrong there costs only them.
        objects, notes = None, list((step.note,) if step.note else () if report is None else report.notes)
        if leveled is not None and estimate is not None and self._objects is not None:
            objects = self._follow(leveled, estimate, report, notes)
        # 3. React: caution follows from the report, and what does not hold any more is withdrawn.
        before = self._reactions.get(step.agent, ReactionState())
        found = _finding(estimate, report, objects, is_accused=step.agent in self._accused)
        reaction = react(found, before, self._rules)
        remember(self._reactions, step.agent, reaction)
        if estimate is not None and reaction.caution >= Caution.WIDEN:
            confirmed = None
            if reaction.caution == Caution.CONFIRMED and step.seen is not None:
                confirmed = step.seen.confirmations(estimate.grid, estimate.target) > 0
            estimate = withdraw(estimate, reaction, confirmed, self._rules)
        speed_mps = 0.0 if estimate is None else speed_for_view(estimate, self._vehicle)
        # 4. Count and hand on.
        latency_s = time.perf_counter() - step.put_s
        with self._lock:
            if estimate is None:
                known = refused in self._refused or len(self._refused) < REASONS
                self._refused[refused if known else OTHER_REASONS] += 1
            else:
                self._answered += 1
                self._latencies.add(latency_s)
        self._to_publish.put(
            Answer(
                step.agent, step.number, leveled, estimate, report, reaction, speed_mps, tuple(notes), refused,
                latency_s, objects,
            )
        )  # fmt: skip

    def _follow(
        self, leveled: LeveledSweep, estimate: FovEstimate, report: StreamReport | None, notes: list[str]
    ) -> SeenObjects | None:
        """Return the objects of a sweep; None, counted and noted, where they cannot be had."""
        assert self._objects is not None
        try:
            objects = self._objects.follow(leveled, estimate, None if report is None else report.now)
        except Exception as error:
            notes.append(f"no objects: {_in_one_line(error)}")
            with self._lock:
                self._objects_failed += 1
            return None
        with self._lock:
            self._objects_took.add(objects.seconds)
        return objects

    def _publish_all(self) -> None:
        """Hand out the answers; once that has failed nothing more is taken in."""
        while (answer := self._to_publish.get()) is not None:
            if self._failure is None:
                try:
                    self._publish(answer)
                except BaseException as error:
                    self._failure = error
                    self._inbox.close()


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
    now, lasting = report.now, report.alarm or is_accused
    return Finding(now.degraded or suspicious, now.inconsistent or lasting, lasting, now.suspect)


def _in_one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
