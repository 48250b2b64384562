import io

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from viewshed.show._canvas import BLACK, WHITE, Canvas
from viewshed.show.plot import _value_pixels, color_map


def _ink(canvas: Canvas) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    return np.asarray((canvas.pixels() < 128).all(axis=-1))


def test_a_png_holds_what_is_drawn() -> None:
    page = Canvas.blank(60, 40)
    page.rectangle((10, 20, 30, 25), (1, 2, 3))
    pixels = np.asarray(Image.open(io.BytesIO(page.png())))
    np.testing.assert_array_equal(pixels, page.pixels())
    assert (pixels[20:25, 10:30] == (1, 2, 3)).all()
    assert (pixels == 255).all(axis=-1).sum() == 60 * 40 - 20 * 5


@pytest.mark.parametrize("letter", list("²°↑→…–±éüßøłžαβπЖя×≥"))
def test_letters_of_titles_are_in_the_font(letter: str) -> None:
    drawn, missing = Canvas.blank(40, 40), Canvas.blank(40, 40)
    drawn.text((10, 30), letter, 10)
    missing.text((10, 30), "漢", 10)  # is not: its place is marked
    assert _ink(missing).any()
    assert (drawn.pixels() < 200).any()
    assert (drawn.pixels() != missing.pixels()).any()


def test_a_polygon_has_its_area_and_smooth_edges_and_may_lie_outside() -> None:
    page = Canvas.blank(40, 40)
    page.polygon([(5.0, 5.0), (30.5, 9.25), (11.0, 33.0)], BLACK)
    darkness = 1 - page.pixels()[..., 0] / 255
    (ax, ay), (bx, by) = (25.5, 4.25), (6.0, 28.0)
    assert darkness.sum() == pytest.approx((ax * by - ay * bx) / 2, rel=0.02)
    before = page.pixels().copy()
    page.polygon([(500.0, 5.0), (530.0, 9.0), (510.0, 33.0)], WHITE)
    np.testing.assert_array_equal(page.pixels(), before)


@pytest.mark.parametrize("name", ["viridis", "cividis", "magma"])
def test_colors_are_those_of_matplotlib(name: str) -> None:
    expected = colormaps[name](np.arange(256))[:, :3] * 255
    assert np.abs(color_map(name) - expected).max() < 12
    assert np.abs(color_map(name) - expected).mean() < 0.6


def test_values_are_drawn_from_ahead_and_left_and_unknown_ones_white() -> None:
    values = np.array([[0.0, 0.5], [np.nan, 2.0]], np.float32)
    pixels = _value_pixels(values, "cividis", 1.0, 4)
    assert (pixels[:2, :2] == color_map("cividis")[255]).all()  # the cell ahead at the left
    assert (pixels[:2, 2:] == 255).all()
    assert (pixels[2:, :2] == color_map("cividis")[128]).all()
    assert (pixels[2:, 2:] == color_map("cividis")[0]).all()
