"""Running a pipeline over sweeps with the answers handed to recorders, for ``replay``, ``record`` and ``view``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from viewshed.cli._outputs import Failures, Named, refuse_inputs
from viewshed.cli._verdicts import stream_verdicts

if TYPE_CHECKING:
    from viewshed.datasets.recorder.moment import DriveTruth, Moment, RisingTimes
    from viewshed.pipeline import Answer, Pipeline
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
    """

    def __init__(self, records: Sequence[Record], failures: Failures, *, is_live: bool) -> None:
        self._records, self._failures, self._is_live = records, failures, is_live
        self._awaited: dict[int, Awaited] = {}
        self._times: RisingTimes | None = None

    def expect(self, number: int, awaited: Awaited) -> None:
        """Keep a sweep until its answer comes, or that of a later one of its agent."""
        self._awaited[number] = awaited

    def __call__(self, answer: Answer) -> None:
        """Take an answer."""
        awaited = self._awaited[answer.number]
        # Earlier sweeps of the agent have no answer any more: they were dropped.
        for number in [k for k, each in self._awaited.items() if each.agent == awaited.agent and k <= answer.number]:
            del self._awaited[number]
        if answer.estimate is None:
            self._failures.report(f"{awaited.due_s:.3f} s", ValueError(answer.refused))
        else:
            said = "" if answer.report is None else f"; {stream_verdicts(answer.report)}"
            visible = f"visible {answer.estimate.area_m2():.0f} m²"
            typer.echo(f"{awaited.due_s:9.3f} s  {visible}  {1e3 * answer.latency_s:.1f} ms{said}")
        if self._records:
            self._record(answer, awaited)

    def _record(self, answer: Answer, awaited: Awaited) -> None:
        from viewshed.datasets.recorder.moment import Moment, RisingTimes

        self._times = self._times or RisingTimes()
        t_ns = self._times.of(awaited.agent, awaited.sweep.t_ns)
        moment = Moment(awaited.agent, t_ns, awaited.sweep, answer, awaited.truth, self._is_live)
        for record in self._records:
            record(moment)


@contextmanager
def recorders(to: Path | None, schemas: str, inputs: Sequence[Path]) -> Iterator[list[Record]]:
    """Open the bag to write, if any.

    Raises:
        ValueError: it would replace an input, or its name is that of no bag.
    """
    if to is None:
        if schemas != "ros":
            raise ValueError("--schemas goes with --to")
        yield []
        return
    from viewshed.datasets.recorder.recorder import open_recorder

    refuse_inputs([to], inputs)
    with open_recorder(to, schemas) as record:
        yield [record]


def written_line(place: Path) -> str:
    """Return what was written, and how much it is."""
    files = [place] if place.is_file() else sorted(place.iterdir())
    return f"{place}: {sum(file.stat().st_size for file in files) / 1e6:.2f} MB"


def repeated(read: Callable[[], Iterable[Named]], *, loop: bool) -> Iterator[Named]:
    """Yield the sweeps once, or again and again as long as any can be read."""
    is_any = True
    while is_any:
        is_any = False
        for named in read():
            is_any = loop
            yield named


def run(pipeline: Pipeline, listener: Listener, sweeps: Iterable[Awaited]) -> int:
    """Put sweeps into a pipeline whose answers go to a listener, print what was done, and return how many they were."""
    from viewshed.pipeline import prepare_process

    prepare_process()
    count = 0
    try:
        with pipeline:
            for each in sweeps:
                listener.expect(count, each)
                pipeline.put(each.sweep, each.agent)
                count += 1
    finally:
        typer.echo(pipeline.statistics().line())
    return count
