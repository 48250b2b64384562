"""The study of all evidence: drives are the same by any engine, labels are by hand, and the page follows from files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from viewshed.cli import main
from viewshed.monitor.evidence import EVIDENCE, SECTORS
from viewshed.monitor.over_time import EDetector, e_values
from viewshed_lab._config import preset_names
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.studies.monitor.archive import FOLDER, DriveEvidence, SweepTable
from viewshed_lab.studies.monitor.drives import Drive, _conditions, measure_drive
from viewshed_lab.studies.monitor.examples import examples_of, is_trained_on
from viewshed_lab.studies.monitor.jobs import run_study
from viewshed_lab.studies.monitor.plan import ALL_ATTACKS, CORRUPTED, FRAMES, ONSET, SPLITS, MonitorPlan, family_of
from viewshed_lab.studies.monitor.recorded import measure_recorded_drive
from viewshed_lab.studies.monitor.results import (
    INCONSISTENT,
    AttackedSweeps,
    Limits,
    Rate,
    Scored,
    delays_of,
    placements,
)
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.studies.store import ResultStore

TINY = MonitorPlan.load("tiny")

CASES = [Case("attack", "ghost_wall", "default"), Case("null", "ghost_wall"), Case("corruption", "rain", "5"),
         Case("attack", "replay", "frozen"), Case("strength", "pose_spoof", "yaw_deg 2")]  # fmt: skip


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive.simulate(TINY, "rooms", "train", 1)


@pytest.fixture(scope="module")
def measured(drive: Drive) -> DriveEvidence:
    return measure_drive(drive, CASES)


def test_a_drive_is_ten_sweeps_a_tenth_of_a_second_apart(drive: Drive) -> None:
    times = [sweep.t_ns for sweep in drive.sweeps]
    assert len(times) == FRAMES
    assert_array_equal(np.diff(np.array(times, np.float64)), 1e8)
    assert drive.conditions == BENIGN, "drives that are attacked are clear"


def test_evidence_of_a_drive_in_its_cases(measured: DriveEvidence) -> None:
    assert measured.cases == tuple(CASES)
    assert measured.benign.shape == (FRAMES, len(EVIDENCE), SECTORS)
    assert measured.evidence.shape == (len(CASES), FRAMES - ONSET, len(EVIDENCE), SECTORS)
    touched = measured.touched.sum(axis=-1)
    assert ((touched[0] >= 6) & (touched[0] <= 9)).all(), "a sector of 30° is six of 5°, or seven where it is between"
    assert not touched[[1, 2]].any(), "null attacks and rain touch nothing"
    assert (touched[3] > SECTORS / 2).all()
    assert (touched[4] == SECTORS).all(), "a false pose is false all around"
    # The wedge stays where it was before the sensor.
    assert (measured.touched[0].all(axis=0).sum()) >= 5


def test_a_lasting_attack_does_not_repeat_its_noise(drive: Drive) -> None:
    walls = list(drive.tamper(CASES[0]))
    ranges = [np.sort(np.linalg.norm(one.sweep.points[one.added], axis=1)) for one in walls[:2]]
    count = min(map(len, ranges))
    assert count > 20
    assert not np.allclose(ranges[0][:count], ranges[1][:count])


def test_a_drive_survives_its_file(measured: DriveEvidence, tmp_path: Path) -> None:
    measured.save(tmp_path)
    once = (tmp_path / measured.file).read_bytes()
    again = DriveEvidence.load(tmp_path / measured.file)
    assert (again.cases, again.names, again.sensor) == (measured.cases, measured.names, measured.sensor)
    assert_array_equal(again.touched, measured.touched)
    assert_allclose(again.benign.astype(np.float32), measured.benign, rtol=1e-3, atol=1e-6)
    again.save(tmp_path)
    assert (tmp_path / measured.file).read_bytes() == once


def test_labels_by_hand(measured: DriveEvidence) -> None:
    table = SweepTable.of([measured])
    examples = examples_of(table)
    labels = {case: examples.inconsistent[table.is_case([case])] for case in table.cases}
    assert_array_equal(labels[BENIGN], np.zeros(FRAMES))
    assert_array_equal(labels[CASES[0]], np.ones(FRAMES - ONSET))
    assert np.isnan(labels[CASES[1]]).all(), "null attacks are for the test alone"
    assert_array_equal(labels[CASES[2]], np.zeros(FRAMES - ONSET))
    assert_array_equal(examples.degraded[table.case == 0], np.zeros(FRAMES))
    assert np.isnan(examples.degraded[table.case != 0]).all(), "what begins half-way is open"
    lasting = examples_of(SweepTable.of([replace(measured, conditions=Case("corruption", "rain", "5"))]))
    assert_array_equal(lasting.degraded[:FRAMES], np.ones(FRAMES))
    lasting = examples_of(SweepTable.of([replace(measured, conditions=Case("corruption", "rain", "3"))]))
    assert np.isnan(lasting.degraded).all()
    assert_array_equal(examples.sectors[FRAMES], measured.touched[0, 0])
    without = is_trained_on(table, str(family_of("ghost_wall_clean")))
    assert not without[table.is_case([CASES[0]])].any(), "a clean spoofer is of the family of its attack"
    assert without[table.is_case([CASES[3]])].all()
    rained = table.is_case([CASES[2]])
    assert_allclose(examples.weight[table.case == 0].sum(), 0.35 * len(rained), rtol=1e-5)
    assert_allclose(examples.weight[rained].sum(), 0.15 * len(rained), rtol=1e-5)


def test_measured_sweeps_are_attacked_one_by_one(drive: Drive) -> None:
    found = measure_recorded_drive(TINY, 3, list(drive.sweeps[:3]))
    assert (found.scene, found.benign.shape[0]) == ("recorded recorded 3", 3)
    assert found.cases == (Case("attack", "ghost_wall", "default"),)
    assert found.refused == (Case("attack", "replay", "default"),), "there is none before the first"
    table = SweepTable.of([found])
    assert_array_equal(table.frame, [0, 1, 2, 0, 1, 2])
    assert table.touched[3:].any(axis=1).all()


def _scored(values: list[float], sensors: list[str]) -> Scored:
    """Return a row of a drive of its own for each value."""
    drives = [
        DriveEvidence(
            "rooms", "test", n, sensor, BENIGN, ("a",), np.zeros((FRAMES, 1, SECTORS)),
            np.zeros((1, SECTORS)), (),
            np.zeros((0, FRAMES - ONSET, 1, SECTORS)), np.zeros((0, FRAMES - ONSET, SECTORS), np.bool_), (),
        )
        for n, sensor in enumerate(sensors)
    ]  # fmt: skip
    table = SweepTable.of(drives)
    table = table.rows(table.frame == 1)
    scores = np.array([values, values], np.float32).T
    return Scored(table, scores)


def test_areas_and_limits_are_of_each_sensor_by_itself() -> None:
    benign = _scored([0.0, 1.0, 10.0, 11.0], ["a", "a", "b", "b"])
    attacked = _scored([1.0, 5.0, 10.5], ["a", "b", "b"])
    assert_array_equal(placements(benign, attacked, INCONSISTENT), [0.75, 0.0, 0.5])
    many = _scored([*map(float, range(19)), 50.0], ["a"] * 19 + ["b"])
    limits = Limits.of(many, INCONSISTENT, 0.1)
    assert limits.by_sensor == {"a": 17.0}
    assert limits.others == 18.0  # the 19th of 20
    assert_array_equal(limits.alarms(_scored([17.0, 17.5, 18.5], ["a", "a", "b"]), INCONSISTENT), [0, 1, 1])
    assert np.isnan(Limits.of(many, INCONSISTENT, 0.01).alarms(attacked, INCONSISTENT)).all()


def test_delays_by_hand() -> None:
    """A detector that alarms on any p-value of .01."""
    limit = float(e_values([0.01])[0])
    rare, usual = np.array([1.0, 1.0, 0.01, 1.0, 1.0]), np.ones(5)
    assert_array_equal(delays_of([(EDetector(limit), p) for p in (rare, usual, rare[2:])]), [3, 0, 1])
    # Two p-values of .03 together are as rare, unless a new run begins between them.
    pair = EDetector(float(e_values([0.03])[0]) * 1.5, run=2)
    assert_array_equal(delays_of([(pair, np.array([0.03, 0.03, 1.0]))]), [2, 0])


def test_attacked_sweeps_are_streams_of_drives() -> None:
    names, ones = np.array(["a", "a", "b", "a"]), np.ones(4)
    attacked = AttackedSweeps(
        names, np.array(["x"] * 4), names, np.array([1, 1, 1, 2]), np.array([6, 5, 5, 5]), ones, ones, ones,
        np.array([0.1, 0.2, 0.3, 0.4]), np.array([1e-6, 0.2, 0.3, 0.4]), np.array([[1e3, np.nan]] * 4),
    )  # fmt: skip
    joined, mask = AttackedSweeps.joined([attacked]), attacked.attack == "a"
    assert [joined.p[rows].tolist() for rows in joined.streams(mask)] == [[0.2, 0.1], [0.4]]
    # The second sweep of the first drive alarms, wherever a run of five begins.
    assert sorted(joined.delays(mask, 0)) == [0] * 5 + [2] * 5
    assert not len(joined.delays(mask, 1)), "refused"


def test_a_rate_has_an_interval_over_scenes() -> None:
    rate = Rate.of(np.array([1.0, 1.0, 0.0, np.nan]), np.array([0, 0, 1, 2]))
    assert rate.value == pytest.approx(2 / 3)
    assert (rate.scenes, rate.sweeps) == (2, 3)
    assert rate.interval[0] <= 2 / 3 <= rate.interval[1]
    assert np.isnan(Rate.of(np.zeros(0), np.zeros(0, np.int64)).value)


def test_further_drives_to_train_on_are_never_attacked_and_corrupted_as_often_as_others() -> None:
    plan = MonitorPlan.load("small")
    first = plan.train[0]
    assert not any(plan.cases_of("drives", "train", number) for number in range(first, first + plan.unattacked[0]))
    assert [plan.cases_of("drives", "train", n) for n in range(first)] == [
        replace(plan, unattacked=(0, 0), published=(0, 0, 0)).cases_of("drives", "train", n) for n in range(first)
    ]
    conditions = [_conditions(plan, ("drives", "train", number)) for number in range(first, first + plan.unattacked[0])]
    # Standard error of a share of .3 of 1,000: .014.
    assert abs(np.mean([one != BENIGN for one in conditions]) - CORRUPTED) < 0.045


def test_benign_drives_are_never_attacked_and_corrupted_as_often_as_others() -> None:
    plan = MonitorPlan.load("small")
    assert not any(plan.cases_of("drives", "benign", number) for number in range(1000))
    conditions = [_conditions(plan, ("drives", "benign", number)) for number in range(1000)]
    assert abs(np.mean([one != BENIGN for one in conditions]) - CORRUPTED) < 0.045


def test_every_attack_is_tried_in_its_turn() -> None:
    plan = replace(MonitorPlan.load("small"), test=(400, 70), attacked=(200, 70))
    every = plan.all_cases()
    assert len(set(every)) == len(every)
    assert {case.name for case in every if case.kind == "attack"} == set(ALL_ATTACKS)
    tried = [case for number in range(400) for case in plan.cases_of("drives", "test", number)]
    counts = {case: tried.count(case) for case in every}
    assert max(counts.values()) - min(counts.values()) <= 1
    assert plan.cases_of("drives", "calibration", 0) == []
    assert [bool(plan.cases_of("drives", "test", number)) for number in range(4)] == [False, True, False, True]


@pytest.mark.parametrize("name", preset_names("studies/monitor/plans"))
def test_a_plan_survives_its_plain_values(name: str) -> None:
    plan = MonitorPlan.load(name)
    assert MonitorPlan.from_json(plan.to_json()) == plan
    assert len(plan.drive_keys()) == sum(sum(getattr(plan, split)) for split in (*SPLITS, "unattacked"))
    assert len(set(plan.job_keys())) == len(plan.job_keys())


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"domains": ["moon"]}, "domains must be among .*, got 'moon'"),
        ({"attacks": ["unifrom"]}, "attacks must be among uniform, .*, got 'unifrom'"),
        ({"evidence": ["guess"]}, "evidence must be among .*, got 'guess'"),
        ({"train": [1, 2]}, "train must have a number of drives for each of 1 domains"),
        ({"seed": -1}, "seed must lie in"),
        ({"published": [1, 7, 1]}, r"published must be three numbers of drives up to \(10, 6, 6\), got"),
    ],
)
def test_a_wrong_plan_is_one_clear_line(change: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        MonitorPlan.from_json(TINY.to_json() | change)


def test_the_command_runs_and_the_bytes_do_not_depend_on_the_engine(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["study", "monitor", "--preset", "tiny", "--out", str(tmp_path / "one"), "--workers", "1"])
    assert not stop.value.code
    text, full = ((tmp_path / "one" / name).read_text("utf-8") for name in ("monitor.md", "monitor_full.md"))
    assert all(f"\n| {word} " in text for word in ("ghost_wall (6)", "replay, frozen (11)", "**all**"))
    assert "\n| rain " in full  # the published page is the short one
    assert "\n| rain " not in text
    store = ResultStore.open(tmp_path / "two", TINY)
    assert list(run_study(store, LocalEngine(2), ("drives",))) == []
    files = sorted(path.name for path in (tmp_path / "one" / FOLDER).iterdir())
    assert len(files) == len(TINY.drive_keys())
    for name in files:
        assert (tmp_path / "two" / FOLDER / name).read_bytes() == (tmp_path / "one" / FOLDER / name).read_bytes()
