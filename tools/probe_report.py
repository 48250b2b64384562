"""Report how often the exact truth and really placed targets say the same, as a table in the docs.

Usage: python tools/probe_report.py [OUT.md] [PLACES_EACH]
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from placed_probes import Probes, Setting, place, reason

from viewshed._page import facts, page, table
from viewshed._results import write_page
from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
from viewshed.grid import GRIDS
from viewshed.sensors import lidar_model
from viewshed.sim.observe import pose_and_motion
from viewshed.sim.raycast.caster import cast_world
from viewshed.sim.truth.exact import exact_truth
from viewshed.sim.world import AgentPlan
from viewshed.sim.worlds import WORLDS

SEEDS = (11, 12)
T_S = 2.0
REVOLUTION_S = 0.05
BANDS_M = {False: (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 64.0, 91.0), True: (0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 23.0)}
REASONS = {
    "side": "the beam enters the box by its front and leaves by its side, before the plate",
    "top": "the beam enters the box by its front and leaves by its top, before the plate",
    "ground": "the beam would meet the ground inside the last cell, before the plate, and meets the box's front",
    "fewer": "a beam that the truth counts does not meet the box",
    "other": "none of these",
}
_INTRODUCTION = """\
The exact truth counts beams on a plate. Here the plate is really put up: a box as wide and high as the target, one cell
deep, across the line of sight, its back through the center of the cell and its front one cell nearer, on the local
ground. The world is cast again with the same draws of leaves and glass, and the beams whose first stop is the box are
counted. *Agreement*: truth and probe are on the same side of the target's number of returns. Places that touch anything
else are left out; each range is tried as often as any other. *Contested*: agreement among those probes for which the
truth or the cast has at least one beam (behind a wall both say 0, which is easy). *Truth only*: the truth says visible,
the probe does not; *probe only* the other way round."""
_WHOLE = """\
The same with a whole target, turned at random and centered in its cell. It is no test of the truth: a car of 4.2 m
shows up to 4.5 m where the plate shows 1.8 m, and its nearest corner stands 2.3 m before the center, so more
beams meet it, and it looks out from behind what hides its center. It tells how cautious the definition is: nearly all
disagreements are cars that are met and not claimed."""


@dataclass(frozen=True, slots=True)
class Group:
    """Probes of one setting."""

    world: str
    sensor: str
    indoor: bool
    probes: Probes
    reasons: Counter[str]


def settings(world: str, seed: int) -> Iterator[tuple[str, bool, Setting]]:
    """Yield the sensor's name, whether it is indoors, and the setting, for each sensor of a kind of world."""
    indoor = WORLDS[world](np.random.Generator(np.random.PCG64(seed)), AgentPlan()).indoor
    for sensor in ("vlp16",) if indoor else ("hdl32e", "hdl64e", "roadside"):
        plan = AgentPlan(
            1, 1, sensor="hdl32e" if sensor == "roadside" else sensor, sensor_height_m=0.6 if indoor else 1.84
        )
        made = WORLDS[world](np.random.Generator(np.random.PCG64(seed)), plan)
        agent = made.agents[int(sensor == "roadside")]
        snapshot, model = made.snapshot(T_S), lidar_model(agent.sensor)
        pose, motion = pose_and_motion(made, agent, T_S, REVOLUTION_S)
        scan = cast_world(snapshot, model, pose, motion, seed)
        truth, known = exact_truth(scan, made, GRIDS["indoor" if indoor else "road"], agent=agent)
        yield model.name, indoor, Setting(snapshot, scan, seed, truth, known)


def groups(target: Target, count: int, whole: bool) -> Iterator[Group]:
    """Yield the probes of every world, seed and sensor."""
    for world in WORLDS:
        for seed in SEEDS:
            for sensor, indoor, setting in settings(world, seed):
                probes = place(setting, target, count, np.random.default_rng(seed), whole)
                rows = [] if whole else [probes.boxes.select(np.array([k])) for k in np.flatnonzero(~probes.agree)]
                reasons = Counter(reason(setting, row, target) for row in rows)
                print(world, sensor, target.name, "whole" if whole else "plate", len(probes.met), file=sys.stderr)
                yield Group(world, sensor, indoor, probes, reasons)


