"""``viewshed replay``: the sweeps of a recording at the pace at which they were measured."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import typer

from viewshed.cli._options import AS_THEY_ARE, NOT_FOLLOWED, Following, Index, Reading
from viewshed.cli._outputs import Failures, Named, output_names
from viewshed.cli._places import chosen_files
from viewshed.cli._profile import AS_USUAL, PipelineOptions, at_rate
from viewshed.cli._record import Awaited, SchemaNames, To, repeated, run_recorded
from viewshed.cli._stream import named_sweeps
from viewshed.cli.estimate import Files

USUAL_PERIOD_S = 0.1
"""Between two sweeps whose times are not known or do not rise."""

LONGEST_PERIOD_S = 2.0
"""Longer gaps, as between the scenes of a recording, are cut to this."""


@dataclass(slots=True)
class Pacer:
    """Hands sweeps on when they are due."""

    rate: float  # speed as a multiple of that of the measurement; 0 waits for none
    time_s: float = 0.0  # of the last sweep that was handed on, since the first

    def kept(self, sweeps: Iterable[Named]) -> Iterator[Named]:
        """Yield each sweep when it is due, at once if that is past."""
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
        return USUAL_PERIOD_S
    return min((now_ns - last_ns) / 1e9, LONGEST_PERIOD_S)


def replay(
    ctx: typer.Context,
    files: Files = None,
    reading: Reading = AS_THEY_ARE,
    index: Index = None,
    rate: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Pace: 1 as measured, 2 twice as fast.")] = 1.0,
    as_fast: Annotated[
        bool, typer.Option("--as-fast", help="Do not wait between sweeps; --rate does not count.")
    ] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")] = False,
    to: To = None,
    schemas: SchemaNames = "ros",
    running: PipelineOptions = AS_USUAL,
    following: Following = NOT_FOLLOWED,
) -> None:
    """Estimate the sweeps of a recording as they would come in live.

    Each is a line: time, visible area and latency. A sweep that is not begun when the next one is due is dropped and
    counted, unless --as-fast. With --to the sweeps and what came of them are written to a bag; with --as-fast the same
    bytes each time.

    Example: viewshed replay drive.mcap --rate 2
    """
    chosen, failures = running.settings(ctx), Failures()
    jobs = list(chosen_files(files or [], index))
    places = [file for file, _ in jobs]
    names = output_names(places)

    def read() -> Iterator[Named]:
        return named_sweeps(reading, jobs, names, failures, history=running.history)

    pace = Pacer(0.0 if as_fast else rate)
    taken = pace.kept(at_rate(repeated(read, loop=loop), chosen.rate_hz))
    awaited = (Awaited(each.sweep.agent, pace.time_s, each.sweep) for each in taken)
    run_recorded(
        running, chosen, awaited, following, failures, to=to, schemas=schemas, inputs=places, is_live=not as_fast
    )
