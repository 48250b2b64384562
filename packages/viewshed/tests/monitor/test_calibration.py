"""Limits of alarms: promises of conformal limits on any distribution, rates of streams, files."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from scipy import stats

from viewshed.arrays import F32
from viewshed.monitor.calibration import (
    Calibration,
    load_calibration,
    save_calibration,
    scores_of,
    shipped_calibration,
)
from viewshed.monitor.evidence import EVIDENCE, SECTORS
from viewshed.monitor.tails import peaks_of

HZ, MINUTE = 2.5, 150
"""Sweeps a second, and in a minute."""

KINDS = {name: EVIDENCE[name] for name in ("arrival", "same_noise", "nearer", "range_noise")}


def benign_stream(seed: int, sweeps: int = MINUTE, scale: float = 1.0) -> F32:
    """Return evidence (T, E, SECTORS) drawn at random: exponential, of a scale that is the stream's own."""
    rng = np.random.default_rng(seed)
    return rng.exponential(scale, (sweeps, len(KINDS), SECTORS)).astype(np.float32)


@pytest.fixture(scope="module")
def made() -> Calibration:
    """Twelve minutes, in places that differ by a factor of ten."""
    return Calibration.fit([benign_stream(k, scale=10.0 ** (k % 2)) for k in range(12)], HZ, KINDS)


def test_the_rate_holds_on_further_streams_in_each_place(made: Calibration) -> None:
    limit = made.limit(10.0)
    for place, scale in enumerate((1.0, 10.0, 3.0)):
        alarms = 0
        for number in range(3):
            evidence = benign_stream(100 + 10 * place + number, scale=scale)
            alarms += int((Calibration.fit([evidence], HZ, KINDS, base=made).peaks > limit).sum())
        assert alarms <= stats.poisson.ppf(0.999, 10.0 * 0.05), f"ten an hour are asked, {alarms} in 3 minutes"


def test_fewer_alarms_need_a_higher_limit_or_more_minutes(made: Calibration) -> None:
    assert made.hours == pytest.approx(0.2, abs=0.01)
    assert made.limit(10.0) < made.limit(6.0) < made.limit(1.0, extrapolate=True)
    assert made.per_hour(made.limit(6.0)) == pytest.approx(6.0)
    with pytest.raises(ValueError, match=r"need 60 minutes of benign driving, got 12\.0; give more"):
        made.limit(1.0)
    with pytest.raises(ValueError, match="per_hour must be positive, got 0"):
        made.limit(0.0)
    assert "extrapolation" in made.promise(1.0)
    assert "extrapolation" not in made.promise(10.0)


def test_a_minute_is_the_least(made: Calibration) -> None:
    with pytest.raises(ValueError, match=r"benign drives must last 1 minute at least, got 0\.83; give more"):
        Calibration.fit([benign_stream(0, 125)], HZ, KINDS, base=made)
    assert Calibration.fit([benign_stream(0)], HZ, KINDS, base=made).least_per_hour == pytest.approx(60.0)


@pytest.fixture(scope="module")
def honest(made: Calibration) -> Calibration:
    return Calibration.fit([benign_stream(k, 300) for k in range(20, 23)], HZ, KINDS, base=made)


