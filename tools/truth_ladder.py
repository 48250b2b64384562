"""Report what keeps the shadow map from the exact truth, one step of knowledge at a time, as a table in the docs.

Usage: python tools/truth_ladder.py [OUT.md] [SAMPLES_EACH]
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed._page import facts, page, table
from viewshed._results import write_page
from viewshed.datasets.presets import preset_named
from viewshed.datasets.simulated import ScenePlan, world_of
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.height_map import NODES, HeightMap
from viewshed.fov.truth import Truth
from viewshed.fov.visibility import CAR, Beams, expected_returns
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.metrics import ConfusionCounts
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import lidar_model
from viewshed.sim.assets.shapes import REFLECTIVITY
from viewshed.sim.lidar.measurement import measure
from viewshed.sim.lidar.weather import CONDITIONS
from viewshed.sim.observe import pose_and_motion
from viewshed.sim.raycast.caster import cast_world
from viewshed.sim.raycast.scan import ExactScan
from viewshed.sim.truth.exact import exact_truth
from viewshed.sim.world import Agent, World
from viewshed.sweep import Sweep

PRESETS = ("nuscenes-small", "ugv-small", "carla-small")
_TEXT = """\
Each row gives the shadow map more of what a sensor does not tell: the exact ground instead of the estimated one; ranges
without noise and no weak return lost; and for the beams that met nothing or gave no light back where they ended. The
last row of all is the counting kernel alone (interpolated in azimuth, targets tested in range bins): what no estimator
on this kernel can pass. *Clear* leaves out the cells next to the target's number of returns. Clear weather."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One revolution and all that is known about it."""

    scan: ExactScan
    world: World
    agent: Agent
    truth: Truth
    known: NDArray[np.bool_]
    height_m: float

    def measured(self) -> Sweep:
        """Return what the sensor measures in clear weather."""
        rng = np.random.Generator(np.random.PCG64(1))
        return measure(self.scan, CONDITIONS["clear"], rng, sensor_height_m=self.height_m).sweep()

    def noise_free(self) -> Sweep:
        """Return every stop that gives light back, exactly."""
        scan, pose = self.scan, self.scan.world_from_sensor
        column, ring = np.nonzero(np.isfinite(scan.depth_m) & (REFLECTIVITY[scan.material] > 0))
        reach = scan.direction[column, ring] * scan.depth_m[column, ring, None]
        points = (scan.origin_m[column, ring] + reach) @ pose.rotation.astype(np.float32)
        return Sweep(
            points, ring=ring.astype(np.int16), model=scan.model, sensor_height_m=self.height_m, world_from_sensor=pose
        )

    def ground(self, half_m: float) -> HeightMap:
        """Return the exact ground on the lattice that estimators use."""
        pose = self.scan.world_from_sensor
        steps = (np.arange(NODES) + 0.5) * 2 * half_m / NODES - half_m
        nodes = np.stack([*np.meshgrid(steps, steps, indexing="ij"), np.zeros((NODES, NODES))], axis=-1)
        z = self.world.terrain.at(Rigid.from_yaw(pose.yaw, pose.translation) @ nodes)
        heights = (z - self.world.terrain.at(pose.translation[None])[0]).astype(np.float32)
        return HeightMap(heights, half_m, np.ones((NODES, NODES), np.bool_))

    def beams(self) -> Beams:
        """Return every beam but those on the own vehicle, up to its stop or its maximum range, seen from the sensor."""
        scan = self.scan
        keep = np.ones(scan.thing.shape, np.bool_) if self.agent.carrier is None else scan.thing != self.agent.carrier
        depth = np.minimum(scan.depth_m[keep], scan.model.max_range_m)
        stop = scan.origin_m[keep] + scan.direction[keep] * depth[:, None]
        x, y, z = (stop @ Rigid.from_yaw(scan.world_from_sensor.yaw).rotation.astype(np.float32)).T
        azimuth = np.arctan2(y, x)
        azimuth[azimuth >= np.pi] = -np.pi
        range_m = np.maximum(np.hypot(x, y), np.float32(1e-3))
        return Beams(azimuth, z / range_m, range_m)


def shots(name: str, count: int) -> Iterator[Shot]:
    """Yield revolutions of a preset, spread over its training scenes."""
    preset = preset_named(name)
    for k in range(count):
        scene = ScenePlan(preset, 0, k % preset.scenes[0])
        world, frame = world_of(scene), (k // preset.scenes[0] * 7 + k) % scene.frames
        time, number = divmod(frame, preset.agents)
        t_s, agent = (time + 0.5) * preset.interval_s, world.agents[number]
        pose, motion = pose_and_motion(world, agent, t_s, preset.revolution_s)
        scan = cast_world(world.snapshot(t_s), lidar_model(agent.sensor), pose, motion, seed=k)
        height = float(pose.translation[2] - world.terrain.at(pose.translation[None])[0])
        yield Shot(scan, world, agent, *exact_truth(scan, world, preset.grid, agent=agent), height)


def steps(shot: Shot, grid: BevGrid) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield each step's name and what it claims."""
    exact = shot.ground(grid.half_extent_m)
    leveled: LeveledSweep | None = None
    for name, sweep in (("as measured", shot.measured()), ("no noise, nothing lost", shot.noise_free())):
        leveled = level(sweep, grid)
        yield name, ShadowMap(grid).estimate(leveled).visible()
        if name == "as measured":
            for rule in ("fill", "max_range"):
                yield f"{name}, no return {rule}", ShadowMap(grid, CAR, rule).estimate(leveled).visible()
        yield f"{name}, exact ground", ShadowMap(grid).estimate(replace(leveled, ground=exact)).visible()
    for name, ground in (("every beam exact", leveled.ground if leveled else exact), ("the kernel alone", exact)):
        counts, _ = expected_returns(shot.beams(), shot.height_m, ground, grid, CAR)
        yield name, counts >= CAR.min_returns


def ladder(name: str, count: int) -> str:
    """Return the table of a preset."""
    tallies: dict[tuple[str, bool], ConfusionCounts] = defaultdict(lambda: ConfusionCounts(samples=0))
    for shot in shots(name, count):
        grid, true = shot.truth.grid, shot.truth.visible(CAR)
        gap = np.abs(shot.truth.expected_returns["car"].astype(np.int16) - CAR.min_returns)
        for step, claimed in steps(shot, grid):
            for clear in (False, True):
                among = shot.known & (gap > 2) if clear else shot.known
                tallies[step, clear] += ConfusionCounts.of(claimed, true, among, grid.cell_area_m2)
    rows = []
    for step in dict.fromkeys(key[0] for key in tallies):
        one, clear_of = tallies[step, False], tallies[step, True]
        rates = [f"{rate:.3f}" for rate in (one.precision, one.recall, one.f1)]
        rows.append([step, *rates, f"{one.over_m2:.0f}", f"{one.under_m2:.0f}", f"{clear_of.f1:.3f}"])
    return table(["shadow map given", "precision", "recall", "F1", "over m²", "under m²", "F1, clear"], rows)


def report(count: int) -> str:
    """Return the page."""
    parts = [part for name in PRESETS for part in (f"## {name}", ladder(name, count))]
    return page("What keeps the shadow map from the truth", facts(target="car", samples=f"{count} each"), _TEXT, *parts)


if __name__ == "__main__":
    text = report(int(sys.argv[2]) if len(sys.argv) > 2 else 40)
    if len(sys.argv) > 1:
        write_page(Path(sys.argv[1]), text)
    else:
        print(text)
