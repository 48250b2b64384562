"""Pictures of detections: points and boxes seen from above, forward is up, left is left."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import Detections, ObjectKind
from viewshed.objects.matching import corners_of
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.show._canvas import BLACK, Canvas, Color

KIND_COLORS: Mapping[ObjectKind, Color] = {
    ObjectKind.CAR: (213, 94, 0), ObjectKind.TRUCK: (204, 121, 167), ObjectKind.PEDESTRIAN: (0, 114, 178),
    ObjectKind.CYCLIST: (0, 158, 115), ObjectKind.OTHER: (150, 120, 0),
}  # fmt: skip
"""Colors of the outlines (Okabe and Ito 2008)."""

_GROUND, _STANDING = np.array([214, 214, 214], np.uint8), np.array([70, 70, 78], np.uint8)

_STANDING_M = 0.3

_MARGIN, _TOP, _BOTTOM = 16, 34, 40


def draw_detections(
    leveled: LeveledSweep,
    found: Detections,
    true: NDArray[np.float64] | None = None,
    *,
    title: str = "",
    half_extent_m: float = 40.0,
    side: int = 800,
) -> bytes:
    """Return a PNG of the points of a leveled sweep with the boxes that were found in it.

    Args:
        leveled: the sweep.
        found: outlined in the color of their kind, with a tick where they head (or the opposite: a box does not say).
        true: (K, 7) boxes that are filled with light green below the points.
        title: one line above.
        half_extent_m: half the side of what is shown.
        side: of the map, in pixels.
    """
    scale = side / (2 * half_extent_m)

    def at(xy: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.stack([(half_extent_m - xy[..., 1]) * scale, (half_extent_m - xy[..., 0]) * scale], axis=-1)

    # 1. True boxes below, then points: the ground light, what stands on it dark.
    page = Canvas.blank(side, side)
    for corners in at(corners_of(np.zeros((0, 7)) if true is None else true)):
        page.polygon([(x, y) for x, y in corners], (190, 226, 190))
    pixels = page.pixels().copy()
    standing = leveled.height_m >= _STANDING_M
    for rows, color in ((~standing, _GROUND), (standing, _STANDING)):
        column, row = np.floor(at(leveled.points[rows, :2])).astype(np.intp).T
        inside = (column >= 0) & (column < side) & (row >= 0) & (row < side)
        pixels[row[inside], column[inside]] = color
    # 2. Outlines, and a cross for the sensor.
    picture = Canvas(pixels)
    for corners, kind in zip(at(corners_of(found.boxes)), found.kinds, strict=True):
        _outline(picture, corners, KIND_COLORS[ObjectKind(int(kind))])
    middle = side / 2
    for across, along in ((6, 1), (1, 6)):
        picture.rectangle((middle - across, middle - along, middle + across, middle + along), BLACK)
    # 3. The page: title, map, and what the colors mean.
    whole = Canvas.blank(side + 2 * _MARGIN, side + _TOP + _BOTTOM)
    whole.text((_MARGIN, _TOP - 12), title, 10)
    whole.paste(picture, _MARGIN, _TOP)
    left = float(_MARGIN)
    for kind, filling in KIND_COLORS.items():
        count = int((found.kinds == kind).sum())
        whole.rectangle((left, side + _TOP + 14, left + 14, side + _TOP + 28), filling)
        whole.text((left + 20, side + _TOP + 26), f"{kind.name.lower()} {count}", 9)
        left += 130
    whole.text((side + _MARGIN, side + _TOP + 26), f"{2 * half_extent_m:g} m wide", 9, anchor="rs")
    return whole.png()


def _outline(picture: Canvas, corners: NDArray[np.float64], color: Color) -> None:
    """Draw the four sides of a box, and a line from its middle to its front, as thin polygons."""
    front = (corners[0] + corners[3]) / 2
    lines = [(corners[k], corners[(k + 1) % 4]) for k in range(4)] + [(corners.mean(axis=0), front)]
    for begin, end in lines:
        away = end - begin
        across = np.array([-away[1], away[0]]) / max(float(np.hypot(*away)), 1e-6)
        sides = (begin + across, end + across, end - across, begin - across)
        picture.polygon([(float(x), float(y)) for x, y in sides], color)
