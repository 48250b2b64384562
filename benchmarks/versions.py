"""Time versions of viewshed side by side on real sweeps.

    python -m benchmarks.versions NAME=CHECKOUT … [--page FILE]

Every version runs in a process of its own, with its own checkout; all take turns, round by round in an order drawn
anew, so that what disturbs one disturbs all. Checkouts must be built (their extension module, or their compiled cache).
The sweeps are a nuScenes one of 35,000 and a KITTI one of 125,000 points, without attitude, height or sensor: what a
user has who reads a file. From points in memory to an estimate with its states and its doubt; every sweep is new to the
estimator.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import summary
from viewshed._page import commit_of, facts, page, table

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("VIEWSHED_REAL_DATA", ROOT.parent / "shared" / "data"))
SWEEPS = {"nuScenes, 35k": "nuscenes/*.pcd.bin", "KITTI, 125k": "kitti/odometry00/*.bin"}
SEED = 0


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the table: what is timed, and the target in Hz or milliseconds for each sweep.

    Attributes:
        title: in words.
        job: of ``version_worker.JOBS``.
        method: estimator, or what reads.
        in_hz: rates are shown, not milliseconds.
        targets: one for each sweep, or none.
        per: sweeps in one job.
    """

    title: str
    job: str
    method: str
    in_hz: bool
    targets: tuple[float, ...] = ()
    per: int = 1


LINES = (
    Line("`shadow_map`, the default", "estimate", "shadow_map", True, (700, 350)),
    Line("`shadow_map`, a sweep a core", "many", "shadow_map", True, (), 8),
    Line("`viewnet`", "estimate", "viewnet", True, (300, 180)),
    Line("`viewnet`, a sweep a core", "many", "viewnet", True, (400, 250), 8),
    Line("`first_blocker`", "estimate", "first_blocker", False, (0.6, 1.5)),
    Line("`quantized`", "estimate", "quantized", False, (0.6, 1.5)),
    Line("`continuous`", "estimate", "continuous", False, (0.6, 1.5)),
    Line("`concave_hull`", "estimate", "concave_hull", False, (8, 10)),
    Line("`mc_dropout`, 20 passes", "estimate", "mc_dropout", True, (50, 50)),
    Line("`read_sweep`", "read", "viewshed", False),
    Line("`numpy.fromfile`", "read", "numpy.fromfile", False),
)


class Version:
    """A version in a process of its own."""

    def __init__(self, name: str, checkout: Path) -> None:
        self.name = name
        worker = Path(__file__).with_name("version_worker.py")
        command = (sys.executable, str(ROOT / "tools" / "with_checkout.py"), str(checkout), str(worker))
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.number, self.place = self._answer()

    def seconds(self, line: Line, path: Path) -> float | None:
        """Return the seconds of one run, or None where the version cannot do it."""
        answer = self._ask([line.job, line.method, str(path)])
        return answer if isinstance(answer, float) else None

    def _ask(self, question: Any) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"{self.name} ended")
        return json.loads(answer)

    def resident_mb(self) -> float:
        """Return the memory that the process holds."""
        status = Path(f"/proc/{self._process.pid}/status").read_text(encoding="utf-8")
        return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def measure(
    versions: Sequence[Version], line: Line, path: Path, rounds: int, rng: np.random.Generator
) -> dict[str, list[float]]:
    """Return the milliseconds a sweep of each version, over rounds in which each ran once."""
    able = [version for version in versions if version.seconds(line, path) is not None]
    taken: dict[str, list[float]] = {version.name: [] for version in able}
    for _ in range(rounds):
        for pick in rng.permutation(len(able)):
            seconds = able[pick].seconds(line, path)
            assert seconds is not None
            taken[able[pick].name].append(1e3 * seconds / line.per)
    return taken


