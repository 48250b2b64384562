"""Promises of calibrated alarms, on any distribution; p-values and martingales against crepes and scipy."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from crepes.base import p_values_batch
from crepes.martingales import SimpleJumper, semi_online_p_values
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from viewshed.arrays import F64
from viewshed.monitor.calibration import (
    Calibration,
    Group,
    HighestScores,
    Promise,
    Promised,
    alarm_limit,
    alarms_allowed,
    betting_martingale,
    drift_warning,
    one_per_scene,
    online_p_values,
    p_values,
)

SCORES = st.lists(st.integers(0, 6), min_size=1, max_size=30)
RATES = st.sampled_from([0.01, 0.02, 0.05, 0.1, 0.25, 0.5])
VLP, HDL = Group("VLP-16", "none"), Group("HDL-32E", "none")

DRAWS: dict[str, Callable[[np.random.Generator, tuple[int, ...]], F64]] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "heavy tails": lambda rng, shape: rng.standard_cauchy(shape),
    "three values": lambda rng, shape: rng.choice([0.0, 0.0, 0.0, 1.0, 5.0], shape),
    "mostly zero": lambda rng, shape: np.where(rng.random(shape) < 0.93, 0.0, rng.exponential(size=shape)),
}


@given(SCORES, SCORES)
def test_p_values_are_those_of_crepes(benign: list[int], scores: list[int]) -> None:
    expected = p_values_batch(np.array(benign), np.array(scores), smoothing=False)
    assert p_values(benign, scores) == pytest.approx(expected, abs=1e-15)
    # Smoothed ones lie between the shares of scores above and of those as high.
    smoothed = p_values(benign, scores, np.random.default_rng(0))
    above = np.array([sum(b > s for b in benign) for s in scores]) / (len(benign) + 1)
    assert (smoothed <= expected + 1e-15).all()
    assert (smoothed >= above - 1e-15).all()


@given(SCORES)
def test_leaving_each_out_p_values_are_super_uniform(values: list[int]) -> None:
    """Of n + 1 exchangeable scores each is the further one with equal probability."""
    every = np.array([*values, 3], np.float64)
    count = len(every)
    found = np.array([p_values(np.delete(every, k), every[[k]])[0] for k in range(count)])
    for share in np.arange(1, count + 1) / count:
        assert (found <= share + 1e-12).mean() <= share + 1e-12


def test_smoothed_p_values_are_uniform_whatever_the_ties() -> None:
    rng = np.random.default_rng(2)
    draws = [DRAWS["three values"](rng, (20,)) for _ in range(3000)]
    found = [p_values(draw[:19], draw[19:], rng)[0] for draw in draws]
    assert stats.kstest(found, "uniform").pvalue > 0.01


@pytest.mark.parametrize(
    ("rate", "promise", "need"),
    [
        (0.001, "expected", 999),
        (0.001, "confident", 2302),
        (0.01, "expected", 99),
        (0.01, "confident", 230),
        (0.1, "confident", 22),
    ],
)
def test_a_rate_that_the_scenes_cannot_support_is_refused_with_their_number(
    rate: float, promise: Promise, need: int
) -> None:
    word = " with probability 0.9" if promise == "confident" else ""
    with pytest.raises(
        ValueError, match=rf"rate of {rate:g}{word} needs at least {need} benign scenes, got {need - 1}"
    ):
        alarms_allowed(need - 1, rate, promise)
    assert alarms_allowed(need, rate, promise) == 0


@given(st.integers(1, 3000), RATES)
def test_the_confident_limit_is_the_lowest_whose_beta_tail_gives_it(scenes: int, rate: float) -> None:
    try:
        above = alarms_allowed(scenes, rate, "confident")
    except ValueError:
        assert stats.beta.cdf(rate, 1, scenes) < 0.9
        return
    assert stats.beta.cdf(rate, above + 1, scenes - above) >= 0.9
    assert stats.beta.cdf(rate, above + 2, scenes - above - 1) < 0.9
    assert above <= max(alarms_allowed(scenes, rate), 0)


@given(st.integers(1, 3000), st.integers(0, 40))
def test_both_promises_of_a_limit(scenes: int, above: int) -> None:
    promised = Promised(scenes, min(above, scenes - 1))
    beta = stats.beta(promised.above + 1, scenes - promised.above)
    assert promised.expected == pytest.approx(beta.mean())
    assert promised.confident == pytest.approx(beta.ppf(0.9), rel=1e-6)
    assert f"{promised.above} of {scenes} benign scenes" in str(promised)


@pytest.mark.parametrize("name", DRAWS)
@pytest.mark.parametrize(("scenes", "rate"), [(99, 0.01), (250, 0.05)])
def test_the_promises_hold_on_any_distribution(name: str, scenes: int, rate: float) -> None:
    """1,000 calibrations, each with its rate on 400,000 further scores: exact up to 3 standard errors."""
    rng, further = np.random.default_rng(scenes), np.sort(DRAWS[name](np.random.default_rng(9), (400_000,)))
    rates: dict[Promise, list[float]] = {"expected": [], "confident": []}
    for _ in range(1000):
        benign = DRAWS[name](rng, (scenes,))
        for promise in ("expected", "confident"):
            if scenes == 99 and promise == "confident":
                continue
            limit = alarm_limit(benign, rate, promise)
            rates[promise].append(1.0 - np.searchsorted(further, limit, "right") / len(further))
    mean = np.mean(rates["expected"])
    assert mean <= rate + 3 * np.std(rates["expected"]) / math.sqrt(1000)
    if rates["confident"]:
        kept = np.mean(np.array(rates["confident"]) <= rate + 1e-3)
        assert kept >= 0.9 - 3 * math.sqrt(0.09 / 1000)
    if name in ("normal", "heavy tails"):
        assert mean == pytest.approx(rate, rel=0.1), "not wasted either"


@pytest.mark.parametrize("promise", ["expected", "confident"])
def test_a_p_value_alarms_where_the_limit_does(promise: Promise) -> None:
    scores = DRAWS["three values"](np.random.default_rng(3), (300,)) + np.linspace(0, 2, 300).round(1)
    calibration = Calibration({VLP: scores}, 0.05, promise)
    level = (calibration.promised(VLP).above + 1) / 301
    for score in np.unique(np.concatenate([scores, scores + 0.05])):
        assert (score > calibration.limit(VLP)) == (calibration.p_value(score, VLP) <= level + 1e-12)


def test_groups_keep_apart_and_an_unknown_one_takes_the_most_cautious() -> None:
    scores = {VLP: np.arange(100.0), HDL: np.arange(100.0) * 10, Group("HDL-32E", "posed"): np.arange(100.0) + 5000}
    calibration = Calibration(scores, 0.02)
    assert (calibration.limit(VLP), calibration.limit(HDL)) == (98.0, 980.0)
    other = Group("OS1-64", "none")
    assert calibration.limit(other) == 980.0
    assert calibration.p_value(500.0, other) == calibration.p_value(500.0, HDL) == 51 / 101
    with pytest.raises(
        ValueError, match=r"of a calibrated group \(VLP-16, single sweeps; .*got OS1-64, earlier sweeps wit"
    ):
        calibration.limit(Group("OS1-64", "unposed"))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Calibration({}, 0.1), "must have benign scores of one group at least"),
        (lambda: Calibration({VLP: np.array([1.0, np.nan])}, 0.4), "VLP-16, single sweeps must be one or more scores"),
        (lambda: Calibration({VLP: np.arange(98.0)}, 0.01), "VLP-16, single sweeps: a false-alarm rate of 0.01 needs"),
        (lambda: Calibration({VLP: np.arange(9.0)}, 0.1).p_value(np.nan, VLP), "score must be a number, got NaN"),
        (lambda: Calibration({VLP: np.arange(9.0)}, 0.1).corrected([]), "real benign scenes must be one at least"),
        (lambda: alarms_allowed(5, 1.5), r"must lie in \(0, 1\), got 1.5"),
        (lambda: alarms_allowed(5, 0.1, "sure"), "promise must be expected or confident, got sure"),  # type: ignore[arg-type]
        (lambda: one_per_scene(["a"], [1.0], "frame", np.random.default_rng(0)), "per must be sweep or drive"),  # type: ignore[arg-type]
        (lambda: HighestScores(3, np.array([[1.0], [2.0]], np.float32)), "highest must descend"),
        (lambda: HighestScores(1, np.ones((2, 1), np.float32)), r"highest must be \(1 to 1, C\)"),
    ],
)
def test_what_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_one_score_for_each_scene_at_random_or_the_largest() -> None:
    scenes, scores = ["b", "a", "b", "b", "a"], np.array([1.0, 2.0, 3.0, np.nan, 5.0])[:, None]
    names, largest = one_per_scene(scenes, scores, "drive", np.random.default_rng(0))
    assert (names, largest[:, 0].tolist()) == (["b", "a"], [3.0, 5.0])
    drawn = {float(one_per_scene(scenes, scores, "sweep", np.random.default_rng(k))[1][1, 0]) for k in range(20)}
    assert drawn == {2.0, 5.0}


@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_highest_scores_give_the_p_values_of_all_scores_where_these_are_small(scenes: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    benign, scores = rng.integers(0, 9, (scenes, 3)).astype(float), np.array([0.0, 7.0, 8.5])
    kept = HighestScores.of(benign, 0.2)
    for column, found in enumerate(kept.p_values(scores)):
        expected = p_values(benign[:, column], scores[[column]])[0]
        assert found == pytest.approx(expected) if expected <= 0.2 else found >= min(expected, 0.2)
    assert kept.p_values(np.full(3, np.nan)).tolist() == [1.0, 1.0, 1.0]
    # A single column is asked as many scores as one likes, ties among them.
    asked = np.array([*range(-1, 10), 7.5, np.nan, np.inf])
    single = HighestScores(kept.scenes, kept.highest[:, :1]).p_values(asked)
    tripled = [kept.p_values(np.full(3, one))[0] for one in asked]
    assert single.tolist() == tripled


_TRIALS = 1500


def _corrected_rates(
    simulated: Callable[[np.random.Generator, int], F64],
    real: Callable[[np.random.Generator, int], F64],
    sizes: tuple[int, int],
    groups: int = 1,
) -> F64:
    """Return corrected p-values of further real sweeps, each with its own calibration."""
    rng, found = np.random.default_rng(4), []
    kinds = [Group(str(number), "none") for number in range(groups)]
    for number in range(_TRIALS):
        scores = {kind: simulated(rng, sizes[0]) for kind in kinds}
        seen = [(kinds[k % groups], float(score)) for k, score in enumerate(real(rng, sizes[1]))]
        plain, further = Calibration(scores, 0.5), (kinds[number % groups], float(real(rng, 1)[0]))
        place = plain.real_scores([further])
        found.append(plain.real_scores(seen).correct(place.place[0], place.weak[0], sizes[0]))
    return np.array(found)


@pytest.mark.parametrize("name", DRAWS)
@pytest.mark.parametrize("shift", [-1.0, 0.0, 2.0])
def test_real_scenes_correct_any_simulation_to_multiples_of_their_number(name: str, shift: float) -> None:
    """P(p ≤ k / 10) ≤ k / 10 with nine real scenes, though the simulation is shifted and twice too wide."""
    found = _corrected_rates(
        lambda rng, n: shift + 2 * DRAWS[name](rng, (n,)), lambda rng, n: DRAWS[name](rng, (n,)), (60, 9)
    )
    for k in range(1, 10):
        error = math.sqrt(k / 10 * (1 - k / 10) / len(found))
        assert (found <= k / 10 + 1e-12).mean() <= k / 10 + 4 * error, "108 comparisons"


@pytest.mark.parametrize("name", DRAWS)
def test_where_the_simulation_has_the_right_shape_every_rate_holds(name: str) -> None:
    found = _corrected_rates(*(lambda rng, n: DRAWS[name](rng, (n,)),) * 2, sizes=(199, 9))
    for rate in (0.01, 0.02, 0.05, 0.13, 0.25, 0.55):
        error = math.sqrt(rate * (1 - rate) / len(found))
        assert (found <= rate + 1e-12).mean() <= rate + 3 * error
    if name == "normal":
        assert (found <= 0.02).mean() >= 0.01, "real scenes allow less than 1 / 10 only with the simulation's help"


def test_a_simulation_that_is_wrong_about_how_often_is_set_right() -> None:
    """Real scores reach the simulated tail five times as often; nine real scenes bring the rate down."""

    def real(rng: np.random.Generator, count: int) -> F64:
        base = rng.random(count)
        return np.where(rng.random(count) < 0.5, 0.9 + 0.1 * base, 0.9 * base)

    plain = [p_values(np.linspace(0, 1, 199), real(np.random.default_rng(k), 1))[0] for k in range(4000)]
    assert np.mean(np.array(plain) <= 0.05) > 0.2
    found = _corrected_rates(lambda rng, n: rng.random(n), real, (199, 9))
    assert (found <= 0.05).mean() <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / _TRIALS)


def test_several_groups_of_real_scenes_hold_together() -> None:
    found = _corrected_rates(*(lambda rng, n: rng.normal(size=n),) * 2, sizes=(199, 9), groups=3)
    for rate in (0.02, 0.05, 0.1):
        assert (found <= rate).mean() <= rate * (1 + 10 / 200) + 3 * math.sqrt(rate / _TRIALS)


def test_real_scenes_beyond_all_simulated_ones_leave_no_small_rate() -> None:
    calibration = Calibration({VLP: np.arange(199.0)}, 0.01)
    with pytest.raises(ValueError, match=r"needs simulated scores beyond those of the 1 real scenes.*a rate of 0.5"):
        calibration.corrected([(VLP, 500.0)])
    halved = replace(calibration, rate=0.5).corrected([(VLP, 500.0)])
    assert halved.limit(VLP) == pytest.approx(500.0)
    # Nine real scenes below the median: a high score counts for more than among simulated ones alone.
    lower = calibration.corrected([(VLP, score + 0.5) for score in range(41, 50)])
    assert lower.p_value(300.0, VLP) == pytest.approx(0.1 * 1 / 150)
    assert lower.limit(VLP) == 198 - int(0.1 * 150 - 1)


@given(SCORES, st.lists(st.integers(-2, 16), min_size=1, max_size=9), RATES)
def test_corrected_p_values_fall_as_scores_rise_and_alarm_above_the_limit(
    simulated: list[int], real: list[int], rate: float
) -> None:
    plain, seen = Calibration({VLP: np.array(simulated, float)}, 0.5), [(VLP, 0.5 * score) for score in real]
    tried = np.linspace(-2, 10, 97)
    rate = max(rate, 1 / (len(real) + 1))  # the least that is granted, whatever the real scores are
    corrected = replace(plain, rate=rate, real=plain.real_scores(seen))
    found = np.array([corrected.p_value(score, VLP) for score in tried])
    assert (np.diff(found) <= 1e-12).all()
    assert found.min() > 0
    assert found.max() <= 1
    assert ((tried > corrected.limit(VLP)) == (found <= rate + 1e-12)).all()


@given(st.lists(st.floats(0, 1), min_size=1, max_size=40))
def test_the_betting_martingale_is_that_of_crepes(p: list[float]) -> None:
    assert betting_martingale(p) == pytest.approx(SimpleJumper().apply(np.array(p)), rel=1e-9)


def test_online_p_values_are_those_of_crepes() -> None:
    scores = np.random.default_rng(1).integers(0, 5, 50)
    same_draws = np.random.Generator(np.random.RandomState(7)._bit_generator)
    assert online_p_values(scores, same_draws) == pytest.approx(semi_online_p_values(scores, seed=7), abs=1e-12)


def test_the_data_warn_of_drift_and_of_an_attacked_part_but_seldom_of_nothing() -> None:
    rng = np.random.default_rng(6)
    calm = sum(
        drift_warning({VLP: rng.normal(size=300), HDL: rng.normal(size=300)}, rng) is not None for _ in range(200)
    )
    assert calm <= 6
    drifting = {VLP: rng.normal(size=300) + np.linspace(0, 1.5, 300)}
    attacked = {VLP: np.concatenate([rng.normal(size=250), rng.normal(2.5, 1, size=60)])}
    for scores in (drifting, attacked):
        warning = drift_warning(scores, rng)
        assert warning.startswith("benign scenes must be exchangeable, but their scores drift")
        assert "\n" not in warning
    assert drift_warning({}, rng) is None
