"""Short drives past boxes that appear, jump or move in a known way."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from viewshed import BevGrid
from viewshed.geometry import Rigid
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim import Box, Scene, cast

GRID = BevGrid(64, 64.0)
HEIGHT_M = 1.8
INTERVAL_NS = 100_000_000

# A yard: walls at y = 14 and y = -11, and at both ends; two different huts.
YARD = (
    Box(0.0, 14.5, 100.0, 1.0, 9.0),
    Box(0.0, -11.5, 100.0, 1.0, 9.0),
    Box(40.5, 0.0, 1.0, 40.0, 9.0),
    Box(-35.5, 0.0, 1.0, 40.0, 9.0),
    Box(-12.0, 9.0, 3.0, 2.0, 4.0),
    Box(-18.0, -7.0, 2.0, 4.0, 4.0),
)

# A plate across the road, 4 m wide and 1.5 m high, 10 m ahead: y from -1 to 3.
PLATE = Box(10.05, 1.0, 0.1, 4.0, 1.5)


def look(
    boxes: Sequence[Box], number: int = 0, x_m: float = 0.0, rng: np.random.Generator | None = None, yaw: float = 0.0
) -> Sweep:
    """Return the sweep of an HDL-32E at (x_m, 0), rotated by ``yaw``, with its pose and time."""
    c, s = np.cos(-yaw), np.sin(-yaw)
    seen = []
    for box in boxes:
        x, y = box.x_m - x_m, box.y_m
        around = Box(c * x - s * y, s * x + c * y, box.length_m, box.width_m, box.top_m, box.bottom_m, box.yaw - yaw)
        seen.append(around)
    sweep = cast(lidar_model("hdl32e"), Scene(tuple(seen)), HEIGHT_M, rng=rng)
    return sweep.replace(world_from_sensor=Rigid.from_yaw(yaw, (x_m, 0.0, HEIGHT_M)), t_ns=number * INTERVAL_NS)


def leveled(sweep: Sweep) -> LeveledSweep:
    """Return a sweep leveled on the grid of all tests."""
    return level(sweep, GRID)


def measure(name: str, *sweeps: Sweep) -> NDArray[np.float32]:
    """Return the named evidence (SECTORS,) for the last of the sweeps."""
    *earlier, now = map(leveled, sweeps)
    result = EVIDENCE[name].measure(MonitoredSweep(now, tuple(earlier)))
    assert result.shape == (SECTORS,)
    assert result.dtype == np.float32
    return result


def sector_at(degrees: float) -> int:
    """Return the sector of an azimuth."""
    return int((degrees + 180.0) // 5.0)
