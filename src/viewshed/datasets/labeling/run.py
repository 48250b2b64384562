"""A recording labeled from start to end: an archive whose truth is the label."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

from viewshed._jobs import Engine
from viewshed.datasets.archive.archive import Archive, ArchiveSource
from viewshed.datasets.archive.build import FRAMES_PER_SHARD, BuildPlan, ShardResult, build_archive, build_shard
from viewshed.datasets.archive.schema import Layout, is_archive
from viewshed.datasets.archive.storage import Storage
from viewshed.datasets.labeling.labeler import TARGETS, LabeledDrive, LabelRules
from viewshed.datasets.recordings import open_source
from viewshed.datasets.recordings.source import SweepRef, SweepSource, open_index
from viewshed.datasets.sample import Sample
from viewshed.preprocess.sensor_identification import infer_sensor
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sim.lidar.stored_sweep import StoredSweep
from viewshed.sweep import Sweep

SPLIT = "all"
"""Name of the split of recordings that have none."""


@dataclass(frozen=True, slots=True)
class Origin:
    """A recording that is labeled; small enough to travel to other processes.

    Attributes:
        place: folder, file or URI.
        kind: a name in ``SOURCES``, "archive", "index", or "auto" to know it by its layout.
        sensor: a beam table's name for sweeps that do not name theirs, "auto" to know it by the returns, or "none".
        every: whether sweeps that the recording does not mark as keyframes are labeled as well.
    """

    place: str
    kind: str = "auto"
    sensor: str = "auto"
    every: bool = False

    def open(self) -> SweepSource:
        """Return the recording.

        Raises:
            ValueError: it is damaged, or its layout is not known.
            OSError: it cannot be read.
        """
        if self.kind == "index":
            return open_index(self.place)
        if self.kind == "archive" or (self.kind == "auto" and ("://" in self.place or is_archive(Path(self.place)))):
            return ArchiveSource.open(self.place)
        return open_source(self.place, self.kind)


@dataclass(frozen=True, slots=True)
class LabelJob:
    """What a worker must know to label one shard.

    Attributes:
        store: where the shard goes.
        name: of its file.
        origin: the recording.
        scene: that its frames are from.
        sensor: agent and sensor that measured them.
        first: the first of its labels among those of the sensor in the scene.
        last: the one after its last.
        rules: how they are labeled.
    """

    store: Storage
    name: str
    origin: Origin
    scene: str
    sensor: tuple[str, str]
    first: int
    last: int
    rules: LabelRules


def label(
    origin: Origin,
    rules: LabelRules,
    store: Storage,
    engine: Engine,
    on_progress: Callable[[ShardResult], None] | None = None,
) -> Archive:
    """Return the archive of a recording's sweeps with their labels, made into ``store``.

    The same bytes for any engine. Sweeps that cannot be read are left out and reported to ``on_progress``; labels of an
    earlier run that was stopped are kept.

    Args:
        origin: the recording; of an archive only the sweeps are read.
        rules: how it is labeled.
        store: where the archive goes.
        engine: makes the shards.
        on_progress: is called with each shard that is done, and of what could not be read.

    Raises:
        ValueError: the recording has no sweeps, or the place holds something else.
        OSError: something cannot be read or written.
    """
    jobs, problems = jobs_of(origin, rules, store)
    if on_progress is not None and problems:
        on_progress(ShardResult(None, problems))
    if not jobs:
        raise ValueError(f"{origin.place} must hold sweeps, got none that can be labeled")
    layout = Layout(rules.grid, tuple(sorted(target.name for target in TARGETS)), ("farthest", "first_blocker"))
    return build_archive(BuildPlan(recipe_of(origin, rules), layout, jobs, label_shard), store, engine, on_progress)


def recipe_of(origin: Origin, rules: LabelRules) -> dict[str, Any]:
    """Return how a recording was labeled, as plain values."""
    about = {"command": "label", "source": Path(origin.place).name, "definition": rules.definition}
    config = {"kind": origin.kind, "sensor": origin.sensor, "every": origin.every}
    config |= {"target": rules.target, "neighbors": rules.neighbors}
    return about | {"config": config, "targets": {target.name: asdict(target) for target in TARGETS}}


def jobs_of(origin: Origin, rules: LabelRules, store: Storage) -> tuple[list[LabelJob], tuple[str, ...]]:
    """Return the shards of a recording's labels, in order, and one line for each thing that is damaged."""
    source = opened(origin)
    jobs: list[LabelJob] = []
    problems = [*source.damage(), *source.notes()]  # a label needs poses, and all that was measured
    for number, scene in enumerate(source.scenes()):
        try:
            refs = source.refs(scene)
        except (ValueError, OSError) as error:
            problems.append(" ".join(str(error).split()))
            continue
        # Sensors in the order in which they come, and how many of their sweeps are labeled.
        counts = Counter(dict.fromkeys(((ref.agent, ref.sensor) for ref in refs), 0))
        counts.update((ref.agent, ref.sensor) for ref in refs if ref.keyframe or origin.every)
        for track, (sensor, wanted) in enumerate(counts.items()):
            for part, first in zip(count(), range(0, wanted, FRAMES_PER_SHARD)):
                name = f"{number:04d}-{track:02d}-{part:03d}.parquet"
                last = min(first + FRAMES_PER_SHARD, wanted)
                jobs.append(LabelJob(store, name, origin, scene, sensor, first, last, rules))
    problems += [problem for problem in source.damage() if problem not in problems]
    return jobs, tuple(problems)


