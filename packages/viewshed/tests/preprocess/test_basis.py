"""What an estimate rests on: the same for every estimator, and counted cell by cell."""

from dataclasses import replace

import numpy as np
import pytest

from viewshed import CAR, BevGrid
from viewshed.estimators import CLASSICAL
from viewshed.fov.estimate import Basis, CellState
from viewshed.preprocess.basis import basis_of
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.preprocess.reach import reach_of_sweep
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

GRID = BevGrid(64, 32.0)
MODEL = LidarModel("sparse", np.deg2rad(np.linspace(-24, 8, 33)), azimuth_columns=720, max_range_m=100.0)


def street(height_m: float | None = None) -> LeveledSweep:
    sweep = cast(MODEL, Scene((Box(12, 2, 1, 6, 3),)), 1.8)
    return level(sweep.replace(sensor_height_m=height_m), GRID)


@pytest.mark.parametrize("name", CLASSICAL)
def test_every_estimate_says_what_it_rests_on(name: str) -> None:
    leveled = street()
    basis = CLASSICAL[name](GRID).estimate(leveled).basis
    assert basis.sensor_height_m == leveled.sensor_height_m
    assert basis.height_source == "estimated"
    assert basis.ground_support == pytest.approx(leveled.ground.support, abs=1e-4)
    assert basis.reach_m == reach_of_sweep(leveled)


def test_shares_are_those_of_the_claimed_cells() -> None:
    leveled = street()
    evidence, state = beam_evidence(leveled, GRID, CAR), np.zeros(GRID.shape, np.uint8)
    state[10, 5], state[40, 20], state[41, 20], state[30, 3] = (
        CellState.FREE, CellState.SURFACE, CellState.FREE, CellState.HIDDEN,
    )  # fmt: skip
    std_m = np.zeros_like(leveled.ground.std_m)
    std_m[9:12, 4:7] = 0.6  # under the first claim; the lattice has the cells' size here
    std_m[29:32, 2:5] = 0.6  # under the hidden cell, which does not count
    measured = np.full(GRID.shape, 9.0, np.float32)
    measured[40, 20] = measured[41, 20] = measured[30, 3] = 1.0
    leveled = replace(leveled, ground=replace(leveled.ground, std_m=std_m))
    basis = basis_of(leveled, replace(evidence, measured=measured), state)
    assert basis.unsure_ground_share == pytest.approx(1 / 3)
    assert basis.inferred_share == pytest.approx(2 / 3)
    nothing = basis_of(leveled, evidence, np.zeros(GRID.shape, np.uint8))
    assert (nothing.unsure_ground_share, nothing.inferred_share) == (0.0, 0.0)


def test_the_source_of_the_height() -> None:
    def source(leveled: LeveledSweep) -> Basis:
        return basis_of(leveled, beam_evidence(leveled, GRID, CAR), np.zeros(GRID.shape, np.uint8))

    assert source(street(1.8)).height_source == "given"
    assert source(street(1.8)).sensor_height_m == 1.8
    ceiling = street().sweep.points * np.array([1.0, 1.0, -1.0], np.float32)
    assert source(level(street().sweep.replace(points=ceiling), GRID)).height_source == "assumed"
