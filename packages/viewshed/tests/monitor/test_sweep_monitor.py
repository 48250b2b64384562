"""The monitor of a sweep: verdicts at their rates, sectors, reasons, its file, and what it refuses."""

import json
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.benign import HDL, KINDS, VLP, benign_sweeps, check_refusals, evidence_of, score_by_hand

from viewshed import BevGrid, Sweep
from viewshed.geometry import Rigid
from viewshed.monitor import SweepMonitor, load_sweep_monitor, save_sweep_monitor
from viewshed.monitor.calibration import Calibration, Group, Per
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep
from viewshed.monitor.over_time import EDetector
from viewshed.monitor.sweep_monitor import (
    EARLIER_SWEEPS,
    EVIDENCE_ID,
    BenignSweep,
    Rates,
    evidence_id,
    group_of,
    shipped_monitor,
)
from viewshed.preprocess.leveling import LeveledSweep, level

RATES = Rates(0.01, 0.02, 0.1)


def _calibrated(sweeps: list[BenignSweep], **options: Any) -> SweepMonitor:
    return SweepMonitor.calibrate(score_by_hand(), sweeps, np.random.default_rng(0), **({"rates": RATES} | options))


@cache
def _monitor() -> SweepMonitor:
    sweeps = benign_sweeps(150, 1) + benign_sweeps(99, 2, HDL, scale=3.0)
    return _calibrated(sweeps, facts={"viewnet": "abc"})


def _attacked(seed: int = 5) -> tuple[NDArray[np.float32], slice]:
    evidence, wedge = evidence_of(np.random.default_rng(seed)), slice(20, 30)
    evidence[0, wedge] = np.linspace(60.0, 70.0, 10)
    return evidence, wedge


def test_an_attacked_wedge_is_inconsistent_and_found_with_its_reason() -> None:
    evidence, wedge = _attacked()
    report = _monitor().report(evidence, VLP, BevGrid(40, 20.0), kinds=KINDS)
    assert report.inconsistent
    assert not report.degraded
    assert report.p_value == pytest.approx(1 / 151)
    assert report.suspect[wedge].all()
    assert report.suspect.sum() <= 12
    assert report.suspect_cells.any()
    assert report.reasons[0] == "70.00 of the returns lie at -32°"
    assert report.monitor == "sweep"


def test_what_raises_all_sectors_a_little_is_degraded_and_no_reason_is_told_of_usual_evidence() -> None:
    monitor, calm = _monitor(), evidence_of(np.random.default_rng(8))
    report = monitor.report(calm, VLP, kinds=KINDS)
    assert not report.inconsistent
    assert not report.degraded
    assert not report.suspect.any()
    assert report.reasons == ()
    assert monitor.report(calm * np.float32(6.0), VLP, kinds=KINDS).degraded


def test_there_is_no_verdict_without_a_reason() -> None:
    monitor, told = _monitor(), list[str]()
    for seed in range(40):
        evidence = evidence_of(np.random.default_rng(seed))
        # All sectors are nearly as high as the highest: usual of one sector, and not of all.
        raised = np.maximum(evidence, 0.97 * np.nanmax(evidence, axis=1, keepdims=True))
        report = monitor.report(raised, VLP, kinds=KINDS)
        if report.inconsistent or report.degraded:
            told.append(report.reasons[0])
    assert any(reason.startswith("rare all together, each alone is not; the rarest: ") for reason in told)


@pytest.mark.parametrize("per", ["sweep", "drive"])
def test_both_verdicts_keep_their_rates_on_further_scenes(per: Per) -> None:
    """25 monitors of 99 scenes, each tried on 60 further ones; per drive any of its sweeps counts."""
    alarms, each = np.zeros(2), 2 if per == "drive" else 1
    for seed in range(25):
        monitor = _calibrated(benign_sweeps(99, 100 + seed, each=2), per=per, rates=Rates(0.05, 0.1, 0.1))
        raised: dict[str, set[str]] = {"inconsistent": set(), "degraded": set()}
        for sweep in benign_sweeps(60, 10_000 + seed, each=each):
            report = monitor.report(sweep.evidence, VLP, kinds=KINDS)
            for name, scenes in raised.items():
                if getattr(report, name):
                    scenes.add(sweep.scene)
        alarms += [len(scenes) for scenes in raised.values()]
    # Three standard errors: of the mean of 25 betas, and of 1,500 scenes.
    assert alarms[0] / 1500 == pytest.approx(0.05, abs=0.021)
    assert alarms[1] / 1500 == pytest.approx(0.1, abs=0.03)


