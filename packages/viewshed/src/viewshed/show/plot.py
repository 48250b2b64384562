"""Bird's-eye pictures of estimates; forward is up, left is left."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import THRESHOLD, CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.monitor.report import IntegrityReport, cells_of_sectors
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.show._canvas import BLACK, WHITE, Canvas, Color, Pixels, text_width

COLORS = {
    CellState.UNKNOWN: (0.93, 0.93, 0.93),
    CellState.FREE: (0.62, 0.82, 0.95),
    CellState.SURFACE: (0.84, 0.37, 0.0),
    CellState.HIDDEN: (0.42, 0.42, 0.47),
}
"""Colors of the states, distinguishable with all common color blindness (after Okabe and Ito 2008)."""

WORDS = {
    CellState.FREE: "free: visible, nothing stands there",
    CellState.SURFACE: "surface: visible, first thing the beams meet",
    CellState.HIDDEN: "hidden: blocked by something nearer",
    CellState.UNKNOWN: "unknown: no evidence",
}

HEIGHTS_M = (0.0, 3.0)
"""Range of heights above local ground covered by the colors of points."""

_EDGE = (0.0, 0.22, 0.5)

_LOW_M = 0.3

_LARGE = 500

_TITLE_LETTERS = 100

_MAX_DOUBT = 0.5
"""Doubt with the brightest color: a half is a guess."""

_MAX_STD = 0.25
"""Standard deviation with the brightest color; few cells exceed it."""

_LINE = 18
"""Height of a line of a title in pixels."""

_ROW = 26
"""Height of a row of a table in pixels."""

_HEAD_COLOR, _LINE_COLOR = (237, 237, 237), (204, 204, 204)
"""Colors of a table: background of its header, lines between its cells."""

_SUSPECT = (214, 39, 40)
"""Color of suspect sectors."""

_MAX_SURPRISE = 5.0
"""Surprise with the brightest color: once in a hundred thousand benign sectors."""

_COLOR_STEPS = {
    "viridis": "440154 481769 472a7a 433d84 3d4e8a 355e8d 2e6d8e 297b8e 23898e 1f978b 21a585 2eb37c 46c06f 65cb5e "
               "89d548 b0dd2f d8e219 fde725",
    "cividis": "00224e 002d68 163770 2e416d 3f4c6c 4e566c 5c616e 696b71 767676 838179 928c78 a09875 afa471 bfb06b "
               "cfbd62 dfca57 f0d846 fee838",
    "magma": "000004 090720 1a1042 311165 4a1079 621980 792282 912b81 aa337d c23b75 d9466b ec5860 f7725c fc8e64 "
             "feaa74 fec68a fde2a3 fcfdbf",
}  # fmt: skip
"""Every fifteenth color of matplotlib's color maps (public domain); the others are interpolated."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture: an estimate, its title, the sweep whose points are drawn or None, and the threshold of the edge."""

    estimate: FovEstimate
    title: str
    leveled: LeveledSweep | None = None
    threshold: float = THRESHOLD


def draw(panel: Panel, dark: bool = False) -> bytes:
    """Return a PNG of one estimate: its states, and maps of probability and doubt unless probabilities are all 0 or 1.

    Args:
        panel: the estimate to draw.
        dark: dark background; the colors of the maps are the same.
    """
    prob = panel.estimate.visible_prob
    is_mask = bool(((prob == 0.0) | (prob == 1.0)).all())
    return picture(panel, dark) if is_mask else maps_picture(panel, dark)


def draw_estimate(estimate: FovEstimate, leveled: LeveledSweep | None, heading: str, dark: bool) -> bytes:
    """Return a PNG of a single estimate; see :meth:`FovEstimate.plot`."""
    return draw(Panel(estimate, heading, leveled, estimate.threshold), dark)


