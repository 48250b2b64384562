"""Report how well rings and sensors are recovered from real sweeps, as a table on the screen and in the docs.

Usage: python tools/beam_report.py DATA_DIR [OUT.md [FILE ...]]

Sweeps in further FILEs come with no sensor that an index names.
"""

from __future__ import annotations

import datetime
import platform
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed._results import with_numbers, write_page
from viewshed.io import read_index, read_indexed, read_sweep
from viewshed.preprocess.beam_matching import polar
from viewshed.preprocess.elevation_clusters import rings_by_clusters
from viewshed.preprocess.ring_recovery import RingAssignment, recover_rings
from viewshed.preprocess.sensor_identification import infer_sensor
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

_HEAD = (
    "sweep", "sensor, as the index says", "inferred", "score", "shuffled, no rings", "rings from", "rings", "placed",
    "alone", "columns", "table off (median / max)", "ms", "clusters", "agree",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Row:
    """What one sweep showed."""

    file: Path
    sensor: str
    inferred: str
    score: float
    blind: str
    beams: RingAssignment
    off: str
    time_ms: float
    clusters: int
    agreement: float

    def cells(self) -> list[str]:
        """Return the row's cells as text."""
        beams = self.beams
        return [
            "/".join(self.file.parts[-2:])[-44:], self.sensor, self.inferred, f"{self.score:.2f}",
            self.blind, beams.source, str(beams.rings), f"{beams.placed_share:.1%}", f"{beams.alone_share:.0%}",
            str(beams.columns), self.off, f"{self.time_ms:.1f}",
            str(self.clusters) if self.clusters else "–", f"{self.agreement:.1%}" if self.clusters else "–",
        ]  # fmt: skip


def rows(folder: Path, files: list[Path]) -> Iterator[Row]:
    """Yield a row for each sweep of the index in ``folder``, and of further files."""
    for entry in read_index(folder / "index.json"):
        try:
            if entry.points is not None or entry.file.suffix == ".bin":
                yield _row(entry.file, entry.sensor, read_indexed(entry))
        except (OSError, ValueError) as error:
            print(f"not read: {error}", file=sys.stderr)
    for file in files:
        yield _row(file, "not told", read_sweep(file))


def _row(file: Path, sensor: str, sweep: Sweep) -> Row:
    model, score = infer_sensor(sweep.points, sweep.ring)
    order = np.random.default_rng(0).permutation(len(sweep))
    blind, _ = infer_sensor(sweep.points[order])
    bare = sweep.replace(model=None)
    beams = recover_rings(bare, model)
    started = time.perf_counter()
    recover_rings(bare, model)
    elapsed_ms = 1e3 * (time.perf_counter() - started)
    clusters, agreement = _agreement(sweep.points[order], beams.ring[order])
    off = _table_off(bare, beams, model)
    return Row(file, sensor, _name(model), score, _name(blind), beams, off, elapsed_ms, clusters, agreement)


def _agreement(points: NDArray[np.float32], ring: NDArray[np.int16]) -> tuple[int, float]:
    """Return how many rings the elevations alone show, and the share of returns that they place as ``ring`` does."""
    found = rings_by_clusters(*polar(np.ascontiguousarray(points)))
    if found is None:
        return 0, 0.0
    inferred, truth = found[0], np.maximum(ring, 0)
    together = np.zeros((int(inferred.max()) + 2, int(truth.max()) + 1), np.int64)
    np.add.at(together, (inferred + 1, truth), 1)
    stands_for, stood_by = together[1:].argmax(axis=1), together[1:].argmax(axis=0)
    right = (inferred >= 0) & (stands_for[np.maximum(inferred, 0)] == truth) & (stood_by[truth] == inferred)
    return len(found[1].elevation), float(right.mean())


def _name(model: LidarModel | None) -> str:
    return "–" if model is None else model.name


def _table_off(sweep: Sweep, beams: RingAssignment, model: LidarModel | None) -> str:
    """Return how far the rings' median elevations lie from the table, in degrees, seen from the beams' origins."""
    if model is None or beams.rings != model.rings:
        return "–"
    range_m = np.hypot(sweep.points[:, 0], sweep.points[:, 1])
    keep = (beams.ring >= 0) & (range_m > 2.0)
    ring = beams.ring[keep]
    angle = np.rad2deg(np.arctan2(sweep.points[keep, 2] - model.origin_m[ring], range_m[keep]) - model.elevation[ring])
    medians = np.abs([np.median(angle[ring == r]) for r in np.flatnonzero(np.bincount(ring) >= 20)])
    return f"{np.median(medians):.3f}° / {medians.max():.3f}°" if len(medians) else "–"


def _machine() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0]}, {len(names)} cores" if names else platform.machine()


def page(found: list[Row], command: str) -> str:
    """Return the Markdown page of the rows."""
    sources = Counter(row.beams.source for row in found)
    named = sum(row.inferred != "–" for row in found)
    shown = sum(row.clusters > 0 for row in found)
    confusion = Counter((row.sensor, row.inferred, row.blind) for row in found)
    head = [
        f"A sensor was named for {named} of {len(found)}. Rings came from: "
        + ", ".join(f"{source} {count}" for source, count in sources.most_common()) + ". Without table, rings and"
        f" order, the elevations of {shown} show rings; the others drove far in the revolution, are not in the sensor's"
        " frame, or are of two sensors.", "",
        "*Placed*: share of the returns that got a ring. *Alone*: share of those that are alone in their pixel; low "
        "where returns of the car itself or several revolutions overlap. *Table off*: median elevation of each ring "
        "against the inferred table, returns beyond 2 m. *Shuffled*: the sensor inferred from the bare points, in "
        "random order. *ms*: one call of `recover_rings`, compiled before. *Clusters*: rings that the elevations of "
        "the bare points show by themselves, in random order and without a table (beams without returns have none); "
        "*agree*: returns in the same ring as in *rings*.", "",
        "## Named as", "",
    ]  # fmt: skip
    tally = [[*names, str(count)] for names, count in confusion.items()]
    body = "\n".join(
        head + _table(("sensor, as the index says", "inferred", "shuffled, no rings", "sweeps"), tally)
        + ["", "## Each sweep", ""] + _table(_HEAD, [row.cells() for row in found])
    )  # fmt: skip
    made = (
        f"- sweeps: {len(found)}\n- date: {datetime.datetime.now(datetime.UTC):%Y-%m-%d}\n"
        f"- machine: {_machine()}\n- command: `{command}`"
    )
    return with_numbers("Rings, beams and sensors recovered from real sweeps", made, body)


def _table(head: tuple[str, ...], body: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in [list(head), ["---"] * len(head), *body]]


def main(arguments: list[str]) -> int:
    """Write the page and return the exit code."""
    if not arguments:
        print(__doc__, file=sys.stderr)
        return 2
    found = []
    for row in rows(Path(arguments[0]), [Path(file) for file in arguments[2:]]):
        found.append(row)
        print(" | ".join(row.cells()), flush=True)
    out = Path(arguments[1] if len(arguments) > 1 else "docs/results/beams.md")
    write_page(out, page(found, "python tools/beam_report.py DATA_DIR OUT.md FILE ..."))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
