"""Running a pipeline over sweeps with the answers handed to recorders, for ``replay``, ``record`` and ``view``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from viewshed.cli._options import NOT_FOLLOWED, Following, NetworkOptions, parse_grid
from viewshed.cli._outputs import Failures, Named, refuse_inputs
from viewshed.cli._profile import PipelineOptions
from viewshed.cli._stream import history_buffer
from viewshed.cli._terminal import note
from viewshed.cli._verdicts import stream_verdicts, watching

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


class Awaited(NamedTuple):
    """A sweep whose answer is awaited: of whom, when it was due since the first, and what a simulation tells of it."""

    agent: str
    due_s: float
    sweep: Sweep
    truth: DriveTruth | None = None


class Listener:
    """Prints the line of each answer and hands it, with its sweep, to what records.

    Args:
        records: what takes the moments.
        failures: count the sweeps that were refused.
        is_live: whether latencies are recorded.
        following: whether agents are put together.
        adversary: who forges, or None.
    """

    def __init__(
        self,
        records: Sequence[Record],
        failures: Failures,
        *,
        is_live: bool,
        following: Following = NOT_FOLLOWED,
        adversary: Adversary | None = None,
    ) -> None:
        self._records, self._failures, self._is_live = records, failures, is_live
        self._awaited: dict[int, Awaited] = {}
        self._awaited_lock = Lock()  # sweeps are sent by one thread while another takes the answers
        self._times: RisingTimes | None = None
        self._center = Center(adversary) if following.fuse else None
        self._adversary, self._forged = adversary, set[str]()
        self._metrics: TrackMetrics | None = None
        self.on_accused: Callable[[frozenset[str]], None] = lambda agents: None
        """Is given the agents that the center accuses, after each round."""
        self.failed = False
        """Whether an answer could not be taken; none is taken after that."""

    def expect(self, number: int, awaited: Awaited) -> None:
        """Keep a sweep until its answer comes, or that of a later one of its agent."""
        with self._awaited_lock:
            self._awaited[number] = awaited

    def __call__(self, answer: Answer) -> None:
        """Take an answer, unless one could not be taken before: what is recorded has no gaps."""
        if self.failed:
            return
        try:
            self._take(answer)
        except Exception:
            self.failed = True
            raise

    def _take(self, answer: Answer) -> None:
        with self._awaited_lock:
            awaited = self._awaited[answer.number]
            # Earlier sweeps of the agent have no answer any more: they were dropped.
            for number in [
                k for k, each in self._awaited.items() if each.agent == awaited.agent and k <= answer.number
            ]:
                del self._awaited[number]
        if answer.estimate is None:
            self._failures.report(f"{awaited.due_s:.3f} s", ValueError(answer.refused))
        else:
            findings = "" if answer.report is None else f"; {stream_verdicts(answer.report)}"
            visible = f"visible {answer.estimate.area_m2():.0f} m²"
            findings += "" if answer.objects is None else objects_line(answer.objects)
            typer.echo(f"{awaited.due_s:9.3f} s  {visible}  {1e3 * answer.latency_s:.1f} ms{findings}")
        done = None if self._center is None else self._center.take(answer)
        if done is not None and self._center is not None:
            self.on_accused(self._center.accused)
        if self._records:
            self._record(answer, awaited, done)

    def _record(self, answer: Answer, awaited: Awaited, done: Round | None) -> None:
        from viewshed.recordings.write.moment import Moment, RisingTimes

        self._times = self._times or RisingTimes()
        t_ns = self._times.of(awaited.agent, awaited.sweep.t_ns)
        if self._adversary is not None:
            known = {awaited.agent} if awaited.truth is None else set(awaited.truth.mounts)
            self._forged |= self._adversary.agents or known
        moment = Moment(
            awaited.agent, t_ns, awaited.sweep, answer, awaited.truth, self._is_live, self._metrics_of(answer, awaited),
            tuple(sorted(self._forged)), done, None if self._center is None else self._center.trust.get(awaited.agent),
        )  # fmt: skip
        for record in self._records:
            record(moment)

    def _metrics_of(self, answer: Answer, awaited: Awaited) -> dict[str, float]:
        """Return how well the tracks agree with the truth; nothing where there is no truth, or there are no tracks."""
        if answer.objects is None or awaited.truth is None:
            return {}
        from viewshed.recordings.write.track_metrics import TrackMetrics

        self._metrics = self._metrics or TrackMetrics()
        return self._metrics.of(awaited.agent, 1e-9 * (awaited.sweep.t_ns or 0), answer.objects, awaited.truth)


class Center:
    """Puts the answers of several agents together and prints a line for each round.

    Args:
        adversary: who forges claimed fields of view, or None.
    """

    def __init__(self, adversary: Adversary | None = None) -> None:
        from viewshed.agents.rounds import Rounds

        self._rounds, self._adversary = Rounds(), adversary
        self._last: Round | None = None
        self.trust: dict[str, float] = {}
        """In each agent, after the last round."""
        self.accused: frozenset[str] = frozenset()
        """Agents that lie by the center's limits, after the last round."""

    def take(self, answer: Answer) -> Round | None:
        """Return the last round that an answer ended, if it did."""
        if answer.leveled is None or answer.estimate is None or answer.objects is None:
            return None
        return self.add(answer.leveled.delivered, answer.estimate, answer.objects)

    def add(self, sweep: Sweep, estimate: FovEstimate, objects: SeenObjects) -> Round | None:
        """Return the last round that a report ended, if it did; a pose is as certain as its sweep states."""
        from viewshed.agents.registration import PoseStd
        from viewshed.agents.report import AgentReport
        from viewshed.cli.fuse import line_of, note_gaps

        if estimate.t_ns is None or estimate.world_from_level is None:
            raise ValueError(
                f"--fuse needs a time and a pose of each sweep, {estimate.agent} has one without; give --poses"
            )
        claimed = estimate if self._adversary is None else self._adversary.view(estimate)
        report = AgentReport.of(claimed, objects.detections, PoseStd.stated_by(sweep), objects.ground)
        done = self._rounds.add(1e-9 * estimate.t_ns, report)
        for line in self._rounds.notes:
            note(line)
        for each in done:
            typer.echo(f"center: {line_of(each)}")
            note_gaps(each, self._last)
            self._last = each
            agents = each.picture.agents
            self.trust |= dict(zip(agents, each.picture.verdicts.trust.tolist(), strict=True))
            self.accused = frozenset(name for name, flag in zip(agents, each.accused, strict=True) if flag)
        return done[-1] if done else None