def picture(panel: Panel, dark: bool = False) -> bytes:
    """Return a PNG of one estimate: states, edge of the view, points by height, sensor, scale bar, legend."""
    side, lines = 768, _title_lines(panel)
    top = _LINE * len(lines) + 16
    page = Canvas.blank(side + 104, side + top + 72, dark)
    page.paste(_map(panel, side), 20, top)
    _title(page, lines, 20, top, 10)
    _legend(page, 2, panel.estimate)
    if panel.leveled is not None:
        _height_bar(page, side + 46, top + 198, 18, 360)
    return page.png()


def maps_picture(panel: Panel, dark: bool = False) -> bytes:
    """Return a PNG of the states and, beside them, maps of probability, doubt and (if known) standard deviation.

    Color scales are the same in every picture. The image is narrow enough for its text to stay legible in a document.
    """
    estimate, side, lines = panel.estimate, 640, _title_lines(panel)
    maps = [
        ("probability of visible", estimate.visible_prob, "cividis", 1.0),
        ("doubt: chance that the answer is wrong", estimate.doubt(), "magma", _MAX_DOUBT),
    ]
    if estimate.std is not None and np.isfinite(estimate.std).any():
        maps.append(("deviation over the passes", estimate.std, "magma", _MAX_STD))
    above, gap = 22 * len(lines) + 16, 34
    map_side = (side - gap * (len(maps) - 1)) // len(maps)
    page = Canvas.blank(side + max(map_side + 130, 370) + 20, side + above + 124, dark)
    page.paste(_map(panel, side), 20, above)
    _title(page, lines, 20, above, 11, 22)
    for k, (title, values, colors, top) in enumerate(maps):
        left, upper = side + 40, above + k * (map_side + gap)
        page.paste(Canvas(_value_pixels(values, colors, top, map_side)), left, upper)
        page.text((left, upper - 8), title, 10)
        _color_bar(page, colors, _ticks(top), top, (left + map_side + 10, upper, 14, map_side))
    if panel.leveled is not None:
        _height_line(page, page.height - 82)
    _legend(page, 2, estimate)
    return page.png()


def monitor_picture(
    panel: Panel, report: IntegrityReport, names: Sequence[str], surprises: NDArray[np.float32]
) -> bytes:
    """Return a PNG of a monitor's report: the map with suspect sectors in red, and all evidence by azimuth.

    Args:
        panel: the estimate and its sweep.
        report: of the monitor.
        names: (E,) of the evidence.
        surprises: (E, SECTORS) -log10 of the share of benign sectors that are as suspicious; NaN where it abstains.
    """
    side, row = 560, 22
    lines = [*_title_lines(panel)]
    above = _LINE * len(lines) + 16
    names_width = round(max(text_width(name.replace("_", " "), 9) for name in names)) + 16
    left = side + 40 + names_width
    strip = np.repeat(surprises[:, ::-1], 5, axis=1)  # azimuth from +180° to -180°, so that left is left
    reasons = [part for number, reason in enumerate(report.reasons, 1) for part in _fit(f"{number}. {reason}")]
    reasons = reasons or ["nothing unusual"]
    table_bottom = above + row * len(names)
    below = max(above + side, table_bottom + 60 + _LINE * len(reasons))
    width = left + max(strip.shape[1] + 150, round(max(text_width(line, 9) for line in reasons)) - names_width + 20)
    page = Canvas.blank(width, below + 68)
    # 1. The map, with the suspect sectors in red.
    suspect = cells_of_sectors(
        report.suspect, BevGrid(side, panel.estimate.grid.half_extent_m, panel.estimate.grid.offset_m)
    )
    pixels = _map(panel, side).pixels().copy()
    red = suspect[::-1, ::-1]
    pixels[red] = (0.55 * pixels[red] + 0.45 * np.array(_SUSPECT)).astype(np.uint8)
    page.paste(Canvas(pixels), 20, above)
    _title(page, lines, 20, above, 9)
    # 2. Surprise of all evidence by azimuth.
    for number, name in enumerate(names):
        page.text((left - 8, above + row * number + 15), name.replace("_", " "), 9, "rs")
        values = np.repeat(strip[number][None], row - 4, axis=0)
        known = np.isfinite(values)
        shades = color_map("magma")[(np.clip(np.where(known, values, 0) / _MAX_SURPRISE, 0, 1) * 255).astype(np.intp)]
        pixels = np.where(known[..., None], shades, np.uint8(230)).astype(np.uint8)
        page.paste(Canvas(pixels), left, above + row * number)
    for share, words in ((0.0, "behind"), (0.25, "left"), (0.5, "ahead"), (0.75, "right"), (1.0, "behind")):
        page.text((left + share * strip.shape[1], table_bottom + 12), words, 8, "ms")
    ticks = [(float(value), f"1 in {10**value:,}") for value in range(1, 6)]
    _color_bar(page, "magma", ticks, _MAX_SURPRISE, (left + strip.shape[1] + 12, above, 14, row * len(names) - 4))
    page.text((left + strip.shape[1] + 12, above - 8), "benign sectors", 8)
    # 3. The reasons, the strongest first.
    for number, line in enumerate(reasons):
        page.text((side + 40, table_bottom + 44 + _LINE * number), line, 9)
    _legend(page, 4, panel.estimate)
    return page.png()


