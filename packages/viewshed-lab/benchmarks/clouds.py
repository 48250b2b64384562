"""Sweeps for benchmarks: a street junction measured by two sensors, with the fields of a typical file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from viewshed.io import read_sweep
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim import cast, junction

SENSORS = {"35k": ("HDL-32E", 35_000), "120k": ("HDL-64E", 120_000)}
SENSOR_HEIGHT_M = 1.8


def synthetic(size: str, rng: np.random.Generator) -> Sweep:
    """Return a sweep of about ``size`` points with rings, but without azimuth, attitude or height (estimated then)."""
    sensor, points = SENSORS[size]
    model = lidar_model(sensor)
    trial = cast(model, junction(), SENSOR_HEIGHT_M)
    columns = round(model.azimuth_columns * points / len(trial))
    sweep = cast(replace(model, azimuth_columns=columns), junction(), SENSOR_HEIGHT_M, rng=rng)
    return sweep.replace(azimuth=None, attitude=None, sensor_height_m=None)


def real() -> dict[str, Sweep]:
    """Return a nuScenes and a KITTI sweep by size, from the folder in VIEWSHED_REAL_DATA; none if it is not set."""
    folder = os.environ.get("VIEWSHED_REAL_DATA")
    if not folder:
        return {}
    files = {"35k": "nuscenes/*.pcd.bin", "120k": "kitti/odometry00/*.bin"}
    return {size: read_sweep(min(Path(folder).glob(pattern))) for size, pattern in files.items()}


def write_nuscenes(sweep: Sweep, path: Path) -> Path:
    """Write the columns x, y, z, intensity, ring (file axes: x right, y forward) as float32 and return the path."""
    ring = np.zeros(len(sweep)) if sweep.ring is None else sweep.ring
    x, y, z = sweep.points.T
    np.stack([-y, x, z, np.zeros_like(x), ring], axis=1).astype(np.float32).tofile(path)
    return path


def write_kitti(sweep: Sweep, path: Path) -> Path:
    """Write the columns x, y, z, reflectance as float32 and return the path."""
    table = np.zeros((len(sweep), 4), np.float32)
    table[:, :3] = sweep.points
    table.tofile(path)
    return path