def test_false_discoveries_of_sectors_stay_below_their_rate() -> None:
    monitor, wrong, found = _monitor(), [], []
    for seed in range(200):
        evidence, wedge = _attacked(seed)
        report = monitor.report(evidence, VLP, kinds=KINDS)
        outside = report.suspect.copy()
        outside[wedge] = False
        wrong.append(outside.sum() / max(report.suspect.sum(), 1))
        found.append(report.suspect[wedge].mean())
    assert np.mean(wrong) <= 0.1
    assert np.mean(found) > 0.95


def test_an_unknown_sensor_takes_the_most_cautious_group_and_says_so() -> None:
    evidence, _ = _attacked()
    report = _monitor().report(evidence, Group("OS1-64", "none"), kinds=KINDS)
    assert report.threshold == max(_monitor().inconsistent.limit(group) for group in (VLP, HDL))
    said = "OS1-64, single sweeps was not calibrated, no rate is promised: judged by the most cautious of 2 sensors"
    assert report.notes == (said,)


def test_the_same_sweeps_give_the_same_file_and_the_file_the_same_monitor(tmp_path: Path) -> None:
    real = [replace(sweep, scene=f"real {number}") for number, sweep in enumerate(benign_sweeps(9, 3, each=1))]
    corrected = _monitor().corrected(real, np.random.default_rng(0), rates=Rates(0.1, 0.1, 0.1))
    for monitor in (_monitor(), corrected):
        save_sweep_monitor(monitor, tmp_path / "one.npz")
        save_sweep_monitor(monitor, tmp_path / "two.npz")
        assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
        again = load_sweep_monitor(tmp_path / "one.npz")
        for evidence in (_attacked()[0], evidence_of(np.random.default_rng(9))):
            before, after = (each.report(evidence, VLP, BevGrid(40, 20.0), kinds=KINDS) for each in (monitor, again))
            assert str(before) == str(after)
        assert again.promises() == monitor.promises()
        assert (again.facts, again.per, again.warnings) == (monitor.facts, monitor.per, monitor.warnings)


def test_promises_are_told_for_each_group_and_verdict() -> None:
    lines = _monitor().promises()
    assert len(lines) == 5, "two groups, two verdicts, and alarms over time"
    assert lines[0].startswith("HDL-32E, single sweeps: inconsistent above ")
    assert lines[0].endswith("expected rate at most 1.000%, at most 2.299% with probability 0.9")
    scores = {VLP: np.arange(999.0)}
    real = [(VLP, 10.0 * number + 0.5) for number in range(53)]
    told = Calibration(scores, 0.01).corrected(real).promise_of(VLP)
    assert told.startswith(
        "corrected by 53 real scenes: expected rate at most 1.852% however wrong the simulation is, 1."
    )


def test_every_damaged_file_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "monitor.npz"
    save_sweep_monitor(_calibrated(benign_sweeps(9, 1), rates=Rates(0.2, 0.2, 0.1)), path)
    refused = check_refusals(path, load_sweep_monitor, 997, 150)
    assert refused > 0.6, "a date or a flag that nobody reads is no damage"


def test_a_file_of_another_version_or_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "monitor.npz"
    save_sweep_monitor(replace(_monitor(), evidence="0123"), path)
    with pytest.raises(ValueError, match=rf"monitor sweep of evidence 0123, not {EVIDENCE_ID}; calibrate it again"):
        load_sweep_monitor(path)
    save_sweep_monitor(_monitor(), path)
    monkeypatch.setattr("viewshed.monitor.sweep_monitor._MAX_BYTES", 1000)
    with pytest.raises(ValueError, match="must be at most 1000 bytes"):
        load_sweep_monitor(path)


def test_a_release_voids_no_monitor_and_other_evidence_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "monitor.npz"
    save_sweep_monitor(_monitor(), path)
    monkeypatch.setattr("viewshed.__version__", "99.0")
    assert load_sweep_monitor(path).evidence == shipped_monitor().evidence == EVIDENCE_ID
    known = list(EVIDENCE.items())
    name, first = known[0]
    others = [
        dict(known[1:]), dict(reversed(known)), {**EVIDENCE, "new": first},
        {**EVIDENCE, name: replace(first, version=9)},
        {**EVIDENCE, name: replace(first, over_time=not first.over_time)},
    ]  # fmt: skip
    assert len({EVIDENCE_ID, *map(evidence_id, others)}) == 1 + len(others)
    assert evidence_id({**EVIDENCE, name: replace(first, sentence="in other words")}) == EVIDENCE_ID


