"""The truth of a sensor with fewer beams: counted by hand, and against the corrupted sweeps themselves."""

import numpy as np
import pytest

from viewshed import CAR, BevGrid
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import STILL, ExactScan
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import Thing, World
from viewshed_lab.studies.cases import apply, case_generator, kept_rings, visible_with, with_rings
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.studies.samples import StudySample, sample_of
from viewshed_lab.threats.corruptions import CORRUPTIONS, FewerBeams

FLAT = Terrain.of(np.linspace(-40, 40, 5), np.linspace(-40, 40, 5), lambda x, y: 0.0 * x)
LEFT_WALL = World("test", FLAT, (Thing("wall", (Box(0, 0, 20, 0.5, 5),), 5, 8, 0.0),))
"""A wall along the road, 8 m to the left, from 5 m behind to 15 m ahead."""
GRID = BevGrid(64, 32.0)


def _scan() -> ExactScan:
    """Three rings at -20°, -10° and -5°, 2 m above the ground."""
    model = LidarModel("three", np.deg2rad([-20.0, -10.0, -5.0]), 3600, max_range_m=40.0)
    return cast_world(LEFT_WALL.snapshot(0.0), model, Rigid(np.eye(3), np.array([0.0, 0.0, 2.0])), STILL, seed=0)


def _seen(scan: ExactScan, x: float, y: float) -> tuple[int, bool]:
    truth = exact_truth(scan, LEFT_WALL, GRID, (CAR,))[0]
    i, j = int(np.floor(x + 32)), int(np.floor(y + 32))  # cells of 1 m
    return int(truth.expected_returns["car"][i, j]), bool(truth.visible(CAR)[i, j])


def test_beams_that_are_gone_are_not_counted() -> None:
    """At 5.5 m the lower two rings are 0.0 and 1.03 m high, at 10.5 m the upper two 0.15 and 1.08 m."""
    whole, lowest, highest = _scan(), with_rings(_scan(), np.array([1, 0, 0], bool)), np.array([0, 0, 1], bool)
    alone = with_rings(_scan(), highest)
    assert alone.model.elevation.tolist() == pytest.approx([np.deg2rad(-5.0)])
    assert _seen(whole, 5.5, 0.5)[1]
    assert _seen(alone, 5.5, 0.5) == (0, False)  # 1.52 m high there: above the car
    assert _seen(alone, 10.5, -0.5)[1]
    assert _seen(lowest, 10.5, -0.5) == (0, False)  # in the ground from 5.5 m on
    assert _seen(alone, 10.5, -10.5)[1]
    assert not _seen(alone, 10.5, 10.5)[1]  # behind the wall, which only stands on the left


@pytest.fixture(scope="module")
def sample() -> StudySample:
    return sample_of("nuscenes", 1, 3, 7)


@pytest.mark.parametrize("name", ["fewer_beams", "dead_rings"])
def test_the_rings_of_the_truth_are_those_of_the_corrupted_sweep(name: str, sample: StudySample) -> None:
    case = Case("corruption", name, "4")
    clean, spoilt = sample.sweep, apply(case, sample, case_generator(3, "nuscenes", 1, case)).sweep
    assert clean.ring is not None
    assert spoilt.ring is not None
    assert clean.model is not None
    kept = kept_rings(CORRUPTIONS[name](4), clean.model, case_generator(3, "nuscenes", 1, case))
    assert set(spoilt.ring.tolist()) == set(clean.ring.tolist()) & set(np.flatnonzero(kept).tolist())
    visible = visible_with(case, sample, case_generator(3, "nuscenes", 1, case))
    assert visible is not None
    before = sample.truth.visible()
    assert not (visible & ~before).any()
    assert 0 < visible.sum() < before.sum()


def test_other_cases_and_recorded_samples_keep_their_truth(sample: StudySample) -> None:
    rng = np.random.default_rng(0)
    assert visible_with(BENIGN, sample, rng) is None
    assert visible_with(Case("corruption", "fog", "3"), sample, rng) is None
    assert visible_with(Case("corruption", "fewer_beams", "3"), StudySample(sample.sample), rng) is None


def test_kept_rings_by_hand() -> None:
    model = lidar_model("HDL-32E")
    kept = kept_rings(FewerBeams(1, 4), model, np.random.default_rng(0))
    assert np.flatnonzero(kept).tolist() == [0, 4, 8, 12, 16, 20, 24, 28]
    assert (~kept_rings(CORRUPTIONS["dead_rings"](5), model, np.random.default_rng(0))).sum() == 16
