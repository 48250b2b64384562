"""The report of aimed attacks: what is counted of one scene, and what its tables say of counts made by hand."""

from dataclasses import replace
from typing import get_args

import aimed_attacks
import numpy as np
import pytest
from aimed_attacks import AIMED, CONFIRMED, ONE, PAST, Outcome

from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.metrics import ConfusionCounts
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame, world_of
from viewshed_lab.studies.samples import StudySample
from viewshed_lab.threats.attacks import Placement, Tampered


@pytest.fixture(scope="module")
def sample() -> StudySample:
    """A sweep on a coarse grid with five earlier ones."""
    preset = replace(preset_named("nuscenes"), conditions=("clear",), condition_weights=(1.0,), grid_cells=64)
    scene = ScenePlan(preset, 0, 3)
    return StudySample(simulate_frame(scene, 6), (), (scene, 6))


def test_each_attack_is_counted_in_its_wedge_alone_and_with_earlier_sweeps(sample: StudySample) -> None:
    grid = sample.truth.grid
    victims = {"shadow_map": ShadowMap(grid), "first_blocker": FirstBlocker(grid)}
    found = aimed_attacks.outcomes_of(sample, victims, 0)
    bases = {("shadow_map", ONE), ("shadow_map", PAST), ("shadow_map", CONFIRMED), ("first_blocker", ONE)}
    assert {key[2:] for key in found} == bases
    assert len(found) == 4 * len(get_args(Placement)) * len(bases)
    for outcomes in found.values():
        [one] = outcomes
        assert one.clean.cells == one.attacked.cells == one.new.cells
        assert 0 < one.clean.cells < grid.cells**2 / 4
        assert one.new.both <= one.attacked.both
        assert one.new.over <= one.attacked.over
        # What is claimed after an attack was claimed before, or is new.
        assert one.attacked.over <= one.clean.over + one.new.over
    for attack in ("far wall", "removal and far wall"):
        alone, confirmed = (found[attack, AIMED, "shadow_map", basis][0] for basis in (ONE, CONFIRMED))
        assert alone.new.over > 10
        assert confirmed.new.over < 0.5 * alone.new.over
    assert found["removal", AIMED, "shadow_map", ONE][0].new.over == 0


def test_an_attack_on_a_thing_that_moves_is_known_as_one(sample: StudySample) -> None:
    scene, frame = sample.frame or pytest.fail("simulated")
    now_s = (frame // scene.preset.agents + 0.5) * scene.preset.interval_s
    pose, points = sample.sweep.world_from_sensor, sample.sweep.points
    world = (pose @ points)[:, :2]
    moving = np.zeros(len(points), np.bool_)
    agent = world_of(scene).agents[0]
    for number, thing in enumerate(world_of(scene).things):
        (x, y, _), (x0, y0, _) = thing.pose_at(now_s), thing.pose_at(now_s - 0.5)
        if number != agent.carrier and np.hypot(x - x0, y - y0) > 1.0:
            moving |= np.hypot(*(world - (x, y)).T) < 2.0
    assert moving.sum() > 20
    none = np.zeros(len(points), np.bool_)
    for removed, known in ((moving, True), (~moving, False), (none, False)):
        kept = sample.sweep.select(~removed)
        assert aimed_attacks.opens_moving(sample, Tampered(kept, none[: len(kept)], removed)) == known


def _outcome(both: int, over: int, under: int, *, moving: bool = False) -> Outcome:
    counts = ConfusionCounts(both, over, under, 100, area_m2=100.0)
    return Outcome(counts, counts, ConfusionCounts(both, over, 0, 0, area_m2=1.0), moving)


def test_a_target_is_met_by_precision_and_recall_together() -> None:
    outcomes = {
        ("removal", AIMED, "a", ONE): [_outcome(96, 4, 900)],
        ("far wall", AIMED, "a", CONFIRMED): [_outcome(40, 10, 5), _outcome(60, 0, 15)],
        ("patch of 150", AIMED, "a", CONFIRMED): [_outcome(96, 4, 40), _outcome(4, 36, 0, moving=True)],
    }
    rows = list(aimed_attacks._target_rows(outcomes, ["a"]))
    assert [row[-1] for row in rows] == ["met", "met", "met", "met", "**missed**", "**missed**"]
    assert [row[2] for row in rows] == ["1", "1", "2", "2", "2", "1"]
    assert rows[2][4].startswith("0.909 [0.800, 1.000] / 0.833")
    assert rows[4][4].startswith("0.714 ")
    assert rows[5][4].startswith("0.960 [0.960, 0.960] / 0.706")
    assert aimed_attacks._areas([_outcome(40, 10, 5), _outcome(60, 0, 15)], 0.25) == "14 / 1"
