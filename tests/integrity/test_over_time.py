"""The e-detector: its bets, its mean time between false alarms, its delay; against sums of martingales of crepes."""

import numpy as np
import pytest
from crepes.martingales import SimpleJumper
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import integrate

from viewshed.integrity.over_time import POWERS, EDetector, e_values, limit_per_drive, measure_false_alarms

P_VALUES = st.lists(st.floats(1e-4, 1.0), min_size=1, max_size=20)


class _Bets:
    """A betting function for crepes with one account."""

    def apply(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array(np.mean([k * p ** (k - 1) for k in POWERS], axis=0))[:, None]


def test_bets_have_mean_one_on_uniform_p_values_and_less_on_conformal_ones() -> None:
    mean, error = integrate.quad(lambda x: float(e_values([np.exp(-x)])[0] * np.exp(-x)), 0, 700)
    assert mean == pytest.approx(1.0, abs=1e-6 + error)
    for scenes in (9, 99, 999):
        bets = e_values(np.arange(1, scenes + 2) / (scenes + 1))
        assert bets.mean() < 1
        assert (np.diff(bets) < 0).all()


@given(P_VALUES)
def test_the_wealth_is_the_sum_of_martingales_begun_at_every_sweep(p: list[float]) -> None:
    detector, values = EDetector(np.inf), np.array(p)
    for value in p:
        assert not detector.add(value)
    expected = sum(SimpleJumper(J=1e-12, bf=_Bets()).apply(values[k:])[-1] for k in range(len(p)))
    assert detector.wealth == pytest.approx(expected, rel=1e-9)


@given(P_VALUES, st.integers(1, 4))
def test_blocks_bet_once_with_the_mean_of_their_bets(p: list[float], block: int) -> None:
    detector, single = EDetector(np.inf, block), 0.0
    for value in p:
        detector.add(value)
    bets = e_values(p)
    for k in range(len(p) // block):
        single = bets[k * block : (k + 1) * block].mean() * (1 + single)
    assert detector.wealth == pytest.approx(single, rel=1e-9)


@pytest.mark.parametrize("block", [1, 3])
def test_false_alarms_on_independent_sweeps_are_rarer_than_stated(block: int) -> None:
    """Conformal p-values of 499 scenes; a limit of 50 blocks."""
    rng = np.random.default_rng(block)
    drives = [rng.integers(1, 501, 200) / 500 for _ in range(60)]
    found = measure_false_alarms(EDetector(50.0, block), drives, 10.0, rng)
    assert found.hours == pytest.approx(12_000 / 36_000)
    assert found.stated_per_hour == pytest.approx(36_000 / (50 * block))
    assert found.interval_per_hour[0] <= found.per_hour <= found.stated_per_hour
    assert "were sweeps independent" in str(found)


def test_dependence_breaks_the_statement_and_is_measured() -> None:
    """All sweeps of a drive share most of their rank: the calibration alone cannot hold the stated rate."""
    rng = np.random.default_rng(3)
    drives = [np.clip(rng.random() + 0.02 * rng.normal(size=200), 0.002, 1.0) for _ in range(60)]
    found = measure_false_alarms(EDetector(500.0), drives, 10.0, rng)
    assert found.interval_per_hour[0] > 2 * found.stated_per_hour


def test_the_limit_of_whole_drives_holds_whatever_the_dependence() -> None:
    rng, alarmed = np.random.default_rng(4), 0
    for _ in range(40):
        drives = [np.clip(rng.random() + 0.05 * rng.normal(size=20), 0.002, 1.0) for _ in range(29)]
        detector = limit_per_drive(EDetector(1.0), drives[:19], 0.1)
        for drive in drives[19:]:
            one = detector.fresh()
            alarmed += max(map(one.add, drive.tolist()))
    # Standard error of 40 calibrations of 19 drives, each tried on 10: about .016.
    assert alarmed / 400 <= 0.1 + 3 * 0.016
    with pytest.raises(ValueError, match=r"rate of 0.1 needs at least 9 benign drives, got 8"):
        limit_per_drive(EDetector(1.0), drives[:8], 0.1)


def test_an_attack_alarms_soon_tells_its_delay_and_then_it_begins_anew() -> None:
    """One false alarm an hour at 10 Hz, 999 calibration scenes: p-values of .001 from sweep 100 on."""
    detector, rng = EDetector.for_rate(1.0, 10.0), np.random.default_rng(5)
    assert detector.limit == 36_000
    for p in rng.uniform(0.3, 1.0, 100):
        assert not detector.add(float(p))
    alarms = [detector.add(0.001) for _ in range(6)]
    first = alarms.index(True)
    assert first + 1 <= 3, "no more sweeps than this"
    assert not any(alarms[first + 1 :])
    again, sweeps = EDetector(36_000.0), 1
    while not again.add(0.001):
        sweeps += 1
    assert again.doubtful_sweeps == sweeps <= 4
    assert not again.add(1.0)
    assert again.wealth < 1


@pytest.mark.parametrize("p", [0.0, -0.1, 1.5, np.nan])
def test_what_is_no_p_value_is_refused(p: float) -> None:
    with pytest.raises(ValueError, match=r"p-values must lie in \(0, 1\]"):
        EDetector(10.0).add(p)


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"limit and block must be 1 at least, got 0.5 and 1"):
        EDetector(0.5)
    with pytest.raises(ValueError, match=r"per_hour and hz must be positive, got 0.0 and 10.0"):
        EDetector.for_rate(0.0, 10.0)
    with pytest.raises(ValueError, match="benign drives must have sweeps, got none"):
        measure_false_alarms(EDetector(10.0), [[]], 10.0, np.random.default_rng(0))
