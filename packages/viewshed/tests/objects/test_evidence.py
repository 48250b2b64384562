"""Evidence: tables, weights and what they become over time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed.objects.cells import BoxCells
from viewshed.objects.evidence import (
    BLIND,
    CAP,
    EvidenceTable,
    cell_bins,
    cell_ratios,
    jump_bins,
    mean_after,
    ratios_of,
    wealth_after,
)


@given(st.lists(st.integers(0, 400), min_size=3, max_size=3), st.lists(st.integers(0, 400), min_size=3, max_size=3))
def test_ratios_have_mean_one_on_what_they_were_counted_on(honest: list[int], forged: list[int]) -> None:
    """Each bin counted once more, the mean of the ratios over honest tracks is 1 as long as none is capped."""
    table = EvidenceTable(tuple(map(float, honest)), tuple(map(float, forged)))
    ratios = table.ratios()
    if (ratios < CAP).all() and (ratios > 1 / CAP).all():
        share = (np.array(honest) + 1.0) / (sum(honest) + 3.0)
        assert share @ ratios == pytest.approx(1.0)


@given(st.lists(st.floats(0.01, 100.0), min_size=1, max_size=30), st.floats(0.05, 0.3))
def test_the_mean_over_time_is_a_weighted_geometric_mean(ratios: list[float], dt_s: float) -> None:
    """Beside a direct sum with weights exp(-age / window)."""
    log_mean = 0.0
    for k, ratio in enumerate(ratios):
        log_mean = float(mean_after(np.array(log_mean), np.array(ratio), dt_s, np.array((k + 1) * dt_s), 1.0))
    weights = np.exp(-dt_s * np.arange(len(ratios))[::-1])
    assert log_mean == pytest.approx(float(weights @ np.log(ratios) / weights.sum()), abs=1e-9)


def test_on_honest_ratios_wealth_grows_by_one_each_block() -> None:
    """The mean of W after t blocks of independent ratios with mean 1 is t at most: no more than its promise."""
    rng = np.random.default_rng(0)
    wealth = np.zeros(20000)
    for _ in range(5):
        wealth = wealth_after(wealth, rng.choice([0.5, 2.0], len(wealth), p=[2 / 3, 1 / 3]), 1.0, 1.0)
    assert wealth.mean() == pytest.approx(5.0, rel=0.05)


def test_blind_bins_say_nothing() -> None:
    """Where most of a box is unknown, or nothing jumped yet, the ratio is 1."""
    nothing = BoxCells(*(np.zeros(1) for _ in BoxCells._fields))
    bins = cell_bins(nothing, np.ones(1))
    assert (bins == BLIND).all()
    assert cell_ratios(np.ones(1000), bins).tolist() == [1.0]
    assert ratios_of(EvidenceTable((1.0,) * 12, (9.0,) * 12), jump_bins(np.array([np.nan]))).tolist() == [1.0]
