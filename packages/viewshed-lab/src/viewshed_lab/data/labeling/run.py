"""A recording labeled from start to end: an archive whose truth is the label."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from itertools import count
from pathlib import Path
from typing import Any

from viewshed.io import IndexEntry, read_index, read_indexed
from viewshed.preprocess.sensor_identification import infer_sensor
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import RecordingSource, SweepRef, SweepSource
from viewshed.recordings.recording import is_data_set
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sweep import Sweep
from viewshed_lab._jobs import Engine
from viewshed_lab.data.archive.archive import Archive, ArchiveSource
from viewshed_lab.data.archive.build import FRAMES_PER_SHARD, ShardJob, ShardResult, build_archive
from viewshed_lab.data.archive.schema import Layout
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.labeling.labeler import TARGETS, LabeledDrive, LabelRules
from viewshed_lab.data.sample import Sample
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep

SPLIT = "all"
"""Name of the split of recordings that have none."""


@dataclass(frozen=True, slots=True)
class Origin:
    """A recording that is labeled; small enough to travel to other processes.

    Raises:
        ValueError: no beam table has this name.
    """

    place: str  # folder, file or URI
    kind: str = "auto"  # a name in ``SOURCES``, "archive", "index", or "auto" to know it by its layout
    # a beam table's name for sweeps that do not name theirs, "auto" to know it by the returns, or "none"
    sensor: str = "auto"
    every: bool = False  # whether sweeps that the recording does not mark as keyframes are labeled as well

    def __post_init__(self) -> None:
        if self.sensor not in ("auto", "none"):
            lidar_model(self.sensor)

    def open(self) -> SweepSource:
        """Return the recording.

        Raises:
            ValueError: it is damaged, or its layout is not known.
            OSError: it cannot be read.
        """
        if self.kind == "index":
            return _open_index(self.place)
        if self.kind == "archive" or (self.kind == "auto" and is_data_set(self.place)):
            return ArchiveSource.open(self.place)
        return open_source(self.place, self.kind)


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
    jobs, problems, listing = jobs_of(origin, rules)
    if on_progress is not None and problems:
        on_progress(ShardResult(None, problems))
    if not jobs:
        raise ValueError(f"{Storage.of(origin.place).place} must hold sweeps, got none that can be labeled")
    layout = Layout(rules.grid, tuple(sorted(target.name for target in TARGETS)), ("farthest", "first_blocker"))
    return build_archive(recipe_of(origin, rules, listing), layout, jobs, store, engine, on_progress)


def recipe_of(origin: Origin, rules: LabelRules, listing: Sequence[Any]) -> dict[str, Any]:
    """Return how a recording was labeled, as plain values; ``listing`` names its sweeps."""
    source = Path(Storage.of(origin.place).place).name  # a URI's options may hold secrets
    about = {"command": "label", "source": source, "definition": rules.definition}
    config = {"kind": origin.kind, "sensor": origin.sensor, "every": origin.every}
    config |= {"sweeps": hashlib.sha256(json.dumps(listing).encode()).hexdigest()}
    config |= {"target": rules.target, "neighbors": rules.neighbors}
    return about | {"config": config, "targets": {target.name: asdict(target) for target in TARGETS}}


def jobs_of(origin: Origin, rules: LabelRules) -> tuple[list[ShardJob], tuple[str, ...], list[Any]]:
    """Return the shards of a recording's labels, in order, a line for each thing that is damaged, and its sweeps."""
    source = opened(origin)
    jobs: list[ShardJob] = []
    if isinstance(source, ArchiveSource) and source.archive.manifest.recipe.get("command") == "attack":
        raise ValueError(f"{source.archive.store.place} must be benign, got one under attack; label what it was made of")
    listing = [shard.sha256 for shard in source.archive.shards] if isinstance(source, ArchiveSource) else list[Any]()
    problems = [*source.damage(), *source.notes()]  # a label needs poses, and all that was measured
    for number, scene in enumerate(source.scenes()):
        try:
            refs = source.refs(scene)
        except (ValueError, OSError) as error:
            problems.append(" ".join(str(error).split()))
            continue
        listing += [(scene, Path(ref.file).name, ref.t_ns, ref.key) for ref in refs]
        # Sensors in the order in which they come, and how many of their sweeps are labeled.
        counts = Counter(dict.fromkeys(((ref.agent, ref.sensor) for ref in refs), 0))
        counts.update((ref.agent, ref.sensor) for ref in refs if ref.keyframe or origin.every)
        for track, (sensor, wanted) in enumerate(counts.items()):
            for part, first in zip(count(), range(0, wanted, FRAMES_PER_SHARD)):
                name = f"{number:04d}-{track:02d}-{part:03d}.parquet"
                part_of = slice(first, first + FRAMES_PER_SHARD)
                jobs.append(ShardJob(name, partial(labeled_samples, origin, rules, scene, sensor, part_of)))
    problems += [problem for problem in source.damage() if problem not in problems]
    return jobs, tuple(problems), listing


