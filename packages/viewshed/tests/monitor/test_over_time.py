"""The e-detector: its bets, its mean time between false alarms, its delay; against sums of martingales of crepes."""

import numpy as np
import pytest
from crepes.martingales import SimpleJumper
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import integrate

from viewshed.monitor.over_time import POWERS, BenignRuns, EDetector, e_values, measure_false_alarms

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
    assert found.interval_per_hour[0] <= found.per_hour <= 36_000 / (50 * block)


def test_dependence_breaks_the_statement_and_is_measured() -> None:
    """All sweeps of a drive share most of their rank: the calibration alone cannot hold the stated rate."""
    rng = np.random.default_rng(3)
    drives = [np.clip(rng.random() + 0.02 * rng.normal(size=200), 0.002, 1.0) for _ in range(60)]
    found = measure_false_alarms(EDetector.for_rate(72.0, 10.0), drives, 10.0, rng)
    assert found.interval_per_hour[0] > 2 * 72.0


def _drive(rng: np.random.Generator, sweeps: int) -> NDArray[np.float64]:
    """Return the p-values of a drive, nearly the same in all its sweeps."""
    return np.clip(rng.random() + 0.05 * rng.normal(size=sweeps), 0.002, 1.0)


def test_limits_of_benign_runs_keep_the_chosen_rate_whatever_the_dependence() -> None:
    """Drives of five runs, alike through all of them; one run of twenty sweeps in ten may alarm."""
    rng, alarms, per_hour = np.random.default_rng(4), 0, 180.0
    for _ in range(40):
        detector = BenignRuns.of([_drive(rng, 20) for _ in range(29)]).detector(per_hour, hz=10.0)
        assert detector.run == 20
        for _ in range(10):
            one = detector.fresh()
            alarms += sum(map(one.add, _drive(rng, 100).tolist()))
    hours = 40 * 10 * 100 / 36_000
    # Standard error: 400 drives in 40 calibrations, one in ten alarms in each of its runs: about 30 an hour.
    assert 0.3 * per_hour <= alarms / hours <= per_hour + 2 * 30


def test_a_run_alarms_once_and_the_next_begins_anew() -> None:
    detector = EDetector(10.0, run=5)
    found = [detector.add(p) for p in (0.001, 0.001, 0.001, 0.001, 0.001, 1.0, 0.001, 1.0, 1.0, 1.0, 1.0)]
    assert [number for number, alarm in enumerate(found) if alarm] == [0, 6]
    assert detector.wealth == pytest.approx(float(e_values([1.0])[0])), "the eleventh sweep is the first of a run"


def test_a_rate_that_the_benign_runs_do_not_support_is_refused_with_the_hours_that_it_needs() -> None:
    runs = BenignRuns(np.arange(1.0, 360.0), sweeps=20)
    assert runs.hours(hz=10.0) == pytest.approx(359 * 2 / 3600)
    assert runs.least_per_hour(hz=10.0) == pytest.approx(5.0)
    assert runs.detector(5.0, hz=10.0).limit == np.nextafter(359.0, np.inf)
    assert runs.detector(10.0, hz=10.0).limit == np.nextafter(358.0, np.inf)
    with pytest.raises(
        ValueError, match=r"^1 false alarms an hour need 0.999 h of benign runs, got 0.199 h; ask for 5.0"
    ):
        runs.detector(1.0, hz=10.0)
    # At twice the sweeps a second a run is half as long.
    with pytest.raises(ValueError, match=r"need 0.2 h of benign runs, got 0.0997 h"):
        runs.detector(5.0, hz=20.0)
    for empty in ([], [np.zeros(0)]):
        with pytest.raises(ValueError, match="benign runs must be one or more"):
            BenignRuns.of(empty)


def test_runs_are_the_most_hours_of_equal_length() -> None:
    scenes = [np.full(length, 0.5) for length in (3, 10, 9, 8, 2)]
    runs = BenignRuns.of(scenes)
    assert (runs.sweeps, len(runs.wealth)) == (8, 3)


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
    with pytest.raises(ValueError, match=r"limit, block and run must be 1 at least, got 0.5, 1 and None"):
        EDetector(0.5)
    with pytest.raises(ValueError, match="got 2, 1 and 0"):
        EDetector(2, run=0)
    with pytest.raises(ValueError, match=r"per_hour and hz must be positive, got 0.0 and 10.0"):
        EDetector.for_rate(0.0, 10.0)
    with pytest.raises(ValueError, match="benign drives must have sweeps, got none"):
        measure_false_alarms(EDetector(10.0), [[]], 10.0, np.random.default_rng(0))
