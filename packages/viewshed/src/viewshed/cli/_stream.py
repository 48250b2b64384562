"""Streams of named sweeps for ``estimate``, ``view`` and ``replay``."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from viewshed.cli._options import Reading
from viewshed.cli._outputs import Failures, Named, free_name, with_bar
from viewshed.cli._places import chosen_files
from viewshed.cli._terminal import BAD_INPUTS, note

if TYPE_CHECKING:
    from viewshed.estimators import Estimator
    from viewshed.estimators.temporal import SweepBuffer
    from viewshed.io import IndexEntry
    from viewshed.sweep import Sweep

    Job = tuple[Path, IndexEntry | None]


def named_sweeps(
    reading: Reading, jobs: list[Job], names: list[str], failures: Failures, *, history: int = 0
) -> Iterator[Named]:
    """Yield every readable sweep with its name and pose; report files that cannot be read.

    With a ``history`` of earlier sweeps, a sweep without a pose or a time is reported as well.
    """
    taken = {name.casefold() for name in names}
    files = with_bar(placed_sweeps(reading, jobs, failures), len(jobs))
    for (file, sweeps), name in zip(files, names, strict=True):
        try:
            for scene, sweep, sweep_name in _named(sweeps, name, taken):
                if history and (sweep.world_from_sensor is None or sweep.t_ns is None):
                    failures.report(file, ValueError(_NO_HISTORY))
                else:
                    yield Named(sweep, sweep_name, file, scene)
        except BAD_INPUTS as error:
            failures.report(file, error)


_NO_HISTORY = (
    "--history needs a pose and a time of each sweep, this one has none; give --poses FILE, an --index with poses, or a"
    " recording that has them"
)


def placed_sweeps(
    reading: Reading, jobs: list[Job], failures: Failures | None = None
) -> Iterator[tuple[Path, Iterator[tuple[str, Sweep]]]]:
    """Yield each file with its scenes and sweeps, with the poses of ``--poses``; note what was assumed about them.

    Sweeps of another scene are another stream; a file without times is one. A sweep without a pose in ``--poses`` is
    reported to ``failures`` and left out; without ``failures`` the error is raised.
    """
    files, poses = [file for file, _ in jobs], None
    if reading.poses is not None:
        from viewshed.recordings.read.pose_files import PoseFile

        poses = PoseFile.read(reading.poses)
        poses.check(files)
        for line in poses.notes:
            note(f"{reading.poses}: {line}")

    def placed(file: Path, entry: IndexEntry | None) -> Iterator[tuple[str, Sweep]]:
        for scene, number, sweep in reading.numbered_sweeps(file, entry):
            try:
                placed_sweep = sweep if poses is None else poses.place_sweep(sweep, file, number, files)
            except BAD_INPUTS as error:
                if failures is None:
                    raise
                failures.report(file, error)
                continue
            if placed_sweep.t_ns is None:  # its file, or itself if it is one of a folder, is a stream
                scene = f"{scene} {file} {number if file.is_dir() else ''}"  # noqa: PLW2901
            yield scene, placed_sweep

    for job in jobs:
        yield job[0], placed(*job)


def one_sweep(reading: Reading, file: Path, index: Path | None = None, number: int = 0) -> Sweep:
    """Return one sweep of a file, folder or recording, with the data of an index and poses."""
    count = 0
    jobs = list(chosen_files([file], index))
    for sweep in (sweep for _, sweeps in placed_sweeps(reading, jobs) for _, sweep in sweeps):
        if count > number:
            note(f"{file} holds more sweeps; number {number}, counted from 0, is used; --number selects another")
            break
        chosen, count = sweep, count + 1
    if count <= number:
        raise ValueError(f"number must be below {count}, the number of sweeps in {file}, got {number}")
    return chosen


def _named(sweeps: Iterator[tuple[str, Sweep]], name: str, taken: set[str]) -> Iterator[tuple[str, Sweep, str]]:
    """Yield scene, sweep and name of its results: the file's, with agent and number if it has several sweeps."""
    first = next(sweeps, None)
    if first is None:
        return
    try:
        second = next(sweeps, None)
    except BAD_INPUTS:
        yield *first, name
        raise
    if second is None:
        yield *first, name
        return
    for number, (scene, sweep) in enumerate(chain((first, second), sweeps)):
        agent = "" if sweep.agent == "ego" else f"_{sweep.agent.replace('/', '_')}"
        yield scene, sweep, free_name(f"{name}{agent}_{number:03}", taken)


def history_buffer(estimator: Estimator, sweeps: int) -> SweepBuffer | None:
    """Return a buffer of this many earlier sweeps for an estimator, or None for 0."""
    from viewshed.estimators.temporal import SweepBuffer

    if sweeps and not estimator.uses_history:
        raise ValueError(f"--history is for shadow_map, got {estimator.name}, which uses one sweep only")
    return SweepBuffer(sweeps) if sweeps else None
