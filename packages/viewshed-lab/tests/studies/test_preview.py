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
    NOT_KNOWN,
    SIDE,
    PreviewSample,
    difference_colors,
    motions,
    plan_view,
    point_colors,
    preview_png,
    sheet,
    state_colors,
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


def _is(image: NDArray[np.float32], material: str) -> NDArray[np.bool_]:
    """Pixels whose color is that of a material, brightness apart."""
    color = surface_colors(World("", Terrain.plane(1.0)), np.array([-1], np.int32), np.array([material_index(material)],
                           np.uint8))[0].astype(np.float64)  # fmt: skip
    pixels = image.astype(np.float64)
    cosine = pixels @ color / np.maximum(np.linalg.norm(pixels, axis=-1), 1e-9) / np.linalg.norm(color)
    return np.asarray(cosine > 0.9995)


def test_a_block_ahead_at_the_left_is_ahead_at_the_left_of_the_plan() -> None:
    world = _world()
    i, j = np.nonzero(_is(plan_view(world, world.snapshot(0.0), Rigid.identity(), GRID), "brick"))
    meters = 2 * GRID.half_extent_m / SIDE
    assert (i.min(), i.max()) == pytest.approx(((16 + 6) / meters, (16 + 10) / meters - 1), abs=1)
    assert (j.min(), j.max()) == pytest.approx(((16 + 5) / meters, (16 + 7) / meters - 1), abs=1)


def test_what_moves_is_followed_for_two_seconds() -> None:
    world = _world()
    assert motions(world, world.snapshot(1.0), 1.0) == pytest.approx(np.array([[[2.0, 0.0], [6.0, 0.0]]]))


def _truth(state: NDArray[np.uint8]) -> Truth:
    nothing = np.zeros(GRID.shape, np.bool_)
    returns = np.where((state == CellState.FREE) | (state == CellState.SURFACE), 9, 0).astype(np.uint8)
    names = ("farthest", "first_blocker", "line_of_sight")
    definitions = {name: nothing.copy() for name in names}
    definitions["farthest"][:32, :32] = True  # behind, right
    definitions["line_of_sight"][32:, :32] = True  # ahead, right
    return Truth(GRID, {"car": returns, "pedestrian": returns}, {"car": state, "pedestrian": state}, definitions)


def _quarters(image: NDArray[np.float32]) -> list[list[float]]:
    """Colors of a cell ahead left, ahead right, behind left and behind right."""
    return [image[i, j].tolist() for i in (48, 16) for j in (48, 16)]


def test_colors_are_those_of_the_truth() -> None:
    state = np.full(GRID.shape, CellState.HIDDEN, np.uint8)
    state[32:, 32:] = CellState.SURFACE  # ahead, left
    known = np.ones(GRID.shape, np.bool_)
    known[:32, 32:] = False  # behind, left
    wanted = [COLORS[CellState.SURFACE], COLORS[CellState.HIDDEN], NOT_KNOWN, COLORS[CellState.HIDDEN]]
    assert np.allclose(_quarters(state_colors(_truth(state), known, "car")), wanted)
    words = ["probe, not first_blocker", "line_of_sight only", "", "farthest, not probe"]
    quarters = _quarters(difference_colors(_truth(state), known))
    assert np.allclose(quarters, [DIFFERENCES.get(word, NOT_KNOWN) for word in words])


def test_points_are_drawn_where_they_are_the_highest_on_top() -> None:
    image = point_colors(np.array([[8.0, 4.0], [8.0, 4.0], [-8.0, 99.0]]), np.array([2.9, 0.1, 1.0]), GRID)
    painted = np.argwhere((image != image[0, 0]).any(axis=-1))
    assert painted.tolist() == [[(8 + 16) * 8, (4 + 16) * 8]]
    assert image[tuple(painted[0])][0] > 0.8  # yellow


def test_forward_is_up_and_left_is_left_on_the_sheet() -> None:
    points = np.array([[3.0, -4.0, -1.5], [6.0, 6.0, 0.5], [11.0, 7.0, -1.3]], np.float32)  # grass, block, behind it
    state, known = np.full(GRID.shape, CellState.FREE, np.uint8), np.ones(GRID.shape, np.bool_)
    shot = PreviewSample(_world(), 0, 0.0, Sweep(points, sensor_height_m=1.5), _truth(state), known, "a yard")
    image = imread(io.BytesIO(sheet([shot], "yards")))[..., :3]
    panel = image[65:325, :260]  # the first picture of five
    rows, columns = np.nonzero(_is(panel, "brick"))
    assert len(rows) > 100
    assert rows.max() < 0.45 * len(panel)
    assert columns.max() < 0.45 * len(panel)


def test_the_preview_of_a_preset_is_a_picture_small_enough_for_a_page() -> None:
    png = preview_png("nuscenes-small", 5)
    assert imread(io.BytesIO(png)).shape == (1575, 1300, 4)
    assert len(png) < 1_500_000
