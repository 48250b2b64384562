"""What a writer puts down, its reader gets back: sweeps made by hypothesis."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from viewshed import LidarModel, Rigid, Sweep
from viewshed.io import read_sweep, write_sweep
from viewshed.sweep import PlanarScan

FLOATS = st.floats(-200, 200, width=32)
ANGLES = st.floats(-6.25, 6.25, width=32)
RANGES = st.floats(0.5, np.inf)


@st.composite
def sweeps(draw: st.DrawFn) -> Sweep:
    count = draw(st.integers(1, 20))
    column = hnp.arrays(np.float32, count, elements=FLOATS)
    maybe = st.one_of(st.none(), column)
    angle = st.one_of(st.none(), hnp.arrays(np.float32, count, elements=ANGLES))
    time_s = st.one_of(st.none(), hnp.arrays(np.float32, count, elements=st.floats(-2, 2, width=32)))
    yaw = draw(st.floats(-3, 3))
    model = LidarModel("a b", np.linspace(-0.4, 0.1, 32), 1800, azimuth_offset=np.linspace(0, 0.1, 32), source="ours")
    if draw(st.booleans()):
        shots = np.stack(np.broadcast_arrays(model.azimuth_step * np.arange(1800)[:, None], model.elevation), axis=-1)
        shots[600:] = np.nan  # a field of 120 degrees
        model = replace(model, shots=shots, inferred=False)
    return Sweep(
        draw(hnp.arrays(np.float32, (count, 3), elements=FLOATS)),
        draw(maybe),
        draw(st.one_of(st.none(), hnp.arrays(np.int16, count, elements=st.integers(0, 31)))),
        draw(angle),
        draw(time_s),
        draw(st.one_of(st.none(), st.integers(-(2**63), 2**63 - 1))),
        attitude=np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]) if draw(st.booleans()) else None,
        sensor_height_m=draw(st.one_of(st.none(), st.floats(0.1, 10))),
        world_from_sensor=Rigid.from_yaw(yaw, (1.0, -2.0, 3.0)) if draw(st.booleans()) else None,
        model=model if draw(st.booleans()) else None,
        agent=draw(st.sampled_from(["ego", "car 2", "Übersicht"])),
        dropped_points=draw(st.integers(0, 5)),
        infer_sensor=draw(st.booleans()),
        vehicle_yaw=draw(st.one_of(st.none(), st.floats(-3, 3))),
        planar=draw(st.one_of(st.none(), st.builds(PlanarScan, hnp.arrays(np.float32, 3, elements=ANGLES), RANGES))),
        pose_covariance=np.diag(np.arange(6.0)) if draw(st.booleans()) else None,
    )


def same(first: Any, second: Any) -> bool:
    if first is None or second is None:
        return first is second
    return bool(np.array_equal(first, second))


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(sweep=sweeps())
@pytest.mark.parametrize("suffix", [".npz", ".npz.gz"])
def test_npz_keeps_everything(suffix: str, sweep: Sweep, tmp_path: Path) -> None:
    write_sweep(sweep, tmp_path / f"a{suffix}")
    back = read_sweep(tmp_path / f"a{suffix}")
    for name in ("points", "intensity", "ring", "azimuth", "time_s", "attitude", "pose_covariance"):
        assert same(getattr(sweep, name), getattr(back, name)), name
    for name in ("t_ns", "sensor_height_m", "agent", "dropped_points", "infer_sensor", "vehicle_yaw"):
        assert getattr(sweep, name) == getattr(back, name), name
    assert (sweep.world_from_sensor is None) == (back.world_from_sensor is None)
    if sweep.world_from_sensor is not None and back.world_from_sensor is not None:
        assert same(sweep.world_from_sensor.as_matrix(), back.world_from_sensor.as_matrix())
    assert (sweep.planar is None) == (back.planar is None)
    if sweep.planar is not None and back.planar is not None:
        assert same(sweep.planar.open_azimuth, back.planar.open_azimuth)
        assert sweep.planar.max_range_m == back.planar.max_range_m
    assert (sweep.model is None) == (back.model is None)
    if sweep.model is not None and back.model is not None:
        for name in (
            "name",
            "elevation",
            "azimuth_columns",
            "azimuth_offset",
            "origin_m",
            "min_range_m",
            "source",
            "inferred",
        ):
            assert same(getattr(sweep.model, name), getattr(back.model, name)), name
        assert same(sweep.model.fired, back.model.fired)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(sweep=sweeps())
@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".pcd.gz"])
def test_pcd_and_ply_keep_every_column(suffix: str, sweep: Sweep, tmp_path: Path) -> None:
    write_sweep(sweep, tmp_path / f"a{suffix}")
    back = read_sweep(tmp_path / f"a{suffix}")
    for name in ("points", "intensity", "ring", "azimuth", "time_s"):
        assert same(getattr(sweep, name), getattr(back, name)), name


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(sweep=sweeps())
def test_rows_keep_points_and_intensity(sweep: Sweep, tmp_path: Path) -> None:
    wanted = np.zeros(len(sweep), np.float32) if sweep.intensity is None else sweep.intensity
    for name in ("a.bin", "a.npy"):
        write_sweep(sweep, tmp_path / name)
        back = read_sweep(tmp_path / name, format={"bin": "kitti", "npy": "npy"}[name[-3:]])
        assert same(sweep.points, back.points)
        assert (back.intensity is None and name == "a.npy") or same(wanted, back.intensity)
    if sweep.ring is not None:
        write_sweep(sweep, tmp_path / "a.pcd.bin")
        back = read_sweep(tmp_path / "a.pcd.bin")
        assert same(sweep.points, back.points)
        assert same(sweep.ring, back.ring)
        assert same(wanted, back.intensity)


def test_written_files_replace_the_old_one_and_leave_nothing_else(tmp_path: Path) -> None:
    for name in ("a.bin", "a.bin"):
        write_sweep(Sweep(np.ones((3, 3), np.float32)), tmp_path / name)
    assert [file.name for file in tmp_path.iterdir()] == ["a.bin"]
    with pytest.raises(ValueError, match="a sweep without ring cannot be written as nuScenes"):
        write_sweep(Sweep(np.ones((3, 3), np.float32)), tmp_path / "b.pcd.bin")
    with pytest.raises(ValueError, match=r"b\.feather: format is not known from the name"):
        write_sweep(Sweep(np.ones((3, 3), np.float32)), tmp_path / "b.feather")
    with pytest.raises(ValueError, match=r"format must be one of .* to write, got 'ouster'"):
        write_sweep(Sweep(np.ones((3, 3), np.float32)), tmp_path / "b.pcap", format="ouster")
    assert [file.name for file in tmp_path.iterdir()] == ["a.bin"]
