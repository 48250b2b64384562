"""Damage small valid files at random and read them: every reader must answer with a sweep or one clear line.

    python tools/fuzz_readers.py --minutes 10 --seed 1

Each case is read in a worker process of limited memory, so that crashes, hangs and hunger are seen from outside.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import json
import os
import platform
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
import tracemalloc
import warnings
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType

import numpy as np
from recording_files import recordings, write
from sweep_files import SampleFile, ouster_metadata, samples

from viewshed._results import with_numbers
from viewshed.datasets.recordings import open_source
from viewshed.datasets.recordings.source import each_sweep
from viewshed.io import read_index, read_sweeps

RECORDING = "recording"
SPOILED = {
    "opv2v": ("s/641/000068.yaml", "s/data_protocol.yaml"), "nuscenes": ("v1.0-mini/sample_data.json",
    "v1.0-mini/ego_pose.json", "v1.0-mini/sample_annotation.json"), "kitti_raw": (
    "2011_09_26/2011_09_26_drive_0001_sync/tracklet_labels.xml",), "carla": ("recording.json", "actors.jsonl",
    "car/poses.csv"), "ros1 bag": ("a.bag",), "db3": ("a.db3",), "mcap": ("a.mcap",),
}  # fmt: skip
"""Recording → its files that are damaged."""
NET = "is damaged or of a kind that is not read"
"""What the net of last resort says: the reader itself did not expect this."""
CASE_SECONDS = 5
FLOOR_BYTES = 64_000_000
RATIO = 10
SLICE_SECONDS = 10.0
EXTREMES = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 0x7FFFFFFFFFFFFFFF, 0xFFFFFFFFFFFFFFFF)
WORDS = (
    b"-1",
    b"0",
    b"99999999999",
    b"nan",
    b"1e999",
    b"\n",
    b" ",
    b"\x00" * 8,
    b"{" * 500,
    b"[" * 5000,
    b"%s",
    b"\xff\xfe",
)


class HangError(Exception):
    """A case took longer than CASE_SECONDS."""


@dataclass(slots=True)
class Tally:
    """What happened to the cases of one sample."""

    done: int = 0
    read: int = 0
    caught_by_net: int = 0
    peak_bytes: int = 0
    slowest_s: float = 0.0
    crashes: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Count another tally in."""
        self.done += other.done
        self.read += other.read
        self.caught_by_net += other.caught_by_net
        self.peak_bytes = max(self.peak_bytes, other.peak_bytes)
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.crashes += other.crashes
        self.faults += other.faults


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with one to six random damages."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 7))):
        at = int(rng.integers(0, max(1, len(data))))
        span = int(rng.integers(1, 1 + max(1, min(64, len(data) // 4))))
        replaced, by = _damage(bytes(data[at : at + span]), rng)
        data[at : at + replaced] = by
    return bytes(data)


def _damage(here: bytes, rng: np.random.Generator) -> tuple[int, bytes]:
    """Return how many bytes to replace at a place, and by what; ``here`` is what stands there."""
    match int(rng.integers(0, 7)):
        case 0:
            return 1, bytes([here[0] ^ 1 << int(rng.integers(0, 8))] if here else [])
        case 1:
            size = int(rng.choice((1, 2, 4, 8)))
            number = EXTREMES[int(rng.integers(0, len(EXTREMES)))] & ((1 << 8 * size) - 1)
            return size, number.to_bytes(size, "little" if rng.integers(0, 2) else "big")
        case 2:
            return sys.maxsize, b""
        case 3 | 4 as kind:
            return (len(here), b"") if kind == 3 else (0, here)
        case 5:
            return 0, WORDS[int(rng.integers(0, len(WORDS)))]
        case _:
            return 4, struct.pack("<f", float(rng.choice((np.nan, np.inf, -np.inf, 3e38, 1e-40))))


def cases() -> dict[str, SampleFile]:
    """Return every sample, the metadata beside a capture, and an index of sweeps."""
    files: dict[str, SampleFile] = samples()
    capture = files["ouster pcap"]
    files["ouster metadata"] = SampleFile("ouster", "o.json", ouster_metadata(), {"o.pcap": capture.content})
    index = [{"file": "a.bin", "sensor": "HDL-64E", "sensor_from_file": np.eye(4).tolist(), "t": 1.5}]
    for kind, names in SPOILED.items():
        whole = recordings()[kind]
        for name in names:
            others = {other: content for other, content in whole.items() if other != name}
            files[f"{kind} {name.rsplit('/', 1)[-1]}"] = SampleFile(RECORDING, name, whole[name], others)
    files["index"] = SampleFile("index", "index.json", json.dumps(index).encode(), {"a.bin": files["kitti"].content})
    return files


def read_case(sample: SampleFile, folder: Path, content: bytes, *, auto: bool) -> str | None:
    """Read a damaged sample; return None for a sweep, or the one line that refuses it.

    Raises:
        AssertionError: the refusal is not one line that names the file.
    """
    path = folder / sample.name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    if sample.format == RECORDING:
        return read_recording(folder)
    try:
        if sample.format == "index":
            read_index(path)
            return None
        if sample.name.endswith(".json"):
            path = folder / next(iter(sample.beside))
        for sweep in read_sweeps(path, format="auto" if auto else sample.format):
            assert np.isfinite(sweep.points).all()
    except (ValueError, OSError) as error:
        message = str(error)
        assert "\n" not in message, f"two lines: {message!r}"
        assert str(path) in message, f"no file name: {message!r}"
        return message
    return None


def read_recording(folder: Path) -> str | None:
    """Read a recording with a damaged file; return None where nothing is said about it, or the last line.

    Raises:
        AssertionError: a line is not one, or names no file.
    """
    lines: list[str] = []
    try:
        source = open_source(folder)
        for ref, sweep in each_sweep(source, on_damage=lambda _, line: lines.append(line)):
            assert np.isfinite(sweep.points).all()
            try:
                source.boxes(ref)
            except (ValueError, OSError) as error:
                lines.append(str(error))
    except (ValueError, OSError) as error:
        lines.append(str(error))
    for line in lines:
        assert "\n" not in line, f"two lines: {line!r}"
        assert str(folder) in line, f"no file name: {line!r}"
    return lines[-1] if lines else None


def work(name: str, seed: int, first: int, folder: Path) -> None:
    """Read cases of one sample from number ``first`` on, until the slice of time is over; print a summary."""
    sample = cases()[name]
    write(folder, sample.beside)
    read_case(sample, folder, sample.content, auto=False)
    with tempfile.TemporaryDirectory() as other:
        read_case(cases()["kitti"], Path(other), cases()["kitti"].content, auto=True)
    signal.signal(signal.SIGALRM, _hang)
    with Path("/proc/self/statm").open() as statm:
        pages = int(statm.read().split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + 8 * FLOOR_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", UserWarning)  # columns that are left out
    tracemalloc.start()
    tally = Tally()
    number = first
    end = time.monotonic() + SLICE_SECONDS
    with (folder / "number").open("wb", buffering=0) as progress:
        while time.monotonic() < end:
            os.pwrite(progress.fileno(), struct.pack("<q", number), 0)
            _one_case(sample, folder, np.random.default_rng((seed, number)), tally)
            number += 1
    tally.done = number - first
    print(json.dumps(asdict(tally)))


def _one_case(sample: SampleFile, folder: Path, rng: np.random.Generator, tally: Tally) -> None:
    content = mutate(sample.content, rng)
    auto = bool(rng.integers(0, 3) == 0)
    tracemalloc.reset_peak()
    before, begin = tracemalloc.get_traced_memory()[0], time.monotonic()
    signal.alarm(CASE_SECONDS)
    try:
        message = read_case(sample, folder, content, auto=auto)
        tally.read += message is None
        tally.caught_by_net += message is not None and NET in message
    except BaseException as error:
        tally.faults.append(f"{type(error).__name__}: {str(error)[:200]} (auto={auto}, {content[:40]!r}…)")
    finally:
        signal.alarm(0)
    peak = tracemalloc.get_traced_memory()[1] - before
    if peak > max(FLOOR_BYTES, RATIO * len(content)):
        tally.faults.append(f"memory: {peak} bytes for a file of {len(content)}")
    tally.peak_bytes = max(tally.peak_bytes, peak)
    tally.slowest_s = max(tally.slowest_s, time.monotonic() - begin)


def _hang(_signal: int, _frame: FrameType | None) -> None:
    raise HangError


def run_slice(name: str, seed: int, first: int) -> Tally:
    """Run one worker; return its tally, or that of a crash at the case it was at."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--worker", name, "--seed", str(seed)]
        command += ["--first", str(first), "--in", folder]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=6 * SLICE_SECONDS, check=False)
            code, output, why = done.returncode, done.stdout, done.stderr[-300:]
        except subprocess.TimeoutExpired:
            code, output, why = -1, "", "hang outside Python"
        if code == 0:
            return Tally(**json.loads(output.splitlines()[-1]))
        progress = Path(folder) / "number"
        at = struct.unpack("<q", progress.read_bytes())[0] if progress.is_file() else first
    return Tally(done=at - first + 1, crashes=[f"seed {seed} case {at}: exit {code} {why}"])


def fuzz(minutes: float, seed: int) -> dict[str, Tally]:
    """Go round the samples until the time is over; return tallies by sample."""
    tallies = {name: Tally() for name in cases()}
    end = time.monotonic() + 60 * minutes
    for name in itertools.cycle(tallies):
        if time.monotonic() >= end:
            break
        tallies[name].add(run_slice(name, seed, tallies[name].done))
    return tallies


def report(tallies: dict[str, Tally], minutes: float, seed: int) -> str:
    """Return the results as a Markdown page."""
    sizes = {name: len(sample.content) for name, sample in cases().items()}
    lines = [
        "Each case is a small valid file with one to six random damages, read with its format named (2 of 3), to be "
        "found out (1 of 3), or as a file of a recording. It must give a sweep of finite points, or a ValueError or "
        f"OSError of one line that names the file, within {CASE_SECONDS} s. Memory is the peak of Python's and numpy's "
        f"allocations for one case; the limit is {RATIO} × the file, at least {FLOOR_BYTES // 1_000_000} MB. Address "
        f"space is limited too: a worker may grow by {8 * FLOOR_BYTES // 1_000_000} MB, compiled decoders included.",
        "",
        "What is refused *by the net* the reader itself did not expect: the one place that names files in errors made "
        "a line of it.",
        "",
        "| file | bytes | executions | read | refused | by the net | crashes | other faults | peak MB | slowest ms |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, tally in tallies.items():
        bad = len(tally.crashes) + len(tally.faults)
        lines.append(
            f"| {name} | {sizes[name]} | {tally.done} | {tally.read} | {tally.done - tally.read - bad} "
            f"| {tally.caught_by_net} | {len(tally.crashes)} | {len(tally.faults)} | {tally.peak_bytes / 1e6:.2f} "
            f"| {1000 * tally.slowest_s:.0f} |"
        )
    executions = sum(tally.done for tally in tallies.values())
    made = (
        f"- command: `python tools/fuzz_readers.py --minutes {minutes:g} --seed {seed}`, one process\n"
        f"- date: {datetime.datetime.now(datetime.UTC):%Y-%m-%d}\n"
        f"- version: {platform.machine()}, Linux, Python {platform.python_version()}, numpy {np.__version__}"
    )
    return with_numbers("Fuzzing the readers", made, "\n".join([*lines, "", f"Executions in all: {executions}."]))


def main() -> None:
    """Fuzz, print what went wrong, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "results" / "fuzz.md")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--in", dest="folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        work(given.worker, given.seed, given.first, given.folder)
        return
    tallies = fuzz(given.minutes, given.seed)
    for name, tally in tallies.items():
        for fault in [*tally.crashes, *tally.faults][:5]:
            print(f"{name}: {fault}")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(report(tallies, given.minutes, given.seed), encoding="utf-8")
    print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
