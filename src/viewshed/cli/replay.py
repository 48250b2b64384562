"""``viewshed replay``: the sweeps of a recording at the pace at which they were measured."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO, HistorySweeps, NetworkOptions, Reading
from viewshed.cli._outputs import Failures, Named, output_names
from viewshed.cli._stream import estimated, named_sweeps
from viewshed.cli.estimate import Files, Method

if TYPE_CHECKING:
    from viewshed.estimators import Estimator

USUAL_PERIOD_S = 0.1
"""Between two sweeps whose times are not known or do not rise."""

LONGEST_PERIOD_S = 2.0
"""Longer gaps, as between the scenes of a recording, are cut to this."""


@dataclass(slots=True)
class Pace:
    """Hands sweeps on when they are due.

    Attributes:
        rate: so many times as fast as they were measured; 0 waits for none.
        time_s: of the last sweep that was handed on, since the first.
    """

    rate: float
    time_s: float = 0.0

    def kept(self, sweeps: Iterable[Named]) -> Iterator[Named]:
        """Yield each sweep when it is due, at once if that is past."""
        begun, last_ns = None, None
        for named in sweeps:
            if begun is None:
                begun = time.monotonic()
            else:
                self.time_s += _period_s(last_ns, named.sweep.t_ns)
            if self.rate:
                time.sleep(max(0.0, begun + self.time_s / self.rate - time.monotonic()))
            last_ns = named.sweep.t_ns
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
    files: Files = None,
    method: Method = None,
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    index: options.Index = None,
    target: options.TargetName = "car",
    history: HistorySweeps = 0,
    rate: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Times as fast as it was measured.")] = 1.0,
    as_fast: Annotated[bool, typer.Option("--as-fast", help="Wait for nothing, whatever --rate.")] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")] = False,
) -> None:
    """Estimate the sweeps of a recording at their own pace: one line each, with time, visible area and latency.

    A sweep that comes late is not left out: those after it wait no longer than they must.

    Example: viewshed replay drive.mcap --rate 2
    """
    from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator

    estimator: Estimator = NetworkOptions().estimator(method, options.parse_grid(grid), target)
    if history:
        estimator = TemporalEstimator(estimator, SweepBuffer(history))
    reading, failures = Reading(sensor), Failures()
    jobs = list(options.chosen(files or [], index))
    names = output_names([file for file, _ in jobs])

    def read() -> Iterator[Named]:
        """Yield the sweeps once, or again and again as long as any can be read."""
        is_any = True
        while is_any:
            is_any = False
            for named in named_sweeps(reading, jobs, names, failures):
                is_any = loop
                yield named

    pace = Pace(0.0 if as_fast else rate)
    latencies_ms: list[float] = []
    for each in estimated(pace.kept(read()), estimator, failures):
        latencies_ms.append(each.elapsed_ms)
        visible = f"visible {each.estimate.area_m2():.0f} m²"
        typer.echo(f"{pace.time_s:9.3f} s  {each.named.name}  {visible}  {each.elapsed_ms:.1f} ms")
    if latencies_ms:
        ordered = sorted(latencies_ms)
        typer.echo(
            f"{len(ordered)} sweeps, latency {ordered[len(ordered) // 2]:.1f} ms (median),"
            f" {ordered[-1]:.1f} ms (longest)"
        )
    if failures.count:
        raise typer.Exit(2)