def test_a_file_that_names_a_release_is_of_that_release_s_evidence(tmp_path: Path) -> None:
    save_sweep_monitor(_monitor(), tmp_path / "now.npz")
    arrays = dict(np.load(tmp_path / "now.npz"))
    for release, is_known in (("0.3.0", True), ("0.2.0", False)):
        about = json.loads(arrays["about"].tobytes())
        del about["evidence"]
        about |= {"version": 2, "viewshed": release}
        path = tmp_path / f"{release}.npz"
        np.savez_compressed(path, **(arrays | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)}))
        with nullcontext() if is_known else pytest.raises(ValueError, match="must be a whole monitor file"):
            load_sweep_monitor(path)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: _calibrated(benign_sweeps(98, 1)),
            "VLP-16, single sweeps: a false-alarm rate of 0.01 needs at least 99",
        ),
        (lambda: _calibrated([]), "must have benign scores of one group at least, got none"),
        (
            lambda: _calibrated([BenignSweep("a", VLP, np.zeros((9, SECTORS)))]),
            r"evidence must be 3 lines of 72 sectors \(crowd, change, third\), got shape",
        ),
        (
            lambda: replace(
                _monitor(), score=replace(score_by_hand(), output_offsets=np.full(2, np.nan, np.float32))
            ).report(_attacked()[0], VLP),
            "scores must be finite, got",
        ),
        (
            lambda: _monitor().report(_attacked()[0], Group("VLP-16", "posed"), kinds=KINDS),
            "must be of a calibrated group",
        ),
        (
            lambda: _monitor().require({"viewnet": "xyz"}),
            "viewnet must be that of the monitor, abc, got xyz; calibrate",
        ),
        (lambda: replace(_monitor(), benign={}), "must be of the same groups"),
        (lambda: replace(_monitor(), discovery_rate=0.0), r"discovery_rate must lie in \(0, 1\), got 0.0"),
    ],
)
def test_what_is_refused_in_one_line(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_streams_keep_their_false_alarms_an_hour_though_the_sweeps_of_a_drive_are_alike(tmp_path: Path) -> None:
    """Ten sweeps of each drive are nearly the same: bets as if they were independent fail, limits of runs hold."""
    monitor = replace(_calibrated(benign_sweeps(199, 1, each=10), rates=Rates(0.05, 0.05, 0.1)), per_hour=180.0)
    assert (monitor.runs.sweeps, len(monitor.runs.wealth)) == (10, 199)
    alarms = {"stated": 0, "of runs": 0}
    stated = EDetector.for_rate(per_hour=180.0, hz=10.0)  # one in 200 sweeps, one drive in twenty
    further = benign_sweeps(400, 3, each=10)
    for detector, name in ((stated, "stated"), (monitor.detector(), "of runs")):
        for first in range(0, len(further), 10):
            one, drive = detector.fresh(), further[first : first + 10]
            reports = [monitor.report(sweep.evidence, sweep.group, kinds=KINDS) for sweep in drive]
            alarms[name] += any(one.add(report.tail_p_value) for report in reports)
    # Standard error of a share of .05 over 199 calibration drives and 400 others: about .02.
    assert alarms["of runs"] / 400 <= 0.05 + 2 * 0.02
    assert alarms["stated"] > alarms["of runs"]
    save_sweep_monitor(monitor, tmp_path / "monitor.npz")
    again = load_sweep_monitor(tmp_path / "monitor.npz")
    assert (again.detector().limit, again.per_hour) == (monitor.detector().limit, 180.0)
    assert replace(monitor, per_hour=None).detector().limit > monitor.detector().limit, "as few as there can be"
    with pytest.raises(ValueError, match=r"^1 false alarms an hour need 1 h of benign runs, got 0.0553 h; ask for 18"):
        monitor.detector(per_hour=1.0)
    assert monitor.promises()[-1] == (
        "over time, at 10 Hz: expected false alarms at most 180 an hour, by 0.055 h of benign runs of 1 s"
    )


def test_attacked_scenes_in_a_row_leave_a_warning() -> None:
    assert _monitor().warnings == ()
    attacked = [replace(s, scene=f"late {s.scene}", evidence=s.evidence * 20) for s in benign_sweeps(60, 4)]
    warned = _calibrated(benign_sweeps(150, 1) + attacked, rates=Rates(0.05, 0.05, 0.1))
    assert warned.warnings[0].startswith("benign scenes must be exchangeable, but their scores drift")


def _leveled(number: int, *, posed: bool = True, points: int = 400) -> LeveledSweep:
    rng = np.random.default_rng(number)
    azimuth, range_m = rng.uniform(-np.pi, np.pi, points), rng.uniform(4, 30, points)
    xyz = np.column_stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), rng.uniform(-1.8, 1.0, points)])
    pose = Rigid.identity() if posed else None
    sweep = Sweep(
        xyz.astype(np.float32),
        sensor_height_m=1.8,
        t_ns=number * 100_000_000,
        world_from_sensor=pose,
        infer_sensor=False,
    )
    return level(sweep, BevGrid(40, 20.0))


