"""Write the pictures of docs/monitor.md: what the shipped monitor says of attacked drives, and of real snowfall.

    python tools/monitor_pictures.py SNOW [--out docs/assets]

``SNOW`` is a sweep in snowfall (``snowy_scan.pcd`` of the recordings). The drives are simulated, of test scenes of the
study of the monitor: for each attack the first one in which an attacked sweep is called inconsistent, and of it the
first such sweep. So the pictures show what an alarm looks like, not how often there is one.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from viewshed import read_sweep
from viewshed._files import write_atomic
from viewshed.cli._verdicts import stream_monitor, stream_verdicts
from viewshed.cli.monitor import Seen, SweepRun
from viewshed.grid import GRIDS
from viewshed_lab.studies.monitor.drives import Drive
from viewshed_lab.studies.monitor.plan import FROZEN, ONSET, MonitorPlan
from viewshed_lab.studies.records import Case

ASSETS = Path(__file__).resolve().parents[1] / "docs" / "assets"

DOMAIN = "drives"

MOST_DRIVES = 40
"""Test drives of the study that are tried for an attack."""

WHERE = {"replay": FROZEN}
"""Levels of the attacks that have one here; others are as strong as they are by default."""


def main() -> None:
    """Draw all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("snow", type=Path)
    parser.add_argument("--out", type=Path, default=ASSETS)
    given = parser.parse_args()
    for name in ("far_wall", "replay", "relay"):
        found = next((each for each in _called(name)), None)
        if found is None:
            raise SystemExit(f"{name}: no sweep of {MOST_DRIVES} drives is called inconsistent")
        print(found.line)
        write_atomic(given.out / f"monitor_{name}.png", found.picture)
    run = SweepRun(stream_monitor(None), GRIDS["road"])
    leveled, report = run.check(Seen("snow", given.snow.name, read_sweep(given.snow)))
    line = f"{given.snow.name}: {stream_verdicts(report)}"
    print(line)
    write_atomic(given.out / "monitor_snow.png", run.picture(leveled, report.now, line))


@dataclass(frozen=True, slots=True)
class Explained:
    """What the monitor says of a sweep, in a line and as a picture (PNG)."""

    line: str
    picture: bytes


def _called(name: str) -> Iterator[Explained]:
    """Yield attacked sweeps of test drives that are called inconsistent."""
    plan = MonitorPlan.load("small")
    for number in range(MOST_DRIVES):
        drive = Drive.simulate(plan, DOMAIN, "test", number)
        run = SweepRun(stream_monitor(None), plan.preset(DOMAIN).grid)
        attacked = [one.sweep for one in drive.tamper(Case("attack", name, WHERE.get(name, "")))]
        for frame, sweep in enumerate([*drive.sweeps[:ONSET], *attacked]):
            leveled, report = run.check(Seen(name, name, sweep))
            if frame >= ONSET and report.now.inconsistent:
                line = f"{name}, sweep {frame - ONSET + 1} of the attack: {stream_verdicts(report)}"
                yield Explained(line, run.picture(leveled, report.now, line))


if __name__ == "__main__":
    main()
