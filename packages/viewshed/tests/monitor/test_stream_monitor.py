"""The monitor of streams: attacks begin an alarm, which is latched; odd times, sensors and sweeps."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.evidence.drives import GRID, PLATE, YARD, look, sector_at

from viewshed import Sweep
from viewshed.monitor import Calibration, StreamMonitor, save_calibration, shipped_calibration
from viewshed.monitor.evidence import EARLIER_SWEEPS, EVIDENCE, SECTORS
from viewshed.monitor.impossible import MAX_OUT_OF_TIME_SHARE, impossible_reasons, share_out_of_time
from viewshed.monitor.stream_monitor import SILENT_SWEEPS, SINGLE_SWEEP_NOTE, StreamReport
from viewshed.monitor.tails import CALM_SWEEPS
from viewshed.monitor.watch import MAX_HELD_SWEEPS, Verdict, Watch
from viewshed.preprocess.leveling import LeveledSweep, level

SWEEPS = 40


@cache
def _drive(seed: int, agent: str = "ego") -> tuple[LeveledSweep, ...]:
    """Sweeps of a sensor that drives through the yard at 2 m/s, with noise."""
    rng = np.random.default_rng(seed)
    sweeps = (look(YARD, number, 0.2 * number, rng).replace(agent=agent) for number in range(SWEEPS))
    return tuple(level(sweep, GRID) for sweep in sweeps)


def _attacked(number: int, *, seed: int = 9) -> LeveledSweep:
    """The sweep of a number, with a plate that stands ahead of the sensor."""
    plate = replace(PLATE, x_m=PLATE.x_m + 0.2 * SWEEPS)
    return level(look((*YARD, plate), number, 0.2 * number, np.random.default_rng(seed)), GRID)


def _monitor(**options: float) -> StreamMonitor:
    return StreamMonitor(per_hour=60.0, **options)  # type: ignore[arg-type]


def _after(monitor: StreamMonitor, count: int = SWEEPS) -> list[StreamReport]:
    return [monitor.check(sweep) for sweep in _drive(50)[:count]]


@pytest.mark.slow
def test_an_attack_begins_an_alarm_there_which_is_latched_and_ends() -> None:
    monitor = _monitor()
    calm = _after(monitor, 30)
    assert sum(report.alarm for report in calm) <= 2
    found = monitor.check(_attacked(30), GRID)
    assert found.alarm
    assert found.now.inconsistent
    assert found.delay_s == 0.0
    assert found.now.suspect[sector_at(7.0)]
    assert not found.now.suspect[sector_at(170.0)]
    assert found.now.p_value < 1e-2
    assert any("m²" in reason or "m/s" in reason for reason in found.now.reasons)
    assert found.now.suspect_m2 > 0.0
    # One honest sweep later it is still on, after enough of them it is not.
    later = [monitor.check(sweep) for sweep in _drive(50)[31:]]
    assert later[0].alarm
    assert later[0].delay_s == pytest.approx(0.1)
    assert later[0].doubtful_sweeps == 2
    assert later[0].suspect[sector_at(7.0)]
    assert not later[8].now.inconsistent


def test_what_lasts_becomes_the_past_and_the_alarm_ends_once() -> None:
    rng, kinds = np.random.default_rng(0), len(EVIDENCE)

    def evidence(count: int) -> NDArray[np.float32]:
        drawn = rng.exponential(1.0, (count, kinds, SECTORS)).astype(np.float32)
        drawn[:, of_sensor] = drawn[:, of_sensor, :1]
        return drawn

    of_sensor = np.array([kind.two_sided for kind in EVIDENCE.values()])

    made = Calibration.fit([evidence(150) for _ in range(4)], hz=2.5)
    watch = Watch(made, made.limit(10.0, extrapolate=True))
    assert not any(watch.check(one).alarm for one in evidence(100))
    # From now on the sensor is higher, noisier and has more returns.
    changed = evidence(2 * MAX_HELD_SWEEPS)
    changed[:, [list(EVIDENCE).index(name) for name in ("sensor_height", "range_noise", "returns")]] += 300.0
    alarms = [watch.check(one).alarm for one in changed]
    ended = alarms.index(False)
    assert MAX_HELD_SWEEPS <= ended <= MAX_HELD_SWEEPS + CALM_SWEEPS
    assert not any(alarms[ended:])


def test_empty_and_blinded_sweeps_are_alarms_even_alone() -> None:
    monitor = _monitor()
    near = np.random.default_rng(0).normal(0.0, 0.06, (9000, 3)).astype(np.float32)
    for points, reason in ((np.zeros((0, 3), np.float32), "0 usable returns"), (near, "within 0.7 m")):
        report = monitor.fresh().check(level(Sweep(points, t_ns=0), GRID))
        assert report.alarm
        assert report.now.suspect.all()
        assert any(reason in one for one in report.now.reasons)
        assert not report.now.notes


@pytest.mark.parametrize(("share", "called"), [(0.0, False), (0.01, False), (0.05, True), (0.2, True)])
def test_returns_where_the_sensor_did_not_point_at_their_time_are_impossible(share: float, called: bool) -> None:
    rng = np.random.default_rng(3)
    direction = np.sort(rng.uniform(-np.pi, np.pi, 9000))
    moved = rng.random(9000) < share
    at = direction + np.where(moved, rng.uniform(0.5, 2.5, 9000), 0.0)
    height_m = rng.uniform(-1.6, 2.0, 9000)
    points = np.column_stack([20.0 * np.cos(at), 20.0 * np.sin(at), height_m]).astype(np.float32)
    sweep = Sweep(points, t_ns=0, time_s=(0.1 * (direction + np.pi) / (2 * np.pi)).astype(np.float32))
    assert any("did not point at their time" in one for one in impossible_reasons(level(sweep, GRID))) == called
    # Two heads that point apart share one clock: times tell nothing.
    behind = sweep.replace(points=points * np.where(np.arange(9000) % 2, np.float32(1), np.float32(-1))[:, None])
    assert share_out_of_time(behind) > MAX_OUT_OF_TIME_SHARE
    assert not any("at their time" in one for one in impossible_reasons(level(behind, GRID)))


def test_one_sweep_alone_says_that_it_cannot_tell() -> None:
    reports = _after(_monitor(), EARLIER_SWEEPS + 1)
    assert [report.now.notes for report in reports] == [(SINGLE_SWEEP_NOTE,)] * EARLIER_SWEEPS + [()]
    assert np.isnan([report.now.p_value for report in reports[:EARLIER_SWEEPS]]).all()
    assert not any(report.alarm for report in reports[:EARLIER_SWEEPS])


@pytest.mark.parametrize(
    ("time_ns", "note"),
    [
        (5 * 10**8, "time repeats that of the sweep before: the stream begins anew"),
        (2 * 10**8, "time went back by 0.3 s: the stream begins anew"),
        (20 * 10**9, "time jumped by 19.5 s: the stream begins anew"),
    ],
)
def test_a_stream_whose_time_is_none_begins_anew_and_says_so(time_ns: int, note: str) -> None:
    monitor = _monitor()
    _after(monitor, 6)
    odd = level(_drive(50)[6].sweep.replace(t_ns=time_ns), GRID)
    report = monitor.check(odd)
    assert report.notes == (note,)
    assert report.now.notes == (SINGLE_SWEEP_NOTE,)


def test_after_a_gap_the_past_stays_but_nothing_is_compared() -> None:
    monitor = _monitor()
    _after(monitor, 12)
    late = monitor.check(level(_drive(50)[12].sweep.replace(t_ns=3 * 10**9), GRID))
    assert late.notes == ()
    assert late.now.notes == ("the last sweep is 1.9 s old: it is not compared",)
    assert np.isnan(late.now.evidence[list(EVIDENCE).index("arrival")]).all()


def test_agents_are_apart_bounded_and_bad_settings_refused() -> None:
    monitor = _monitor(agents=2)
    for name in "abc":
        monitor.check(level(look(YARD).replace(agent=name), GRID))
    assert [agent for agent, _ in monitor._agents] == ["b", "c"]
    monitor.reset("b")
    assert [agent for agent, _ in monitor._agents] == ["c"]
    with pytest.raises(ValueError, match="agents must be 1 at least, got 0"):
        _monitor(agents=0)
    with pytest.raises(ValueError, match="jump_s must be positive, got 0"):
        _monitor(jump_s=0.0)


def test_another_sensor_has_its_own_past() -> None:
    monitor = _monitor()
    reports = {"first": list[StreamReport](), "second": list[StreamReport]()}
    for leveled in _drive(50)[:8]:
        assert leveled.sweep.model is not None
        for name, of_sensor in reports.items():
            sweep = leveled.sweep.replace(model=replace(leveled.sweep.model, name=name))
            of_sensor.append(monitor.check(level(sweep, GRID)))
    alone = [report.now.p_value for report in _after(_monitor(), 8)]
    for of_sensor in reports.values():
        assert not any(report.notes for report in of_sensor)
        assert [report.now.p_value for report in of_sensor] == pytest.approx(alone, nan_ok=True)
    # A sweep that names no sensor is of the last one, whose time it repeats; forgetting an agent forgets both.
    assert "time repeats" in monitor.check(level(_drive(50)[7].sweep.replace(model=None), GRID)).notes[0]
    monitor.reset("ego")
    assert not monitor._agents


@pytest.mark.parametrize(
    ("without", "note"),
    [(("world_from_sensor",), "without poses, 6 of 17 kinds of evidence have no data"), ((), None)],
)
def test_evidence_that_looks_at_nothing_is_noted_once(without: tuple[str, ...], note: str | None) -> None:
    monitor = _monitor()
    notes = [
        monitor.check(level(leveled.sweep.replace(**dict.fromkeys(without)), GRID)).now.notes
        for leveled in _drive(50)[:25]
    ]
    said = [(number, one) for number, each in enumerate(notes) for one in each if one != SINGLE_SWEEP_NOTE]
    assert said == ([(SILENT_SWEEPS - 1, note)] if note else [])


def test_a_rate_that_the_calibration_does_not_support_is_noted() -> None:
    sweep = _drive(50)[0]
    assert StreamMonitor(per_hour=0.3).check(sweep).now.notes == (SINGLE_SWEEP_NOTE,)
    (_, note) = StreamMonitor(per_hour=0.01).check(sweep).now.notes
    assert note == "0.01 false alarms an hour are an extrapolation: the drives support 0.29"


def test_a_file_brings_its_rate_and_another_one_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "own.npz"
    save_calibration(replace(shipped_calibration(), facts={"per_hour": "30.0"}), path)
    assert StreamMonitor.of_file(path).per_hour == 30.0
    assert StreamMonitor.of_file(path, 2.0).limit == StreamMonitor(per_hour=2.0).limit


def test_where_all_evidence_abstains_there_is_no_p_value() -> None:
    monitor = _monitor()
    verdict = Verdict(0.0, np.full((len(EVIDENCE), SECTORS), np.nan, np.float32))
    report = monitor._report(verdict, (), (), verdict.sectors, None, ())
    assert np.isnan(report.p_value)
    assert not report.inconsistent
