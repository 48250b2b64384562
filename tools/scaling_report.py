"""How many machines and hours a large data set takes: measures this machine, then extrapolates.

``python tools/scaling_report.py`` writes ``docs/results/scaling.md``.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from viewshed import ESTIMATORS
from viewshed._files import write_atomic
from viewshed._jobs import ENGINES, Engine, LocalEngine
from viewshed._page import facts, page, table
from viewshed.datasets import Archive, Storage
from viewshed.datasets.presets import Preset, preset_named
from viewshed.datasets.simulated import simulate

SWEEPS = {"all of nuScenes": 390_000, "10⁹ sweeps": 1_000_000_000}
FLEETS = {
    "all of nuScenes": ((1, 2), (1, 16), (1, 64), (10, 64)),
    "10⁹ sweeps": ((1, 64), (10, 64), (100, 64), (1000, 64)),
}
"""Machines and cores of each."""
PART_SWEEPS = 1_000_000
"""Sweeps in each of the archives that a very large data set is cut into."""
LINK_BYTES_PER_S = 1.25e9
"""What one machine moves to and from an object store: 10 Gbit/s, an assumption."""
REQUEST_S = 0.1
"""What one request to an object store waits, an assumption."""
UNDER_WAY = {"local": os.cpu_count() or 1, "ray": 200}
"""Jobs that each engine has under way when it is measured; a cluster of many cores is stood in for by a queue."""
EMPTY_JOBS = 4000


@dataclass(frozen=True, slots=True)
class Measured:
    """What this machine did.

    Attributes:
        made_per_s: labeled samples written by one worker.
        made_per_s_all: the same with one worker for each core.
        cores: of this machine.
        peak_bytes: memory of the largest process.
        sample_bytes: in the archive.
        shard_frames: samples in a shard, mean.
        manifest_bytes: a shard takes in the manifest.
        read_per_s: samples read in order by one process, points and truth made.
        random_ms: to read one frame anywhere, median.
        estimate_per_s: sweeps that the shadow map takes by one process.
        engines: for each, seconds until its first empty job is done, and empty jobs per second from then on.
    """

    made_per_s: float
    made_per_s_all: float
    cores: int
    peak_bytes: int
    sample_bytes: float
    shard_frames: float
    manifest_bytes: float
    read_per_s: float
    random_ms: float
    estimate_per_s: float
    engines: dict[str, tuple[float, float]]


def main() -> None:
    """Measure, extrapolate, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="nuscenes")
    parser.add_argument("--sweeps", type=int, default=1200, help="simulated for each measurement")
    parser.add_argument("--out", type=Path, default=Path("docs/results/scaling.md"))
    given = parser.parse_args()
    load = _load()
    preset = preset_named(given.preset).scaled(given.sweeps)
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(preset, Path(folder))
    told = facts(preset=f"{given.preset}, {preset.sweeps} sweeps", load=load)
    parts = [_MEASURED, measured_table(measured), _PLAN, *(plan(measured, *item) for item in SWEEPS.items())]
    write_atomic(given.out, page("Scaling", told, *parts, _LAYOUT, layout_table(measured)).encode())


_MEASURED = "## Measured on this machine"
_PLAN = f"""\
## Extrapolated

Assumed, not measured: the time goes down with the number of cores; cores elsewhere are as fast as these; a machine
moves {LINK_BYTES_PER_S / 1e9:g} GB/s to and from its store. *Making* is simulation with the truth of both targets,
written; a core makes what a core of this machine makes when all are busy, and waits {REQUEST_S:g} s for the store to
take each shard. *Memory* is a worker's peak on every core. *Reading* is one pass in order, points and
truth made. *Estimating* is `shadow_map` over sweeps in memory. *Link* is the share of a machine's link that the writing
takes. *Driver* is the share of what one Ray driver was seen to hand out that the making needs: from about half on, run
the parts of the data set (below) as programs of their own."""
_LAYOUT = f"""\
## Files

One manifest names every shard, so it grows with the data set. Cut what has more than some millions of sweeps into parts
of {PART_SWEEPS:,}, each an archive with a seed and a folder of its own. *Waiting* is what a program that asks for one
file after the other waits for all shards, at {REQUEST_S:g} s (assumed) a request to an object store."""


def measure(preset: Preset, folder: Path) -> Measured:
    """Return what this machine does with a preset; ``folder`` is used for the archives."""
    cores = os.cpu_count() or 1
    for workers in {1, cores}:  # compiles
        _made(preset.scaled(96), folder / f"warm{workers}", workers)
    one_s, archive = _made(preset, folder / "one", 1)
    all_s, again = _made(preset, folder / "all", cores)
    if again.manifest.shards != archive.manifest.shards:
        raise AssertionError("the bytes depend on the number of workers")
    shards, timed = archive.manifest.shards, {name: _empty_jobs(ENGINES[name](n)) for name, n in UNDER_WAY.items()}
    return Measured(
        len(archive) / one_s, len(archive) / all_s, cores, _peak_bytes(),
        sum(shard.bytes for shard in shards) / len(archive), len(archive) / len(shards),
        _manifest_bytes(archive),
        _read_per_s(archive), _random_ms(archive), _estimate_per_s(archive), timed,
    )  # fmt: skip


def _made(preset: Preset, folder: Path, workers: int) -> tuple[float, Archive]:
    start_s = time.perf_counter()
    archive = simulate(preset, Storage.of(folder), LocalEngine(workers))
    return time.perf_counter() - start_s, archive


def _peak_bytes() -> int:
    """Memory of the largest process so far, of this one and those that it waited for."""
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return 1024 * max(resource.getrusage(kind).ru_maxrss for kind in kinds)


