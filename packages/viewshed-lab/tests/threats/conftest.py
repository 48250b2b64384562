"""A sweep of a VLP-16 at an asymmetric junction, with every optional column."""

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim import cast, junction


@pytest.fixture(scope="session")
def street() -> Sweep:
    sweep = cast(lidar_model("vlp16"), junction(), 1.8)
    time_s = (sweep.azimuth + np.float32(np.pi)) / np.float32(20 * np.pi)
    intensity = np.random.default_rng(5).uniform(10, 90, len(sweep)).astype(np.float32)
    pose = Rigid.from_yaw(0.5, (10.0, 20.0, 1.8))
    return sweep.replace(time_s=time_s, intensity=intensity, world_from_sensor=pose, t_ns=7, agent="a")
