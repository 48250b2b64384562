"""Preview of a preset: worlds, sweeps and truths of a few simulated samples in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from viewshed.arrays import F32, F64
from viewshed.fov.estimate import CellState
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.show.plot import COLORS, HEIGHTS_M, WORDS
from viewshed.sweep import Sweep
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame, world_of
from viewshed_lab.sim.assets.shapes import BOX, MATERIALS
from viewshed_lab.sim.colors import surface_colors, without_ceiling
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import GROUND, Snapshot, World
from viewshed_lab.studies.figures import png_of

SIDE = 256
"""Pixels per side of a view from above."""

DIFFERENCES = {
    "nobody": (0.42, 0.42, 0.47),
    "probe (ours) and first_blocker": (0.62, 0.82, 0.95),
    "probe, not first_blocker": (0.0, 0.45, 0.70),
    "farthest, not probe": (0.84, 0.37, 0.0),
    "line_of_sight only": (0.94, 0.89, 0.26),
}
"""Colors by which definitions call a cell visible for a car; `probe` is the project's own definition."""

NOT_KNOWN = (1.0, 0.94, 0.78)
"""Color of cells without truth."""

HEADINGS = (
    "world from above", "sweep: height above ground", "truth: car", "truth: pedestrian", "who says visible, for a car",
)  # fmt: skip

_SCENES = 500  # scenes that are searched for each kind of world

_INCHES = 2.6
"""Side of one view."""


def plan_view(world: World, snapshot: Snapshot, world_from_level: Rigid, grid: BevGrid) -> F32:
    """Return the colors (SIDE, SIDE, 3) of the world from above, higher solids on top of lower ones."""
    fine = BevGrid(SIDE, grid.half_extent_m, grid.offset_m)
    xy = (world_from_level @ np.dstack([fine.centers, np.zeros(fine.shape)]))[..., :2]
    image = _ground_colors(world.terrain, xy, fine.cell_m, world_from_level.yaw)
    snapshot = without_ceiling(world, snapshot)
    height_m = snapshot.center_m[:, 2] - world.terrain.at(snapshot.center_m[:, :2])
    half_height = (np.abs(snapshot.rotation[:, 2]) * snapshot.half_m).sum(axis=1)
    colors = surface_colors(world, snapshot.thing, snapshot.material)
    light = 0.75 + 0.35 * np.clip((height_m + half_height) / (3.0 if world.indoor else 12.0), 0, 1)
    opacity = np.where(np.isfinite([MATERIALS[row].per_m for row in snapshot.material]), 0.7, 1.0)
    for k in np.argsort(height_m + half_height, kind="stable"):
        window, inside = _footprint(snapshot, k, xy, fine.cell_m)
        region = image[window]
        region[inside] += opacity[k] * (np.minimum(colors[k] * light[k], 1.0) - region[inside])
    return image


def _ground_colors(terrain: Terrain, xy: F64, step_m: float, yaw: float) -> F32:
    """Return the ground colors of the pixels, shaded from one side to show slopes and curbs."""
    i = np.clip(np.searchsorted(terrain.x_m, xy[..., 0], "right") - 1, 0, len(terrain.x_m) - 2)
    j = np.clip(np.searchsorted(terrain.y_m, xy[..., 1], "right") - 1, 0, len(terrain.y_m) - 2)
    material = terrain.material[i, j]
    colors = surface_colors(World("", terrain), np.full(material.shape, GROUND, np.int32), material)
    along, across = np.gradient(terrain.at(xy), step_m)
    toward = along * np.cos(0.6 - yaw) + across * np.sin(0.6 - yaw)
    light = 1.0 + np.clip(-1.2 * toward, -0.4, 0.4)
    return np.asarray(np.clip(colors * light[..., None], 0, 1), np.float32)


def _footprint(snapshot: Snapshot, k: int, xy: F64, step_m: float) -> tuple[tuple[slice, slice], NDArray[np.bool_]]:
    """Return the window of pixels around a solid and the mask of those it covers; at least the nearest one."""
    half = np.maximum(snapshot.half_m[k, :2], 0.6 * step_m)
    (ax, ay), corner = xy[1, 0] - xy[0, 0], xy[0, 0]
    offset = snapshot.center_m[k, :2] - corner
    i, j = (offset @ [ax, ay]) / step_m**2, (offset @ [-ay, ax]) / step_m**2
    reach = float(np.hypot(*half)) / step_m + 1
    window = tuple(slice(max(int(at - reach), 0), max(int(at + reach + 2), 0)) for at in (i, j))
    local = ((xy[window] - snapshot.center_m[k, :2]) @ snapshot.rotation[k, :2, :2]) / half
    inside = np.abs(local).max(axis=-1) <= 1 if snapshot.kind[k] == BOX else (local**2).sum(axis=-1) <= 1
    return (window[0], window[1]), np.asarray(inside)