def objects_line(objects: SeenObjects) -> str:
    """Return how many objects are detected and tracked, and how many tracks are suspicious."""
    suspicious = int((objects.shown & objects.explained.accused).sum())
    counts = f"; {len(objects.detections)} objects, {objects.shown.sum()} tracks"
    return counts + (f", {suspicious} suspicious" if suspicious else "")


def run_recorded(
    running: PipelineOptions,
    chosen: Profile,
    sweeps: Iterable[Awaited],
    following: Following,
    failures: Failures,
    *,
    to: Path | None,
    schemas: str,
    inputs: Sequence[Path],
    is_live: bool,
) -> None:
    """Answer sweeps, write what came of them to a bag if one is named, and end the command with its exit code.

    Live, a sweep that comes too late is dropped; else each is answered, and equal sweeps give equal bytes.
    """
    estimator = NetworkOptions().estimator(chosen.method, parse_grid(chosen.grid), running.target)
    buffer, watch = history_buffer(estimator, chosen.history), watching(chosen.monitor, running.monitor_file)
    with recorders(to, schemas, inputs) as records:
        count = answer(
            records, sweeps, estimator, buffer, watch, chosen, following, failures, is_live=is_live,
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
    """Yield the sweeps once, or again and again as long as any can be read."""
    is_any = True
    while is_any:
        is_any = False
        for named in read():
            is_any = loop
            yield named


def answer(
    records: Sequence[Record],
    sweeps: Iterable[Awaited],
    estimator: Estimator,
    history: SweepBuffer | None,
    watch: StreamMonitor | None,
    chosen: Profile,
    following: Following,
    failures: Failures,
    *,
    is_live: bool,
    certified_only: bool = False,
) -> int:
    """Answer sweeps, hand the answers to what records, and return how many sweeps there were; see :func:`run`."""
    from viewshed.pipeline import Pipeline

    adversary = following.adversary()
    listener = Listener(records, failures, is_live=is_live, following=following, adversary=adversary)
    pipeline = Pipeline(
        estimator, listener, history=history, monitor=watch, objects=following.object_stream(adversary),
        rules=chosen.rules, certify=chosen.certify, certified_only=certified_only,
        lossless=not is_live, stale_after_s=math.inf,
    )  # fmt: skip
    return run(pipeline, listener, sweeps, adversary)


def run(pipeline: Pipeline, listener: Listener, sweeps: Iterable[Awaited], adversary: Adversary | None = None) -> int:
    """Put sweeps into a pipeline whose answers go to a listener, print what was done, and return how many they were.

    An adversary forges them before.
    """
    from viewshed.pipeline import prepare_process

    prepare_process()
    count, listener.on_accused = 0, pipeline.accuse
    try:
        with pipeline:
            for each in sweeps:
                if listener.failed:  # the pipeline raises why when it closes
                    break
                sent = each if adversary is None else each._replace(sweep=adversary.sweep(each.sweep))
                listener.expect(count, sent)
                pipeline.put(sent.sweep, sent.agent)
                count += 1
    finally:
        if count:
            typer.echo(pipeline.statistics().line())
    note_unmet(adversary)
    return count


def note_unmet(adversary: Adversary | None) -> None:
    """Say which agents were to be attacked and never came."""
    if adversary is not None and adversary.unmet():
        note(f"--attacked {', '.join(sorted(adversary.unmet()))}: no agent has this name, nothing of it was forged")
