"""A simulated, asymmetric drive past objects over uneven ground."""

from dataclasses import dataclass

import numpy as np

from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan, Motion
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import Thing, World

GRID = BevGrid(96, 32.0)
SPEED_MPS, YAW, YAW_RATE, STEP_S, HEIGHT_M = 8.0, 0.7, 0.15, 0.5, 1.1
TERRAIN = Terrain.of(
    np.linspace(-120, 120, 121), np.linspace(-120, 120, 121), lambda x, y: 0.5 * np.sin(x / 14) + 0.03 * y
)
THINGS = (
    Thing("wall", (Box(0, 0, 0.6, 14, 4),), 11, 4, 0.2), Thing("car", (Box(0, 0, 4.2, 1.8, 1.5),), -7, 5, 0.7),
    Thing("black car", (Box(0, 0, 4.2, 1.8, 1.5, material="absorber"),), 6, -7, 2.0),
    Thing("house", (Box(0, 0, 9, 12, 6),), -18, -9, 0.3),
)  # fmt: skip
WORLD = World("test", TERRAIN, THINGS)
MODEL = LidarModel("test", np.deg2rad(np.linspace(-24, 6, 40)), 720, np.deg2rad(np.linspace(-0.1, 0.15, 40)))


@dataclass(frozen=True, eq=False)
class Shot:
    """One revolution: exact scan, measured sweep, and the truth of what the sensor could have seen."""

    scan: ExactScan
    sweep: Sweep
    truth: Truth
    known: np.ndarray


def pose_at(t_s: float) -> Rigid:
    """Return the pose at a time: a slow left turn, the sensor upright over the ground."""
    yaw = YAW + YAW_RATE * t_s
    x = (np.sin(yaw) - np.sin(YAW)) * SPEED_MPS / YAW_RATE
    y = -(np.cos(yaw) - np.cos(YAW)) * SPEED_MPS / YAW_RATE
    z = float(TERRAIN.at(np.array([[x, y]]))[0]) + HEIGHT_M
    return Rigid.from_yaw(yaw, (x, y, z))


def shot_at(number: int) -> Shot:
    """Return the revolution with a number; number 0 is at the origin."""
    t_s = number * STEP_S
    pose, before, after = pose_at(t_s), pose_at(t_s - 0.05), pose_at(t_s + 0.05)
    vx, vy, vz = (after.translation - before.translation) / 0.1
    scan = cast_world(WORLD.snapshot(t_s), MODEL, pose, Motion((vx, vy, vz), YAW_RATE, 0.1), 7)
    rng = np.random.default_rng(number + 50)
    t_ns = round((t_s + 10) * 1e9)
    sweep = measure(scan, CONDITIONS["clear"], rng, sensor_height_m=HEIGHT_M, t_ns=t_ns).sweep()
    return Shot(scan, sweep, *exact_truth(scan, WORLD, GRID))