def _cells(probes: Sequence[Probes], which: Sequence[NDArray[np.bool_]]) -> list[str]:
    """Return the cells of a row: how many, how many visible, agreement, contested agreement, and the two errors."""
    expected = np.concatenate([one.expected[keep] for one, keep in zip(probes, which, strict=True)])
    met = np.concatenate([one.met[keep] for one, keep in zip(probes, which, strict=True)])
    least = probes[0].target.min_returns
    if not len(met):
        return ["0", *["–"] * 5]
    same, some = (expected >= least) == (met >= least), (expected > 0) | (met > 0)
    contested = f"{same[some].mean():.2%} of {some.sum()}" if some.any() else "–"
    wrong = [int(((expected >= least) & (met < least)).sum()), int(((expected < least) & (met >= least)).sum())]
    return [str(len(met)), f"{(met >= least).mean():.0%}", f"{same.mean():.2%}", contested, *map(str, wrong)]


_HEAD = ["probes", "visible", "agreement", "contested", "truth only", "probe only"]


def by_band(found: Sequence[Group], indoor: bool) -> str:
    """Return the table of range bands."""
    probes, bands = [group.probes for group in found if group.indoor == indoor], BANDS_M[indoor]
    rows = []
    for low, high in pairwise(bands):
        which = [(one.range_m >= low) & (one.range_m < high) for one in probes]
        rows.append([f"{low:.0f} to {high:.0f} m", *_cells(probes, which)])
    return table(["range", *_HEAD], rows)


def by_world(found: Sequence[Group]) -> str:
    """Return the table of worlds and sensors."""
    keys = dict.fromkeys((group.world, group.sensor) for group in found)
    rows = []
    for key in keys:
        probes = [group.probes for group in found if (group.world, group.sensor) == key]
        rows.append([*key, *_cells(probes, [np.ones(len(one.met), np.bool_) for one in probes])])
    return table(["world", "sensor", *_HEAD], rows)


def _total(found: Sequence[Group]) -> list[str]:
    return _cells([group.probes for group in found], [np.ones(len(group.probes.met), np.bool_) for group in found])


def _why(found: Sequence[Group]) -> str:
    reasons = sum((group.reasons for group in found), Counter[str]())
    rows = [[REASONS[name], str(count)] for name, count in reasons.most_common()]
    gaps = np.concatenate([np.abs(g.probes.expected - g.probes.met)[~g.probes.agree] for g in found])
    few, some = int((gaps <= 1).sum()), int((gaps <= 3).sum())
    near = f"Of {len(gaps)} disagreements {few} are of one beam and {some} of three at most."
    return f"{near}\n\n{table(['most of the beams that differ', 'probes'], rows)}"


def report(count: int) -> str:
    """Return the page."""
    plate = {target: list(groups(target, count, whole=False)) for target in (CAR, PEDESTRIAN)}
    whole = {target: list(groups(target, count, whole=True)) for target in (CAR, PEDESTRIAN)}
    both = [group for found in plate.values() for group in found]
    total = sum(len(group.probes.met) for group in both)
    agree = sum(int(group.probes.agree.sum()) for group in both)
    asked = f"**{agree / total:.2%} of {total} probes agree** (asked for: 99 % of 20000)."
    parts = [_INTRODUCTION, asked, "## In total",
             table(["placed", *_HEAD], [[f"plate, {t.name}", *_total(found)] for t, found in plate.items()]
                   + [[f"whole {t.name}", *_total(found)] for t, found in whole.items()])]  # fmt: skip
    for target, found in plate.items():
        parts += [f"## Plates: {target.name}", "Outdoors", by_band(found, indoor=False), "Indoors",
                  by_band(found, indoor=True), _why(found), by_world(found)]  # fmt: skip
    parts += ["## Whole targets", _WHOLE]
    for target, found in whole.items():
        parts += [
            f"### {target.name}",
            "Outdoors",
            by_band(found, indoor=False),
            "Indoors",
            by_band(found, indoor=True),
        ]
    told = facts(seeds=", ".join(map(str, SEEDS)), revolution=f"{REVOLUTION_S} s, sensors in motion")
    return page("Truth against placed probes", told, *parts)


if __name__ == "__main__":
    text = report(int(sys.argv[2]) if len(sys.argv) > 2 else 600)
    if len(sys.argv) > 1:
        write_page(Path(sys.argv[1]), text)
    else:
        print(text)
