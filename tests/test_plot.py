import io

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from viewshed import BevGrid, CellState, FovEstimate, Sweep
from viewshed.level import level_sweep
from viewshed.plot import COLORS, Panel, _raster, comparison, contact_sheet, picture

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


def test_forward_is_up_and_left_is_left() -> None:
    raster = _raster(Panel(_estimate(), ""), 1)
    assert np.allclose(raster[0, 0], COLORS[CellState.SURFACE])
    assert np.allclose(raster[-1, -1], COLORS[CellState.HIDDEN])


def test_points_are_painted_where_they_are() -> None:
    sweep = Sweep(np.array([[7.5, 7.5, 1.0], [7.5, 7.5, 1.0]], np.float32), sensor_height_m=1.5)
    raster = _raster(Panel(_estimate(), "", level_sweep(sweep, GRID)), 1)
    assert not np.allclose(raster[0, 0], COLORS[CellState.SURFACE])
    assert np.allclose(raster[0, 1], COLORS[CellState.UNKNOWN])


@pytest.mark.parametrize("count", [1, 2, 5])
def test_pictures_open_and_are_not_blank(count: int) -> None:
    panels = [Panel(_estimate(), f"panel {k}") for k in range(count)]
    rows = [[str(k), "1"] for k in range(count)]
    for png in (picture(panels[0]), comparison(panels, rows, ["a", "b"]), contact_sheet(panels, across=3)):
        image = _image(png)
        assert min(image.shape[:2]) > 100
        free = np.abs(image - np.array(COLORS[CellState.FREE])).max(axis=-1) < 0.02
        assert free.sum() > 50
