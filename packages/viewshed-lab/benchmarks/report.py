"""The rows as a table for a terminal, a page and a JSON file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from viewshed_lab import _page as report
from viewshed_lab._results import write_page


@dataclass(frozen=True, slots=True)
class Row:
    """One measured step."""

    step: str  # description of the step
    size: str  # size of its input
    median_ms: float  # our median
    low_ms: float  # 10th percentile
    high_ms: float  # 90th percentile
    repeats: int  # number of runs
    floor_ms: float | None  # bytes that must be moved, divided by the bandwidth measured in the same run, or None
    target: str  # as text, empty without a target
    met: bool | None  # whether the target is met, None without a target
    others_ms: dict[str, float]  # medians of the alternatives by name
    peak_mb: float | None = None  # peak memory of a process in 10⁶ bytes, or None if not measured

    def cells(self) -> list[str]:
        """Return the row as text, cell by cell."""
        verdict = {True: "met", False: "**missed**", None: "–"}[self.met]
        ratios = "; ".join(f"{name} {_ratio(value / self.median_ms)} ×" for name, value in self.others_ms.items())
        return [
            self.step, self.size, f"{_ms(self.median_ms)} ({_ms(self.low_ms)}–{_ms(self.high_ms)})",
            "–" if self.floor_ms is None else _ms(self.floor_ms), self.target or "–", verdict, ratios or "–",
            "–" if self.peak_mb is None else f"{self.peak_mb:.0f}",
        ]  # fmt: skip


HEAD = [
    "step", "points", "median, ms (10–90 %)", "floor, ms", "target", "",
    "time of the alternatives, as a multiple of ours", "peak, MB",
]  # fmt: skip
INTRODUCTION = """\
Grid of 256 × 256 cells, one thread, medians in milliseconds with the 10th and 90th percentile. The alternatives are
measured in the same run, interleaved with ours round by round in an order drawn anew, so the ratios hold better than
the milliseconds do: a ratio above 1 says that ours is faster. The **floor** is the time that moving the input and the
output once through memory takes at the bandwidth measured in the same run; what fits into a cache can pass below it.

The sweeps are a simulated street junction as an HDL-32E (35k points) and an HDL-64E (120k) see it, with rings but
without attitude, height or beam azimuth, so that leveling and the ground, which have a row of their own, are part of
every estimator's time; rows marked *real* are a nuScenes and a KITTI sweep from the folder
in `VIEWSHED_REAL_DATA`. The estimators start from points in memory
and end with probability and state of every cell. Processes are timed on the wall clock. **First** is the first
one in a home that is empty, where nothing is cached; later ones follow in the same home."""


def write(rows: Sequence[Row], facts: dict[str, str], page: Path) -> None:
    """Write the page (Markdown), and the same data as JSON beside it."""
    body = report.table(HEAD, [row.cells() for row in rows])
    write_page(page, report.page("Speed", facts, INTRODUCTION, _verdict(rows), body))
    content = {"facts": facts, "rows": [asdict(row) for row in rows]}
    page.with_suffix(".json").write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _verdict(rows: Sequence[Row]) -> str:
    judged = [row for row in rows if row.met is not None]
    return f"{sum(row.met is True for row in judged)} of {len(judged)} targets are met; the table marks the others."


def _ms(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _ratio(value: float) -> str:
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"
