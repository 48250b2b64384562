"""The monitor of a stream: earlier sweeps, times that are no times, agents apart, alarms over time."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from tests.monitor.benign import KINDS, score_by_hand

from viewshed import BevGrid, Sweep
from viewshed.geometry import Rigid
from viewshed.monitor import SweepMonitor
from viewshed.monitor.evidence import MonitoredSweep
from viewshed.monitor.over_time import EDetector
from viewshed.monitor.score import measure_all
from viewshed.monitor.stream_monitor import StreamMonitor
from viewshed.monitor.sweep_monitor import EARLIER_SWEEPS, BenignSweep, Rates, group_of
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.preprocess.sensor_identification import SensorId
from viewshed.sensors import lidar_model


def _leveled(seed: int, t_ns: int | None = None, *, agent: str = "ego", crowded: bool = False) -> LeveledSweep:
    rng = np.random.default_rng(seed)
    azimuth, range_m = rng.uniform(-np.pi, np.pi, 300), rng.uniform(4, 30, 300)
    if crowded:
        azimuth[:200] = rng.uniform(0.5, 0.6, 200)
    xyz = np.column_stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), rng.uniform(-1.8, 1.0, 300)])
    sweep = Sweep(
        xyz.astype(np.float32), sensor_height_m=1.8, t_ns=t_ns, world_from_sensor=Rigid.identity(),
        infer_sensor=False, agent=agent,
    )  # fmt: skip
    return level(sweep, BevGrid(40, 20.0))


@cache
def _monitor() -> SweepMonitor:
    sweeps = []
    for scene in range(60):
        earlier = tuple(_leveled(100 * scene + k) for k in range(EARLIER_SWEEPS))
        for history in ((), earlier):
            monitored = MonitoredSweep(_leveled(100 * scene + 50), history)
            evidence = np.stack([kind.measure(monitored) for kind in KINDS.values()])
            sweeps.append(BenignSweep(str(scene), group_of(monitored), evidence))
    score = score_by_hand(np.stack([sweep.evidence.astype(np.float32) for sweep in sweeps[1::2]]))
    return SweepMonitor.calibrate(score, sweeps, np.random.default_rng(0), rates=Rates(0.05, 0.05, 0.1))


def _stream(**options: float) -> StreamMonitor:
    return StreamMonitor(_monitor(), EDetector(1000.0), evidence=KINDS, **options)  # type: ignore[arg-type]


def _time_ns(number: float) -> int:
    return 10**18 + round(number * 1e8)


def test_the_sixth_sweep_is_judged_with_five_earlier_ones_about_a_tenth_of_a_second_apart() -> None:
    for every in (1.0, 0.5):  # 10 Hz, and 20 Hz of which every second is used
        stream, notes = _stream(), []
        sweeps = [_leveled(7000 + k, _time_ns(k * every)) for k in range(12)]
        reports = [stream.check(sweep) for sweep in sweeps]
        notes = [report.now.notes for report in reports]
        first = next(k for k, note in enumerate(notes) if not note)
        assert first == EARLIER_SWEEPS / every
        used = sweeps[:first] if every == 1.0 else sweeps[:first:2]
        expected = _monitor().check(MonitoredSweep(sweeps[first], tuple(used)), KINDS)
        assert reports[first].now.score == expected.score


def test_a_report_has_the_evidence_that_was_scored_what_is_held_included() -> None:
    kinds = {**KINDS, "change": replace(KINDS["change"], over_time=True)}
    stream = StreamMonitor(_monitor(), EDetector(1000.0), evidence=kinds)
    sweeps = [_leveled(7000 + k, _time_ns(k)) for k in range(8)]
    reports = [stream.check(sweep) for sweep in sweeps]
    for report in reports:
        assert _monitor().score(report.now.evidence).inconsistent == report.now.score
    alone = [measure_all(MonitoredSweep(sweeps[k], tuple(sweeps[k - EARLIER_SWEEPS : k])), kinds) for k in (5, 6, 7)]
    assert_array_equal(reports[7].now.evidence[[0, 2]], alone[-1][[0, 2]])
    assert_array_equal(reports[7].now.evidence[1], np.max([each[1] for each in alone], axis=0))


@pytest.mark.parametrize(
    ("time", "note"),
    [
        (5.0, "time repeats that of the sweep before: the stream begins anew"),
        (2.0, "time went back by 0.3 s: the stream begins anew"),
        (20.0, "time jumped by 1.5 s: the stream begins anew"),
        (None, "the sweep has no time: it is judged without earlier sweeps"),
    ],
)
def test_a_stream_whose_time_is_none_begins_anew_and_says_so(time: float | None, note: str) -> None:
    stream = _stream()
    for k in range(6):
        assert stream.check(_leveled(7000 + k, _time_ns(k))).notes == ()
    broken = stream.check(_leveled(7100, None if time is None else _time_ns(time)))
    assert broken.notes == (note,)
    assert "evidence over time abstains" in broken.now.notes[0]
    if time is not None:
        assert stream.check(_leveled(7101, _time_ns(time + 1))).notes == ()


def test_another_sensor_begins_anew() -> None:
    stream = _stream()
    stream.check(_leveled(1, _time_ns(0)))
    other = replace(_leveled(2, _time_ns(1)), sensor_id=SensorId(None, lidar_model("VLP-16")))
    expected = "the sensor changed from unknown sensor without rings to VLP-16 without rings: the stream begins anew"
    assert stream.check(other).notes == (expected,)


def test_a_lasting_attack_alarms_with_its_delay_and_agents_are_apart() -> None:
    stream = _stream()
    for k in range(8):
        for agent in ("one", "two"):
            assert not stream.check(_leveled(8000 + k, _time_ns(k), agent=agent)).alarm
    for k in range(8, 20):
        attacked = stream.check(_leveled(8000 + k, _time_ns(k), agent="one", crowded=True))
        calm = stream.check(_leveled(8000 + k, _time_ns(k), agent="two"))
        assert attacked.now.inconsistent
        assert not calm.alarm
        if attacked.alarm:
            break
    assert attacked.alarm
    assert attacked.wealth >= attacked.limit == 1000.0
    assert k - 8 <= 5
    # Doubt may have begun a little before the attack, never after it.
    assert (k - 8) * 0.1 - 1e-6 <= attacked.delay_s <= (k - 8) * 0.1 + 0.5
    assert attacked.delay_s == pytest.approx(0.1 * (attacked.doubtful_sweeps - 1))


def test_agents_are_bounded_and_bad_settings_refused() -> None:
    stream = _stream(agents=2)
    for k in range(5):
        stream.check(_leveled(9000 + k, _time_ns(k), agent=f"agent {k}"))
    assert list(stream._agents) == ["agent 3", "agent 4"]
    with pytest.raises(ValueError, match="agents must be 1 at least, got 0"):
        _stream(agents=0)
    with pytest.raises(ValueError, match="every_s and jump_s must be positive, got"):
        _stream(every_s=0.0)


def test_a_sweep_that_cannot_be_checked_leaves_the_stream_as_it_was() -> None:
    stream = _stream()
    for k in range(5):
        stream.check(_leveled(7000 + k, _time_ns(k)))
    empty = level(Sweep(np.zeros((0, 3), np.float32), t_ns=_time_ns(5), infer_sensor=False), BevGrid(40, 20.0))
    with pytest.raises(ValueError, match="sweep must have usable returns"):
        stream.check(empty)
    assert stream.check(_leveled(7005, _time_ns(5))).now.notes == ()


def test_evidence_of_a_sweep_that_could_not_be_judged_is_not_held() -> None:
    kinds = {**KINDS, "change": replace(KINDS["change"], over_time=True)}
    stream, undisturbed = (StreamMonitor(_monitor(), EDetector(1000.0), evidence=kinds) for _ in range(2))
    for k in range(7):
        sweep = _leveled(7000 + k, _time_ns(k))
        stream.check(sweep)
        undisturbed.check(sweep)
    stream.monitor = replace(_monitor(), score=_NoScore())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="evidence gives no score"):
        stream.check(_leveled(7500, _time_ns(7), crowded=True))
    stream.monitor = _monitor()
    one, other = (each.check(_leveled(7007, _time_ns(7))) for each in (stream, undisturbed))
    assert_array_equal(one.now.evidence, other.now.evidence)
    assert one.wealth == other.wealth


class _NoScore:
    """A score that raises."""

    names = tuple(KINDS)

    def __call__(self, evidence: object) -> object:
        raise ValueError("evidence gives no score")


def test_after_a_reset_the_next_sweep_is_judged_by_itself() -> None:
    stream = _stream()
    for k in range(6):
        stream.check(_leveled(7000 + k, _time_ns(k)))
    stream.reset("another")
    assert not stream.check(_leveled(7006, _time_ns(6))).now.notes
    stream.reset()
    assert any("judged without earlier sweeps" in note for note in stream.check(_leveled(7007, _time_ns(7))).now.notes)
