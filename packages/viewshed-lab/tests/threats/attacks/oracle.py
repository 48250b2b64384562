"""The beam model as an oracle: which rules an attacked sweep violates, by the simulator's own beams.

It uses nothing of :mod:`viewshed_lab.threats.attacks` except the record of the attack: pixels come from the range
image, beams from the motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tests.sim.oracle import firing

from viewshed import GRIDS, WORLDS, Sweep, lidar_model
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.observe import pose_and_motion
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.threats.attacks import Tampered

ON_BEAM_M = 0.001
COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")
SEEN_IN = (
    ("junction", "hdl32e", 240, 0.1, 3.0),
    ("highway", "os1_32", 128, 0.1, 2.0),
    ("street", "vlp32c", 180, 0.0, 4.0),
    ("parking", "vlp16", 360, 0.05, 1.0),
    ("rooms", "vlp16", 300, 0.1, 2.0),
)
"""World, sensor, columns (a third on masts), period of a revolution, time."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A simulated sweep and the pixels that it came from."""

    name: str  # world, agent and sensor
    image: StoredSweep  # the range image
    sweep: Sweep  # of that range image
    earlier: Sweep  # the sweep of the same agent half a second before
    half_extent_m: float  # of the grid: indoor or road

    def again(self) -> Sweep:
        """Return an equal sweep that shares no memory with this one, so that nothing cached for this one applies."""
        return self.sweep.replace(
            **{name: None if (value := getattr(self.sweep, name)) is None else value.copy() for name in COLUMNS}
        )


def scenes(seen_in: Sequence[tuple[str, str, int, float, float]] = SEEN_IN) -> list[Scene]:
    """Return small scenes: sensors on vehicles, robots and tilted masts, at rest and in motion."""
    return [scene for number, row in enumerate(seen_in) for scene in _scenes(number, *row)]


def _scenes(number: int, world_name: str, sensor: str, columns: int, period_s: float, t_s: float) -> Iterator[Scene]:
    rng = np.random.Generator(np.random.PCG64(100 + number))
    plan = AgentPlan(1, 1, sensor=sensor, sensor_height_m=0.6 if world_name == "rooms" else 1.84)
    world = WORLDS[world_name](rng, plan)
    for agent in world.agents:
        model = replace(lidar_model(agent.sensor), azimuth_columns=columns // (3 if agent.carrier is None else 1))
        images = []
        for time_s in (t_s - 0.5, t_s):
            pose, motion = pose_and_motion(world, agent, time_s, period_s)
            scan = cast_world(world.snapshot(time_s), model, pose, motion, number)
            images.append(measure(scan, CONDITIONS["clear"], rng, t_ns=round(time_s * 1e9), agent=agent.name))
        earlier, image = images
        half_m = GRIDS["indoor" if world.indoor else "road"].half_extent_m
        name = f"{world_name} {agent.name} {model.name}"
        yield Scene(name, image, image.sweep(), earlier.sweep(), half_m)


def broken_by_any(clean: Sweep, tampered: Tampered, budget: int | None) -> list[str]:
    """Return the rules for every attack that this one violates; ``budget`` counts added returns."""
    found = []
    kept, left = ~tampered.added, ~tampered.removed
    for name in COLUMNS:
        before, after = getattr(clean, name), getattr(tampered.sweep, name)
        if (before is None) != (after is None):
            found.append(f"column {name} appeared or vanished")
        elif before is not None and before[left].tobytes() != after[kept].tobytes():
            found.append(f"{name} of untouched rows changed")
    if budget is not None and int(tampered.added.sum()) > budget:
        found.append(f"{int(tampered.added.sum())} returns added with a budget of {budget}")
    before, after = clean.intensity, tampered.sweep.intensity
    if before is not None and after is not None and not set(after[tampered.added]) <= set(before):
        found.append("an intensity that the sweep has not")
    return found


def broken_on_beams(scene: Scene, tampered: Tampered, budget: int | None) -> list[str]:
    """Return the rules of the beam model that an attack violates; ``budget`` counts changed beams."""
    found = broken_by_any(scene.sweep, tampered, None)
    if tampered.wedge is None:
        return [*found, "no wedge"] if tampered.added.any() or tampered.removed.any() else found
    new, gone = tampered.sweep.points[tampered.added], scene.sweep.points[tampered.removed]
    for what, points in (("added", new), ("removed", gone)):
        if not tampered.wedge.holds(np.arctan2(points[:, 1], points[:, 0])).all():
            found.append(f"a return {what} outside the wedge")
    was_column, was_ring = np.nonzero(scene.image.steps)
    column, ring, off_m, depth_m, late_s = beams_of(scene, tampered)
    if len(new) and off_m.max() > ON_BEAM_M:
        found.append(f"a return {off_m.max():.4f} m beside its beam")
    if len(new) and np.abs(late_s).max() > 1e-6:
        found.append(f"a return {late_s.max():.6f} s off its column")
    model = scene.image.model
    if len(new) and not ((depth_m > model.min_range_m - 0.003) & (depth_m < model.max_range_m + 0.003)).all():
        found.append("a range that the sensor does not report")
    return found + _broken_pixels(scene, tampered, budget, (was_column, was_ring), (column, ring))


def _broken_pixels(
    scene: Scene,
    tampered: Tampered,
    budget: int | None,
    was: tuple[NDArray[np.intp], NDArray[np.intp]],
    made: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> list[str]:
    rings = scene.image.model.rings
    clean, new = was[0] * rings + was[1], made[0] * rings + made[1]
    now = np.zeros(len(tampered.sweep), np.int64)
    now[~tampered.added], now[tampered.added] = clean[~tampered.removed], new
    found = []
    if len(np.unique(now)) < len(now):
        found.append("two returns of one beam")
    if (np.diff(now) < 0).any():
        found.append("rows out of firing order")
    touched = len(np.union1d(clean[tampered.removed], new))
    if budget is not None and touched > budget:
        found.append(f"{touched} beams touched with a budget of {budget}")
    return found


def beams_of(
    scene: Scene, tampered: Tampered
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return column, ring, distance beside the beam, depth and error in time of each return added (A,)."""
    image, made = scene.image, tampered.added
    starts, directions, time_s = firing(image.model, image.motion, image.world_from_sensor)
    points = tampered.sweep.points[made].astype(np.float64)
    ring, at_s = tampered.sweep.ring[made].astype(np.intp), tampered.sweep.time_s[made]
    column = columns_of(image, points, ring, at_s)
    reach = points - starts[column, ring]
    way = directions[column, ring].astype(np.float64)
    depth_m = (reach * way).sum(axis=1)
    off_m = np.linalg.norm(reach - depth_m[:, None] * way, axis=1)
    late_s = at_s - time_s[column] - image.motion.period_s / 2
    return column, ring, off_m, depth_m, late_s.astype(np.float64)


def columns_of(
    image: StoredSweep, points: NDArray[np.float64], ring: NDArray[np.intp], at_s: NDArray[np.float32]
) -> NDArray[np.intp]:
    """Return the columns (A,): by time if the sensor rotates, else by azimuth."""
    columns, period_s = image.model.azimuth_columns, image.motion.period_s
    if period_s > 0:
        by_time: NDArray[np.intp] = np.rint(at_s / period_s * columns - 0.5).astype(np.intp)
        return by_time
    azimuth = np.arctan2(points[:, 1], points[:, 0]) - image.model.azimuth_offset[ring] + np.pi
    by_azimuth: NDArray[np.intp] = np.rint(azimuth / image.model.azimuth_step - 0.5).astype(np.intp) % columns
    return by_azimuth
