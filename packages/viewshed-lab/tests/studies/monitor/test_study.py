"""The study of alarms: streams with attacks that branch off, rates with intervals, traces from archives."""

import re
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from viewshed import GRIDS, Sweep, write_sweep
from viewshed.monitor import Calibration, StreamMonitor
from viewshed.monitor.evidence import EVIDENCE, SECTORS
from viewshed.preprocess.leveling import level
from viewshed.sensors import LidarModel
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.studies.monitor.page import _exceeded, files_of, judge, rate_interval, trace_page
from viewshed_lab.studies.monitor.plan import MonitorPlan
from viewshed_lab.studies.monitor.streams import (
    ATTACKED_SWEEPS,
    Stream,
    StreamEvidence,
    measure_stream,
    read_streams,
    run_streams,
)
from viewshed_lab.studies.monitor.traces import call_trace
from viewshed_lab.studies.monitor.tried import mixed_pixels, tried
from viewshed_lab.studies.store import bind

PLAN = replace(
    MonitorPlan.load("shipped"), seconds=3.0, attack_every_s=1.2, attacks=("blinded", "pose_spoof"),
    conditions=("clear",),
)  # fmt: skip


def test_the_plan_shares_no_style_and_names_each_stream_once() -> None:
    plan = MonitorPlan.load("shipped")
    keys = plan.job_keys()
    assert len(set(keys)) == len(keys) == 45 * len(plan.calibration) + (8 + 45) * len(plan.report)
    calibration, first = keys[: 45 * len(plan.calibration)], keys[45 * len(plan.calibration) :][: 2 * len(plan.report)]
    assert {part for part, _, _ in calibration} == {"calibration"}
    assert {(part, number) for part, _, number in first} == {("report", "0"), ("benign", "0")}
    with pytest.raises(ValueError, match="must share no style, got street in both"):
        replace(plan, report=(*plan.report, "street"))


@pytest.mark.slow
def test_a_stream_is_measured_attacked_judged_and_kept(tmp_path: Path) -> None:
    found = measure_stream(Stream(PLAN, "report", "parking", 0))
    assert found.benign.shape == (30, len(EVIDENCE), SECTORS)
    assert found.attacked.shape == (len(found.cases), ATTACKED_SWEEPS, len(EVIDENCE), SECTORS)
    assert [first for _, first in found.cases] == [11, 11, 23, 23]
    again = measure_stream(Stream(PLAN, "report", "parking", 0))
    assert_array_equal(found.benign, again.benign)
    found.save(tmp_path / "one.npz")
    kept = StreamEvidence.load(tmp_path / "one.npz")
    assert (kept.cases, kept.facts, kept.style) == (found.cases, found.facts, "parking")
    rng = np.random.default_rng(0)
    benign = [rng.exponential(1.0, (700, len(EVIDENCE), SECTORS)).astype(np.float32) for _ in range(2)]
    made = Calibration.fit(benign, 10.0)
    judged = judge(made, kept)
    blinded = [judged.attacked[k] for k, (name, _) in enumerate(kept.cases) if name == "blinded"]
    returns = list(EVIDENCE).index("returns")
    assert min(float(one[:, returns].min()) for one in blinded) > 3.0
    text = files_of(PLAN, made, [kept], [kept], [], {"removal": (3, 0.5, 0.0)})["monitor.md"].decode()
    assert "| parking | 0.1 |" in text
    assert "| pose_spoof | 2 |" in text
    area = re.search(r"\| mean of the attacks \|  \| (\d\.\d{3}) \|", text)
    assert area is not None
    assert f"| onset AUROC by style |  | {area[1]} to {area[1]} |" in text
    assert "| removal | 3 | 0.50 | 0.00 |" in text


def test_only_streams_of_the_plan_are_read_and_another_plan_is_refused(tmp_path: Path) -> None:
    plan, none = MonitorPlan.load("tiny"), np.zeros((0, len(EVIDENCE), SECTORS), np.float32)

    def made(name: str) -> None:
        one = StreamEvidence(name, "rooms", {}, none, (), none[:, None], np.zeros(0, np.bool_), {})
        one.save(tmp_path / f"{name}.npz")

    made("calibration-rooms-00")
    with pytest.raises(ValueError, match="got those of an unknown plan; give another --out or delete it"):
        list(read_streams(plan, tmp_path, "calibration"))
    (tmp_path / "calibration-rooms-00.npz").unlink()
    small = replace(plan, calibration_streams=1, calibration=("rooms",), report=("hall",), benign_streams=0)
    bind(tmp_path, small.to_json())
    for name in ("calibration-rooms-00", "calibration-rooms-01", "calibration-street-00"):
        made(name)
    assert [one.name for one in read_streams(small, tmp_path, "calibration")] == ["calibration-rooms-00"]
    for refused in (read_streams(plan, tmp_path, "report"), run_streams(plan, tmp_path, LocalEngine(1))):
        with pytest.raises(ValueError, match=r"got another plan \(calibration .*; give another --out or delete it"):
            list(refused)


