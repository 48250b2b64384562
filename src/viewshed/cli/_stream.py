"""Sweeps one after the other, for ``estimate``, ``view`` and ``replay``: read, named, leveled, estimated, timed."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from viewshed.cli._options import BAD_INPUTS, Reading
from viewshed.cli._outputs import Failures, Named, free_name, warm_up, with_bar

if TYPE_CHECKING:
    from viewshed.estimators import Estimator
    from viewshed.fov.estimate import FovEstimate
    from viewshed.io import IndexEntry
    from viewshed.preprocess.leveling import LeveledSweep
    from viewshed.sweep import Sweep

    Job = tuple[Path, IndexEntry | None]


def named_sweeps(reading: Reading, jobs: list[Job], names: list[str], failures: Failures) -> Iterator[Named]:
    """Yield every sweep that can be read, with its name; what cannot is reported."""
    taken = {name.casefold() for name in names}
    for (file, entry), name in zip(with_bar(jobs, len(jobs)), names, strict=True):
        try:
            yield from (Named(sweep, own, file) for sweep, own in _named(reading.sweeps(file, entry), name, taken))
        except BAD_INPUTS as error:
            failures.report(file, error)


def _named(sweeps: Iterator[Sweep], name: str, taken: set[str]) -> Iterator[tuple[Sweep, str]]:
    """Yield each sweep with the name of its results: the file's, or numbered ones where it holds several."""
    first = next(sweeps)
    try:
        second = next(sweeps, None)
    except BAD_INPUTS:
        yield first, name
        raise
    if second is None:
        yield first, name
        return
    yield first, free_name(f"{name}_000", taken)
    yield second, free_name(f"{name}_001", taken)
    for number, sweep in enumerate(sweeps, start=2):
        yield sweep, free_name(f"{name}_{number:03}", taken)


@dataclass(frozen=True, slots=True, eq=False)
class Estimated:
    """A sweep with its estimate.

    Attributes:
        named: the sweep as it was read.
        leveled: the same, leveled.
        estimate: what it could see.
        elapsed_ms: time of leveling and estimating.
    """

    named: Named
    leveled: LeveledSweep
    estimate: FovEstimate
    elapsed_ms: float


def estimated(sweeps: Iterable[Named], estimator: Estimator, failures: Failures) -> Iterator[Estimated]:
    """Yield each sweep with its estimate; the sensor of each is first expected to be that of the one before."""
    from viewshed.preprocess.leveling import level

    sensor, is_warm = None, False
    for named in sweeps:
        try:
            if not is_warm:
                warm_up(estimator, named.sweep)
                is_warm = True
            start = time.perf_counter()
            leveled = level(named.sweep, estimator.grid, sensor)
            estimate = estimator.estimate(leveled)
            elapsed_ms = 1e3 * (time.perf_counter() - start)
        except BAD_INPUTS as error:
            failures.report(named.file, error)
            continue
        sensor = leveled.sensor_id.model
        yield Estimated(named, leveled, estimate, elapsed_ms)
