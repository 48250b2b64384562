"""A look at what a preset simulates: worlds, sweeps and truths of a few samples on one sheet.

Pictures of simulated worlds, and the sheet that shows them beside their sweeps and truths.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.fov.estimate import CellState
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.show.plot import COLORS, HEIGHTS_M, WORDS
from viewshed.sweep import Sweep
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame, world_of
from viewshed_lab.sim.assets.shapes import BOX, MATERIALS
from viewshed_lab.sim.colors import Image, surface_colors, to_bytes, without_ceiling
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import GROUND, Snapshot, World

SIDE = 256
"""Pixels along each side of a view from above."""

_DPI, _GAP, _TOP, _HEAD, _LEGEND = 100, 7, 44, 24, 108

DIFFERENCES = {
    "nobody": (0.42, 0.42, 0.47),
    "probe (ours) and first_blocker": (0.62, 0.82, 0.95),
    "probe, not first_blocker": (0.0, 0.45, 0.70),
    "farthest, not probe": (0.84, 0.37, 0.0),
    "line_of_sight only": (0.94, 0.89, 0.26),
}
"""F32 of who calls a cell visible for a car; `probe` is the project's own definition."""

NOT_KNOWN = (1.0, 0.94, 0.78)
"""Color of cells whose truth is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class PreviewRow:
    """One sweep on the sheet: its heading, what moves, and its pictures (rows, columns, 3) from left to right."""

    title: str
    marks: Marks
    pictures: tuple[Image, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """What is drawn over the view from above, in its pixels (across, down)."""

    arrows: NDArray[np.float64]  # (n, 4) start and end of things that move: where they will be in two seconds
    agents: NDArray[np.float64]  # (m, 2) the other agents
    sensor: tuple[float, float]  # this agent's
    scale_m: float  # length of the scale bar
    scale_pixels: float  # the same in pixels


def plan_view(world: World, snapshot: Snapshot, world_from_level: Rigid, grid: BevGrid) -> Image:
    """Return the world from above (SIDE, SIDE, 3), forward up, left left: higher solids over lower ones."""
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
    return to_bytes(image)[::-1, ::-1]


def _ground_colors(terrain: Terrain, xy: NDArray[np.float64], step_m: float, yaw: float) -> F32:
    """Return ground colors of the pixels, lit from one side so that slopes and curbs show."""
    i = np.clip(np.searchsorted(terrain.x_m, xy[..., 0], "right") - 1, 0, len(terrain.x_m) - 2)
    j = np.clip(np.searchsorted(terrain.y_m, xy[..., 1], "right") - 1, 0, len(terrain.y_m) - 2)
    material = terrain.material[i, j]
    colors = surface_colors(World("", terrain), np.full(material.shape, GROUND, np.int32), material)
    along, across = np.gradient(terrain.at(xy), step_m)
    toward = along * np.cos(0.6 - yaw) + across * np.sin(0.6 - yaw)
    light = 1.0 + np.clip(-1.2 * toward, -0.4, 0.4)
    return np.asarray(np.clip(colors * light[..., None], 0, 1), np.float32)


def _footprint(
    snapshot: Snapshot, k: int, xy: NDArray[np.float64], step_m: float
) -> tuple[tuple[slice, slice], NDArray[np.bool_]]:
    """Return the window of pixels around a solid and which of them it covers; the nearest one if it is small."""
    half = np.maximum(snapshot.half_m[k, :2], 0.6 * step_m)
    (ax, ay), corner = xy[1, 0] - xy[0, 0], xy[0, 0]
    offset = snapshot.center_m[k, :2] - corner
    i, j = (offset @ [ax, ay]) / step_m**2, (offset @ [-ay, ax]) / step_m**2
    reach = float(np.hypot(*half)) / step_m + 1
    window = tuple(slice(max(int(at - reach), 0), max(int(at + reach + 2), 0)) for at in (i, j))
    local = ((xy[window] - snapshot.center_m[k, :2]) @ snapshot.rotation[k, :2, :2]) / half
    inside = np.abs(local).max(axis=-1) <= 1 if snapshot.kind[k] == BOX else (local**2).sum(axis=-1) <= 1
    return (window[0], window[1]), np.asarray(inside)


def marks(world: World, snapshot: Snapshot, agent: int, pose: tuple[Rigid, float], grid: BevGrid) -> Marks:
    """Return what is drawn over the view from above; ``pose`` is ``world_from_level`` and the time in seconds."""
    world_from_level, t_s = pose
    first = np.unique(snapshot.thing, return_index=True)[1]
    first = first[np.hypot(*snapshot.velocity_mps[first, :2].T) > 0.2]
    start = np.array([world.things[snapshot.thing[k]].pose_at(t_s)[:2] for k in first]).reshape(-1, 2)
    end = start + 2.0 * snapshot.velocity_mps[first, :2]
    others = [world.world_from_sensor(one, t_s).translation[:2] for k, one in enumerate(world.agents) if k != agent]
    arrows = np.hstack([_pixels(xy, world_from_level, grid) for xy in (start, end)])
    agents = _pixels(np.array(others).reshape(-1, 2), world_from_level, grid)
    scale_m = 20.0 if grid.half_extent_m > 30 else 5.0
    pixels = scale_m * SIDE / (2 * grid.half_extent_m)
    within = _inside(arrows[:, :2]) & _inside(arrows[:, 2:])
    sensor = _pixels(world_from_level.translation[None, :2], world_from_level, grid)[0]
    return Marks(arrows[within], agents[_inside(agents)], (float(sensor[0]), float(sensor[1])), scale_m, pixels)


def _pixels(xy: NDArray[np.float64], world_from_level: Rigid, grid: BevGrid) -> NDArray[np.float64]:
    """Return (n, 2) pixels (across, down) of places (n, 2) in the world."""
    level = world_from_level.inverse() @ np.column_stack([xy, np.zeros(len(xy))])
    return np.asarray(SIDE - ((level[:, :2] - grid.origin_m) * SIDE / (2 * grid.half_extent_m))[:, ::-1])


def _inside(pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(((pixels >= 3) & (pixels <= SIDE - 3)).all(axis=1))


def points_view(xy: NDArray[np.float64], height_m: NDArray[np.float64], grid: BevGrid) -> Image:
    """Return points from above (SIDE, SIDE, 3), colored by height above the ground, the highest on top."""
    image = np.full((SIDE, SIDE, 3), 24, np.uint8)
    order = np.argsort(height_m, kind="stable")
    cells, inside = BevGrid(SIDE, grid.half_extent_m, grid.offset_m).index(xy[order])
    i, j = cells[inside].T
    image[i, j] = to_bytes(height_colors(height_m[order][inside]))
    return image[::-1, ::-1]


def height_colors(height_m: NDArray[np.float64]) -> F32:
    """Return colors (n, 3) of heights above the ground."""
    low, high = HEIGHTS_M
    return np.asarray(colormaps["viridis"](0.15 + 0.85 * np.clip((height_m - low) / (high - low), 0, 1))[..., :3])


def state_view(truth: Truth, known: NDArray[np.bool_], target: str) -> Image:
    """Return the states (SIDE, SIDE, 3) for one target; `NOT_KNOWN` where there is no truth."""
    palette = np.array([COLORS[CellState(state)] for state in range(len(CellState))], np.float32)
    colors = palette[truth.state[target]]
    colors[~known] = NOT_KNOWN
    return _enlarged(colors)


def differences_view(truth: Truth, known: NDArray[np.bool_]) -> Image:
    """Return who calls a cell visible (SIDE, SIDE, 3), in the colors of ``DIFFERENCES``."""
    probe, far = truth.visible("car"), truth.definitions["farthest"]
    first, sight = truth.definitions["first_blocker"], truth.definitions["line_of_sight"]
    who = np.where(probe, np.where(first, 1, 2), np.where(far, 3, np.where(sight, 4, 0)))
    colors = np.array(list(DIFFERENCES.values()), np.float32)[who]
    colors[~known] = NOT_KNOWN
    return _enlarged(colors)


def _enlarged(colors: F32) -> Image:
    nearest = (np.arange(SIDE) * len(colors)) // SIDE
    return to_bytes(colors[nearest][:, nearest])[::-1, ::-1]


def sheet(rows: Sequence[PreviewRow], headings: Sequence[str], title: str) -> bytes:
    """Return a PNG with a line of pictures for each row under its title, and a legend."""
    widths = [picture.shape[1] for picture in rows[0].pictures]
    lefts = [int(left) for left in np.cumsum([_GAP, *(width + _GAP for width in widths[:-1])])]
    height, width = _TOP + len(rows) * (SIDE + _HEAD) + _LEGEND, sum(widths) + _GAP * (len(widths) + 1)
    page = np.full((height, width, 3), 255, np.uint8)
    for k, row in enumerate(rows):
        for left, picture in zip(lefts, row.pictures, strict=True):
            top = _TOP + k * (SIDE + _HEAD) + _HEAD
            page[top : top + SIDE, left : left + picture.shape[1]] = picture
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    axes.imshow(page, extent=(0, width, height, 0), interpolation="nearest", aspect="auto")
    axes.text(_GAP, 6, title, fontsize=11, weight="bold", va="top")
    for left, heading in zip(lefts, headings, strict=True):
        axes.text(left, _TOP - 2, heading, fontsize=8.5, va="bottom", color="0.25")
    for k, row in enumerate(rows):
        top = _TOP + k * (SIDE + _HEAD) + _HEAD
        axes.text(_GAP, top - 4, row.title, fontsize=8.5, va="bottom", weight="bold")
        _draw_marks(axes, row.marks, (lefts[0], top))
    _legend(axes, height - _LEGEND)
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", pil_kwargs={"optimize": True})
    return buffer.getvalue()


def _draw_marks(axes: Axes, drawn: Marks, corner: tuple[int, int]) -> None:
    for x0, y0, x1, y1 in drawn.arrows + np.tile(corner, 2):
        axes.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "->", "color": "black", "linewidth": 0.9})
    left, top = corner
    across, down = (drawn.agents + corner).T
    axes.scatter(across, down, s=22, facecolor="#ff3fd0", edgecolor="white", linewidth=0.7)
    x, y = left + drawn.sensor[0], top + drawn.sensor[1]
    axes.scatter(x, y, s=46, marker="^", facecolor="black", edgecolor="white", linewidth=0.8)
    axes.plot([left + 8, left + 8 + drawn.scale_pixels], [top + SIDE - 8] * 2, color="black", linewidth=2)
    axes.text(left + 8, top + SIDE - 11, f"{drawn.scale_m:g} m", fontsize=7, va="bottom")


def _legend(axes: Axes, top: int) -> None:
    """Write what the colors mean: heights, marks, states, differences."""
    heights = height_colors(np.linspace(*HEIGHTS_M, 200))[None]
    axes.imshow(heights, extent=(_GAP, _GAP + 200, top + 20, top + 10), aspect="auto")
    low, high = HEIGHTS_M
    axes.text(_GAP + 208, top + 15, f"returns: {low:g} to {high:g} m above the ground", fontsize=8, va="center")
    words = "▲ this sensor   ● (pink) other agents   → where things will be in 2 s"
    axes.text(_GAP, top + 33, words, fontsize=8, va="center")
    states = [(text, COLORS[state]) for state, text in WORDS.items()]
    for k, (text, color) in enumerate([*states, ("no truth: own vehicle, outside the world", NOT_KNOWN)]):
        _swatch(axes, (480 + 290 * (k % 2), top + 10 + 18 * (k // 2)), color, text)
    for k, (text, color) in enumerate(DIFFERENCES.items()):
        _swatch(axes, (1080, top + 10 + 18 * k), color, text)


def _swatch(axes: Axes, corner: tuple[float, float], color: tuple[float, float, float], words: str) -> None:
    axes.add_patch(Rectangle(corner, 12, 10, facecolor=color, edgecolor="black", linewidth=0.4))
    axes.text(corner[0] + 18, corner[1] + 5, words, fontsize=8, va="center")


HEADINGS = (
    "world from above", "sweep: height above ground", "truth: car", "truth: pedestrian", "who says visible, for a car",
)  # fmt: skip

_SCENES = 500


@dataclass(frozen=True, slots=True, eq=False)
class PreviewSample:
    """One sample and what it was made from."""

    world: World  # the world it was made in
    agent: int  # index of the agent that measured it
    t_s: float  # time in the world
    sweep: Sweep  # what the sensor measured
    truth: Truth  # what it could have seen
    known: NDArray[np.bool_]  # (cells, cells) where that is known
    title: str  # what it is, for the reader


def preview_png(preset: str, seed: int) -> bytes:
    """Return a PNG that shows one sample of each kind of world that a preset has, with its truth.

    Moving agents and those on masts take turns where a preset has both.
    """
    composed = replace(preset_named(preset), seed=seed)
    rows = [row_of(preview_sample(scene, agent)) for scene, agent in _choice(composed)]
    return sheet(rows, HEADINGS, f"viewshed simulate {preset} --preview --seed {seed}")


def preview_sample(scene: ScenePlan, agent: int) -> PreviewSample:
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
    return PreviewSample(world, agent, t_s, sweep, frame.truth, frame.known, title)


def _choice(preset: Preset) -> list[tuple[ScenePlan, int]]:
    """Return the first scene of each kind of world, and one of its agents, moving and on masts in turn."""
    first: dict[str, ScenePlan] = {}
    for number in range(_SCENES):
        scene = ScenePlan(preset, 0, number)
        first.setdefault(scene.world_kind, scene)
    scenes = [first[kind] for kind in preset.worlds if kind in first]
    turns = [0, preset.moving] if preset.moving and preset.roadside else [0]
    return [(scene, turns[k % len(turns)]) for k, scene in enumerate(scenes)]


def row_of(sample: PreviewSample) -> PreviewRow:
    """Return a sample as a line of pictures: above, sweep, truth of both targets, other definitions."""
    world, grid = sample.world, sample.truth.grid
    snapshot = world.snapshot(sample.t_s)
    sensor = world.world_from_sensor(world.agents[sample.agent], sample.t_s)
    ground = world.ground_of(world.agents[sample.agent])
    foot = [*sensor.translation[:2], float(ground.at(sensor.translation[None])[0])]
    world_from_level = Rigid.from_yaw(sensor.yaw, foot)
    returns = sensor @ sample.sweep.points
    height_m = returns[:, 2] - ground.at(returns)
    pictures = (
        plan_view(world, snapshot, world_from_level, grid),
        points_view((world_from_level.inverse() @ returns)[:, :2], height_m, grid),
        *(state_view(sample.truth, sample.known, target) for target in ("car", "pedestrian")),
        differences_view(sample.truth, sample.known),
    )
    return PreviewRow(
        sample.title, marks(world, snapshot, sample.agent, (world_from_level, sample.t_s), grid), pictures
    )
