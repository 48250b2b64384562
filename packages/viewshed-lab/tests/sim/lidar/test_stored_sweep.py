"""Range images become sweeps: every point where its beam says, motion undone."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim.oracle import firing

from viewshed.geometry import Rigid
from viewshed.sensors import lidar_model
from viewshed_lab.sim.lidar.firing import column_poses, still_firing
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.raycast.scan import STILL, Motion

MODEL = replace(lidar_model("os1_32g"), azimuth_columns=360)
POSE = Rigid.from_yaw(0.7, (4.0, -1.0, 1.8))
MOTION = Motion((9.0, -2.0, 0.5), 0.6, 0.1)


def image(motion: Motion = STILL) -> StoredSweep:
    rng = np.random.default_rng(3)
    steps = rng.integers(0, 20_000, (360, 32)).astype(np.uint16) * (rng.random((360, 32)) < 0.7)
    level = (steps % 255 + 1).astype(np.uint8) * (steps > 0)
    return StoredSweep(MODEL, steps.astype(np.uint16), level.astype(np.uint8), 0.002, POSE, motion, 1.8, 12, "robot")


def test_motion_is_undone_in_world_axes() -> None:
    """A wall point seen by a moving sensor, computed in the world, comes back in the reference frame."""
    one = image(MOTION)
    sweep = one.sweep()
    column, ring = np.nonzero(one.steps)
    k = 1234
    time_s = ((column[k] + 0.5) / 360 - 0.5) * 0.1
    at = Rigid.from_yaw(0.7 + 0.6 * time_s, POSE.translation + np.array([9.0, -2.0, 0.5]) * time_s)
    azimuth = np.deg2rad(-180 + column[k] + 0.5) + MODEL.azimuth_offset[ring[k]]
    elevation, along = MODEL.elevation[ring[k]], one.steps[column[k], ring[k]] * 0.002
    ray = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    local = along * ray + np.array([0.0, 0.0, MODEL.origin_m[ring[k]]])
    expected = POSE.inverse() @ (at @ local[None, :])
    assert sweep.points[k] == pytest.approx(expected[0], abs=2e-4)
    assert sweep.time_s[k] == pytest.approx(time_s + MOTION.period_s / 2, abs=1e-6)


@pytest.mark.parametrize("motion", [STILL, MOTION, Motion((9.0, -2.0, 0.5), 0.0, 0.1)])
def test_firing_starts_and_points_where_the_returns_are(motion: Motion) -> None:
    one = image(motion)
    start, direction, time_s = firing(MODEL, motion, POSE)
    column, ring = np.nonzero(one.steps)
    along = (one.steps[column, ring] * 0.002)[:, None]
    sweep = one.sweep()
    assert np.abs(start[column, ring] + direction[column, ring] * along - sweep.points).max() < 1e-4
    assert np.abs(np.linalg.norm(direction, axis=2) - 1).max() < 1e-6
    assert sweep.time_s is not None
    assert sweep.time_s == pytest.approx(time_s[column] + motion.period_s / 2, abs=1e-7)
    shared = (*still_firing(MODEL), *column_poses(MODEL, motion, POSE))
    assert not any(part.flags.writeable for part in shared)