def label_shard(job: LabelJob) -> ShardResult:
    """Return what became of the shard of ``job``, which is written with a file beside it that holds its checksum.

    Raises:
        OSError: a file cannot be written.
    """
    problems: list[str] = []
    return build_shard(job.store, job.name, labeled_samples(job, problems), lambda: tuple(problems))


def labeled_samples(job: LabelJob, problems: list[str]) -> Iterator[Sample]:
    """Yield the labeled samples of a job; what cannot be read is one line of ``problems``."""
    source = opened(job.origin)
    split = _split(source, job.scene)
    refs = [ref for ref in source.refs(job.scene) if (ref.agent, ref.sensor) == job.sensor]
    wanted = [index for index, ref in enumerate(refs) if ref.keyframe or job.origin.every][job.first : job.last]
    reader = _Reader(source, job.origin)
    track = LabeledDrive.of(reader.sweep, refs, job.rules, (wanted[0], wanted[-1] + 1))
    for index in wanted:
        try:
            truth, known = track.label(index)
            yield Sample(reader.stored(refs[index]), truth, known, job.scene, split)
        except (ValueError, OSError) as error:
            problems.append(" ".join(str(error).split()))


def _split(source: SweepSource, scene: str) -> str:
    return source.split(scene) if isinstance(source, ArchiveSource) else SPLIT


@lru_cache(maxsize=1)
def opened(origin: Origin) -> SweepSource:
    """Return the recording, opened once by each process; errors as :meth:`Origin.open`."""
    return origin.open()


@dataclass(slots=True)
class _Reader:
    """Reads sweeps of one sensor and gives them its beam table where they do not name it."""

    source: SweepSource
    origin: Origin
    _model: LidarModel | None = None
    _identified: bool = False

    def sweep(self, ref: SweepRef) -> Sweep:
        """Return a sweep with its beam table."""
        return self._with_model(self.source.read(ref))

    def stored(self, ref: SweepRef) -> StoredSweep | Sweep:
        """Return what the archive of labels keeps of a sweep."""
        return self.source.measured(ref) if isinstance(self.source, ArchiveSource) else self.sweep(ref)

    def _with_model(self, sweep: Sweep) -> Sweep:
        if sweep.model is not None:
            return sweep
        if not self._identified:
            self._model, self._identified = self._identify(sweep), True
        fits = self._model is not None and (sweep.ring is None or int(sweep.ring.max(initial=0)) < self._model.rings)
        return sweep.replace(model=self._model) if fits else sweep

    def _identify(self, sweep: Sweep) -> LidarModel | None:
        if self.origin.sensor == "auto":
            return infer_sensor(sweep.points, sweep.ring)[0]
        return None if self.origin.sensor == "none" else lidar_model(self.origin.sensor)
