"""Report what wedges that are aimed gain, against one sweep and against one with earlier ones, as a table in the docs.

Usage: python tools/aimed_attacks.py [OUT.md] [SCENES]
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from viewshed.arrays import Mask
from viewshed.estimators import CLASSICAL, DEFAULT_ESTIMATOR, Estimator, load_estimator
from viewshed.estimators.temporal import where_confirmed
from viewshed.fov.visibility import CAR
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed.metrics import ConfusionCounts
from viewshed.preprocess.history import HISTORY_SWEEPS, History
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab._page import facts, page, table
from viewshed_lab._results import write_page
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame, world_of
from viewshed_lab.studies.samples import StudySample
from viewshed_lab.studies.statistics import bootstrap, precision
from viewshed_lab.threats.attacks import ATTACKS, Placement, Tampered
from viewshed_lab.threats.attacks.adaptive import cells_in

SEED, FRAME = 77, 11
"""Of the scenes; the frame of each that is attacked, so that five lie before it."""

PATCH_BUDGET, PATCH_DEG = 150, 10.0

_TRIED: dict[str, tuple[str, int | None, dict[str, float]]] = {
    "far wall": ("far_wall", None, {}),
    "patch of 150": ("far_wall", PATCH_BUDGET, {"sector_deg": PATCH_DEG}),
    "removal": ("removal", None, {}),
    "removal and far wall": ("removal_and_far_wall", None, {}),
}

ONE, PAST, CONFIRMED = "one sweep", "five earlier sweeps", "five, confirmed"
"""What an estimate rests on."""

_MOVED_M, _THING_M = 0.2, (7.0, 2.0)
"""What moved so far since the sweep before moves; returns so near to its middle, ahead and beside, are its own."""

HELPED = ("shadow_map", "viewnet")
"""Methods that use earlier sweeps."""

AIMED = "largest_hidden_area"

_TARGETS: tuple[tuple[str, str, float, float], ...] = (
    ("removal", ONE, 0.95, 0.0),
    ("far wall", CONFIRMED, 0.85, 0.75),
    ("patch of 150", CONFIRMED, 0.95, 0.75),
)
"""An attack, what the estimate rests on, and the precision and recall that are aimed at."""

_INTRODUCTION = """\
{scenes} simulated road scenes (HDL-32E, clear); the truth is exact, for a car. Wedges are 30° wide and all of their
beams may be attacked; the patch is a far wall of {budget} returns in {patch:g}°. Spoofers win beams and place returns
as measured on commercial sensors. `random` aims at a return of a near obstacle; the other two read the clean
sweep, as the attacker sees it ([attacks](../attacks.md)).

- **precision / recall**: of what is claimed in the wedge under attack, the share that the truth shows; of what the
  truth shows there, the share that is claimed; over the cells of all scenes.
- **newly claimed / false**: m² a sweep in the wedge that the method claims under attack and, given the same, not
  before; and how much of it the truth does not show.
- **{past}**: honest ones, half a second apart, of the same moving sensor. **{confirmed}**: the same with
  `--require-confirmation`."""

_ABOUT_TARGETS = """\
Wedges at `{aimed}`. In brackets the 95 % interval of the precision by a bootstrap over scenes.
*Obstacles that stand*: scenes in which most of what the attack takes away belongs to no thing that moves. A vehicle
that came into the line of sight since the last earlier sweep is remembered nowhere: what it hides now was honestly seen
a moment ago, and no map of what stands can close it."""

_CONCLUSION = """\
What one sweep cannot know: a beam that a spoofer makes return from behind an obstacle looks exactly like a beam through
an open view. Where an attacker moves all beams that the obstacle stopped, nothing in the sweep speaks for the obstacle
any more, and every method here claims what it hides. Only something beside the sweep can tell: earlier sweeps, another
agent, a map, a camera. A removal alone is no evidence of an open view: what it opens is the method's own fault."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one attack on one estimate of one scene, in the wedge where the truth is known."""

    clean: ConfusionCounts  # the claims without an attack
    attacked: ConfusionCounts  # the claims under attack
    new: ConfusionCounts  # what is claimed under attack and not without, of it what the truth shows
    moving: bool = False  # whether the obstacle that the attack opens moves


Claims = dict[tuple[str, str], Mask]
"""Claimed cells (cells, cells) by method and by what the estimate rests on."""

Outcomes = dict[tuple[str, str, str, str], list[Outcome]]
"""By attack, placement, method and what the estimate rests on; one a scene."""


