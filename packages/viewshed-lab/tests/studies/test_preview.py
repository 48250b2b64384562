import io
from dataclasses import replace

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
from viewshed_lab.data.presets import preset_named
from viewshed_lab.sim.assets.shapes import MATERIALS, Box, material_index
from viewshed_lab.sim.camera import Lens, photograph, surface_colors, viewpoint
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, Thing, Track, World
from viewshed_lab.studies.preview import (
    DIFFERENCES,
    HEADINGS,
    NOT_KNOWN,
    SIDE,
    PreviewSample,
    _choice,
    differences_view,
    marks,
    plan_view,
    points_view,
    preview_png,
    preview_sample,
    row_of,
    sheet,
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


def _reddish(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels of brick, in sun or shade."""
    return np.asarray(image[..., 0] > 1.25 * image[..., 1].astype(np.float64))


def test_a_block_ahead_at_the_left_is_at_the_upper_left_of_the_plan() -> None:
    world = _world()
    rows, columns = np.nonzero(_is(plan_view(world, world.snapshot(0.0), Rigid.identity(), GRID), "brick"))
    meters = 2 * GRID.half_extent_m / SIDE
    assert (rows.min(), rows.max()) == pytest.approx(((16 - 10) / meters, (16 - 6) / meters - 1), abs=1)
    assert (columns.min(), columns.max()) == pytest.approx(((16 - 7) / meters, (16 - 5) / meters - 1), abs=1)


def test_the_plan_turns_with_the_sensor() -> None:
    world = _world()
    turned = plan_view(world, world.snapshot(0.0), Rigid.from_yaw(np.pi / 2), GRID)  # the block is ahead at the right
    rows, columns = np.nonzero(_is(turned, "brick"))
    assert rows.mean() == pytest.approx(SIDE / 2 - 6 * 8, abs=1.5)
    assert columns.mean() == pytest.approx(SIDE / 2 + 8 * 8, abs=1.5)


def test_ceilings_are_left_out_indoors_only() -> None:
    roof = Thing("ceiling", (Box(0.0, 0.0, 30.0, 30.0, 3.2, 3.0, material="wood"),))
    for indoor, share in ((True, 0.0), (False, 30**2 / 32**2)):
        world = _world(roof, indoor=indoor)
        found = _is(plan_view(world, world.snapshot(0.0), Rigid.identity(), GRID), "wood").mean()
        assert found == pytest.approx(share, abs=0.2 * share)


def test_thin_poles_show_in_the_plan() -> None:
    pole = Thing("pole", (Box(0.0, 0.0, 0.02, 0.02, 4.0, material="brick"),), -5.03, -7.01)
    world = World("", Terrain.plane(60.0, material="grass"), (pole,), (MAST,))
    assert 1 <= _is(plan_view(world, world.snapshot(0.0), Rigid.identity(), GRID), "brick").sum() <= 4


def test_arrows_point_where_things_go_and_agents_are_marked() -> None:
    world = _world()
    drawn = marks(world, world.snapshot(1.0), 0, (Rigid.identity(), 1.0), GRID)
    per_m = SIDE / 32
    assert drawn.arrows.tolist() == [pytest.approx([128, 128 - 2 * per_m, 128, 128 - 6 * per_m])]
    assert drawn.agents.tolist() == [pytest.approx([128 + 9 * per_m, 128 + 6 * per_m])]
    assert drawn.sensor == pytest.approx((128, 128))


def test_a_camera_sees_what_is_where() -> None:
    world, lens = _world(), Lens(0.0, 90.0, (100, 200))
    photo = photograph(world, world.snapshot(0.0), Rigid.from_yaw(0.0, (-4.0, 0.0, 1.6)), lens)
    assert photo.image.shape == (100, 200, 3)
    down, across = np.nonzero(_reddish(photo.image))
    assert across.max() < 100  # left of the axis
    assert across.min() == pytest.approx(100 - 100 * 7 / 10, abs=2)  # the near left edge: 7 m left, 10 m ahead
    assert down.min() == pytest.approx(50 - 100 * 1.4 / 10, abs=2)  # its top: 1.4 m above the camera
    assert photo.depth_m[60, 120] == pytest.approx(np.linalg.norm([1.6 / 0.1, 3.2, 1.6]), rel=0.06)  # grass
    assert np.isinf(photo.depth_m[5]).all()


def test_projection_agrees_with_a_picture_taken() -> None:
    world, lens = _world(), Lens(-15.0, 90.0, (100, 200))
    pose = Rigid.from_yaw(0.2, (-4.0, 0.0, 2.5))
    corner = pose.inverse() @ np.array([[6.0, 6.0, 1.5], [6.0, 6.0, 40.0]])
    pixels, inside = lens.project(corner)
    assert inside.tolist() == [True, False]
    photo = photograph(world, world.snapshot(0.0), pose, lens)
    assert photo.depth_m[tuple(pixels[0])] == pytest.approx(np.linalg.norm(corner[0]), rel=0.02)
    assert _reddish(photo.image)[tuple(pixels[0])]


def test_a_camera_does_not_stand_behind_a_wall() -> None:
    wall = Thing("wall", (Box(0.0, 0.0, 0.3, 20.0, 6.0, material="concrete"),), -5.0, 0.0)
    ways = np.array([[-9.0, 0.0, 3.0], [-2.0, 1.0, 1.0]])
    snapshot = _world(wall).snapshot(0.0)
    eye = np.array([0.0, 0.0, 1.8])
    assert viewpoint(snapshot, eye, 0.0, ways).translation.tolist() == pytest.approx([-2.0, 1.0, 2.8])
    assert viewpoint(snapshot, eye, np.pi / 2, ways).translation.tolist() == pytest.approx([0.0, -9.0, 4.8])
    assert viewpoint(snapshot, eye, 0.0, ways[:1]).translation.tolist() == pytest.approx(eye.tolist())


@pytest.mark.parametrize("wrong", [{"pitch_deg": -80.0}, {"across_deg": 170.0}, {"shape": (1, 9)}])
def test_a_lens_must_make_sense(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="pitch_deg must lie in"):
        Lens(**wrong)  # type: ignore[arg-type]


def test_every_material_has_its_color() -> None:
    rows = np.arange(len(MATERIALS), dtype=np.uint8)
    colors = surface_colors(_world(), np.full(len(rows), -1, np.int32), rows)
    assert len(np.unique(colors, axis=0)) == len(MATERIALS)


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


def test_a_row_has_a_picture_for_each_heading_and_hides_returns_behind_things() -> None:
    row = row_of(_shot(_world()))
    assert len(row.pictures) == len(HEADINGS)
    assert {picture.shape[0] for picture in row.pictures} == {SIDE}
    lone = replace(_shot(_world()), sweep=Sweep(np.zeros((0, 3), np.float32), sensor_height_m=1.5))
    changed = (row.pictures[1] != row_of(lone).pictures[1]).any(axis=-1)
    assert changed.sum() == 2  # the third return lies behind the block


def test_the_sheet_opens_and_is_the_same_each_time() -> None:
    rows = [row_of(_shot(_world())), row_of(_shot(_world(indoor=True)))]
    png = sheet(rows, HEADINGS, "two yards")
    assert png == sheet(rows, HEADINGS, "two yards")
    image = imread(io.BytesIO(png))
    assert image.shape[1] <= 1800
    assert image.shape[0] <= 2 * 330 + 110
    free = np.abs(image[..., :3] - np.array(COLORS[CellState.FREE])).max(axis=-1) < 0.02
    assert free.sum() >= 3 * SIDE**2  # two truths in each of two rows, less the points


@pytest.mark.parametrize(("preset", "kinds"), [("ugv-small", 4), ("carla-small", 5)])
def test_a_preset_shows_each_kind_of_world(preset: str, kinds: int) -> None:
    chosen = _choice(replace(preset_named(preset), seed=3))
    assert len({scene.world_kind for scene, _ in chosen}) == len(chosen) == kinds
    assert {scene.preset.seed for scene, _ in chosen} == {3}
    moving = preset_named(preset).moving
    assert {agent < moving for _, agent in chosen} == ({True, False} if preset.startswith("carla") else {True})


def test_a_row_is_the_same_each_time_and_another_for_another_seed() -> None:
    one, same, other = (
        row_of(preview_sample(*_choice(replace(preset_named("ugv-small"), seed=seed))[0])).pictures
        for seed in (1, 1, 2)
    )
    assert all((a == b).all() for a, b in zip(one, same, strict=True))
    assert all((a != b).any() for a, b in zip(one, other, strict=True))


def test_the_preview_of_a_preset_is_a_picture_small_enough_for_a_page() -> None:
    png = preview_png("nuscenes-small", 5)
    assert imread(io.BytesIO(png)).shape == (110 + 5 * 280, 1799, 4)
    assert len(png) < 1_500_000


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(ValueError, match="preset must be one of"):
        preview_png("no-such-preset", 0)
