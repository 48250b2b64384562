"""Pictures of estimates, seen from above: forward is up, left is left. The only module that imports matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from viewshed.bev import BevGrid
from viewshed.estimate import CellState, FovEstimate
from viewshed.level import LevelSweep

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
_PIXELS = 1024
_EDGE = (0.0, 0.27, 0.55)


@dataclass(frozen=True, slots=True)
class Panel:
    """One picture of several: an estimate, its heading, and the sweep's points or None for the states alone."""

    estimate: FovEstimate
    title: str
    level: LevelSweep | None = None


def picture(panel: Panel) -> bytes:
    """Return a PNG of one estimate: states, edge of the view, points by height, sensor, scale bar, legend."""
    figure = Figure(figsize=(8.2, 8.4), dpi=110)
    axes = figure.add_axes((0.03, 0.095, 0.87, 0.85))
    _draw(axes, panel)
    axes.set_title(panel.title, fontsize=10, loc="left")
    _legend(figure, 2)
    if panel.level is not None:
        _height_bar(figure, (0.915, 0.3, 0.018, 0.45))
    return _png(figure)


def comparison(panels: Sequence[Panel], rows: Sequence[Sequence[str]], header: Sequence[str]) -> bytes:
    """Return a PNG of several estimates side by side above a table of ``rows`` (one for each panel)."""
    across = min(len(panels), 3)
    down = -(-len(panels) // across)
    height = 4.3 * down + 0.28 * len(panels) + 1.5
    figure = Figure(figsize=(4.2 * across, height), dpi=100)
    bottom = (0.28 * len(panels) + 1.2) / height
    for k, panel in enumerate(panels):
        row, column = divmod(k, across)
        size = (1 - bottom) / down
        axes = figure.add_axes((column / across + 0.01, 1 - (row + 1) * size + 0.01, 1 / across - 0.02, size * 0.88))
        _draw(axes, panel)
        axes.set_title(panel.title, fontsize=9)
    axes = figure.add_axes((0.02, 0.75 / height, 0.96, bottom - 0.95 / height))
    axes.axis("off")
    table = axes.table(cellText=[list(row) for row in rows], colLabels=list(header), loc="center", bbox=Bbox.unit())
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    _legend(figure, 2 if across < 3 else 4)
    return _png(figure)


def contact_sheet(panels: Sequence[Panel], across: int = 8, inches: float = 1.7) -> bytes:
    """Return a PNG with one small picture for each panel, ``across`` in a row."""
    down = -(-max(len(panels), 1) // across)
    height = down * (inches + 0.22) + 0.7
    figure = Figure(figsize=(across * inches, height), dpi=80)
    for k, panel in enumerate(panels):
        row, column = divmod(k, across)
        top = 1 - (row + 1) * (inches + 0.22) / height
        axes = figure.add_axes((column / across + 0.003, top, 1 / across - 0.006, inches / height * 0.98))
        _draw(axes, panel, pixels=256)
        axes.set_title(panel.title, fontsize=5.5, pad=2)
    _legend(figure, 4)
    return _png(figure)


def _draw(axes: Any, panel: Panel, pixels: int = _PIXELS) -> None:
    grid = panel.estimate.grid
    (x0, y0), side = grid.origin_m, 2 * grid.half_extent_m
    image = _raster(panel, max(pixels // grid.cells, 1))
    axes.imshow(image, extent=(y0 + side, y0, x0, x0 + side), interpolation="nearest", aspect="equal")
    axes.set_xticks([])
    axes.set_yticks([])
    size = 0.022 * side
    axes.add_patch(Polygon([(0, 1.4 * size), (size, -size), (-size, -size)], color="black", zorder=3))
    _scale_bar(axes, grid)


def _raster(panel: Panel, zoom: int) -> NDArray[np.float32]:
    """Return the picture as (rows, columns, 3): row 0 is farthest ahead, column 0 farthest left."""
    estimate = panel.estimate
    palette = np.array([COLORS[CellState(state)] for state in range(len(CellState))], np.float32)
    image = np.kron(palette[estimate.state], np.ones((zoom, zoom, 1), np.float32))
    if zoom > 1:
        image[_edge(np.kron(estimate.visible(), np.ones((zoom, zoom), bool)))] = _EDGE
    if panel.level is not None:
        _paint_points(image, panel.level, BevGrid(len(image), estimate.grid.half_extent_m, estimate.grid.offset_m))
    return image[::-1, ::-1]


def _edge(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    inner = mask.copy()
    inner[1:-1, 1:-1] &= mask[2:, 1:-1] & mask[:-2, 1:-1] & mask[1:-1, 2:] & mask[1:-1, :-2]
    return mask & ~inner


def _paint_points(image: NDArray[np.float32], level: LevelSweep, fine: BevGrid) -> None:
    """Paint each point with the color of its height, higher ones over lower ones."""
    order = np.argsort(level.height_m, kind="stable")
    cells, inside = fine.index(level.points[order])
    low, high = HEIGHTS_M
    share = np.clip((level.height_m[order][inside] - low) / (high - low), 0, 1)
    i, j = cells[inside].T
    image[i, j] = _viridis()[(share * 255).astype(np.intp)]


def _viridis() -> NDArray[np.float32]:
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.arange(256)), dtype=np.float32)[:, :3]


def _scale_bar(axes: Any, grid: BevGrid) -> None:
    length = max(
        step for step in (0.1, 0.5, 1, 2, 5, 10, 20, 50, 100, 500) if step <= grid.half_extent_m / 2 or step == 0.1
    )
    (x0, y0), side = grid.origin_m, 2 * grid.half_extent_m
    x, y = x0 + 0.04 * side, y0 + 0.04 * side
    axes.plot([y + length, y], [x, x], color="black", linewidth=2.5, solid_capstyle="butt")
    axes.text(y + length / 2, x + 0.012 * side, f"{length:g} m", ha="center", va="bottom", fontsize=8)
    axes.set_xlim(y0 + side, y0)
    axes.set_ylim(x0, x0 + side)


def _legend(figure: Figure, columns: int) -> None:
    patches = [Patch(facecolor=COLORS[state], edgecolor="black", linewidth=0.4, label=WORDS[state]) for state in WORDS]
    figure.legend(handles=patches, loc="lower center", ncols=columns, fontsize=8, frameon=False)


def _height_bar(figure: Figure, place: tuple[float, float, float, float]) -> None:
    axes = figure.add_axes(place)
    axes.imshow(_viridis()[::-1, None], aspect="auto", extent=(0, 1, *HEIGHTS_M))
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.tick_params(labelsize=8)
    axes.set_title("height\nabove\nground, m", fontsize=7)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
