"""A look at what a preset simulates: worlds, sweeps and truths of a few samples on one sheet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.presets import Preset, preset_named
from viewshed.datasets.simulate import ScenePlan, simulate_frame, world_of
from viewshed.geometry import Rigid
from viewshed.plot_worlds import Row, differences_view, height_colors, marks, plan_view, points_view, sheet, state_view
from viewshed.sim.camera import Image, Lens, Photo, opened, photograph, to_bytes, viewpoint
from viewshed.sim.world import Snapshot, World
from viewshed.sweep import Sweep
from viewshed.truth import Truth

HEADINGS = (
    "world from above", "camera, with the sweep's returns", "sweep: height above ground", "truth: car",
    "truth: pedestrian", "who says visible, for a car",
)  # fmt: skip
_VEHICLE_LENS, _MAST_LENS, _ROBOT_LENS = Lens(-14.0), Lens(-26.0), Lens(-44.0)
_RINGS = 40
_SCENES = 500
_BEHIND_M = np.array([[-9.0, 0.0, 3.2], [-6.0, 0.0, 2.8], [-4.0, 1.0, 2.2], [-2.0, 0.0, 1.6]])
_BEHIND_MAST_M = np.array([[-3.0, 0.0, 1.5], [-1.0, 0.0, 0.5]])
_ABOVE_ROBOT_M = np.array([[-5.0, 0.0, 6.5]])


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One sample and what it was made from.

    Attributes:
        world: the world it was made in.
        agent: index of the agent that measured it.
        t_s: time in the world.
        sweep: what the sensor measured.
        truth: what it could have seen.
        known: (cells, cells) where that is known.
        title: what it is, for the reader.
    """

    world: World
    agent: int
    t_s: float
    sweep: Sweep
    truth: Truth
    known: NDArray[np.bool_]
    title: str


def preview_png(preset: str, seed: int) -> bytes:
    """Return a PNG that shows one sample of each kind of world that a preset has, with its truth.

    Moving agents and those on masts take turns where a preset has both.

    Raises:
        ValueError: there is no such preset, or the seed is out of range.
    """
    composed = replace(preset_named(preset), seed=seed)
    rows = [row_of(shot_of(scene, agent)) for scene, agent in _choice(composed)]
    return sheet(rows, HEADINGS, f"viewshed simulate {preset} --preview --seed {seed}")


def shot_of(scene: ScenePlan, agent: int) -> Shot:
    """Return the frame in the middle of a scene, as one of its agents measured it."""
    preset, world = scene.preset, world_of(scene)
    time = -(-scene.frames // preset.agents) // 2
    t_s, who = (time + 0.5) * preset.interval_s, world.agents[agent]
    frame = simulate_frame(scene, time * preset.agents + agent)
    sweep, target = frame.sweep, "pedestrian" if world.indoor else "car"
    seen = frame.truth.visible(target)[frame.known].mean()
    title = (
        f"{scene.world_kind}, {scene.conditions} · {who.name}, {who.sensor}, {sweep.sensor_height_m or 0:.1f} m up · "
        f"{len(sweep)} returns · a {target} would be seen in {seen:.0%} of the known cells"
    )
    return Shot(world, agent, t_s, sweep, frame.truth, frame.known, title)


def _choice(preset: Preset) -> list[tuple[ScenePlan, int]]:
    """Return the first scene of each kind of world, and one of its agents, moving and on masts in turn."""
    first: dict[str, ScenePlan] = {}
    for number in range(_SCENES):
        scene = ScenePlan(preset, 0, number)
        first.setdefault(scene.world_kind, scene)
    scenes = [first[kind] for kind in preset.worlds if kind in first]
    turns = [0, preset.moving] if preset.moving and preset.roadside else [0]
    return [(scene, turns[k % len(turns)]) for k, scene in enumerate(scenes)]


def row_of(shot: Shot) -> Row:
    """Return a shot as a line of pictures: above, camera, sweep, truth of both targets, other definitions."""
    world, grid = shot.world, shot.truth.grid
    snapshot = world.snapshot(shot.t_s)
    sensor = world.world_from_sensor(world.agents[shot.agent], shot.t_s)
    foot = [*sensor.translation[:2], float(world.terrain.at(sensor.translation[None])[0])]
    world_from_level = Rigid.from_yaw(sensor.yaw, foot)
    returns = sensor @ shot.sweep.points
    height_m = returns[:, 2] - world.terrain.at(returns)
    pictures = (
        plan_view(world, snapshot, world_from_level, grid),
        _camera(shot, snapshot, sensor, returns),
        points_view((world_from_level.inverse() @ returns)[:, :2], height_m, grid),
        *(state_view(shot.truth, shot.known, target) for target in ("car", "pedestrian")),
        differences_view(shot.truth, shot.known),
    )
    return Row(shot.title, marks(world, snapshot, shot.agent, (world_from_level, shot.t_s), grid), pictures)


def _camera(shot: Shot, snapshot: Snapshot, sensor: Rigid, returns: NDArray[np.float64]) -> Image:
    """Return the picture of a camera behind the sensor, with the returns that it would see."""
    mast = shot.world.agents[shot.agent].carrier is None
    ways, lens = (_BEHIND_MAST_M, _MAST_LENS) if mast else (_BEHIND_M, _VEHICLE_LENS)
    if shot.world.indoor:
        ways, lens = _ABOVE_ROBOT_M, _ROBOT_LENS
    snapshot, top_m = opened(shot.world, snapshot)
    shown = returns[_few_rings(shot.sweep)]
    shown = shown[shown[:, 2] - shot.world.terrain.at(shown) < top_m - 0.1]
    pose = viewpoint(snapshot, sensor.translation + np.array([0.0, 0.0, 0.3]), sensor.yaw, ways)
    photo = photograph(shot.world, snapshot, pose, lens)
    return _with_returns(photo, lens, pose.inverse() @ shown, shown[:, 2] - shot.world.terrain.at(shown))


def _few_rings(sweep: Sweep) -> NDArray[np.bool_]:
    """Return which returns are drawn: at most 40 rings, evenly, so that a dense sensor does not cover the picture."""
    if sweep.ring is None or len(sweep) == 0:
        return np.ones(len(sweep), np.bool_)
    return np.asarray(sweep.ring % -(-(int(sweep.ring.max()) + 1) // _RINGS) == 0)


def _with_returns(photo: Photo, lens: Lens, points: NDArray[np.float64], height_m: NDArray[np.float64]) -> Image:
    """Return the picture with a pixel for each return that nothing hides, colored by height."""
    pixels, inside = lens.project(points)
    down, across = pixels.T
    seen = inside & (np.linalg.norm(points, axis=1) < 1.02 * photo.depth_m[down, across] + 0.15)
    image = photo.image.copy()
    image[down[seen], across[seen]] = to_bytes(height_colors(height_m[seen]))
    return image