def scenes_of(count: int) -> Iterator[StudySample]:
    """Yield sweeps of different scenes, each with five earlier ones."""
    preset = replace(preset_named("nuscenes"), conditions=("clear",), condition_weights=(1.0,), seed=SEED)
    for number in range(count):
        scene = ScenePlan(preset, 0, number)
        yield StudySample(simulate_frame(scene, FRAME), (), (scene, FRAME))


def attacked(name: str, placement: Placement, sweep: Sweep, number: int) -> Tampered:
    """Return a sweep under one of the attacks that are tried."""
    attack_name, budget, changes = _TRIED[name]
    attack: Any = ATTACKS[attack_name](budget)
    tampered: Tampered = replace(attack, placement=placement, **changes).apply(
        sweep, np.random.Generator(np.random.PCG64(number))
    )
    return tampered


def earlier_sweeps(sample: StudySample) -> list[LeveledSweep]:
    """Return the five sweeps that the sensor measured before a simulated sample, leveled, the oldest first."""
    if sample.frame is None:
        raise ValueError("a sample must be simulated to have earlier sweeps, got a recorded one")
    scene, frame = sample.frame
    step = scene.preset.agents
    numbers = range(frame % step, frame, step)[-HISTORY_SWEEPS:]
    return [level(simulate_frame(scene, number).sweep, sample.truth.grid) for number in numbers]


def claims(sweep: Sweep, victims: Mapping[str, Estimator], earlier: Sequence[LeveledSweep]) -> Claims:
    """Return what every method claims of a sweep, by itself and with the sweeps before it where it uses any."""
    leveled, found = level(sweep, next(iter(victims.values())).grid), Claims()
    history = History.of(leveled, earlier)
    for name, victim in victims.items():
        found[name, ONE] = victim.estimate(leveled).visible()
        if victim.uses_history:
            estimate = victim.estimate(leveled, history)
            found[name, PAST] = estimate.visible()
            found[name, CONFIRMED] = where_confirmed(estimate, history).visible()
    return found


