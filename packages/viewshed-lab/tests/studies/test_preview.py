import io

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.show.plot import COLORS
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import Box, material_index
from viewshed_lab.sim.colors import surface_colors
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, Thing, Track, World
from viewshed_lab.studies.preview import (
    DIFFERENCES,
    HEADINGS,
    NOT_KNOWN,
    SIDE,
    PreviewSample,
    differences_view,
    marks,
    plan_view,
    points_view,
    preview_png,
    row_of,
    state_view,
)

pytestmark = pytest.mark.slow

GRID = BevGrid(64, 16.0)
BRICK = Thing("block", (Box(0.0, 0.0, 4.0, 2.0, 3.0, material="brick"),), 8.0, 6.0)
ROAD = Track(np.array([0.0, 4.0]), np.array([[0.0, 0.0], [8.0, 0.0]]), np.array([0.0, 0.0]))
CART = Thing("car", (Box(0.0, 0.0, 2.0, 1.0, 1.0),), track=ROAD, tilts=True)
MAST = Agent("mast", "hdl32e", Rigid.from_yaw(0.0, (-6.0, -9.0, 5.0)))
ROVER = Agent("rover", "hdl32e", Rigid.from_yaw(0.0, (0.0, 0.0, 1.5)), 1)


def _world(*more: Thing, indoor: bool = False) -> World:
    return World("yard", Terrain.plane(60.0, material="grass"), (BRICK, CART, *more), (ROVER, MAST), indoor)


def _is(image: NDArray[np.uint8], material: str) -> NDArray[np.bool_]:
    """Pixels whose color is that of a material, brightness apart."""
    color = surface_colors(World("", Terrain.plane(1.0)), np.array([-1], np.int32), np.array([material_index(material)],
                           np.uint8))[0].astype(np.float64)  # fmt: skip
    pixels = image.astype(np.float64)
    cosine = pixels @ color / np.maximum(np.linalg.norm(pixels, axis=-1), 1e-9) / np.linalg.norm(color)
    return np.asarray(cosine > 0.9995)


def test_a_block_ahead_at_the_left_is_at_the_upper_left_of_the_plan() -> None:
    world = _world()
    rows, columns = np.nonzero(_is(plan_view(world, world.snapshot(0.0), Rigid.identity(), GRID), "brick"))
    meters = 2 * GRID.half_extent_m / SIDE
    assert (rows.min(), rows.max()) == pytest.approx(((16 - 10) / meters, (16 - 6) / meters - 1), abs=1)
    assert (columns.min(), columns.max()) == pytest.approx(((16 - 7) / meters, (16 - 5) / meters - 1), abs=1)


def test_arrows_point_where_things_go_and_agents_are_marked() -> None:
    world = _world()
    drawn = marks(world, world.snapshot(1.0), 0, (Rigid.identity(), 1.0), GRID)
    per_m = SIDE / 32
    assert drawn.arrows.tolist() == [pytest.approx([128, 128 - 2 * per_m, 128, 128 - 6 * per_m])]
    assert drawn.agents.tolist() == [pytest.approx([128 + 9 * per_m, 128 + 6 * per_m])]
    assert drawn.sensor == pytest.approx((128, 128))


def _truth(state: NDArray[np.uint8]) -> Truth:
    nothing = np.zeros(GRID.shape, np.bool_)
    returns = np.where((state == CellState.FREE) | (state == CellState.SURFACE), 9, 0).astype(np.uint8)
    names = ("farthest", "first_blocker", "line_of_sight")
    definitions = {name: nothing.copy() for name in names}
    definitions["farthest"][:32, :32] = True  # behind, right
    definitions["line_of_sight"][32:, :32] = True  # ahead, right
    return Truth(GRID, {"car": returns, "pedestrian": returns}, {"car": state, "pedestrian": state}, definitions)


def _quarters(image: NDArray[np.uint8]) -> list[list[float]]:
    """Colors in the middle of the upper left, upper right, lower left and lower right quarter."""
    return [(image[a, b] / 255).tolist() for a in (64, 192) for b in (64, 192)]


def test_truth_is_drawn_forward_up_and_left_left() -> None:
    state = np.full(GRID.shape, CellState.HIDDEN, np.uint8)
    state[32:, 32:] = CellState.SURFACE  # ahead, left
    known = np.ones(GRID.shape, np.bool_)
    known[:32, 32:] = False  # behind, left
    quarters = _quarters(state_view(_truth(state), known, "car"))
    wanted = [COLORS[CellState.SURFACE], COLORS[CellState.HIDDEN], NOT_KNOWN, COLORS[CellState.HIDDEN]]
    assert np.allclose(quarters, wanted, atol=0.02)
    quarters = _quarters(differences_view(_truth(state), known))
    words = ["probe, not first_blocker", "line_of_sight only", "", "farthest, not probe"]
    assert np.allclose(quarters, [DIFFERENCES.get(word, NOT_KNOWN) for word in words], atol=0.02)


def test_points_are_drawn_where_they_are_the_highest_on_top() -> None:
    image = points_view(np.array([[8.0, 4.0], [8.0, 4.0], [-8.0, 99.0]]), np.array([2.9, 0.1, 1.0]), GRID)
    painted = np.argwhere((image != 24).any(axis=-1))
    assert painted.tolist() == [[SIDE - 1 - (8 + 16) * 8, SIDE - 1 - (4 + 16) * 8]]
    assert image[tuple(painted[0])][0] > 200  # yellow


def _shot(world: World) -> PreviewSample:
    points = np.array([[3.0, -4.0, -1.5], [6.0, 6.0, 0.5], [11.0, 7.0, -1.3]], np.float32)  # grass, block, behind it
    state = np.full(GRID.shape, CellState.FREE, np.uint8)
    sweep = Sweep(points, sensor_height_m=1.5)
    return PreviewSample(world, 0, 0.0, sweep, _truth(state), np.ones(GRID.shape, np.bool_), "a yard")


def test_a_row_has_a_picture_for_each_heading() -> None:
    row = row_of(_shot(_world()))
    assert len(row.pictures) == len(HEADINGS)
    assert {picture.shape for picture in row.pictures} == {(SIDE, SIDE, 3)}


def test_the_preview_of_a_preset_is_a_picture_small_enough_for_a_page() -> None:
    png = preview_png("nuscenes-small", 5)
    assert imread(io.BytesIO(png)).shape == (152 + 5 * 280, 1322, 4)
    assert len(png) < 1_500_000