def comparison(panels: Sequence[Panel], rows: Sequence[Sequence[str]], header: Sequence[str]) -> bytes:
    """Return a PNG of several estimates side by side above a table of ``rows`` (one for each panel).

    A line above the table gives the sensor's height, if the first estimate states it.
    """
    across, side = len(panels) if len(panels) < 4 else 2 if len(panels) == 4 else 3, 400
    down = -(-len(panels) // across)
    basis = panels[0].estimate.basis
    table_top, table_height = down * (side + 36) + (10 if basis is None else 10 + _LINE), _ROW * (len(rows) + 1)
    columns = _column_widths(rows, header)
    width = max(across * (side + 12) + 12, sum(columns) + 24)
    page = Canvas.blank(width, table_top + table_height + 60)
    margin = (width - across * (side + 12) + 12) // 2
    for k, panel in enumerate(panels):
        row, column = divmod(k, across)
        left, top = margin + column * (side + 12), 28 + row * (side + 36)
        page.paste(_map(panel, side), left, top)
        page.text((left + side / 2, top - 8), panel.title, 10, "ms")
    if basis is not None:
        page.text((12, table_top - 8), basis.height_line, 9)
    _table(page, rows, header, columns, table_top)
    _legend(page, 4 if across == 3 else 2)
    return page.png()


def contact_sheet(panels: Sequence[Panel], across: int = 7, side: int = 168) -> bytes:
    """Return a PNG of thumbnails of ``side`` pixels, one for each panel, ``across`` in a row."""
    down = -(-max(len(panels), 1) // across)
    page = Canvas.blank(across * (side + 6) + 6, down * (side + 32) + 52)
    for k, panel in enumerate(panels):
        row, column = divmod(k, across)
        left, top = 6 + column * (side + 6), 30 + row * (side + 32)
        page.paste(_map(panel, side), left, top)
        for number, line in enumerate(reversed(panel.title.splitlines())):
            page.text((left + side / 2, top - 4 - 10 * number), line, 6.5, "ms")
    _legend(page, 4)
    return page.png()


def _title(page: Canvas, lines: Sequence[str], left: int, top: int, points: float, spacing: int = _LINE) -> None:
    """Draw lines of text above a picture, the last one 8 pixels above ``top``."""
    for number, line in enumerate(reversed(lines)):
        page.text((left, top - 8 - spacing * number), line, points)


def _title_lines(panel: Panel) -> list[str]:
    """Return the lines above a picture: its title, and the basis of the estimate if it is known."""
    basis = panel.estimate.basis
    height = () if basis is None else (basis.height_line,)
    view = () if basis is None or not panel.estimate.visible().any() else (basis.view_line,)
    return [part for line in (*panel.title.splitlines(), *height, *view) for part in _fit(line)]


def _fit(line: str) -> list[str]:
    """Wrap a line to the width of the picture; text beyond two lines is left out."""
    return textwrap.wrap(line, _TITLE_LETTERS, max_lines=2, placeholder=" …")


def map_picture(panel: Panel, pixels: int) -> Canvas:
    """Return the square picture of a joint estimate without a sensor symbol: states, edge and scale bar."""
    canvas = Canvas(_raster(panel, pixels))
    _scale_bar(canvas, 2 * panel.estimate.grid.half_extent_m)
    return canvas


def _map(panel: Panel, pixels: int) -> Canvas:
    """Return the square picture of an estimate: states, edge, points, sensor symbol, scale bar and direction."""
    canvas, grid = map_picture(panel, pixels), panel.estimate.grid
    (x0, y0), side = grid.origin_m, 2 * grid.half_extent_m
    scale = pixels / side
    # The sensor symbol is an arrow at the origin of the level frame that points forward.
    column, row = (y0 + side) * scale, (x0 + side) * scale
    size = pixels * (0.012 if pixels > 300 else 0.03)
    arrow = [(0.0, -1.5 * size), (size, size), (0.0, 0.5 * size), (-size, size)]
    corners = [(column + right, row + down) for right, down in arrow]
    canvas.polygon(corners, WHITE, grow=1.0)
    canvas.polygon(corners, BLACK)
    if pixels >= _LARGE:
        _forward_mark(canvas)
    return canvas


def _raster(panel: Panel, pixels: int) -> Pixels:
    """Return the picture as (pixels, pixels, 3) uint8: row 0 is farthest ahead, column 0 farthest left."""
    estimate = panel.estimate
    palette = _bytes(np.array([COLORS[CellState(state)] for state in range(len(CellState))]))
    nearest = (np.arange(pixels) * estimate.grid.cells) // pixels
    image = palette[estimate.state[nearest][:, nearest]]
    if pixels >= 2 * estimate.grid.cells:
        image[_edge(estimate.visible(panel.threshold)[nearest][:, nearest])] = _bytes(np.array(_EDGE))
    if panel.leveled is not None:
        fine = BevGrid(pixels, estimate.grid.half_extent_m, estimate.grid.offset_m)
        _paint_points(image, panel.leveled, fine)
        # Draw SURFACE cells again, because the points hide them.
        surface = estimate.state[nearest][:, nearest] == CellState.SURFACE
        image[surface] = palette[CellState.SURFACE]
    return image[::-1, ::-1]


def _edge(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels of a mask that have a neighbor outside it; the border of the picture is no edge."""
    padded = np.pad(mask, 1, mode="edge")
    inner = padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
    return mask & ~inner


def _paint_points(image: Pixels, leveled: LeveledSweep, fine: BevGrid) -> None:
    """Draw points in the color of their height, higher ones on top; obstacles take 2 × 2 pixels in large pictures."""
    low, high = HEIGHTS_M
    order = np.argsort(leveled.height_m, kind="stable")
    cells, inside = fine.index(leveled.points[order])
    height_m = leveled.height_m[order][inside]
    i, j = cells[inside].T
    colors = color_map("viridis")[(np.clip((height_m - low) / (high - low), 0, 1) * 255).astype(np.intp)]
    image[i, j] = colors
    if len(image) < _LARGE:
        return
    tall = slice(int(np.searchsorted(height_m, _LOW_M)), None)
    last = len(image) - 1
    for di, dj in ((0, 1), (1, 0), (1, 1)):
        image[np.minimum(i[tall] + di, last), np.minimum(j[tall] + dj, last)] = colors[tall]


@lru_cache(maxsize=3)
def color_map(name: str) -> Pixels:
    """Return the (256, 3) uint8 colors of ``viridis``, ``cividis`` or ``magma``, from low to high."""
    steps = np.array([list(bytes.fromhex(step)) for step in _COLOR_STEPS[name].split()])
    at = np.linspace(0, 255, len(steps))
    return np.stack([np.interp(np.arange(256), at, channel) for channel in steps.T], axis=1).round().astype(np.uint8)


def _value_pixels(values: NDArray[np.float32], colors: str, top: float, pixels: int) -> Pixels:
    """Return values (cells, cells) from 0 to ``top`` as (pixels, pixels, 3) uint8; white where not finite."""
    nearest = (np.arange(pixels) * len(values)) // pixels
    image = values[nearest][:, nearest][::-1, ::-1]
    known = np.isfinite(image)
    level = np.clip(np.where(known, image, 0.0) / top * 256, 0, 255).astype(np.intp)
    return np.where(known[..., None], color_map(colors)[level], np.uint8(255)).astype(np.uint8)


def _bytes(colors: NDArray[np.float64]) -> Pixels:
    return (colors * 255).round().astype(np.uint8)


def _scale_bar(canvas: Canvas, side_m: float) -> None:
    """Draw a scale bar of a round length in the lower right corner."""
    pixels, points = canvas.width, 8.0 if canvas.width > 300 else 6.0
    length_m = _round_length(side_m / 4)
    length, pad, letters = length_m / side_m * pixels, max(0.012 * pixels, 4.0), 1.6 * points
    right = bottom = 0.97 * pixels
    canvas.veil((right - length - pad, bottom - letters - 2 * pad, right + pad, bottom + pad))
    canvas.rectangle((right - length, bottom - 1.5, right, bottom + 1.5), BLACK)
    canvas.text((right - length / 2, bottom - pad), f"{length_m:g} m", points, "ms")


def _round_length(limit_m: float) -> float:
    """Return the longest of 1, 2, 5 times a power of ten meters that is not above ``limit_m``.

    >>> _round_length(32.0), _round_length(8.0)
    (20.0, 5.0)
    """
    power = 10.0 ** np.floor(np.log10(limit_m))
    return float(max(step * power for step in (1, 2, 5) if step * power <= limit_m * (1 + 1e-9)))


def _forward_mark(canvas: Canvas) -> None:
    words, left, top = "↑ forward", 0.02 * canvas.width, 0.02 * canvas.width
    canvas.veil((left - 5, top - 4, left + text_width(words, 9) + 5, top + 17), radius=4)
    canvas.text((left, top + 12), words, 9)


def _column_widths(rows: Sequence[Sequence[str]], header: Sequence[str]) -> list[int]:
    """Return the width of each column of a table in pixels: its widest text plus padding."""
    heads = [text_width(words, 9, bold=True) for words in header]
    cells = [[text_width(words, 9) for words in row] for row in rows]
    return [round(max(column)) + 28 for column in zip(heads, *cells, strict=True)]


def _table(
    page: Canvas, rows: Sequence[Sequence[str]], header: Sequence[str], columns: Sequence[int], top: int
) -> None:
    """Draw a table over the width of the page; the first column is left-aligned, the others right-aligned."""
    room = page.width - 24 - sum(columns)
    edges = 12 + np.concatenate([[0], np.cumsum(columns)]) + np.arange(len(columns) + 1) * room // len(columns)
    for k, row in enumerate([header, *rows]):
        above, below = top + k * _ROW, top + (k + 1) * _ROW
        for j, (left, right) in enumerate(pairwise(edges.tolist())):
            page.rectangle((left, above, right + 1, below + 1), _HEAD_COLOR if k == 0 else WHITE, _LINE_COLOR)
            if k == 0:
                page.text(((left + right) / 2, below - 9), row[j], 9, "ms", bold=True)
            elif j == 0:
                page.text((left + 10, below - 9), row[j], 9)
            else:
                page.text((right - 10, below - 9), row[j], 9, "rs")


def _legend(page: Canvas, columns: int, of: FovEstimate | None = None) -> None:
    """Draw the legend of the states, with their shares, at the bottom of the page; in two columns if it is narrow."""
    entries = [(state, words if of is None else f"{of.share(state):.0%} {words}") for state, words in WORDS.items()]
    widest = max(text_width(words, 8.0) for _, words in entries)
    if columns * (widest + 52) > page.width:
        columns = 2
    wide = min(page.width / 96, 12.0) if columns == 2 else 0.0  # font size that stays legible in a document
    points = wide if 2 * (widest * wide / 8 + 52) < page.width and wide > 8 else 8.0 if page.width > 640 else 6.5
    spacing = max(18, round(1.9 * points))
    down = -(-len(entries) // columns)
    across = [entries[k * down : (k + 1) * down] for k in range(columns)]
    widths = [30 + max(text_width(words, points) for _, words in column) for column in across]
    left, top = (page.width - sum(widths) - 22 * (columns - 1)) / 2, page.height - 13 - spacing * (down - 1)
    for column, width in zip(across, widths, strict=True):
        for k, (state, words) in enumerate(column):
            foot = top + spacing * k
            page.rectangle((left, foot - round(points), left + 23, foot), _color(COLORS[state]), page.ink)
            page.text((left + 30, foot), words, points)
        left += width + 22


def _height_bar(page: Canvas, left: int, top: int, width: int, height: int) -> None:
    """Draw the color bar of the points' heights."""
    low, high = HEIGHTS_M
    ticks = [(value, f"{value:g}") for value in np.arange(low, high + 0.5)]
    _color_bar(page, "viridis", ticks, high - low, (left, top, width, height))
    for number, line in enumerate(["ground, m", "above", "height", "points:"]):
        page.text((left + width / 2, top - 10 - 14 * number), line, 8, "ms")


def _height_line(page: Canvas, top: int) -> None:
    """Draw the color bar of the points' heights as a horizontal line."""
    low, high = HEIGHTS_M
    before, after, points, width = f"points by their height: {low:g} m", f"{high:g} m and more above ground", 11.0, 160
    left = (page.width - text_width(before, points) - text_width(after, points) - width - 20) / 2
    at = round(left + text_width(before, points) + 10)
    page.text((left, top + 13), before, points)
    shades = color_map("viridis")[(np.arange(width) * 256) // width]
    page.paste(Canvas(np.repeat(shades[None], 14, axis=0)), at, top)
    page.text((at + width + 10, top + 13), after, points)


def _color_bar(
    page: Canvas, colors: str, ticks: Sequence[tuple[float, str]], top_value: float, place: tuple[int, int, int, int]
) -> None:
    """Draw a color bar from 0 to ``top_value`` at (left, top, width, height), with ticks on its right."""
    left, top, width, height = place
    shades = color_map(colors)[(np.arange(height)[::-1] * 256) // height]
    page.paste(Canvas(np.repeat(shades[:, None], width, axis=1)), left, top)
    for value, words in ticks:
        row = top + height * (1 - value / top_value)
        page.rectangle((left + width, row, left + width + 5, row + 1), page.ink)
        page.text((left + width + 8, row), words, 8, "lm")


def _ticks(top: float) -> list[tuple[float, str]]:
    """Return four to ten round values from 0 to ``top``, with their labels.

    >>> _ticks(0.25)
    [(0.0, '0.00'), (0.05, '0.05'), (0.1, '0.10'), (0.15, '0.15'), (0.2, '0.20'), (0.25, '0.25')]
    """
    step = _round_length(top / 4)
    digits = max(0, -int(np.floor(np.log10(step))))
    values = [round(k * step, digits) for k in range(int(top / step * (1 + 1e-9)) + 1)]
    return [(value, f"{value:.{digits}f}") for value in values]


def _color(shares: tuple[float, float, float]) -> Color:
    red, green, blue = _bytes(np.array(shares)).tolist()
    return red, green, blue
