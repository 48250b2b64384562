"""A fresh environment with the core install: its size, and how it starts: ``python -m benchmarks.environment``.

Installs this checkout with pip into a new environment, as a user does, and runs ``viewshed estimate`` there in empty
homes. Writes docs/results/environment.md.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import clouds
from benchmarks.processes import HOMES, PEAK_MB, START_TARGETS, Start, estimates_in_empty_homes
from viewshed._page import facts, page, table

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "results" / "environment.md"
TARGET_MB = 330
SEED = 20_250_307
SHOWN = 12


def main() -> None:
    """Make the environment, measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.environment", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    parser.add_argument("--homes", type=int, default=HOMES, help="empty homes in which the first start is timed")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = folder / "environment" / "bin" / "python"
        begin = time.perf_counter()
        subprocess.run([sys.executable, "-m", "venv", python.parents[1]], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", str(ROOT)], check=True)
        installed_s = time.perf_counter() - begin
        sizes = _sizes_mb(python.parents[1])
        sweep = clouds.write_nuscenes(clouds.synthetic("35k", np.random.default_rng(SEED)), folder / "street.pcd.bin")
        rows = [
            row
            for results, targets in START_TARGETS.items()
            for starts in [
                estimates_in_empty_homes(sweep, folder, results, str(python.with_name("viewshed")), chosen.homes)
            ]
            for row in (
                _row(results, "first", starts.first, targets.first_s),
                _row(results, "later", starts.later, targets.later_s),
            )
        ]
    total = sum(sizes.values())
    about = f"{total:.0f} MB in all; the target is at most {TARGET_MB}. pip and the compiler took {installed_s:.0f} s."
    largest = sorted(sizes.items(), key=lambda item: -item[1])[:SHOWN]
    content = page(
        "The core install", facts(command="`python -m benchmarks.environment`"),
        "## Size", about, table(["package", "MB"], [[f"`{name}`", f"{size:.0f}"] for name, size in largest]),
        "## First and later starts",
        "One sweep of 35k points, as a HDL-32E measures it; each first start in a home of its own that is empty.",
        table(
            ["results", "", "seconds, median (least to most)", "target", "of the processor", "peak, MB", "target"], rows
        ),
    )  # fmt: skip
    chosen.page.write_text(content, encoding="utf-8")
    print(content)


def _sizes_mb(environment: Path) -> dict[str, float]:
    """Return the size of each folder of packages in an environment by name, in 10⁶ bytes; the rest is ``Python``."""
    sizes: dict[str, float] = {}
    for file in environment.rglob("*"):
        if file.is_symlink() or not file.is_file():
            continue
        _, found, inner = file.as_posix().partition("/site-packages/")
        name = inner.partition("/")[0].removesuffix(".libs") if found else "Python"
        sizes[name] = sizes.get(name, 0.0) + file.stat().st_size / 1e6
    return sizes


def _row(results: str, when: str, starts: list[Start], target_s: float) -> list[str]:
    seconds, peak = [start.seconds for start in starts], max(start.peak_mb for start in starts)
    return [
        f"`{results}`", when, f"{np.median(seconds):.2f} ({min(seconds):.2f} to {max(seconds):.2f})",
        f"≤ {target_s:g}", f"{np.median([start.processor_s for start in starts]):.2f}", f"{peak:.0f}", f"≤ {PEAK_MB:g}",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