@pytest.mark.parametrize("share", [0.01, 0.05])
@pytest.mark.parametrize("how", ["scattered", "periodic", "burst"])
def test_attacks_on_up_to_5_percent_of_the_sweeps_do_not_raise_the_limit(
    made: Calibration, honest: Calibration, how: str, share: float
) -> None:
    count, attacked = round(300 * share), [benign_stream(k, 300) for k in range(20, 23)]
    for number, one in enumerate(attacked):
        sweeps = {
            "scattered": np.random.default_rng(number).choice(300, count, replace=False),
            "periodic": np.arange(1, count + 1) * (300 // count) - 1,
            "burst": np.arange(150, 150 + count),
        }[how]
        one[sweeps] *= 1000.0
    found = Calibration.fit(attacked, HZ, KINDS, base=made)
    assert found.limit(20.0) < honest.limit(20.0) + 0.3
    assert found.limit(20.0) > honest.limit(20.0) - 0.5
    assert int(found.facts["left_out"]) >= 2 * count
    assert "left_out" not in honest.facts


def rough_stream(seed: int) -> F32:
    """Return benign evidence (T, E, SECTORS) whose tail is much heavier than the base's."""
    return np.random.default_rng(seed).pareto(3.0, (600, len(KINDS), SECTORS)).astype(np.float32)


@pytest.mark.slow
def test_an_honest_vehicle_in_rougher_places_gets_a_higher_limit_that_holds(made: Calibration) -> None:
    own = Calibration.fit([rough_stream(k) for k in (1, 2)], HZ, KINDS, base=made)
    assert own.limit(15.0) > made.limit(15.0) + 0.5
    assert (own.peaks > made.limit(1.0, extrapolate=True)).sum() > 5
    scores = [scores_of(rough_stream(k), made, np.inf, KINDS) for k in (3, 4)]
    alarms = sum(int((peaks_of(one) > own.limit(15.0)).sum()) for one in scores)
    assert alarms <= stats.poisson.ppf(0.999, 15.0 * 8.0 / 60.0), f"15 an hour are asked, {alarms} in 8 minutes"


def test_where_the_base_calls_many_sweeps_it_is_another_sensor_and_all_count(made: Calibration) -> None:
    streams = [benign_stream(k) for k in (30, 31)]
    for one in streams:
        one[10::6] *= 1000.0
    found = Calibration.fit(streams, HZ, KINDS, base=made)
    assert "left_out" not in found.facts
    assert found.limit(15.0, extrapolate=True) > made.limit(15.0) + 1.0


def test_too_short_streams_are_named_as_the_cause(made: Calibration) -> None:
    one = benign_stream(0)
    with pytest.raises(ValueError, match="got 0 besides 150 sweeps in streams of 5 or fewer, which are too short"):
        Calibration.fit([one[k : k + 1] for k in range(len(one))], HZ, KINDS, base=made)


@given(st.lists(st.floats(0.0, 9.0, width=32), max_size=80))
def test_peaks_are_apart_and_the_highest_is_one(scores: list[float]) -> None:
    peaks = peaks_of(np.array(scores, np.float32))
    assert len(peaks) <= len(scores) // 11 + 1
    assert max(scores, default=0.0) == (peaks.max() if len(peaks) else 0.0)


def test_a_file_brings_it_back_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    made, path = shipped_calibration(), tmp_path / "made.npz"
    save_calibration(made, path)
    again = load_calibration(path)
    assert (again.names, again.hours, again.facts) == (made.names, made.hours, made.facts)
    assert_array_equal(again.peaks, made.peaks)
    assert_array_equal(again.changes.values, made.changes.values)
    assert again.p_value(3.0) == made.p_value(3.0)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(ValueError, match=r"must be a whole monitor file of this version, got: .*; make it again"):
        load_calibration(path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"evidence": "0123456789abcdef"}, "a monitor of evidence 0123456789abcdef"),
        (
            {"version": 6, "evidence": None},
            r"a monitor of format 6 \(this version reads 8\); make it again: .* calibrate ",
        ),
        (None, "got: no monitor; make it again"),
    ],
)
def test_a_calibration_of_other_evidence_or_of_another_format_is_refused(
    changes: dict[str, object] | None, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "made.npz"
    save_calibration(shipped_calibration(), path)
    arrays = dict(np.load(path))
    about = json.loads(arrays.pop("about").tobytes())
    if changes is not None:
        kept = {name: value for name, value in (about | changes).items() if value is not None}  # 0.3 had no evidence
        arrays["about"] = np.frombuffer(json.dumps(kept).encode(), np.uint8)
    np.savez_compressed(path, **arrays)
    with pytest.raises(ValueError, match=said):
        load_calibration(path)