def _on_history(histories: Mapping[str, int]) -> SweepMonitor:
    """Return a monitor calibrated on single sweeps, or on sweeps with history, of a sensor that has no name."""
    sweeps = []
    for name in histories:
        group = Group("unknown sensor without rings", name)  # type: ignore[arg-type]
        for scene in range(20):
            earlier = tuple(_leveled(scene * 10 + k, posed=name == "posed") for k in range(EARLIER_SWEEPS))
            monitored = MonitoredSweep(_leveled(scene * 10 + 7), earlier if name != "none" else ())
            assert group_of(monitored) == group
            evidence = np.stack([kind.measure(monitored) for kind in KINDS.values()])
            sweeps.append(BenignSweep(str(scene), group, evidence))
    return _calibrated(sweeps, rates=Rates(0.1, 0.1, 0.1))


def test_a_sweep_is_judged_with_as_much_history_as_the_monitor_was_calibrated_with() -> None:
    now, posed = _leveled(1000), tuple(_leveled(2000 + k) for k in range(7))
    blind = tuple(_leveled(2000 + k, posed=False) for k in range(7))
    alone, both = _on_history({"none": 1}), _on_history({"none": 1, "posed": 1})
    single = alone.check(MonitoredSweep(now), KINDS)
    assert single.notes == ("judged without earlier sweeps: there are 0 of 5; evidence over time abstains",)
    # Whoever knows single sweeps only, or is given too few, judges the sweep by itself.
    for monitor, earlier in ((alone, posed), (both, posed[:4]), (both, blind)):
        assert monitor.check(MonitoredSweep(now, earlier), KINDS).score == single.score
    assert "they have no poses" in both.check(MonitoredSweep(now, blind), KINDS).notes[0]
    found = both.check(MonitoredSweep(now, posed), KINDS)
    assert found.notes == ()
    assert found.score == both.check(MonitoredSweep(now, posed[2:]), KINDS).score
    with pytest.raises(ValueError, match=r"sweep must have 5 earlier sweeps with poses, .* got 2, none"):
        _on_history({"posed": 1}).check(MonitoredSweep(now, posed[:2]), KINDS)


def test_what_check_refuses() -> None:
    monitor, now = _on_history({"none": 1}), MonitoredSweep(_leveled(1))
    with pytest.raises(
        ValueError, match=r"evidence must be that of the monitor \(crowd, change, third\), got isolated"
    ):
        monitor.check(now)
    with pytest.raises(ValueError, match=r"must be calibrated on the evidence of this version, .* got 0123; calibrate"):
        replace(monitor, evidence="0123").check(now, KINDS)
    with pytest.raises(ValueError, match="must have the estimates of viewnet, got none; estimate them first"):
        replace(monitor, estimates=("viewnet",)).check(now, KINDS)
    with pytest.raises(ValueError, match="sweep must have usable returns, got none"):
        monitor.check(MonitoredSweep(_leveled(1, points=0)), KINDS)


@pytest.mark.parametrize("points", [1, SECTORS - 1])
def test_a_sweep_of_hardly_any_returns_is_never_all_fine(points: int) -> None:
    report = _monitor().check(MonitoredSweep(_leveled(1, points=points)), KINDS)
    assert report.degraded
    assert report.reasons[0] == f"too few returns to judge a sweep by: {points}, less than one in each 5° of azimuth"
