"""Put a calibrated monitor into the package: ``python tools/ship_monitor.py STUDY``.

STUDY is a folder of ``viewshed study monitor``, whose drives and scores are there. The score of all attacks is
calibrated on the calibration drives; its file goes into the folder of shipped monitors.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from viewshed.monitor.sweep_monitor import SHIPPED, load_sweep_monitor, save_sweep_monitor
from viewshed_lab.studies.monitor.archive import SweepTable
from viewshed_lab.studies.monitor.jobs import load_score, score_path
from viewshed_lab.studies.monitor.plan import ALL_FAMILIES
from viewshed_lab.studies.monitor.shipped import monitor_of


def main(words: Sequence[str] | None = None) -> None:
    """Calibrate and write the monitor of a study."""
    parser = argparse.ArgumentParser(prog="ship_monitor.py", description=__doc__)
    parser.add_argument("study", type=Path, help="folder of the study")
    parser.add_argument("--out", type=Path, default=SHIPPED)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--per-hour", type=float, default=10.0, help="false alarms over time")
    chosen = parser.parse_args(words)
    score = load_score(score_path(chosen.study, ALL_FAMILIES))
    monitor = monitor_of(score, SweepTable.read(chosen.study, "calibration"), chosen.seed)
    monitor = replace(monitor, per_hour=chosen.per_hour)
    monitor.detector()  # are there runs enough?
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    save_sweep_monitor(monitor, chosen.out)
    print(*load_sweep_monitor(chosen.out).promises(), *monitor.warnings, sep="\n")
    print(f"{chosen.out.name}: {chosen.out.stat().st_size} bytes, {len(monitor.benign)} groups")


if __name__ == "__main__":
    main()
