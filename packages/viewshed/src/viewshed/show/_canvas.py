"""Canvas for text, boxes, anti-aliased polygons and images; positions are pixels from the upper left corner.

Drawn with Pillow: matplotlib takes a second to start without its font cache, half of it to list the machine's fonts.
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
"""Left, top, right and bottom in pixels; right and bottom are exclusive."""

BLACK, WHITE = (0, 0, 0), (255, 255, 255)

_DARK_PAGE, _DARK_INK = (30, 33, 41), (226, 228, 233)
"""Background and text color of a dark page."""

_SUPERSAMPLING = 8
"""Factor by which shapes are drawn larger and then averaged, for anti-aliased edges."""

_POINT = 100 / 72
"""Pixels per point of font size."""


class Canvas:
    """An image to draw on.

    Args:
        pixels: (height, width, 3) initial image.
        ink: color of text and of frames around images.
    """

    def __init__(self, pixels: Pixels, ink: Color = BLACK) -> None:
        self._image = Image.fromarray(np.ascontiguousarray(pixels))
        self.ink = ink

    @classmethod
    def blank(cls, width: int, height: int, dark: bool = False) -> Canvas:
        """Return an empty white canvas, or a dark one with light ink."""
        page, ink = (_DARK_PAGE, _DARK_INK) if dark else (WHITE, BLACK)
        return cls(np.broadcast_to(np.array(page, np.uint8), (height, width, 3)), ink)

    @property
    def width(self) -> int:
        """Width in pixels."""
        return self._image.width

    @property
    def height(self) -> int:
        """Height in pixels."""
        return self._image.height

    def paste(self, other: Canvas, left: int, top: int) -> None:
        """Paste another canvas with a frame around it."""
        right, bottom = left + other.width, top + other.height
        ImageDraw.Draw(self._image).rectangle((left - 1, top - 1, right, bottom), outline=self.ink)
        self._image.paste(other._image, (left, top))

    def text(self, at: tuple[float, float], words: str, points: float, anchor: str = "ls", bold: bool = False) -> None:
        """Draw a line of text of font size ``points``; ``anchor`` as in Pillow: ``ls`` is left, baseline."""
        ImageDraw.Draw(self._image).text(at, words, fill=self.ink, font=_font(points, bold), anchor=anchor)

    def rectangle(self, box: Box, color: Color, outline: Color | None = None) -> None:
        """Fill a rectangle."""
        left, top, right, bottom = (round(edge) for edge in box)
        ImageDraw.Draw(self._image).rectangle((left, top, right - 1, bottom - 1), color, outline)

    def line(self, corners: Sequence[tuple[float, float]], color: Color, width: int = 1) -> None:
        """Draw a line through corners."""
        ImageDraw.Draw(self._image).line(list(corners), color, width)

    def veil(self, box: Box, radius: float = 0.0) -> None:
        """Fill a translucent white rectangle with round corners, as a background for text."""
        left, top, right, bottom = (round(edge) for edge in box)
        width, height = right - left, bottom - top
        mask = Image.new("L", (width * _SUPERSAMPLING, height * _SUPERSAMPLING))
        corners = (0, 0, width * _SUPERSAMPLING - 1, height * _SUPERSAMPLING - 1)
        ImageDraw.Draw(mask).rounded_rectangle(corners, radius * _SUPERSAMPLING, round(255 * 0.85))
        self._image.paste(WHITE, (left, top), mask.resize((width, height), Image.Resampling.BOX))

    def polygon(self, corners: Sequence[tuple[float, float]], color: Color, grow: float = 0.0) -> None:
        """Fill an anti-aliased polygon; ``grow`` widens it by this number of pixels on each side."""
        xy = np.asarray(corners, np.float64)
        (left, top), (right, bottom) = np.floor(xy.min(axis=0) - grow - 1), np.ceil(xy.max(axis=0) + grow + 1)
        width, height = int(right - left), int(bottom - top)
        if left >= self.width or top >= self.height or right <= 0 or bottom <= 0:
            return
        mask = Image.new("L", (width * _SUPERSAMPLING, height * _SUPERSAMPLING))
        draw = ImageDraw.Draw(mask)
        large = [(float(x), float(y)) for x, y in (xy - (left, top)) * _SUPERSAMPLING]
        draw.polygon(large, 255)
        if grow:
            draw.line([*large, *large[:2]], 255, round(2 * grow * _SUPERSAMPLING), joint="curve")
        self._image.paste(color, (int(left), int(top)), mask.resize((width, height), Image.Resampling.BOX))

    def pixels(self) -> Pixels:
        """Return the image (height, width, 3)."""
        return np.asarray(self._image)

    def png(self) -> bytes:
        """Return the image as a PNG."""
        buffer = io.BytesIO()
        self._image.save(buffer, "png", compress_level=4)
        return buffer.getvalue()


def text_width(words: str, points: float, bold: bool = False) -> float:
    """Return the width of a line of text in pixels."""
    return _font(points, bold).getlength(words)


@lru_cache(maxsize=16)
def _font(points: float, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    content = resources.files("viewshed.show").joinpath("fonts", name).read_bytes()
    return ImageFont.truetype(io.BytesIO(content), points * _POINT, layout_engine=ImageFont.Layout.BASIC)
