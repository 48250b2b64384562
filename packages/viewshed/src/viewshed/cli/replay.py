"""``viewshed replay``: the sweeps of a recording at the pace at which they were measured."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import typer

from viewshed.cli._options import DEFAULT_READING, NO_OBJECTS, Index, ObjectOptions, Reading
from viewshed.cli._outputs import Failures, Named, output_names
from viewshed.cli._places import chosen_files
from viewshed.cli._profile import DEFAULT_PIPELINE, PipelineOptions, at_rate
from viewshed.cli._record import PendingSweep, SchemaNames, To, repeated, run_recorded
from viewshed.cli._stream import named_sweeps
from viewshed.cli.estimate import Files

DEFAULT_PERIOD_S = 0.1
"""Assumed time between two sweeps whose times are unknown or do not increase."""

MAX_PERIOD_S = 2.0
"""Longer gaps, as between the scenes of a recording, are shortened to this."""


@dataclass(slots=True)
class Pacer:
    """Yields sweeps when they are due."""

    rate: float  # speed relative to the measurement; 0 does not wait
    time_s: float = 0.0  # time of the last yielded sweep since the first

    def kept(self, sweeps: Iterable[Named]) -> Iterator[Named]:
        """Yield each sweep when it is due, at once if it is late."""
        begun, last = time.monotonic(), None
        for named in sweeps:
            now = named.sweep
            if last is None:
                begun = time.monotonic()
            elif now.t_ns is None or now.t_ns != last.t_ns or now.agent == last.agent:
                self.time_s += _period_s(last.t_ns, now.t_ns)
            if self.rate:
                time.sleep(max(0.0, begun + self.time_s / self.rate - time.monotonic()))
            last = now
            yield named


def _period_s(last_ns: int | None, now_ns: int | None) -> float:
    """Return the seconds between two sweeps.

    >>> _period_s(0, 50_000_000), _period_s(None, 0), _period_s(5, 0), _period_s(0, 10**12)
    (0.05, 0.1, 0.1, 2.0)
    """
    if last_ns is None or now_ns is None or now_ns <= last_ns:
        return DEFAULT_PERIOD_S
    return min((now_ns - last_ns) / 1e9, MAX_PERIOD_S)


def replay(
    ctx: typer.Context,
    files: Files = None,
    reading: Reading = DEFAULT_READING,
    index: Index = None,
    rate: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Pace: 1 as measured, 2 twice as fast.")] = 1.0,
    as_fast: Annotated[bool, typer.Option("--as-fast", help="Do not wait between sweeps; --rate is ignored.")] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Start over at the end, until Ctrl-C.")] = False,
    to: To = None,
    schemas: SchemaNames = "ros",
    running: PipelineOptions = DEFAULT_PIPELINE,
    object_options: ObjectOptions = NO_OBJECTS,
) -> None:
    """Estimate the sweeps of a recording as they would come in live.

    Prints one line for each sweep: time, visible area and latency. A sweep that is still waiting when the next one is
    due is dropped and counted, unless --as-fast. With --to, the sweeps and their results are written to a bag; with
    --as-fast, the same bytes each time.

    Example: viewshed replay drive.mcap --rate 2
    """
    settings, failures = running.settings(ctx), Failures()
    jobs = list(chosen_files(files or [], index))
    places = [file for file, _ in jobs]
    names = output_names(places)

    def read() -> Iterator[Named]:
        return named_sweeps(reading, jobs, names, failures, history=running.history)

    pace = Pacer(0.0 if as_fast else rate)
    paced = pace.kept(at_rate(repeated(read, loop=loop), settings.rate_hz))
    pending = (PendingSweep(one.sweep.agent, pace.time_s, one.sweep, scene=one.scene) for one in paced)
    run_recorded(
        running, settings, pending, object_options, failures, to=to, schemas=schemas, inputs=places, is_live=not as_fast
    )