def motions(world: World, snapshot: Snapshot, t_s: float) -> F64:
    """Return the places of moving things in the world, now and in two seconds (N, 2, 2)."""
    first = np.unique(snapshot.thing, return_index=True)[1]
    first = first[np.hypot(*snapshot.velocity_mps[first, :2].T) > 0.2]
    start = np.array([world.things[snapshot.thing[k]].pose_at(t_s)[:2] for k in first]).reshape(-1, 2)
    return np.stack([start, start + 2.0 * snapshot.velocity_mps[first, :2]], axis=1)


def point_colors(xy: F64, height_m: F64, grid: BevGrid) -> F32:
    """Return the colors (SIDE, SIDE, 3) of points (N, 2) from above, by height above ground, the highest on top."""
    image = np.full((SIDE, SIDE, 3), 0.094, np.float32)
    order = np.argsort(height_m, kind="stable")
    cells, inside = BevGrid(SIDE, grid.half_extent_m, grid.offset_m).index(xy[order])
    low, high = HEIGHTS_M
    shares = np.clip((height_m[order][inside] - low) / (high - low), 0, 1)
    image[tuple(cells[inside].T)] = colormaps["viridis"](0.15 + 0.85 * shares)[..., :3]
    return image


def state_colors(truth: Truth, known: NDArray[np.bool_], target: str) -> F32:
    """Return the colors (cells, cells, 3) of the states for one target; `NOT_KNOWN` without truth."""
    palette = np.array([COLORS[CellState(state)] for state in range(len(CellState))], np.float32)
    return np.where(known[..., None], palette[truth.state[target]], np.array(NOT_KNOWN, np.float32))


