"""Fit what evidence about tracks is worth, with the package's detector: ``python tools/fit_fusion.py``.

Tables and limits are from benign simulated drives that go through ``viewshed.objects.object_stream``: even ones for the
tables, odd ones for the limits. Then it counts, on more drives, how many honest tracks are accused, how many forged
objects (three fabricated, or three removed) are named within a second, and how many are not shown. Writes single.json
of ``viewshed.objects``, prints the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from viewshed import load_estimator
from viewshed.detections import Detections
from viewshed.objects.calibration import count_drive, highest_e_values, limits_of, model_of_counts
from viewshed.objects.evidence import EvidenceCounts, EvidenceModel
from viewshed.objects.object_stream import ObjectStream, SeenObjects
from viewshed.objects.sensor_view import Observed
from viewshed.objects.single import shipped_model
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab._page import table
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named
from viewshed_lab.threats.adversary import Adversary

PLACE = Path(__file__).resolve().parents[1] / "packages/viewshed/src/viewshed/objects/single.json"

WORLDS, SENSORS = ("street", "junction", "parking"), ("hdl32e", "os1_64", "vlp32c", "hdl64e")

SEED, ACCUSED, START_S = 20_261_123, 0.03, 2.0
"""Of all that is random; share of honest tracks that may be accused; when attacks begin."""

NEAR_M = 2.0
"""A track within this distance of a forged object is of it."""


def sweeps_of(number: int, seconds: float) -> Iterator[Sweep]:
    """Yield the sweeps of a simulated drive of one vehicle."""
    preset = replace(preset_named("drives"), sensors=(SENSORS[number // len(WORLDS) % len(SENSORS)],))
    world = WORLDS[number % len(WORLDS)]
    plan = drive_plan(preset, seconds=seconds, hz=10.0, agents=1, world=world, seed=SEED + number)
    return (sweep for sweep, _ in drive_sweeps(plan))


def observed(number: int, seconds: float) -> Iterator[Observed]:
    """Yield what fusion is given of a benign drive."""
    estimator, objects = load_estimator("shadow_map"), ObjectStream()
    for sweep in sweeps_of(number, seconds):
        leveled = level(sweep, estimator.grid)
        yield objects.observe(leveled, estimator.estimate(leveled))[1]


def accused_share(drives: range, seconds: float, model: EvidenceModel) -> tuple[int, int]:
    """Return how many honest confirmed tracks of drives a model accuses at any time, of how many."""
    highest = [row for k in drives for row in highest_e_values(observed(k, seconds), model).values()]
    over = np.asarray((np.array(highest) >= np.array(model.limits)).any(axis=1))
    return int(over.sum()), len(over)


def found_share(drives: range, seconds: float, attack: str, model: EvidenceModel) -> tuple[int, int, int]:
    """Return how many forged objects of drives are named, or never shown, within a second; of how many."""
    named = hidden = total = 0
    for number in drives:
        for is_named, is_shown in forged_after(number, seconds, attack, model):
            named, hidden, total = named + is_named, hidden + (not is_named and not is_shown), total + 1
    return named, hidden, total


def forged_after(number: int, seconds: float, attack: str, model: EvidenceModel) -> list[tuple[bool, bool]]:
    """Return of each forged object whether it was accused within a second, and whether its track is shown at its end.

    Of fabricated ones the track is one within 2 m of it; of removed ones it is that of a detection that is gone.
    """
    adversary = Adversary(attack, start_s=START_S, count=3, seed=number)
    honest: list[Detections] = []

    def tamper(leveled: LeveledSweep, detections: Detections) -> Detections:
        honest.append(detections)
        return adversary.detections(leveled, detections)

    objects, estimator = ObjectStream(tamper=tamper, model=model), load_estimator("shadow_map")
    forged: dict[int, tuple[np.ndarray, bool, bool]] = {}
    first_s = None
    for sweep in sweeps_of(number, seconds):
        leveled = level(sweep, estimator.grid)
        seen = objects.follow(leveled, estimator.estimate(leveled))
        t_s = 1e-9 * (sweep.t_ns or 0)
        first_s = t_s if first_s is None else first_s
        since_s = t_s - first_s - START_S
        if since_s < -1e-6 or since_s > 1.0 + 1e-6:
            continue
        tracks, shown = seen.explained.tracks, seen.shown
        if not forged:
            forged = _forged_at_first(attack, honest[-1], seen)
        for key, (place, was_named, _) in forged.items():
            near = (
                np.hypot(*(tracks.boxes[:, :2] - place).T) < 2.0
                if attack.startswith("fabricate")
                else tracks.ids == key
            )
            is_named = was_named or bool((near & seen.explained.accused).any())
            forged[key] = place, is_named, bool((near & shown & ~seen.explained.accused).any())
    return [(is_named, is_shown) for _, is_named, is_shown in forged.values()]


def _forged_at_first(attack: str, honest: Detections, seen: SeenObjects) -> dict[int, tuple[np.ndarray, bool, bool]]:
    """Return the forged objects of the first attacked sweep: places of fabricated ones, ids of removed ones' tracks."""
    pose = seen.tracks_from_level
    if attack.startswith("fabricate"):
        places = seen.detections.moved(pose).boxes[len(honest) :, :2]
        return {k: (place, False, False) for k, place in enumerate(places)}
    kept = {tuple(row) for row in seen.detections.boxes[:, :2].round(6).tolist()}
    gone = [k for k, row in enumerate(honest.boxes[:, :2].round(6).tolist()) if tuple(row) not in kept]
    tracks, out = seen.explained.tracks, dict[int, tuple[np.ndarray, bool, bool]]()
    for place in honest.take(np.array(gone, np.intp)).moved(pose).boxes[:, :2]:
        apart = np.where(tracks.confirmed, np.hypot(*(tracks.boxes[:, :2] - place).T), np.inf)
        if len(apart) and apart.min() < NEAR_M:
            out[int(tracks.ids[apart.argmin()])] = place, False, False
    return out


def main() -> None:
    """Fit where it is wanted, check, and print the table."""
    parser = argparse.ArgumentParser(prog="fit_fusion.py", description=__doc__)
    parser.add_argument("--keep", action="store_true", help="keep the shipped model, and only check it")
    parser.add_argument("--drives", type=int, default=16, help="benign drives, half of them for limits")
    parser.add_argument("--checks", type=int, default=6, help="further drives on which accusations are counted")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each drive")
    chosen = parser.parse_args()
    if not chosen.keep:
        fit(chosen.drives, chosen.seconds).save(PLACE)
        shipped_model.cache_clear()
    checks = range(chosen.drives, chosen.drives + chosen.checks)
    over, count = accused_share(checks, chosen.seconds, shipped_model())
    row = [f"{over / count:.3f} ({over} of {count})"]
    for attack in ("fabricate_static", "remove_trajectory"):
        named, hidden, total = found_share(checks, START_S + 1.2, attack, shipped_model())
        row += [f"{named / max(total, 1):.2f}", f"{hidden / max(total, 1):.2f}", str(total)]
    header = ["honest tracks accused", "fabricated: named", "not shown", "of", "removed: named", "not shown", "of"]
    print(table(header, [row]))


def fit(drives: int, seconds: float) -> EvidenceModel:
    """Return the model of benign drives."""
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
