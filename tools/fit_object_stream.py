"""Fit what evidence is worth where the package's own detector finds the objects: ``python tools/fit_object_stream.py``.

``single.json`` is calibrated with a detector by tables, whose boxes stand where the objects do. Those of
``viewshed.perception`` move as the car that they are about is seen from another side, and a limit for the one accuses
honest tracks of the other. This fits tables and limits on benign simulated drives that go through
``viewshed.fusion.object_stream``: even ones for the tables, odd ones for the limits; then it counts, on further drives,
how many honest tracks are accused by either. Writes src/viewshed/fusion/object_stream.json.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from viewshed import load_estimator
from viewshed.datasets.presets import preset_named
from viewshed.datasets.recorder.drive import drive_plan, drive_sweeps
from viewshed.fusion.calibration import count_drive, highest_e_values, limits_of, model_of_counts
from viewshed.fusion.evidence import EvidenceCounts, EvidenceModel
from viewshed.fusion.object_stream import ObjectStream
from viewshed.fusion.sensor_view import Observed
from viewshed.fusion.single import shipped_model
from viewshed.preprocess.leveling import level

PLACE = Path(__file__).resolve().parents[1] / "src" / "viewshed" / "fusion" / "object_stream.json"

WORLDS, SENSORS = ("street", "junction", "parking"), ("hdl32e", "os1_64", "vlp32c", "hdl64e")

SEED, ACCUSED = 20_261_123, 0.03


def observed(number: int, seconds: float) -> Iterator[Observed]:
    """Yield what fusion is given of a benign drive."""
    preset = replace(preset_named("drives"), sensors=(SENSORS[number // len(WORLDS) % len(SENSORS)],))
    world = WORLDS[number % len(WORLDS)]
    plan = drive_plan(preset, seconds=seconds, hz=10.0, agents=1, world=world, seed=SEED + number)
    estimator, objects = load_estimator("shadow_map"), ObjectStream()
    for sweep, _ in drive_sweeps(plan):
        leveled = level(sweep, estimator.grid)
        yield objects.observe(leveled, estimator.estimate(leveled))[1]


def accused_share(drives: range, seconds: float, models: dict[str, EvidenceModel]) -> dict[str, tuple[int, int]]:
    """Return of each model how many honest confirmed tracks it accuses at any time, of how many."""
    out = {}
    for name, model in models.items():
        highest = [row for k in drives for row in highest_e_values(observed(k, seconds), model).values()]
        over = np.asarray((np.array(highest) >= np.array(model.limits)).any(axis=1))
        out[name] = int(over.sum()), len(over)
    return out


def main() -> None:
    """Fit, check and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--drives", type=int, default=16, help="benign drives that are fitted on, half of them for limits"
    )
    parser.add_argument("--checks", type=int, default=6, help="further drives on which accusations are counted")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each drive")
    chosen = parser.parse_args()
    rng, counts, highest = np.random.default_rng(SEED), EvidenceCounts(), list[np.ndarray]()
    for number in range(0, chosen.drives, 2):
        count_drive(observed(number, chosen.seconds), counts, rng)
        print(f"drive {number} counted", flush=True)
    model = model_of_counts(counts, ACCUSED)
    for number in range(1, chosen.drives, 2):
        highest += highest_e_values(observed(number, chosen.seconds), model).values()
        print(f"drive {number}: {len(highest)} honest tracks", flush=True)
    limits = limits_of(np.array(highest).reshape(-1, 3), ACCUSED)
    model = replace(model, limits=limits, tracks=len(highest))
    model.save(PLACE)
    checks = range(chosen.drives, chosen.drives + chosen.checks)
    models = {"fitted": model, "single.json": shipped_model()}
    for name, (over, count) in accused_share(checks, chosen.seconds, models).items():
        print(f"{name}: {over} of {count} honest tracks accused")
    print(f"limits {limits}")


if __name__ == "__main__":
    main()