def row(line: Line, times: Mapping[str, Sequence[float]], names: Sequence[str], target: float | None) -> list[str]:
    """Return the cells of a line for one sweep: each version's figure, the gain, target and verdict."""
    medians = {name: summary(list(each)).median_ms for name, each in times.items()}
    cells = [_shown(line, medians[name]) if name in medians else "–" for name in names]
    gains = [f"{medians[name] / medians[names[0]]:.1f} ×" if name in medians else "–" for name in names[1:]]
    if target is None:
        return [*cells, *gains, "–", "–"]
    met = 1e3 / medians[names[0]] >= target if line.in_hz else medians[names[0]] <= target
    return [*cells, *gains, f"≥ {target:g} Hz" if line.in_hz else f"≤ {target:g} ms", "met" if met else "**missed**"]


def endurance(version: Version, path: Path, count: int) -> str:
    """Return a sentence on so many estimates in a row: median, 99th percentile, and how the memory grows."""
    line = LINES[0]
    warm = max(count // 20, 1)
    times = [version.seconds(line, path) or np.nan for _ in range(warm)]
    before_mb = version.resident_mb()
    times = [version.seconds(line, path) or np.nan for _ in range(count)]
    grown_mb = version.resident_mb() - before_mb
    median, last = 1e3 * np.percentile(times, [50, 99])
    return (
        f"**{count:,} sweeps in a row** (nuScenes, {line.title}): median {median:.2f} ms, 99th percentile"
        f" {last:.2f} ms; that is {last / median:.2f} × the median (target ≤ 1.5 ×); the process holds"
        f" {before_mb:.0f} MB after the first {warm:,} and {grown_mb:+.1f} MB more at the end."
    )


def _shown(line: Line, median_ms: float) -> str:
    return f"{1e3 / median_ms:.0f} Hz" if line.in_hz else f"{median_ms:.2f} ms"


def main() -> None:
    """Measure what the command line names and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.versions", description=__doc__)
    parser.add_argument("checkouts", nargs="*", help="NAME=CHECKOUT of earlier versions")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "results" / "core_speed.md")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--endurance", type=int, default=10_000, help="so many sweeps in a row in the end; 0 for none")
    parser.add_argument("--only", default="", help="only lines that contain this; no page is written")
    given = parser.parse_args()
    named = {"now": str(ROOT)} | dict(each.split("=", 1) for each in given.checkouts)
    versions = [Version(name, Path(checkout)) for name, checkout in named.items()]
    files = {title: sorted(DATA.glob(pattern))[0] for title, pattern in SWEEPS.items()}
    rng = np.random.default_rng(SEED)
    rows = []
    for line in LINES:
        if given.only not in line.title:
            continue
        rounds = max(5, given.rounds // line.per) if line.method != "mc_dropout" else max(5, given.rounds // 4)
        for k, (title, path) in enumerate(files.items()):
            times = measure(versions, line, path, rounds, rng)
            target = line.targets[k] if line.targets else None
            rows.append([line.title, title, *row(line, times, list(named), target)])
            print(" | ".join(rows[-1]), flush=True)
    in_a_row = endurance(versions[0], next(iter(files.values())), given.endurance) if given.endurance else ""
    print(in_a_row)
    for version in versions:
        version.close()
    if not given.only:
        header = ["what", "sweep", *named, *(f"gain over {name}" for name in list(named)[1:]), "target", ""]
        command = ("python -m benchmarks.versions", *(f"{name}=CHECKOUT" for name in list(named)[1:]))
        provenance = facts(
            command=f"`{' '.join(command)} --rounds {given.rounds}`",
            load=f"{os.getloadavg()[0]:.1f} in the minute before, on all cores",
            **{name: f"viewshed at {commit_of(Path(checkout))}" for name, checkout in named.items()},
        )
        given.page.write_text(
            page("Speed of the core", provenance, INTRODUCTION, table(header, rows), in_a_row), encoding="utf-8"
        )


INTRODUCTION = """\
Real sweeps: a nuScenes one and a KITTI one, read from their files, without attitude, height or sensor. From points in
memory to an estimate with states and doubt, on two cores; every sweep is new to the estimator, and nothing is kept of
the one before. The versions take turns in one run, each in a process of its own, so that the ratios hold better than
the milliseconds do. Medians."""


if __name__ == "__main__":
    main()
