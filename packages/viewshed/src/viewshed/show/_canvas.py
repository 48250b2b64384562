"""A page of pixels: text, boxes, smooth polygons and pictures at places in pixels from the upper left corner.

Pillow draws. matplotlib would take a second to start in an empty home, half of it to list the fonts of the machine.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Pixels = NDArray[np.uint8]
"""(height, width, 3)"""

Color = tuple[int, int, int]

Box = tuple[float, float, float, float]
"""Left, top, right and bottom; the last two lie outside."""

BLACK, WHITE = (0, 0, 0), (255, 255, 255)

_DARK_PAGE, _DARK_INK = (30, 33, 41), (226, 228, 233)
"""Of a page that is looked at in the dark."""

_SMOOTH = 8
"""Factor by which shapes are drawn larger, then averaged: their edges are smooth."""

_POINT = 100 / 72
"""Pixels of a point of letter size."""


class Canvas:
    """Pixels that are drawn on.

    Args:
        pixels: (height, width, 3) what is there at first.
        ink: color of text and of lines around pictures.
    """

    def __init__(self, pixels: Pixels, ink: Color = BLACK) -> None:
        self._image = Image.fromarray(np.ascontiguousarray(pixels))
        self.ink = ink

    @classmethod
    def blank(cls, width: int, height: int, dark: bool = False) -> Canvas:
        """Return a white page, or a dark one with light ink."""
        page, ink = (_DARK_PAGE, _DARK_INK) if dark else (WHITE, BLACK)
        return cls(np.broadcast_to(np.array(page, np.uint8), (height, width, 3)), ink)

    @property
    def width(self) -> int:
        """Columns of pixels."""
        return self._image.width

    @property
    def height(self) -> int:
        """Rows of pixels."""
        return self._image.height

    def paste(self, other: Canvas, left: int, top: int) -> None:
        """Put another page onto this one, with a line around it."""
        right, bottom = left + other.width, top + other.height
        ImageDraw.Draw(self._image).rectangle((left - 1, top - 1, right, bottom), outline=self.ink)
        self._image.paste(other._image, (left, top))

    def text(self, at: tuple[float, float], words: str, points: float, anchor: str = "ls", bold: bool = False) -> None:
        """Write a line of text in letters of ``points``; ``anchor`` as Pillow has it: ``ls`` is left, baseline."""
        ImageDraw.Draw(self._image).text(at, words, fill=self.ink, font=_font(points, bold), anchor=anchor)

    def rectangle(self, box: Box, color: Color, outline: Color | None = None) -> None:
        """Fill a rectangle."""
        left, top, right, bottom = (round(edge) for edge in box)
        ImageDraw.Draw(self._image).rectangle((left, top, right - 1, bottom - 1), color, outline)

    def line(self, corners: Sequence[tuple[float, float]], color: Color, width: int = 1) -> None:
        """Draw a line through corners."""
        ImageDraw.Draw(self._image).line(list(corners), color, width)

    def veil(self, box: Box, radius: float = 0.0) -> None:
        """Lay a rectangle of white, with round corners and what lies below shining through, under words."""
        left, top, right, bottom = (round(edge) for edge in box)
        width, height = right - left, bottom - top
        mask = Image.new("L", (width * _SMOOTH, height * _SMOOTH))
        corners = (0, 0, width * _SMOOTH - 1, height * _SMOOTH - 1)
        ImageDraw.Draw(mask).rounded_rectangle(corners, radius * _SMOOTH, round(255 * 0.85))
        self._image.paste(WHITE, (left, top), mask.resize((width, height), Image.Resampling.BOX))

    def polygon(self, corners: Sequence[tuple[float, float]], color: Color, grow: float = 0.0) -> None:
        """Fill a polygon with smooth edges; ``grow`` widens it by this number of pixels on each side."""
        xy = np.asarray(corners, np.float64)
        (left, top), (right, bottom) = np.floor(xy.min(axis=0) - grow - 1), np.ceil(xy.max(axis=0) + grow + 1)
        width, height = int(right - left), int(bottom - top)
        if left >= self.width or top >= self.height or right <= 0 or bottom <= 0:
            return
        mask = Image.new("L", (width * _SMOOTH, height * _SMOOTH))
        draw = ImageDraw.Draw(mask)
        large = [(float(x), float(y)) for x, y in (xy - (left, top)) * _SMOOTH]
        draw.polygon(large, 255)
        if grow:
            draw.line([*large, *large[:2]], 255, round(2 * grow * _SMOOTH), joint="curve")
        self._image.paste(color, (int(left), int(top)), mask.resize((width, height), Image.Resampling.BOX))

    def pixels(self) -> Pixels:
        """Return what is drawn, (height, width, 3)."""
        return np.asarray(self._image)

    def png(self) -> bytes:
        """Return the page as a PNG."""
        buffer = io.BytesIO()
        self._image.save(buffer, "png", compress_level=4)
        return buffer.getvalue()


def text_width(words: str, points: float, bold: bool = False) -> float:
    """Return how many pixels wide a line of text is."""
    return _font(points, bold).getlength(words)


@lru_cache(maxsize=16)
def _font(points: float, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    content = resources.files("viewshed.show").joinpath("fonts", name).read_bytes()
    return ImageFont.truetype(io.BytesIO(content), points * _POINT, layout_engine=ImageFont.Layout.BASIC)
