"""Pictures of the reproduced study: probability and deviation seen from above, and the trade study."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray
from PIL import Image

Kind = Literal["returns", "truth", "probability", "deviation"]
COLORS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#0072B2", "#D55E00")
"""After Okabe and Ito (2008)."""
MARKERS = "osD^vP"
_SCALES: dict[Kind, tuple[str, float | None]] = {
    "returns": ("bone_r", 1.0), "truth": ("Blues", 1.6), "probability": ("cividis", 1.0), "deviation": ("magma", None),
}  # fmt: skip
_DPI = 100
_COLORS = 256
_MAP_INCHES = 1.95


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """One picture from above.

    Attributes:
        title: of the picture.
        kind: what the values are, which decides their colors.
        values: (cells, cells), forward with the first index, left with the second.
    """

    title: str
    kind: Kind
    values: NDArray[Any]


@dataclass(frozen=True, slots=True)
class Dot:
    """One network of the trade study.

    Attributes:
        cells: of its grid, a side.
        depth: poolings.
        width: channels of its first stage.
        values: figures by name.
    """

    cells: int
    depth: int
    width: int
    values: Mapping[str, float]


def map_figure(rows: Mapping[str, Sequence[Map]]) -> bytes:
    """Return a PNG of rows of pictures, each with its name at the left; all deviations have one scale."""
    across = max(map(len, rows.values()))
    figure = Figure(
        (across * _MAP_INCHES + 0.5, len(rows) * (_MAP_INCHES + 0.25) + 0.6), dpi=_DPI, layout="constrained"
    )
    axes = figure.subplots(len(rows), across, squeeze=False)
    most = max(
        (float(each.values.max()) for row in rows.values() for each in row if each.kind == "deviation"), default=0
    )
    drawn: dict[Kind, Any] = {}
    for line, (name, maps) in zip(axes, rows.items(), strict=True):
        line[0].set_ylabel(name, fontsize=9)
        for axis, each in zip(line, maps, strict=False):
            drawn[each.kind] = _map(axis, each, max(most, 1e-3))
    half = across // 2
    for kind, columns in (("probability", axes[:, :half]), ("deviation", axes[:, half:])):
        if kind in drawn:
            bar = figure.colorbar(drawn[kind], ax=columns, location="bottom", shrink=0.6, aspect=40, pad=0.01)
            bar.set_label("mean: probability of visible" if kind == "probability" else "deviation", fontsize=8)
            bar.ax.tick_params(labelsize=7)
    return _png(figure)


def _map(axis: Axes, each: Map, most: float) -> Any:
    """Draw values with forward up and left on the left."""
    colors, high = _SCALES[each.kind]
    drawn = axis.imshow(
        np.asarray(each.values, np.float64)[::-1, ::-1], cmap=colors, vmin=0.0, vmax=most if high is None else high,
        interpolation="nearest",
    )  # fmt: skip
    axis.set_title(each.title, fontsize=8, pad=3)
    axis.set(xticks=[], yticks=[])
    return drawn


def trade_figure(dots: Sequence[Dot], across: str, ups: Sequence[str]) -> bytes:
    """Return a PNG with one panel for each figure of ``ups`` over ``across``: color resolution, mark depth, size width.

    Args:
        dots: the networks.
        across: name of the figure on the horizontal axis, drawn with equal ratios.
        ups: names of the figures on the vertical axes.
    """
    figure = Figure((4.3 * len(ups), 4.3), dpi=_DPI, layout="constrained")
    axes = figure.subplots(1, len(ups), squeeze=False)[0]
    cells, depths = sorted({dot.cells for dot in dots}), sorted({dot.depth for dot in dots})
    for axis, up in zip(axes, ups, strict=True):
        for c, color in zip(cells, COLORS, strict=False):
            for d, mark in zip(depths, MARKERS, strict=False):
                _line(axis, [dot for dot in dots if (dot.cells, dot.depth) == (c, d)], (across, up), (color, mark))
        axis.set_xscale("log")
        axis.xaxis.set_minor_locator(NullLocator())
        _decades(axis, [dot.values[across] for dot in dots])
        axis.set_xlabel(across, fontsize=9)
        axis.set_ylabel(up, fontsize=9)
        axis.grid(linewidth=0.4, color="#cccccc")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return _png(figure)


def _line(axis: Axes, dots: Sequence[Dot], names: tuple[str, str], look: tuple[str, str]) -> None:
    """Draw networks of one resolution and depth, joined from narrow to wide."""
    if not dots:
        return
    chosen = sorted(dots, key=lambda dot: dot.width)
    x, y = ([dot.values[name] for dot in chosen] for name in names)
    label = f"{chosen[0].cells} cells, depth {chosen[0].depth}, widths {', '.join(str(dot.width) for dot in chosen)}"
    axis.plot(x, y, color=look[0], marker=look[1], markersize=4.5, linewidth=0.9, alpha=0.85, label=label)
    for dot, left, up in zip(chosen, x, y, strict=True):
        axis.annotate(str(dot.width), (left, up), textcoords="offset points", xytext=(4, 3), fontsize=6.5)


def _decades(axis: Axes, values: Sequence[float]) -> None:
    """Put ticks at 1, 2 and 5 of each decade in plain numbers."""
    low, high = min(values), max(values)
    ticks = [m * 10.0**e for e in range(-4, 6) for m in (1, 2, 5) if low / 1.6 <= m * 10.0**e <= high * 1.6]
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks], fontsize=8)
    axis.tick_params(axis="y", labelsize=8)


def _png(figure: Figure) -> bytes:
    """Return the figure with few colors: some hundred kilobytes less."""
    drawn, buffer = io.BytesIO(), io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(drawn, format="png")
    image = Image.open(drawn).convert("RGB").quantize(_COLORS, dither=Image.Dither.NONE)
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