def labeled_samples(
    origin: Origin, rules: LabelRules, scene: str, sensor: tuple[str, str], part: slice, problems: list[str]
) -> Iterator[Sample]:
    """Yield labeled samples of one sensor in a scene, a part of all; what cannot be read is a line of ``problems``."""
    source = opened(origin)
    split = source.split(scene) if isinstance(source, ArchiveSource) else SPLIT
    refs = [ref for ref in source.refs(scene) if (ref.agent, ref.sensor) == sensor]
    wanted = [index for index, ref in enumerate(refs) if ref.keyframe or origin.every][part]
    reader = _Reader(source, origin)
    track = LabeledDrive.of(reader.sweep, refs, rules, (wanted[0], wanted[-1] + 1))
    for index in wanted:
        try:
            truth, known = track.label(index)
            yield Sample(reader.stored(refs[index]), truth, known, scene, split)
        except (ValueError, OSError) as error:
            problems.append(" ".join(str(error).split()))


@lru_cache(maxsize=1)
def opened(origin: Origin) -> SweepSource:
    """Return the recording, opened once by each process; errors as :meth:`Origin.open`."""
    return origin.open()


@dataclass(slots=True)
class _Reader:
    """Reads sweeps of one sensor and gives them its beam table where they do not name it."""

    source: SweepSource
    origin: Origin
    _found: list[LidarModel | None] = field(default_factory=list)  # its beam table, once it was looked for

    def sweep(self, ref: SweepRef) -> Sweep:
        """Return a sweep with its beam table."""
        sweep, named = self.source.read(ref), self.origin.sensor
        if sweep.model is not None:
            return sweep
        if not self._found:
            known = None if named in ("auto", "none") else lidar_model(named)
            self._found.append(infer_sensor(sweep.points, sweep.ring)[0] if named == "auto" else known)
        model = self._found[0]
        fits = model is not None and (sweep.ring is None or int(sweep.ring.max(initial=0)) < model.rings)
        return sweep.replace(model=model) if fits else sweep

    def stored(self, ref: SweepRef) -> StoredSweep | Sweep:
        """Return what the archive of labels keeps of a sweep."""
        return self.source.measured(ref) if isinstance(self.source, ArchiveSource) else self.sweep(ref)


def _open_index(index: str) -> SweepSource:
    """Return the sweeps that an index names; those of one drive are a scene, each other one its own."""
    place = Path(index).absolute()
    drives: dict[str, list[IndexEntry]] = {}
    for entry in read_index(index):
        if entry.points:  # of a drive and its sensor, or by its own name
            own = entry.file.relative_to(place.resolve().parent).as_posix()
            drives.setdefault(own if entry.seq is None else f"{entry.seq} ({entry.sensor})", []).append(entry)
    if not drives:
        raise ValueError(f"{index} must name at least one sweep, got none: one has a number of points in its stats")
    for entries in drives.values():
        entries.sort(key=lambda entry: (entry.t or 0.0, str(entry.file)))
    return _Index(place, drives)


class _Index(RecordingSource):
    """The sweeps of an index by drive."""

    def __init__(self, place: Path, drives: Mapping[str, Sequence[IndexEntry]]) -> None:
        self.place, self._drives = place, drives
        self.sweeps: dict[str, list[SweepRef]] = {scene: [] for scene in drives}
        for scene, entries in drives.items():
            for k, entry in enumerate(entries):
                t_ns = None if entry.t is None else round(entry.t * 1e6) * 1000
                self.sweeps[scene].append(SweepRef(scene, k, str(entry.file), t_ns, key=str(k)))

    def _read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with what the index tells about it."""
        return read_indexed(self._drives[ref.scene][ref.index])