def _manifest_bytes(archive: Archive) -> float:
    """Bytes that one shard adds to the manifest."""
    whole, empty = (len(made.text().encode()) for made in (archive.manifest, replace(archive.manifest, shards=())))
    return (whole - empty) / len(archive.shards)


def _read_per_s(archive: Archive) -> float:
    start_s, points = time.perf_counter(), 0
    for sample in archive:
        points += len(sample.sweep.points)
    sys.stderr.write(f"{points} points read\n")
    return len(archive) / (time.perf_counter() - start_s)


def _random_ms(archive: Archive) -> float:
    again, times_s = Archive.open(archive.store.uri), []
    for index in np.random.default_rng(0).permutation(len(archive))[:500]:
        start_s = time.perf_counter()
        _ = again[int(index)]
        times_s.append(time.perf_counter() - start_s)
    return 1e3 * float(np.median(times_s))


def _estimate_per_s(archive: Archive) -> float:
    sweeps = [archive[index].sweep for index in range(0, len(archive), max(1, len(archive) // 100))]
    estimator = ESTIMATORS["shadow_map"](archive.manifest.layout.grid)
    estimator.estimate(sweeps[0])
    start_s = time.perf_counter()
    for sweep in sweeps:
        estimator.estimate(sweep)
    return len(sweeps) / (time.perf_counter() - start_s)


def _empty_jobs(engine: Engine) -> tuple[float, float]:
    """Return seconds until the first of many empty jobs is done, and jobs per second from then on."""
    start_s = time.perf_counter()
    run = engine.run(abs, range(EMPTY_JOBS))
    next(run)
    first_s = time.perf_counter()
    rest = sum(done.error is None for done in run)
    return first_s - start_s, rest / (time.perf_counter() - first_s)


def measured_table(measured: Measured) -> str:
    """Return what was measured as a table."""
    speedup = measured.made_per_s_all / measured.made_per_s
    rows = [
        ("samples made, one worker", f"{measured.made_per_s:.0f} /s"),
        (f"samples made, {measured.cores} workers", f"{measured.made_per_s_all:.0f} /s ({speedup:.2f} × one)"),
        ("memory of the largest process", f"{measured.peak_bytes / 1e6:.0f} MB"),
        ("a sample in the archive", f"{measured.sample_bytes / 1e3:.1f} kB"),
        ("a shard", f"{measured.shard_frames:.1f} samples, {_shard_bytes(measured) / 1e6:.2f} MB"),
        ("a shard in the manifest", f"{measured.manifest_bytes:.0f} bytes"),
        ("samples read in order, one process", f"{measured.read_per_s:.0f} /s"),
        ("a frame read anywhere", f"{measured.random_ms:.2f} ms"),
        ("`shadow_map`, one process", f"{measured.estimate_per_s:.0f} sweeps/s"),
        *(
            (f"engine `{name}`, {UNDER_WAY[name]} under way", f"first job in {start_s:.1f} s, then {rate:,.0f} jobs/s")
            for name, (start_s, rate) in measured.engines.items()
        ),
    ]  # fmt: skip
    return table(("what", "rate or size"), rows)


def plan(measured: Measured, name: str, sweeps: int) -> str:
    """Return the hours and loads of one data set for each fleet, as a section."""
    shard_s = measured.shard_frames * measured.cores / measured.made_per_s_all + REQUEST_S
    per_core = measured.shard_frames / shard_s
    rows = []
    for machines, cores in FLEETS[name]:
        total = machines * cores
        rate = per_core * total
        rows.append((
            f"{machines} × {cores} cores",
            _duration(sweeps / rate), _duration(sweeps / measured.read_per_s / total),
            _duration(sweeps / measured.estimate_per_s / total),
            _bytes(cores * measured.peak_bytes),
            f"{rate / machines * measured.sample_bytes / LINK_BYTES_PER_S:.1%}",
            f"{rate / measured.shard_frames / measured.engines['ray'][1]:.1%}",
        ))  # fmt: skip
    size = f"{sweeps:,} sweeps, {_bytes(sweeps * measured.sample_bytes)}"
    header = ("machines", "making", "reading", "estimating", "memory of each", "link", "driver")
    return f"### {name[0].upper()}{name[1:]}: {size}\n\n{table(header, rows)}"


def layout_table(measured: Measured) -> str:
    """Return shards, manifests and what requests wait for, by sweeps in one archive."""
    rows = []
    for name, sweeps in {**SWEEPS, f"one part of {PART_SWEEPS:,}": PART_SWEEPS}.items():
        shards = sweeps / measured.shard_frames
        rows.append((
            name, f"{shards:,.0f}", _bytes(_shard_bytes(measured)), _bytes(shards * measured.manifest_bytes),
            _duration(shards * REQUEST_S),
        ))  # fmt: skip
    return table(("in one archive", "shards", "of", "manifest", "waiting"), rows)


def _shard_bytes(measured: Measured) -> float:
    return measured.sample_bytes * measured.shard_frames


def _duration(seconds: float) -> str:
    """Return a time in the unit that fits.

    >>> _duration(90), _duration(5400), _duration(400_000), _duration(4e8)
    ('1.5 min', '1.5 h', '4.6 days', '12.7 years')
    """
    for unit, size, below in (("s", 1, 60), ("min", 60, 60), ("h", 3600, 48), ("days", 86400, 730)):
        if seconds < size * below:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds / 31_557_600:,.1f} years"


def _bytes(count: float) -> str:
    """Return a size in the unit that fits.

    >>> _bytes(2.5e6), _bytes(3.9e13)
    ('2.5 MB', '39.0 TB')
    """
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count:.0f} B"


def _load() -> str:
    return f"{os.getloadavg()[0]:.1f} in the minute before, on all cores"


if __name__ == "__main__":
    main()
