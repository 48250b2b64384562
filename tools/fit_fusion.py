"""Fit what evidence about tracks is worth, with the package's detector: ``python tools/fit_fusion.py``.

Tables and limits are from benign simulated drives that go through ``viewshed.objects.object_stream``: even ones for the
tables, odd ones for the limits. Writes single.json of ``viewshed.objects``, and counts on more drives how many honest
tracks are accused; what is found of forged objects ``viewshed study tracks`` measures.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from viewshed import load_estimator
from viewshed.objects.calibration import count_drive, highest_e_values, limits_of, model_of_counts
from viewshed.objects.evidence import EvidenceCounts, EvidenceModel
from viewshed.objects.object_stream import ObjectStream
from viewshed.objects.sensor_view import Observed
from viewshed.objects.single import shipped_model
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named

PLACE = Path(__file__).resolve().parents[1] / "packages/viewshed/src/viewshed/objects/single.json"

WORLDS, SENSORS = ("street", "junction", "parking"), ("hdl32e", "os1_64", "vlp32c", "hdl64e")

SEED, ACCUSED = 20_261_123, 0.03
"""Seed of all random draws; share of honest tracks that may be accused."""


def sweeps_of(number: int, seconds: float) -> Iterator[Sweep]:
    """Yield the sweeps of a simulated drive of one vehicle."""
    preset = replace(preset_named("drives"), sensors=(SENSORS[number // len(WORLDS) % len(SENSORS)],))
    world = WORLDS[number % len(WORLDS)]
    plan = drive_plan(preset, seconds=seconds, hz=10.0, agents=1, world=world, seed=SEED + number)
    return (sweep for sweep, _ in drive_sweeps(plan))


def observed(number: int, seconds: float) -> Iterator[Observed]:
    """Yield the input of fusion on a benign drive."""
    estimator, objects = load_estimator("shadow_map"), ObjectStream()
    for sweep in sweeps_of(number, seconds):
        leveled = level(sweep, estimator.grid)
        yield objects.observe(leveled, estimator.estimate(leveled))[1]


def accused_share(drives: range, seconds: float, model: EvidenceModel) -> tuple[int, int]:
    """Return the number of honest confirmed tracks that a model ever accuses, and the number of all."""
    highest = [row for k in drives for row in highest_e_values(observed(k, seconds), model).values()]
    over = np.asarray((np.array(highest) >= np.array(model.limits)).any(axis=1))
    return int(over.sum()), len(over)


def main() -> None:
    """Fit the model unless it is kept, and check it."""
    parser = argparse.ArgumentParser(prog="fit_fusion.py", description=__doc__)
    parser.add_argument("--keep", action="store_true", help="keep the shipped model, and only check it")
    parser.add_argument("--drives", type=int, default=16, help="benign drives, half of them for limits")
    parser.add_argument("--checks", type=int, default=6, help="further drives on which accusations are counted")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each drive")
    arguments = parser.parse_args()
    if not arguments.keep:
        fit(arguments.drives, arguments.seconds).save(PLACE)
        shipped_model.cache_clear()
    checks = range(arguments.drives, arguments.drives + arguments.checks)
    over, count = accused_share(checks, arguments.seconds, shipped_model())
    print(f"honest tracks accused: {over / count:.3f} ({over} of {count})")


def fit(drives: int, seconds: float) -> EvidenceModel:
    """Return the model fitted on benign drives."""
    rng, counts, highest = np.random.default_rng(SEED), EvidenceCounts(), list[np.ndarray]()
    for number in range(0, drives, 2):
        count_drive(observed(number, seconds), counts, rng)
        print(f"drive {number} counted", flush=True)
    model = model_of_counts(counts, ACCUSED)
    for number in range(1, drives, 2):
        highest += highest_e_values(observed(number, seconds), model).values()
        print(f"drive {number}: {len(highest)} honest tracks", flush=True)
    limits = limits_of(np.array(highest).reshape(-1, 3), ACCUSED)
    return replace(model, limits=limits, tracks=len(highest))


if __name__ == "__main__":
    main()