def difference_colors(truth: Truth, known: NDArray[np.bool_]) -> F32:
    """Return the colors (cells, cells, 3) by which definitions call a cell visible, see ``DIFFERENCES``."""
    probe, far = truth.visible("car"), truth.definitions["farthest"]
    first, sight = truth.definitions["first_blocker"], truth.definitions["line_of_sight"]
    who = np.where(probe, np.where(first, 1, 2), np.where(far, 3, np.where(sight, 4, 0)))
    palette = np.array(list(DIFFERENCES.values()), np.float32)
    return np.where(known[..., None], palette[who], np.array(NOT_KNOWN, np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class PreviewSample:
    """One simulated sample with its world."""

    world: World
    agent: int  # index of the agent that measured the sweep
    t_s: float  # time in the world
    sweep: Sweep
    truth: Truth
    known: NDArray[np.bool_]  # (cells, cells) cells with truth
    title: str  # description for the reader


def preview_png(preset: str, seed: int) -> bytes:
    """Return a PNG of one sample of each kind of world of a preset, with its truth.

    Moving agents and those on masts alternate if a preset has both.
    """
    composed = replace(preset_named(preset), seed=seed)
    samples = [preview_sample(scene, agent) for scene, agent in _choice(composed)]
    return sheet(samples, f"viewshed simulate {preset} --preview --seed {seed}")


def preview_sample(scene: ScenePlan, agent: int) -> PreviewSample:
    """Return the sample of an agent at the middle of a scene."""
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
    return PreviewSample(world, agent, t_s, sweep, frame.truth, frame.known, title)


def _choice(preset: Preset) -> list[tuple[ScenePlan, int]]:
    """Return the first scene of each kind of world with one of its agents, moving and on masts in turn."""
    first: dict[str, ScenePlan] = {}
    for number in range(_SCENES):
        scene = ScenePlan(preset, 0, number)
        first.setdefault(scene.world_kind, scene)
    scenes = [first[kind] for kind in preset.worlds if kind in first]
    turns = [0, preset.moving] if preset.moving and preset.roadside else [0]
    return [(scene, turns[k % len(turns)]) for k, scene in enumerate(scenes)]


def sheet(samples: Sequence[PreviewSample], title: str) -> bytes:
    """Return a PNG with a row of views per sample and a legend; forward is up and left is left."""
    width, height = len(HEADINGS) * _INCHES, len(samples) * (_INCHES + 0.25) + 1.5
    figure = Figure((width, height), dpi=100)
    places = {"left": 0.005, "right": 0.995, "bottom": 1.1 / height, "top": 1.0 - 0.65 / height}
    axes = figure.subplots(
        len(samples), len(HEADINGS), squeeze=False, gridspec_kw=places | {"wspace": 0.03, "hspace": 0.08}
    )
    figure.text(0.005, 1.0 - 0.2 / height, title, fontsize=11, weight="bold")
    for column, heading in enumerate(HEADINGS):
        axes[0, column].annotate(heading, (0.0, 1.09), xycoords="axes fraction", fontsize=8.5, color="0.25")
    for line, sample in zip(axes, samples, strict=True):
        line[0].annotate(sample.title, (0.0, 1.02), xycoords="axes fraction", fontsize=8.5, weight="bold")
        _draw(line, sample)
    low, high = HEIGHTS_M
    states = [(text, COLORS[state]) for state, text in WORDS.items()]
    colors = [*states, ("no truth: own vehicle, outside the world", NOT_KNOWN), *DIFFERENCES.items()]
    handles: list[Any] = [
        Line2D(
            [], [], color="#fde725", marker=".", linestyle="none", label=f"returns, {low:g} (dark) to {high:g} m high"
        ),
        Line2D([], [], color="black", marker="^", linestyle="none", label="this sensor"),
        Line2D([], [], color="#ff3fd0", marker="o", linestyle="none", label="other agents"),
        Line2D([], [], color="black", linewidth=0.9, label="where things will be in 2 s"),
        *(Patch(facecolor=color, edgecolor="black", linewidth=0.4, label=text) for text, color in colors),
    ]
    figure.legend(handles=handles, loc="lower left", ncols=4, frameon=False, fontsize=8)
    return png_of(figure, 256)


def _draw(axes: Sequence[Axes], sample: PreviewSample) -> None:
    """Draw one sample: world, returns, truth of both targets, other definitions."""
    world, grid, agent = sample.world, sample.truth.grid, sample.world.agents[sample.agent]
    snapshot, sensor = world.snapshot(sample.t_s), world.world_from_sensor(agent, sample.t_s)
    ground = world.ground_of(agent)
    foot = [*sensor.translation[:2], float(ground.at(sensor.translation[None])[0])]
    world_from_level = Rigid.from_yaw(sensor.yaw, foot)

    def level(xy: F64) -> F64:
        """Transform places (…, 2) from the world to the sensor's level frame."""
        return np.asarray((world_from_level.inverse() @ np.insert(xy, 2, 0.0, axis=-1))[..., :2])

    returns = sensor @ sample.sweep.points
    views = (
        plan_view(world, snapshot, world_from_level, grid),
        point_colors(level(returns[:, :2]), returns[:, 2] - ground.at(returns), grid),
        *(state_colors(sample.truth, sample.known, target) for target in ("car", "pedestrian")),
        difference_colors(sample.truth, sample.known),
    )
    (back, right), side_m = grid.origin_m, 2 * grid.half_extent_m
    for axis, view in zip(axes, views, strict=True):
        axis.imshow(view[::-1, ::-1], extent=(right + side_m, right, back, back + side_m), interpolation="nearest")
        axis.set_axis_off()
    for start, end in level(motions(world, snapshot, sample.t_s)):
        if (np.abs([start, end] - np.array(grid.offset_m)) < 0.99 * grid.half_extent_m).all():
            axes[0].annotate("", end[::-1], start[::-1], arrowprops={"arrowstyle": "->", "linewidth": 0.9})
    others = [world.world_from_sensor(one, sample.t_s).translation[:2] for one in world.agents if one is not agent]
    forward, left = level(np.array(others).reshape(-1, 2)).T
    axes[0].scatter(left, forward, s=22, c="#ff3fd0", edgecolor="white", linewidth=0.7)
    axes[0].scatter(0.0, 0.0, s=46, marker="^", c="black", edgecolor="white", linewidth=0.8)
    axes[0].set(xlim=(right + side_m, right), ylim=(back, back + side_m))
    scale_m, corner = 20.0 if grid.half_extent_m > 30 else 5.0, (right + 0.97 * side_m, back + 0.03 * side_m)
    axes[0].plot([corner[0], corner[0] - scale_m], [corner[1]] * 2, color="black", linewidth=2)
    axes[0].text(corner[0], corner[1] + 0.01 * side_m, f"{scale_m:g} m", fontsize=7, va="bottom")
