"""Pictures of estimates, seen from above: forward is up, left is left. The only module that imports matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from viewshed.fov.estimate import THRESHOLD, CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import LeveledSweep

Image = NDArray[np.uint8]

COLORS = {
    CellState.UNKNOWN: (0.93, 0.93, 0.93),
    CellState.FREE: (0.62, 0.82, 0.95),
    CellState.SURFACE: (0.84, 0.37, 0.0),
    CellState.HIDDEN: (0.42, 0.42, 0.47),
}
"""Colors of the states; distinguishable with every common color blindness (after Okabe and Ito 2008)."""

WORDS = {
    CellState.FREE: "free: visible, nothing stands there",
    CellState.SURFACE: "surface: visible, first thing the beams meet",
    CellState.HIDDEN: "hidden: blocked by something nearer",
    CellState.UNKNOWN: "unknown: no evidence",
}

HEIGHTS_M = (0.0, 3.0)
"""Heights above local ground between which points are colored."""

_EDGE = (0.0, 0.22, 0.5)

_LOW_M = 0.3

_LARGE = 500

_DPI = 100

_TITLE_LETTERS = 100

_COLUMN = 178
"""Least width of a table's column in pixels."""

_LINE = 18
"""Height of a line of a title in pixels."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture of several: an estimate, its heading, the sweep's points or None, and where the edge is drawn."""

    estimate: FovEstimate
    title: str
    leveled: LeveledSweep | None = None
    threshold: float = THRESHOLD


@dataclass(frozen=True, slots=True)
class _Page:
    """A figure on which places are given in pixels from the upper left corner."""

    figure: Figure
    width: int
    height: int

    @classmethod
    def blank(cls, width: int, height: int) -> _Page:
        return cls(Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI), width, height)

    def axes(self, left: int, top: int, width: int, height: int) -> Axes:
        bottom = self.height - top - height
        place = (left / self.width, bottom / self.height, width / self.width, height / self.height)
        axes = self.figure.add_axes(place)
        axes.set_xticks([])
        axes.set_yticks([])
        return axes

    def png(self) -> bytes:
        buffer = io.BytesIO()
        FigureCanvasAgg(self.figure)
        self.figure.savefig(buffer, format="png", pil_kwargs={"compress_level": 4})
        return buffer.getvalue()


def draw(panel: Panel) -> bytes:
    """Return a PNG of one estimate: of its states, and of probability and deviation where they say more than these."""
    prob = panel.estimate.visible_prob
    is_mask = bool(((prob == 0.0) | (prob == 1.0)).all())
    return picture(panel) if is_mask else maps_picture(panel)


def picture(panel: Panel) -> bytes:
    """Return a PNG of one estimate: states, edge of the view, points by height, sensor, scale bar, legend."""
    side, lines = 768, _title_lines(panel)
    top = _LINE * len(lines) + 16
    page = _Page.blank(side + 104, side + top + 72)
    axes = page.axes(20, top, side, side)
    _draw(axes, panel, side)
    axes.set_title("\n".join(lines), fontsize=10, loc="left", linespacing=1.4)
    shares = {state: f"{panel.estimate.share(state):.0%} " for state in CellState}
    _legend(page, 2, shares)
    if panel.leveled is not None:
        _height_bar(page, (side + 46, top + 198, 18, 360))
    return page.png()


def maps_picture(panel: Panel) -> bytes:
    """Return a PNG of states, probability and, where the estimate has one, deviation side by side."""
    estimate, side, lines = panel.estimate, 520, _title_lines(panel)
    above = _LINE * len(lines) + 16
    maps = {"probability of visible": (estimate.visible_prob, "cividis", 1.0)}
    if estimate.std is not None and np.isfinite(estimate.std).any():
        top = max(float(np.nanmax(estimate.std)), 1e-3)
        maps["standard deviation of the probability"] = (estimate.std, "magma", top)
    page = _Page.blank(20 + (len(maps) + 1) * (side + 20) + 70 * len(maps), side + above + 68)
    axes = page.axes(20, above, side, side)
    _draw(axes, panel, side)
    axes.set_title("\n".join(lines), fontsize=9, loc="left", linespacing=1.4)
    for k, (title, (values, colors, top)) in enumerate(maps.items()):
        left = side + 40 + k * (side + 90)
        axes = page.axes(left, above, side, side)
        drawn = axes.imshow(
            values[::-1, ::-1], cmap=colors, vmin=0.0, vmax=top, interpolation="nearest", aspect="auto"
        )  # fmt: skip
        axes.set_title(title, fontsize=10, loc="left")
        bar = page.axes(left + side + 10, above, 14, side)
        page.figure.colorbar(drawn, cax=bar).ax.tick_params(labelsize=8)
    _legend(page, 4, {state: f"{estimate.share(state):.0%} " for state in CellState})
    return page.png()


