"""Sweeps one after the other, with their names, for ``estimate``, ``view`` and ``replay``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from viewshed.cli._options import BAD_INPUTS, Reading
from viewshed.cli._outputs import Failures, Named, free_name, with_bar

if TYPE_CHECKING:
    from viewshed.estimators import Estimator
    from viewshed.estimators.temporal import SweepBuffer
    from viewshed.io import IndexEntry
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


def history_buffer(estimator: Estimator, sweeps: int) -> SweepBuffer | None:
    """Return what keeps so many earlier sweeps for an estimator, or None for none.

    Raises:
        ValueError: the estimator uses no history.
    """
    from viewshed.estimators.temporal import SweepBuffer

    if sweeps and not estimator.uses_history:
        raise ValueError(f"--history helps viewnet and shadow_map, got {estimator.name}, which looks at one sweep")
    return SweepBuffer(sweeps) if sweeps else None
