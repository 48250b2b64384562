"""Discoveries over sectors, against scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import false_discovery_control

from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.sectors import discoveries

P_VALUES = st.lists(st.sampled_from([0.001, 0.01, 0.02, 0.03, 0.05, 0.2, 0.5, 1.0]), min_size=1, max_size=SECTORS)


@given(P_VALUES, st.sampled_from([0.03, 0.1, 0.25]))
def test_discoveries_are_those_of_scipy(p: list[float], rate: float) -> None:
    assert discoveries(p, rate).tolist() == (false_discovery_control(p) <= rate + 1e-9).tolist()


@pytest.mark.parametrize("shared", [0.0, 0.7])
def test_false_discoveries_stay_below_the_rate(shared: float) -> None:
    """Ten sectors of 72 are attacked; noise is shared by neighbors or not."""
    rng, wrong = np.random.default_rng(1), []
    benign = rng.normal(size=100_000)
    for _ in range(400):
        noise = np.sqrt(1 - shared) * rng.normal(size=SECTORS) + np.sqrt(shared) * np.repeat(rng.normal(size=9), 8)
        noise[:10] += 3.0
        p = 1.0 - np.searchsorted(np.sort(benign), noise) / (len(benign) + 1)
        found = discoveries(p, 0.1)
        wrong.append(found[10:].sum() / max(found.sum(), 1))
    assert np.mean(wrong) <= 0.1


@pytest.mark.parametrize(
    ("p", "rate", "message"),
    [
        ([0.5], 1.0, r"false-discovery rate must lie in \(0, 1\), got 1.0"),
        ([1.5], 0.1, r"p-values must be one row in \[0, 1\]"),
        ([[0.5]], 0.1, r"p-values must be one row"),
        ([np.nan], 0.1, r"p-values must be one row"),
    ],
)
def test_bad_input(p: list[float], rate: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        discoveries(p, rate)


def test_no_p_values_no_discoveries() -> None:
    assert discoveries([], 0.1).shape == (0,)