def test_groups_with_more_alarms_than_their_limit_is_for_are_named() -> None:
    calm, rough = ({1.0: alarms, 6.0: alarms, 10.0: 0, "hours": 1.0} for alarms in (1, 7))
    lines = _exceeded([("calm", pd.DataFrame([calm])), ("rough", pd.DataFrame([rough]))]).splitlines()
    # Garwood's interval of seven counts.
    assert lines[1] == "- at a limit of 6 an hour: rough 7.0 [2.8, 14.4]"
    assert lines[0].startswith("- at a limit of 1 an hour: rough")
    assert lines[2].endswith("none")


@pytest.mark.slow
def test_spoofers_fire_when_the_sensor_points_there_and_mixed_pixels_are_counted_by_hand() -> None:
    found = tried(replace(MonitorPlan.load("shipped"), attacks=("ghost_car", "removal", "relay", "drift")))
    assert set(found) == {"ghost_car", "removal", "relay"}
    assert [late for _, _, late in found.values()] == [0.0] * 3
    assert min(cases for cases, _, _ in found.values()) >= 9
    # A wall at 5 m before one at 7 m: of the five beams at its edges one returns between; each counts in three sectors.
    azimuth, rings = np.deg2rad(np.arange(-179.5, 180.0)), np.arange(4)
    range_m = np.where(np.abs(azimuth) < 0.5, 5.0, 7.0)
    range_m[np.argmin(np.abs(azimuth - 0.5))] = 6.0
    points = np.column_stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), np.zeros(360)])
    every = np.concatenate([points + np.array([0.0, 0.0, 0.1 * ring]) for ring in rings])
    model = LidarModel("by hand", np.arctan(0.1 * rings / 6.0), azimuth_columns=360)
    sweep = Sweep(every, ring=np.repeat(rings, 360), model=model)
    counts = mixed_pixels(level(sweep, GRIDS["road"]))
    assert counts is not None
    edges, between = counts
    assert edges.sum() == 3 * 4 * 5
    assert between.sum() == 3 * 4


def test_intervals_of_rates_are_those_of_poisson_counts() -> None:
    # The rule of three, and the textbook's interval of ten counts.
    assert rate_interval(0, 1.0) == pytest.approx((0.0, 3.69), abs=0.01)
    assert rate_interval(10, 2.0) == pytest.approx((4.80 / 2, 18.39 / 2), abs=0.01)


def test_a_trace_is_read_in_the_order_of_its_numbers_and_a_blinded_sweep_called(tmp_path: Path) -> None:
    rng, folder = np.random.default_rng(0), tmp_path / "3-noise"
    folder.mkdir()
    azimuth = rng.uniform(-np.pi, np.pi, 4000)
    world = np.column_stack([9.0 * np.cos(azimuth), 9.0 * np.sin(azimuth), rng.uniform(-1.5, 2.0, 4000)])
    for number in range(1, 13):
        points = rng.normal(0.0, 0.05, (4000, 3)) if number == 10 else world
        write_sweep(Sweep(points.astype(np.float32)), folder / f"{number}.pcd")
    archive = tmp_path / "noise.tar.xz"
    with tarfile.open(archive, "w:xz") as packed:
        packed.add(folder, "3-noise")
    called = call_trace(archive, StreamMonitor())
    assert [one.number for one in called] == list(range(1, 13))
    assert [one.number for one in called if one.inconsistent] == [10]
    assert "within 0.7 m" in called[9].reason or "usable returns" in called[9].reason
    page = trace_page(called, 5.0, 6.0)
    assert "   10  p" in page
    assert "Allenpandas" in page
    # As a folder under another name, with names that are no numbers: in natural order, without a key and with one.
    other = folder.rename(tmp_path / "mine")
    for number in range(1, 13):
        (other / f"{number}.pcd").rename(other / f"sweep_{number}.pcd")
    unseen = call_trace(other, StreamMonitor())
    assert [one.number for one in unseen if one.inconsistent] == [9]
    assert {one.is_spoofed for one in unseen} == {None}
    page = trace_page(unseen, 5.0, 6.0)
    assert "| mine | no key |  | 1 of 12 | 16715 |" in page
    assert "Allenpandas" not in page
    keyed = call_trace(other, StreamMonitor(), key=(7, 9, 11))
    assert [one.number for one in keyed if one.is_spoofed] == [7, 9, 11]
    assert "| mine | 1 of 3 | 2, 0, missed | 0 of 9 |" in trace_page(keyed, 5.0, 6.0)
    with pytest.raises(ValueError, match=r"--key must be numbers of sweeps of \S+mine, got 99, which is none of them"):
        call_trace(other, StreamMonitor(), key=(7, 99))
    no_archive = tmp_path / "text.tar.xz"
    no_archive.write_text("text")
    with pytest.raises(ValueError, match=r"text\.tar\.xz must be a \.tar\.xz of PCD files, or a folder of them, got"):
        call_trace(no_archive, StreamMonitor())
    empty = tmp_path / "none.tar.xz"
    with tarfile.open(empty, "w:xz"):
        pass
    with pytest.raises(ValueError, match="must hold one PCD file per sweep, got none"):
        call_trace(empty, StreamMonitor())