def opens_moving(sample: StudySample, tampered: Tampered) -> bool:
    """Return whether most obstacle returns that an attack takes lie on things that moved since the sweep before."""
    if sample.frame is None or sample.sweep.world_from_sensor is None:
        raise ValueError("a sample must be simulated to tell what moves, got a recorded one")
    (scene, frame), sweep = sample.frame, sample.sweep
    leveled = level(sweep, sample.truth.grid)
    taken = tampered.removed[leveled.rows] & (leveled.height_m > OBSTACLE_HEIGHTS_M[0])
    xyz = sample.sweep.world_from_sensor @ sweep.points[leveled.rows[taken]]
    interval_s = scene.preset.interval_s
    now_s = (frame // scene.preset.agents + 0.5) * interval_s
    moving, world = np.zeros(len(xyz), np.bool_), world_of(scene)
    carrier = world.agents[frame % scene.preset.agents].carrier
    for number, thing in enumerate(world.things):
        (x, y, yaw), (x_before, y_before, _) = (thing.pose_at(t_s) for t_s in (now_s, now_s - interval_s))
        if number != carrier and np.hypot(x - x_before, y - y_before) > _MOVED_M:
            # In the thing's own frame.
            ahead, beside, _ = np.abs(Rigid.from_yaw(yaw, (x, y, 0.0)).inverse() @ xyz).T
            moving |= (ahead < _THING_M[0]) & (beside < _THING_M[1])
    return bool(len(moving)) and float(moving.mean()) > 0.5


def outcomes_of(sample: StudySample, victims: Mapping[str, Estimator], number: int) -> Outcomes:
    """Return what comes of every attack and placement on one scene; lists of one."""
    earlier, truth = earlier_sweeps(sample), sample.truth.visible(CAR)
    grid, found = sample.truth.grid, Outcomes()
    unattacked = claims(sample.sweep, victims, earlier)
    for name in _TRIED:
        for placement in get_args(Placement):
            tampered = attacked(name, placement, sample.sweep, number)
            if tampered.wedge is None:
                raise ValueError("an attack that is aimed must have a wedge, got none")
            inside = sample.known & cells_in(grid, sample.sweep, tampered.wedge)
            moving = opens_moving(sample, tampered)
            for (method, basis), after in claims(tampered.sweep, victims, earlier).items():
                before = unattacked[method, basis]
                clean, under_attack, new = (
                    ConfusionCounts.of(mask, truth, inside, grid.cell_area_m2)
                    for mask in (before, after, after & ~before)
                )
                found[name, placement, method, basis] = [Outcome(clean, under_attack, new, moving)]
    return found


def _all_outcomes(count: int, victims: Mapping[str, Estimator]) -> Outcomes:
    found: Outcomes = defaultdict(list)
    for number, sample in enumerate(scenes_of(count)):
        for key, of_one in outcomes_of(sample, victims, number).items():
            found[key] += of_one
    return dict(found)


def _pooled(counts: Sequence[ConfusionCounts]) -> ConfusionCounts:
    return sum(counts[1:], counts[0])


def _rates(counts: Sequence[ConfusionCounts]) -> str:
    pooled = _pooled(counts)
    return f"{pooled.precision:.3f} / {pooled.recall:.3f}"


def _areas(outcomes: Sequence[Outcome], cell_m2: float) -> str:
    new = _pooled([one.new for one in outcomes])
    return f"{(new.both + new.over) * cell_m2 / new.samples:.0f} / {new.over * cell_m2 / new.samples:.0f}"


def _target_rows(found: Outcomes, methods: Sequence[str]) -> Iterator[list[str]]:
    for attack, basis, least_precision, least_recall in _TARGETS:
        aim = f"precision ≥ {least_precision:.2f}" + (f", recall ≥ {least_recall:.2f}" if least_recall else "")
        for method in methods:
            outcomes = found[attack, AIMED, method, basis]
            parts = {"": outcomes, ", obstacles that stand": [one for one in outcomes if not one.moving]}
            for part, chosen in parts.items():
                if chosen:
                    rates, met = _against(chosen, least_precision, least_recall)
                    yield [f"{attack}, {basis}{part}", method, str(len(chosen)), aim, rates, met]


def _against(outcomes: Sequence[Outcome], least_precision: float, least_recall: float) -> tuple[str, str]:
    counts = [one.attacked for one in outcomes]
    pooled = _pooled(counts)
    cells = np.array([[one.both, one.over, one.under, one.neither] for one in counts], np.float64)
    low, high = bootstrap([(cells, [str(k) for k in range(len(cells))])], precision)
    met = pooled.precision >= least_precision and pooled.recall >= least_recall
    rates = f"{pooled.precision:.3f} [{low:.3f}, {high:.3f}] / {pooled.recall:.3f}"
    return rates, "met" if met else "**missed**"


def report(count: int) -> str:
    """Return the page for ``count`` scenes."""
    grid = GRIDS["road"]
    victims = {
        name: load_estimator(name, grid=grid) for name in dict.fromkeys([DEFAULT_ESTIMATOR, *HELPED, *CLASSICAL])
    }
    found, helped = _all_outcomes(count, victims), [name for name, one in victims.items() if one.uses_history]
    tries = [(attack, placement) for attack in _TRIED for placement in get_args(Placement)]

    def rows(columns: Sequence[tuple[str, str]], text: Any) -> Iterator[list[str]]:
        for attack, placement in tries:
            cells = [text(found[attack, placement, *column]) for column in columns]
            yield [attack, f"`{placement}`", *cells]

    def rates(outcomes: Sequence[Outcome]) -> str:
        return _rates([one.attacked for one in outcomes])

    def clean_rates(outcomes: Sequence[Outcome]) -> str:
        return _rates([one.clean for one in outcomes])

    def areas(outcomes: Sequence[Outcome]) -> str:
        return _areas(outcomes, grid.cell_area_m2)

    alone = [(name, ONE) for name in victims]
    bases = [(name, basis) for name in helped for basis in (ONE, PAST, CONFIRMED)]
    head = ["attack", "placement"]
    names, based = [*head, *victims], [*head, *(f"{name}, {basis}" for name, basis in bases)]
    about = _INTRODUCTION.format(
        scenes=count, budget=PATCH_BUDGET, patch=PATCH_DEG, past=PAST.capitalize(), confirmed=CONFIRMED.capitalize()
    )
    return page(
        "Aimed attacks: what they gain",
        facts(seed=str(SEED), default=DEFAULT_ESTIMATOR),
        about,
        "## Targets",
        _ABOUT_TARGETS.format(aimed=AIMED),
        table(["what", "method", "scenes", "target", "precision / recall", ""], _target_rows(found, helped)),
        "## One sweep, each method",
        "Precision / recall in the wedge.",
        table(names, rows(alone, rates)),
        "Newly claimed / false, m² a sweep.",
        table(names, rows(alone, areas)),
        "## With earlier sweeps",
        "Precision / recall in the wedge.",
        table(based, rows(bases, rates)),
        "The same without an attack, in the same wedges.",
        table(based, rows(bases, clean_rates)),
        "Newly claimed / false, m² a sweep.",
        table(based, rows(bases, areas)),
        _CONCLUSION,
    )


def main() -> None:
    """Write the report."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/results/aimed_attacks.md")
    write_page(out, report(int(sys.argv[2]) if len(sys.argv) > 2 else 24))


if __name__ == "__main__":
    main()