def comparison(panels: Sequence[Panel], rows: Sequence[Sequence[str]], header: Sequence[str]) -> bytes:
    """Return a PNG of several estimates side by side above a table of ``rows`` (one for each panel).

    Above the table stand the height of the sensor and its reach, where the first estimate says them.
    """
    across, side = len(panels) if len(panels) < 4 else 2 if len(panels) == 4 else 3, 400
    down = -(-len(panels) // across)
    basis = panels[0].estimate.basis
    table_top, table_height = down * (side + 36) + (10 if basis is None else 10 + _LINE), 26 * (len(rows) + 1)
    page = _Page.blank(max(across * (side + 12) + 12, _COLUMN * len(header)), table_top + table_height + 60)
    for k, panel in enumerate(panels):
        row, column = divmod(k, across)
        axes = page.axes(12 + column * (side + 12), 28 + row * (side + 36), side, side)
        _draw(axes, panel, side)
        axes.set_title(panel.title, fontsize=10)
    axes = page.axes(12, table_top, page.width - 24, table_height)
    axes.axis("off")
    axes.set_title("" if basis is None else basis.height_line, fontsize=9, loc="left")
    _table(axes, rows, header)
    _legend(page, 4 if across == 3 else 2)
    return page.png()


def contact_sheet(panels: Sequence[Panel], across: int = 7, side: int = 168) -> bytes:
    """Return a PNG with one small picture of ``side`` pixels for each panel, ``across`` in a row."""
    down = -(-max(len(panels), 1) // across)
    page = _Page.blank(across * (side + 6) + 6, down * (side + 32) + 40)
    for k, panel in enumerate(panels):
        row, column = divmod(k, across)
        axes = page.axes(6 + column * (side + 6), 30 + row * (side + 32), side, side)
        _draw(axes, panel, side)
        axes.set_title(panel.title, fontsize=6.5, pad=2)
    _legend(page, 4)
    return page.png()


def _title_lines(panel: Panel) -> list[str]:
    """Return the lines above a picture: its title, and what the estimate rests on where that is known."""
    basis = panel.estimate.basis
    height = () if basis is None else (basis.height_line,)
    view = () if basis is None or not panel.estimate.visible().any() else (basis.view_line,)
    return [_fit(line) for line in (*panel.title.splitlines(), *height, *view)]


def _fit(line: str) -> str:
    """Return a line that fits above the picture, its middle left out if need be."""
    half = _TITLE_LETTERS // 2
    return line if len(line) <= _TITLE_LETTERS else f"{line[: half - 1]} … {line[-half + 2 :]}"


def _draw(axes: Axes, panel: Panel, pixels: int) -> None:
    grid = panel.estimate.grid
    (x0, y0), side = grid.origin_m, 2 * grid.half_extent_m
    axes.imshow(
        _raster(panel, pixels), extent=(y0 + side, y0, x0, x0 + side), interpolation="nearest", aspect="auto"
    )  # fmt: skip
    size = side * (0.012 if pixels > 300 else 0.03)
    axes.add_patch(
        Polygon(
            [(0, 1.5 * size), (size, -size), (0, -0.5 * size), (-size, -size)], facecolor="black", edgecolor="white",
            linewidth=0.8, zorder=3,
        )
    )  # fmt: skip
    _scale_bar(axes, grid, pixels)
    if pixels >= _LARGE:
        _forward_mark(axes)


def _raster(panel: Panel, pixels: int) -> Image:
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
    return image[::-1, ::-1]


def _edge(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels of a mask that have a neighbor outside it; the rim of the picture is no edge."""
    padded = np.pad(mask, 1, mode="edge")
    inner = padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
    return mask & ~inner


def _paint_points(image: Image, leveled: LeveledSweep, fine: BevGrid) -> None:
    """Paint each point in the color of its height, higher ones on top; large pictures show obstacles as 2 × 2."""
    low, high = HEIGHTS_M
    order = np.argsort(leveled.height_m, kind="stable")
    cells, inside = fine.index(leveled.points[order])
    height_m = leveled.height_m[order][inside]
    i, j = cells[inside].T
    colors = _height_colors()[(np.clip((height_m - low) / (high - low), 0, 1) * 255).astype(np.intp)]
    image[i, j] = colors
    if len(image) < _LARGE:
        return
    tall = slice(int(np.searchsorted(height_m, _LOW_M)), None)
    last = len(image) - 1
    for di, dj in ((0, 1), (1, 0), (1, 1)):
        image[np.minimum(i[tall] + di, last), np.minimum(j[tall] + dj, last)] = colors[tall]


@lru_cache(maxsize=1)
def _height_colors() -> Image:
    return _bytes(colormaps["viridis"](np.arange(256))[:, :3])


def _bytes(colors: NDArray[np.float64]) -> Image:
    return (colors * 255).round().astype(np.uint8)


def _scale_bar(axes: Axes, grid: BevGrid, pixels: int) -> None:
    (x0, y0), side = grid.origin_m, 2 * grid.half_extent_m
    length = _round_length(side / 4)
    size = 8.0 if pixels > 300 else 6.0
    letters = size * 1.6 / pixels * side  # height of a line of text in meters
    x, y, pad = x0 + 0.03 * side, y0 + 0.03 * side, 0.012 * side
    box = Rectangle((y - pad, x - pad), length + 2 * pad, letters + 2 * pad, color="white", alpha=0.85, zorder=2)
    axes.add_patch(box)
    axes.plot([y + length, y], [x, x], color="black", linewidth=2, solid_capstyle="butt", zorder=3)
    axes.text(y + length / 2, x + pad / 2, f"{length:g} m", ha="center", va="bottom", fontsize=size, zorder=3)
    axes.set_xlim(y0 + side, y0)
    axes.set_ylim(x0, x0 + side)


def _round_length(limit_m: float) -> float:
    """Return the longest of 1, 2, 5 times a power of ten meters that is not above ``limit_m``.

    >>> _round_length(32.0), _round_length(8.0)
    (20.0, 5.0)
    """
    power = 10.0 ** np.floor(np.log10(limit_m))
    return float(max(step * power for step in (1, 2, 5) if step * power <= limit_m * (1 + 1e-9)))


def _forward_mark(axes: Axes) -> None:
    box = {"boxstyle": "round", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.text(
        0.02, 0.98, "↑ forward", transform=axes.transAxes, ha="left", va="top", fontsize=9, zorder=3, bbox=box
    )  # fmt: skip


def _table(axes: Axes, rows: Sequence[Sequence[str]], header: Sequence[str]) -> None:
    table = axes.table(cellText=[list(row) for row in rows], colLabels=list(header), loc="center", bbox=Bbox.unit())
    table.auto_set_font_size(False)
    table.set_fontsize(9)
    for (row, _), cell in table.get_celld().items():
        cell.set_edgecolor("0.8")
        if row == 0:
            cell.set_facecolor("0.93")
            cell.set_text_props(weight="bold")


def _legend(page: _Page, columns: int, shares: dict[CellState, str] | None = None) -> None:
    patches: list[Patch] = [
        Patch(facecolor=COLORS[state], edgecolor="black", linewidth=0.4, label=(shares or {}).get(state, "") + words)
        for state, words in WORDS.items()
    ]
    page.figure.legend(
        handles=patches, loc="lower center", ncols=columns, fontsize=9 if columns == 2 else 8, frameon=False
    )


def _height_bar(page: _Page, place: tuple[int, int, int, int]) -> None:
    axes = page.axes(*place)
    axes.imshow(_height_colors()[::-1, None], aspect="auto", extent=(0, 1, *HEIGHTS_M))
    axes.yaxis.tick_right()
    axes.set_yticks(np.arange(HEIGHTS_M[0], HEIGHTS_M[1] + 0.5, 1.0))
    axes.tick_params(labelsize=8)
    axes.set_title("points:\nheight\nabove\nground, m", fontsize=8, pad=8)
