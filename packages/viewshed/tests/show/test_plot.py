import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from viewshed import BevGrid, CellState, FovEstimate, Sweep
from viewshed.fov.estimate import Basis
from viewshed.preprocess.leveling import level
from viewshed.show.plot import (
    COLORS,
    Panel,
    _raster,
    _title_lines,
    color_map,
    comparison,
    contact_sheet,
    draw,
    picture,
)

GRID = BevGrid(16, 8.0)


def _estimate() -> FovEstimate:
    state = np.full(GRID.shape, CellState.UNKNOWN, np.uint8)
    state[15, 15] = CellState.SURFACE  # far ahead, far left
    state[0, 0] = CellState.HIDDEN  # behind, right
    state[8:10, 8:10] = CellState.FREE
    visible = (state == CellState.SURFACE) | (state == CellState.FREE)
    return FovEstimate(GRID, visible.astype(np.float32), state)


def _image(png: bytes) -> NDArray[np.float32]:
    return np.asarray(imread(io.BytesIO(png)), dtype=np.float32)[..., :3]


def test_points_are_painted_where_they_are_and_surfaces_above_them() -> None:
    sweep = Sweep(np.array([[7.5, 7.5, 1.0], [-7.5, -7.5, 1.0]], np.float32), sensor_height_m=1.5)
    raster = _raster(Panel(_estimate(), "", level(sweep, GRID)), 16) / 255
    assert np.allclose(raster[0, 0], COLORS[CellState.SURFACE], atol=0.01)
    assert not np.allclose(raster[-1, -1], COLORS[CellState.HIDDEN], atol=0.01)
    assert np.allclose(raster[0, 1], COLORS[CellState.UNKNOWN], atol=0.01)


def test_scales_are_the_same_in_every_picture_and_doubt_shows_beside_the_probability() -> None:
    """A doubt of .5 is the brightest color, whatever the greatest doubt or deviation of the estimate is."""
    unsure = _estimate()
    sure = np.full(GRID.shape, 0.9, np.float32)
    half = np.full(GRID.shape, 0.5, np.float32)
    std = np.full(GRID.shape, 0.05, np.float32)
    brightest, darker = color_map("magma")[255] / 255, color_map("magma")[51] / 255
    shown = [_image(draw(Panel(replace(unsure, visible_prob=prob, std=std), "x"))) for prob in (half, sure)]
    found = [[_count(image, color) for color in (brightest, darker)] for image in shown]
    assert found[0][0] > 10_000 > found[1][0]  # the map of doubt, and not the bars beside the maps
    assert found[1][1] - found[0][1] > 10_000
    again = _image(draw(Panel(replace(unsure, visible_prob=sure, std=std / np.float32(2)), "x")))
    np.testing.assert_array_equal(shown[1][:450], again[:450])  # another deviation changes no other scale


def _count(image: NDArray[np.float32], color: NDArray[np.float64]) -> int:
    return int((np.abs(image - color).max(axis=-1) < 0.004).sum())


def test_a_dark_page_has_the_same_maps() -> None:
    leveled = level(Sweep(np.array([[7.5, 7.5, 1.0]], np.float32), sensor_height_m=1.5), GRID)
    prob = np.full(GRID.shape, 0.7, np.float32)
    for estimate in (_estimate(), replace(_estimate(), visible_prob=prob)):
        light, dark = (_image(draw(Panel(estimate, "x", leveled), dark=page)) for page in (False, True))
        assert light.shape == dark.shape
        assert light[0, 0].min() == 1.0
        assert dark[0, 0].max() < 0.2
        np.testing.assert_array_equal(light[50:650, 20:620], dark[50:650, 20:620])


@pytest.mark.parametrize("count", [1, 2, 5])
def test_pictures_open_and_are_not_blank(count: int) -> None:
    panels = [Panel(_estimate(), f"panel {k}") for k in range(count)]
    rows = [[str(k), "1"] for k in range(count)]
    for png in (picture(panels[0]), comparison(panels, rows, ["a", "b"]), contact_sheet(panels, across=3)):
        image = _image(png)
        assert min(image.shape[:2]) > 100
        free = np.abs(image - np.array(COLORS[CellState.FREE])).max(axis=-1) < 0.02
        assert free.sum() > 50


@pytest.mark.parametrize("cells", [1, 7, 512, 1000])
def test_grids_of_any_size_make_a_picture(cells: int) -> None:
    grid = BevGrid(cells, 5.0, (3.0, -2.0))
    state = np.full(grid.shape, CellState.FREE, np.uint8)
    image = _image(picture(Panel(FovEstimate(grid, np.ones(grid.shape, np.float32), state), "x" * 300)))
    assert (np.abs(image - np.array(COLORS[CellState.FREE])).max(axis=-1) < 0.02).mean() > 0.5


def test_a_picture_says_what_the_estimate_rests_on() -> None:
    found = replace(_estimate(), basis=Basis(1.84, "estimated", 0.63, 0.04, 0.07, 80.0))
    assert _title_lines(Panel(found, "name\nsummary")) == [
        "name", "summary", "sensor 1.84 m above the ground (estimated, 63% of the near ground agrees), reach 80 m",
        "4% of the view over ground unsure by 0.5 m, 7% by inferred beams",
    ]  # fmt: skip
    assert _title_lines(Panel(_estimate(), "name")) == ["name"]
    blind = replace(found, visible_prob=np.zeros(GRID.shape, np.float32))
    assert len(_title_lines(Panel(blind, "name"))) == 2
    # The page grows by the lines and by nothing else.
    bare, told = (_image(picture(Panel(one, "name"))) for one in (_estimate(), found))
    assert told.shape[0] - bare.shape[0] == 2 * 18
    np.testing.assert_array_equal(told[-820:], bare[-820:])
