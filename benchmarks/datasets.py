"""Measure data sets and write the page: ``python -m benchmarks.datasets [--sweeps N] [--page FILE]``.

Rates of simulating, writing and reading, the choice of the compression, and torch's loader where torch is installed.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path

import numpy as np

from viewshed._jobs import engine_named
from viewshed._page import facts, page, table
from viewshed.datasets import Archive, Storage
from viewshed.datasets.archive import shard as shards
from viewshed.datasets.archive.archive import ArchiveFrames
from viewshed.datasets.presets import Preset, preset_named
from viewshed.datasets.sample import Sample
from viewshed.datasets.simulated import ScenePlan, simulate, simulate_frame

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "datasets.md"
SEED = 20_250_307
LEVELS = (-3, 1, 2, 3, 5, 9)
WORKERS = 2


def main() -> None:
    """Measure what the command line names, and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.datasets", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    parser.add_argument("--sweeps", type=int, default=10_000, help="sweeps of nuscenes to simulate")
    chosen = parser.parse_args()
    told = facts(
        command=f"`{' '.join(['python -m benchmarks.datasets', *sys.argv[1:]])}`",
        libraries=", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "numba", "pyarrow")),
        load=f"{os.getloadavg()[0]:.1f} in the minute before, on all cores",
        seed=str(SEED),
    )
    preset = preset_named("nuscenes").scaled(chosen.sweeps)
    with tempfile.TemporaryDirectory() as name:
        archive, made = _made(preset, Path(name) / "nuscenes")
        parts = ["## Simulating", made, "## Reading", table(["what", "rate", "target"], _reading(archive)),
                 "## Compression of one shard", _compression(preset, Path(name) / "levels")]  # fmt: skip
    chosen.page.write_text(page("Data sets: rates", told, *parts), encoding="utf-8")
    print(f"written to {chosen.page}")


def _made(preset: Preset, folder: Path) -> tuple[Archive, str]:
    """Return the archive, and how fast it was made: kernels are compiled before, by a small one."""
    simulate(preset.scaled(50), Storage.of(folder / "warm"), engine_named("local", WORKERS))
    start_s = time.perf_counter()
    archive = simulate(preset, Storage.of(folder / "data"), engine_named("local", WORKERS))
    elapsed_s = time.perf_counter() - start_s
    count, size = len(archive), sum(one.bytes for one in archive.shards)
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    rows = [
        [f"{count} sweeps of `{preset.name}`, {WORKERS} workers", f"{elapsed_s:.1f} s", "10,000 in 90 s"],
        ["sweeps a second", f"{count / elapsed_s:.0f}", "≥ 150"],
        ["peak memory of the larger worker", f"{peak_mb:.0f} MB", "≤ 2 GB for both"],
        ["bytes a sweep", f"{size / count / 1e3:.1f} kB", ""],
    ]
    return archive, table(["what", "measured", "target"], rows)


def _reading(archive: Archive) -> Iterator[list[str]]:
    rng = np.random.default_rng(SEED)
    where = rng.integers(0, len(archive), 2000)
    for name, job in (
        ("random read of a sample, whole", lambda index: archive[index].sweep),
        ("random read, points not made", archive.__getitem__),
        ("random frame for training (`ArchiveFrames`)", ArchiveFrames(archive).__getitem__),
    ):
        low, median, high = _milliseconds(job, where)
        yield [f"{name}, one process", f"{median:.2f} ms ({low:.2f} to {high:.2f})", "≤ 1 ms"]
    some = archive.of_scenes(archive.scenes[:60])
    yield ["samples in order, one process", f"{_rate(lambda: _counted(some), len(some)):.0f} /s", ""]
    yield [f"samples in order, {WORKERS} processes", f"{_parallel(some):.0f} /s", "≥ 1,000 /s"]
    if importlib.util.find_spec("torch") is not None:
        yield [f"torch's `DataLoader`, batches of 16, shuffled, {WORKERS} workers", f"{_torch(some):.0f} /s", ""]


def _milliseconds(job: Callable[[int], object], where: np.ndarray) -> tuple[float, ...]:
    """Return the 10th, 50th and 90th percentile; files and footers were touched before."""
    for index in where[:200]:
        job(int(index))
    times = []
    for index in where:
        start_s = time.perf_counter()
        job(int(index))
        times.append(1e3 * (time.perf_counter() - start_s))
    return tuple(np.percentile(times, [10, 50, 90]))


def _rate(job: Callable[[], object], count: int) -> float:
    start_s = time.perf_counter()
    job()
    return count / (time.perf_counter() - start_s)


def _counted(archive: Archive) -> int:
    return sum(len(sample.sweep) for sample in archive)


def _parallel(archive: Archive) -> float:
    """Return samples a second of processes that read one half each; started and warm before."""
    from concurrent.futures import ProcessPoolExecutor

    halves = [archive.of_scenes(archive.scenes[k::WORKERS]) for k in range(WORKERS)]
    with ProcessPoolExecutor(WORKERS) as pool:
        list(pool.map(_counted, halves))
        return _rate(lambda: list(pool.map(_counted, halves)), len(archive))


def _torch(archive: Archive) -> float:
    data = importlib.import_module("torch.utils.data")
    loader = data.DataLoader(
        ArchiveFrames(archive), batch_size=16, shuffle=True, num_workers=WORKERS, persistent_workers=True
    )
    for _ in loader:
        pass
    return _rate(lambda: sum(1 for _ in loader), len(archive))


def _compression(preset: Preset, folder: Path) -> str:
    """Return what each level of zstd costs and saves; the one that is used is marked."""
    frames = [simulate_frame(ScenePlan(preset, 0, number), index) for number in range(4) for index in range(8)]
    used, rows = shards.ZSTD_LEVEL, []
    for level in LEVELS:
        setattr(shards, "ZSTD_LEVEL", level)  # noqa: B010 - a constant everywhere else
        write_ms = min(_written_ms(folder, frames) for _ in range(5))
        size = (folder / "a.parquet").stat().st_size
        shard = shards.Shard(Storage.of(folder), "a.parquet")
        _, read_ms, _ = _milliseconds(lambda index, of=shard: of.sample(index), np.arange(len(frames)))  # type: ignore[misc]
        mark = " (used)" if level == used else ""
        rows.append([f"{level}{mark}", f"{size / len(frames) / 1e3:.1f}", f"{write_ms:.2f}", f"{read_ms:.2f}"])
    setattr(shards, "ZSTD_LEVEL", used)  # noqa: B010 - see above
    return table(["zstd level", "kB a frame", "ms to encode and write", "ms to read, points not made"], rows)


def _written_ms(folder: Path, frames: list[Sample]) -> float:
    start_s = time.perf_counter()
    shards.write_shard(Storage.of(folder), "a.parquet", frames)
    return 1e3 * (time.perf_counter() - start_s) / len(frames)


if __name__ == "__main__":
    main()
