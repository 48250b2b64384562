"""Label a whole recording: write an archive whose truth is the label."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
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

SPLIT = "all"
"""Split name of recordings without splits."""


@dataclass(frozen=True, slots=True)
class Origin:
    """A recording to label; small enough to send to other processes.

    Raises:
        ValueError: no beam table has this name.
    """

    place: str  # folder, file or URI
    kind: str = "auto"  # a name in ``SOURCES``, "archive", "index", or "auto" to detect it from the layout
    # beam table of sweeps that do not name theirs, "auto" to identify it from the returns, or "none"
    sensor: str = "auto"
    every: bool = False  # whether to label sweeps that are not keyframes, too

    def __post_init__(self) -> None:
        if self.sensor not in ("auto", "none"):
            lidar_model(self.sensor)

    def open(self) -> SweepSource:
        """Open the recording.

        Raises:
            ValueError: it is damaged, or its layout is unknown.
            OSError: it cannot be read.
        """
        if self.kind == "index":
            return _Index(self.place)
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
    """Label a recording into ``store`` and return the archive; its bytes do not depend on the engine.

    Unreadable sweeps are left out and reported to ``on_progress``; labels of an interrupted run are kept.

    Args:
        origin: the recording; of an archive only the sweeps are read.
        rules: settings.
        store: destination.
        engine: runs the jobs.
        on_progress: called with each finished shard and with problems.

    Raises:
        ValueError: the recording has no sweeps, or the destination holds something else.
        OSError: a file cannot be read or written.
    """
    jobs, problems, listing = jobs_of(origin, rules)
    if on_progress is not None and problems:
        on_progress(ShardResult(None, problems))
    if not jobs:
        raise ValueError(f"{Storage.of(origin.place).place} must hold sweeps, got none that can be labeled")
    layout = Layout(rules.grid, tuple(sorted(target.name for target in TARGETS)), ("farthest", "first_blocker"))
    return build_archive(recipe_of(origin, rules, listing), layout, jobs, store, engine, on_progress)


def recipe_of(origin: Origin, rules: LabelRules, listing: Sequence[Any]) -> dict[str, Any]:
    """Return the recipe of a labeled recording as plain values; ``listing`` identifies its sweeps."""
    source = Path(Storage.of(origin.place).place).name  # a URI's options may hold secrets
    about = {"command": "label", "source": source, "definition": rules.definition}
    config = {"kind": origin.kind, "sensor": origin.sensor, "every": origin.every}
    config |= {"sweeps": hashlib.sha256(json.dumps(listing).encode()).hexdigest()}
    config |= {"target": rules.target, "neighbors": rules.neighbors}
    return about | {"config": config, "targets": {target.name: asdict(target) for target in TARGETS}}


def jobs_of(origin: Origin, rules: LabelRules) -> tuple[list[ShardJob], tuple[str, ...], list[Any]]:
    """Return the jobs that label a recording, in order; one line per problem; and a listing of its sweeps."""
    source = opened(origin)
    jobs: list[ShardJob] = []
    if isinstance(source, ArchiveSource) and source.archive.manifest.recipe.get("command") == "attack":
        raise ValueError(f"{source.archive.store.place} must be benign, got one under attack; label its source")
    listing = [shard.sha256 for shard in source.archive.shards] if isinstance(source, ArchiveSource) else list[Any]()
    problems = [*source.damage(), *source.notes()]  # a label needs poses and all columns
    for number, scene in enumerate(source.scenes()):
        try:
            refs = source.refs(scene)
        except (ValueError, OSError) as error:
            problems.append(" ".join(str(error).split()))
            continue
        listing += [(scene, Path(ref.file).name, ref.t_ns, ref.key) for ref in refs]
        # Sensors in order of appearance, and the number of their sweeps to label.
        counts = Counter(dict.fromkeys(((ref.agent, ref.sensor) for ref in refs), 0))
        counts.update((ref.agent, ref.sensor) for ref in refs if ref.keyframe or origin.every)
        for track, (sensor, sweeps) in enumerate(counts.items()):
            for part, first in enumerate(range(0, sweeps, FRAMES_PER_SHARD)):
                name = f"{number:04d}-{track:02d}-{part:03d}.parquet"
                part_of = slice(first, first + FRAMES_PER_SHARD)
                jobs.append(ShardJob(name, partial(labeled_samples, origin, rules, scene, sensor, part_of)))
    problems += [problem for problem in source.damage() if problem not in problems]
    return jobs, tuple(problems), listing


def labeled_samples(
    origin: Origin, rules: LabelRules, scene: str, sensor: tuple[str, str], part: slice, problems: list[str]
) -> Iterator[Sample]:
    """Yield the labeled samples of one sensor in a part of a scene; report unreadable sweeps in ``problems``."""
    source = opened(origin)
    split = source.split(scene) if isinstance(source, ArchiveSource) else SPLIT
    refs = [ref for ref in source.refs(scene) if (ref.agent, ref.sensor) == sensor]
    indices = [index for index, ref in enumerate(refs) if ref.keyframe or origin.every][part]
    sweep_of = partial(_with_beams, source, origin.sensor, [])
    drive = LabeledDrive.of(sweep_of, refs, rules, (indices[0], indices[-1] + 1))
    for index in indices:
        try:
            truth, known = drive.label(index)
            measured = source.measured(refs[index]) if isinstance(source, ArchiveSource) else sweep_of(refs[index])
            yield Sample(measured, truth, known, scene, split)
        except (ValueError, OSError) as error:
            problems.append(" ".join(str(error).split()))


@lru_cache(maxsize=1)
def opened(origin: Origin) -> SweepSource:
    """Open the recording, once per process; raises like :meth:`Origin.open`."""
    return origin.open()


def _with_beams(source: SweepSource, sensor: str, cached: list[LidarModel | None], ref: SweepRef) -> Sweep:
    """Return a sweep with its own beam table, or with that of ``sensor``, which is looked up once for ``cached``."""
    sweep = source.read(ref)
    if sweep.model is not None:
        return sweep
    if not cached:
        named = None if sensor in ("auto", "none") else lidar_model(sensor)
        cached.append(infer_sensor(sweep.points, sweep.ring)[0] if sensor == "auto" else named)
    [model] = cached
    fits = model is not None and (sweep.ring is None or int(sweep.ring.max(initial=0)) < model.rings)
    return sweep.replace(model=model) if fits else sweep


class _Index(RecordingSource):
    """The sweeps of an index file; the sweeps of a drive are one scene, every other sweep is a scene of its own."""

    def __init__(self, index: str) -> None:
        self.place = Path(index).absolute()
        self._drives: dict[str, list[IndexEntry]] = {}
        for entry in read_index(index):
            if entry.points:  # of a drive and its sensor, or by its own name
                own = entry.file.relative_to(self.place.parent.resolve()).as_posix()
                scene = own if entry.seq is None else f"{entry.seq} ({entry.sensor})"
                self._drives.setdefault(scene, []).append(entry)
        if not self._drives:
            raise ValueError(
                f"{index} must list at least one sweep, got none: the stats of a sweep give its number of points"
            )
        self.sweeps: dict[str, list[SweepRef]] = {}
        for scene, entries in self._drives.items():
            entries.sort(key=lambda entry: (entry.t or 0.0, str(entry.file)))
            times_ns = [None if entry.t is None else round(entry.t * 1e6) * 1000 for entry in entries]
            self.sweeps[scene] = [
                SweepRef(scene, k, str(entry.file), t_ns, key=str(k))
                for k, (entry, t_ns) in enumerate(zip(entries, times_ns, strict=True))
            ]

    def _read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with the metadata of the index."""
        return read_indexed(self._drives[ref.scene][ref.index])
