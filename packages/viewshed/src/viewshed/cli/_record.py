"""Run a pipeline over sweeps and hand the answers to recorders, for ``replay``, ``record`` and ``view``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from viewshed.cli._options import NO_OBJECTS, NetworkOptions, ObjectOptions, parse_grid
from viewshed.cli._outputs import Failures, Named, Streams, refuse_inputs
from viewshed.cli._profile import PipelineOptions
from viewshed.cli._stream import history_buffer
from viewshed.cli._terminal import note
from viewshed.cli._verdicts import optional_monitor, stream_verdicts

if TYPE_CHECKING:
    from viewshed.agents.rounds import Round
    from viewshed.estimators import Estimator
    from viewshed.estimators.temporal import SweepBuffer
    from viewshed.fov.estimate import FovEstimate
    from viewshed.monitor import StreamMonitor
    from viewshed.objects.object_stream import SeenObjects
    from viewshed.pipeline import Answer, Pipeline
    from viewshed.pipeline.adversary import Adversary
    from viewshed.pipeline.profiles import Profile
    from viewshed.recordings.write.moment import DriveTruth, Moment, RisingTimes
    from viewshed.recordings.write.track_metrics import TrackMetrics
    from viewshed.sweep import Sweep

    Record = Callable[[Moment], None]

To = Annotated[
    Path | None, typer.Option("--to", help="Bag to write: NAME.mcap, NAME.bag (ROS 1), or a folder (ROS 2).")
]
SchemaNames = Annotated[str, typer.Option("--schemas", help="Messages of the bag: ros, or foxglove (NAME.mcap).")]


class PendingSweep(NamedTuple):
    """A sweep whose answer is pending."""

    agent: str
    due_s: float  # time since the first sweep
    sweep: Sweep
    truth: DriveTruth | None = None  # of a simulation
    scene: str = ""  # sweeps of another scene are another stream


class Listener:
    """Prints a line for each answer and hands the answer, with its sweep, to recorders.

    Args:
        records: called with each moment.
        failures: reports refused sweeps.
        is_live: whether latencies are recorded.
        object_options: whether agents are fused.
        adversary: of a simulated attack, or None.
    """

    def __init__(
        self,
        records: Sequence[Record],
        failures: Failures,
        *,
        is_live: bool,
        object_options: ObjectOptions = NO_OBJECTS,
        adversary: Adversary | None = None,
    ) -> None:
        self._records, self._failures, self._is_live = records, failures, is_live
        self._pending: dict[int, PendingSweep] = {}
        self._pending_lock = Lock()  # one thread sends sweeps while another takes answers
        self._times: RisingTimes | None = None
        self._center = Center(adversary) if object_options.fuse else None
        self._scene = ""
        self._adversary, self._forged = adversary, set[str]()
        self._metrics: TrackMetrics | None = None
        self.on_accused: Callable[[frozenset[str]], None] = lambda agents: None
        """Called after each round with the agents that the center accuses."""
        self.failed = False
        """Whether an answer could not be handled; later ones are ignored then."""

    def expect(self, number: int, pending: PendingSweep) -> None:
        """Remember a sweep until its answer comes, or the answer of a later sweep of its agent."""
        with self._pending_lock:
            self._pending[number] = pending

    def __call__(self, answer: Answer) -> None:
        """Handle an answer, unless one has failed: recordings must have no gaps."""
        if self.failed:
            return
        try:
            self._take(answer)
        except Exception:
            self.failed = True
            raise

    def _take(self, answer: Answer) -> None:
        with self._pending_lock:
            pending = self._pending[answer.number]
            # Earlier sweeps of the agent were dropped and get no answer.
            for number in [k for k, one in self._pending.items() if one.agent == pending.agent and k <= answer.number]:
                del self._pending[number]
        if answer.estimate is None:
            self._failures.report(f"{pending.due_s:.3f} s", ValueError(answer.refused))
        else:
            findings = "" if answer.report is None else f"; {stream_verdicts(answer.report)}"
            visible = f"visible {answer.estimate.area_m2():.0f} m²"
            findings += "" if answer.objects is None else objects_line(answer.objects)
            typer.echo(f"{pending.due_s:9.3f} s  {visible}  {1e3 * answer.latency_s:.1f} ms{findings}")
        if self._center is not None and pending.scene != self._scene:
            self._center, self._scene = Center(self._adversary), pending.scene
        done = None if self._center is None else self._center.take(answer)
        if done is not None and self._center is not None:
            self.on_accused(self._center.accused)
        if self._records:
            self._record(answer, pending, done)

    def _record(self, answer: Answer, pending: PendingSweep, done: Round | None) -> None:
        from viewshed.recordings.write.moment import Moment, RisingTimes

        self._times = self._times or RisingTimes()
        t_ns = self._times.of(pending.agent, pending.sweep.t_ns)
        if self._adversary is not None:
            known = {pending.agent} if pending.truth is None else set(pending.truth.mounts)
            self._forged |= self._adversary.agents or known
        moment = Moment(
            pending.agent, t_ns, pending.sweep, answer, pending.truth, self._is_live, self._metrics_of(answer, pending),
            tuple(sorted(self._forged)), done, None if self._center is None else self._center.trust.get(pending.agent),
        )  # fmt: skip
        for record in self._records:
            record(moment)

    def _metrics_of(self, answer: Answer, pending: PendingSweep) -> dict[str, float]:
        """Return metrics of the tracks against the truth; empty without truth or tracks."""
        if answer.objects is None or pending.truth is None:
            return {}
        from viewshed.recordings.write.track_metrics import TrackMetrics

        self._metrics = self._metrics or TrackMetrics()
        return self._metrics.of(pending.agent, 1e-9 * (pending.sweep.t_ns or 0), answer.objects, pending.truth)


class Center:
    """Fuses the answers of several agents and prints a line for each round.

    Args:
        adversary: forges claimed fields of view, or None.
    """

    def __init__(self, adversary: Adversary | None = None) -> None:
        from viewshed.agents.rounds import Rounds

        self._rounds, self._adversary = Rounds(), adversary
        self._last: Round | None = None
        self.trust: dict[str, float] = {}
        """Trust in each agent after the last round."""
        self.accused: frozenset[str] = frozenset()
        """Agents accused of lies after the last round."""

    def take(self, answer: Answer) -> Round | None:
        """Add an answer and return the last round that it completed, if any."""
        if answer.leveled is None or answer.estimate is None or answer.objects is None:
            return None
        return self.add(answer.leveled.delivered, answer.estimate, answer.objects)

    def add(self, sweep: Sweep, estimate: FovEstimate, objects: SeenObjects) -> Round | None:
        """Add a report and return the last round that it completed, if any; pose errors are those the sweep states."""
        from viewshed.agents.registration import PoseStd
        from viewshed.agents.report import AgentReport
        from viewshed.cli.fuse import line_of, note_gaps

        if estimate.t_ns is None or estimate.world_from_level is None:
            raise ValueError(
                f"--fuse needs a time and a pose of each sweep, {estimate.agent} has a sweep without them; give --poses"
            )
        claimed = estimate if self._adversary is None else self._adversary.view(estimate)
        report = AgentReport.of(claimed, objects.detections, PoseStd.stated_by(sweep), objects.ground)
        rounds = self._rounds.add(1e-9 * estimate.t_ns, report)
        for line in self._rounds.notes:
            note(line)
        for done in rounds:
            typer.echo(f"center: {line_of(done)}")
            note_gaps(done, self._last)
            self._last = done
            agents = done.picture.agents
            self.trust |= dict(zip(agents, done.picture.verdicts.trust.tolist(), strict=True))
            self.accused = frozenset(name for name, flag in zip(agents, done.accused, strict=True) if flag)
        return rounds[-1] if rounds else None


def objects_line(objects: SeenObjects) -> str:
    """Return the numbers of detected objects, tracks and suspicious tracks as text."""
    suspicious = int((objects.shown & objects.explained.accused).sum())
    counts = f"; {len(objects.detections)} objects, {objects.shown.sum()} tracks"
    return counts + (f", {suspicious} suspicious" if suspicious else "")


def run_recorded(
    running: PipelineOptions,
    settings: Profile,
    sweeps: Iterable[PendingSweep],
    object_options: ObjectOptions,
    failures: Failures,
    *,
    to: Path | None,
    schemas: str,
    inputs: Sequence[Path],
    is_live: bool,
) -> None:
    """Answer sweeps, write sweeps and answers to a bag if one is named, and exit with code 2 after failures.

    Live, late sweeps are dropped. Otherwise each is answered, and equal sweeps give equal bytes.
    """
    estimator = NetworkOptions().estimator(settings.method, parse_grid(settings.grid), running.target)
    buffer = history_buffer(estimator, settings.history)
    watch = optional_monitor(settings.monitor, running.monitor_file)
    with recorders(to, schemas, inputs) as records:
        count = answer(
            records, sweeps, estimator, buffer, watch, settings, object_options, failures, is_live=is_live,
            certified_only=running.certified_only,
        )  # fmt: skip
        if to is not None and not count:
            raise ValueError(f"no sweep could be read, {to} was not written")
    if to is not None:
        files = [to] if to.is_file() else sorted(to.iterdir())
        typer.echo(f"{to}: {sum(file.stat().st_size for file in files) / 1e6:.2f} MB")
    if failures.count:
        raise typer.Exit(2)


@contextmanager
def recorders(to: Path | None, schemas: str, inputs: Sequence[Path]) -> Iterator[list[Record]]:
    """Open the bag to write, if any."""
    if to is None:
        if schemas != "ros":
            raise ValueError("--schemas goes with --to")
        yield []
        return
    from viewshed.recordings.write.recorder import open_recorder

    refuse_inputs([to], inputs)
    with open_recorder(to, schemas) as record:
        yield [record]


def repeated(read: Callable[[], Iterable[Named]], *, loop: bool) -> Iterator[Named]:
    """Yield the sweeps once, or in a loop as long as any can be read."""
    is_any = True
    while is_any:
        is_any = False
        for named in read():
            is_any = loop
            yield named


def answer(
    records: Sequence[Record],
    sweeps: Iterable[PendingSweep],
    estimator: Estimator,
    history: SweepBuffer | None,
    watch: StreamMonitor | None,
    settings: Profile,
    object_options: ObjectOptions,
    failures: Failures,
    *,
    is_live: bool,
    certified_only: bool = False,
) -> int:
    """Answer sweeps, hand the answers to the recorders, and return the number of sweeps; see :func:`run`."""
    from viewshed.pipeline import Pipeline

    adversary = object_options.adversary()
    listener = Listener(records, failures, is_live=is_live, object_options=object_options, adversary=adversary)
    pipeline = Pipeline(
        estimator, listener, history=history, monitor=watch, objects=object_options.object_stream(adversary),
        rules=settings.rules, certify=settings.certify, certified_only=certified_only,
        lossless=not is_live, stale_after_s=math.inf,
    )  # fmt: skip
    return run(pipeline, listener, sweeps, adversary, is_judged=watch is not None)


def run(
    pipeline: Pipeline,
    listener: Listener,
    sweeps: Iterable[PendingSweep],
    adversary: Adversary | None = None,
    *,
    is_judged: bool = False,
) -> int:
    """Put sweeps into a pipeline whose answers go to a listener, print statistics, return the number of sweeps.

    An adversary forges the sweeps first; ``is_judged`` says whether the pipeline has a monitor.
    """
    from viewshed.pipeline import prepare_process

    prepare_process()
    count, streams, listener.on_accused = 0, Streams(is_judged), pipeline.accuse
    try:
        with pipeline:
            for pending in sweeps:
                if listener.failed:  # the pipeline raises the error when it closes
                    break
                if streams.begins(pending.scene, pending.sweep):
                    pipeline.begin_anew()
                sent = pending if adversary is None else pending._replace(sweep=adversary.sweep(pending.sweep))
                listener.expect(count, sent)
                pipeline.put(sent.sweep, sent.agent)
                count += 1
    finally:
        if count:
            typer.echo(pipeline.statistics().line())
    note_unmet(adversary)
    return count


def note_unmet(adversary: Adversary | None) -> None:
    """Note the agents of ``--attacked`` from which no sweep came."""
    if adversary is not None and adversary.unmet():
        note(f"--attacked {', '.join(sorted(adversary.unmet()))}: no agent has this name, nothing of it was forged")
