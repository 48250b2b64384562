"""Masks with known faults, which cross-view truth must rank, and the smallest fault that columns show."""

import numpy as np
import pytest
from scipy.stats import binom

from viewshed import BevGrid
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim.scene import junction
from viewshed_lab.studies.crossview.faults import (
    KNOWN_FAULTS,
    SmallestDifference,
    dilated,
    false_blobs,
    misses,
    smallest_share,
    with_known_faults,
)
from viewshed_lab.studies.crossview.rates import SeenColumns, evaluate_crossview
from viewshed_lab.studies.crossview.simulated import POSES, ExactMask, drive

GRID = BevGrid(128, 32.0)


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_faults_do_what_they_say() -> None:
    one = np.zeros(GRID.shape, bool)
    one[64, 64] = True
    grown = dilated(1.0)(one, GRID, _rng())
    assert grown.sum() == 13, "cells of 0.5 m whose middle is within 1 m of another's"
    assert grown[64, 62]
    assert not grown[63, 62]
    nothing, everything = np.zeros(GRID.shape, bool), np.ones(GRID.shape, bool)
    blob = false_blobs(1)(nothing, GRID, _rng())
    assert blob.sum() * GRID.cell_area_m2 == pytest.approx(np.pi * 2.25**2, rel=0.15)
    assert np.array_equal(misses(1)(everything, GRID, _rng()), ~blob)
    assert np.array_equal(misses(5)(nothing, GRID, _rng()), nothing)
    assert np.array_equal(false_blobs(5)(everything, GRID, _rng()), everything)


@pytest.fixture(scope="module")
def exact() -> tuple[list[Sweep], ExactMask]:
    """The sweeps of a simulated junction from ten places, and the exact masks."""
    views = drive(junction(), lidar_model("hdl64e"), POSES, _rng())
    return [sweep for sweep, _ in views], ExactMask(BevGrid(256, 64.0), {sweep.t_ns or 0: b for sweep, b in views})


@pytest.mark.slow
def test_the_metric_ranks_the_known_faults_of_an_exact_mask(exact: tuple[list[Sweep], ExactMask]) -> None:
    """The exact mask is charged with little; each fault with more, and the larger one with the most."""
    rows = evaluate_crossview([exact[0]], with_known_faults("exact mask", exact[1]), rng=_rng())
    floor = {row.method.removeprefix("exact mask, "): row for row in rows}
    over = {name: row.over.value for name, row in floor.items()}
    under = {name: row.under.value for name, row in floor.items()}
    assert set(floor) == {"exact mask", *KNOWN_FAULTS}
    assert over["exact mask"] < 0.06
    assert under["exact mask"] < 0.01
    assert over["exact mask"] + 0.03 < over["dilated by 1 m"] < over["dilated by 2 m"] - 0.03
    assert over["exact mask"] + 0.03 < over["12 false blobs"] < over["100 false blobs"] - 0.1
    assert under["exact mask"] + 0.03 < under["12 misses"] < under["100 misses"] - 0.1
    assert over["100 misses"] <= over["exact mask"]
    assert under["100 false blobs"] <= under["exact mask"]


def test_columns_far_apart_show_what_independent_draws_show() -> None:
    """Fifty columns 100 m apart: a share p is told with probability P(X >= c), X binomial, c from the floor."""
    far = [np.stack([100.0 * np.arange(50), np.zeros(50)], axis=1)]
    share, floor = smallest_share(far, 0.02, _rng()), 0.02
    least = binom.ppf(0.95, 50, floor) + 1
    assert share == 0.1
    assert (
        binom.sf(least - 1, 50, floor + 0.1 * (1 - floor)) > 0.8 > binom.sf(least - 1, 50, floor + 0.07 * (1 - floor))
    )


def test_hidden_columns_speak_of_over_claim_and_seen_ones_of_under_claim() -> None:
    xy = np.stack([30.0 * np.arange(40), np.zeros(40)], axis=1)
    seen = np.arange(40) >= 4
    columns = SeenColumns(xy, seen, np.arange(40) == 0)
    sweep = Sweep(np.ones((1, 3), np.float32))
    found = SmallestDifference.of([(sweep, columns)] * 2, (0.0, 0.0), _rng())
    assert (found.hidden_columns, found.hidden_sweeps) == (6, 2)
    assert found.under < found.over
