"""Figures of the studies: violins, curves, single attacked sweeps from above, the trade study."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray
from PIL import Image

from viewshed.arrays import F64, Mask
from viewshed.grid import BevGrid
from viewshed_lab.studies.records import BENIGN, Case, Domain
from viewshed_lab.studies.statistics import precision

Kind = Literal["returns", "truth", "probability", "deviation"]

PALETTE = ("#000000", "#E69F00", "#56B4E9", "#8C564B", "#009E73", "#7FCC7F", "#CC79A7", "#0072B2", "#8FB8DE", "#D55E00")
"""After Okabe and Ito (2008); line styles separate curves of similar colors."""

DASHES = ("-", "--", ":", "-.")

AGREE, OVER, UNDER, HIDDEN, OUTSIDE = (0.68, 0.84, 0.95), (0.84, 0.37, 0.0), (0.55, 0.24, 0.62), (0.86,) * 3, (1.0,) * 3
"""Colors of cells that are visible by both, only the estimate, only the truth, neither, and of cells without truth."""

_BENIGN, _ATTACKED = "#0072B2", "#D55E00"

MARKERS = "osD^vP"

_SCALES: dict[Kind, tuple[str, float | None]] = {
    "returns": ("bone_r", 1.0), "truth": ("Blues", 1.6), "probability": ("cividis", 1.0), "deviation": ("magma", None),
}  # fmt: skip

_DPI = 100

_COLORS, _MAP_COLORS = 96, 256

_MAP_INCHES = 1.95


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """One map from above."""

    title: str  # of the map
    kind: Kind  # kind of the values, which sets their colors
    values: NDArray[Any]  # (cells, cells), forward with the first index, left with the second


def map_figure(rows: Mapping[str, Sequence[Map]]) -> bytes:
    """Return a PNG of rows of maps, each row with its name at the left; all deviations share one scale."""
    across = max(map(len, rows.values()))
    figure = Figure(
        (across * _MAP_INCHES + 0.5, len(rows) * (_MAP_INCHES + 0.25) + 0.6), dpi=_DPI, layout="constrained"
    )
    axes = figure.subplots(len(rows), across, squeeze=False)
    deviations = [picture.values for row in rows.values() for picture in row if picture.kind == "deviation"]
    max_deviation = max((float(values.max()) for values in deviations), default=0.0)
    images: dict[Kind, Any] = {}
    for line, (name, maps) in zip(axes, rows.items(), strict=True):
        line[0].set_ylabel(name, fontsize=9)
        for axis, picture in zip(line, maps, strict=False):
            images[picture.kind] = _map(axis, picture, max(max_deviation, 1e-3))
    half = across // 2 if "deviation" in images else across
    for kind, columns in (("probability", axes[:, :half]), ("deviation", axes[:, half:])):
        if kind in images:
            bar = figure.colorbar(images[kind], ax=columns, location="bottom", shrink=0.6, aspect=40, pad=0.01)
            bar.set_label("probability of visible" if kind == "probability" else "deviation", fontsize=8)
            bar.ax.tick_params(labelsize=7)
    return png_of(figure, _MAP_COLORS)


def _map(axis: Axes, picture: Map, max_deviation: float) -> Any:
    """Draw a map with forward up and left on the left."""
    colors, high = _SCALES[picture.kind]
    image = axis.imshow(
        np.asarray(picture.values, np.float64)[::-1, ::-1], cmap=colors, vmin=0.0,
        vmax=max_deviation if high is None else high, interpolation="nearest",
    )  # fmt: skip
    axis.set_title(picture.title, fontsize=8, pad=3)
    axis.set(xticks=[], yticks=[])
    return image


def trade_figure(dots: Mapping[tuple[int, int, int], Mapping[str, float]], across: str, ups: Sequence[str]) -> bytes:
    """Return a PNG with one panel per figure of ``ups`` over ``across``; colors are resolutions, markers are depths.

    Args:
        dots: figures of each network by name, by its cells per side, poolings and channels of the first stage.
        across: name of the figure on the horizontal axis, which is logarithmic.
        ups: names of the figures on the vertical axes.
    """
    figure = Figure((4.3 * len(ups), 4.3), dpi=_DPI, layout="constrained")
    axes = figure.subplots(1, len(ups), squeeze=False)[0]
    resolutions, depths = (sorted({shape[k] for shape in dots}) for k in (0, 1))
    for axis, up in zip(axes, ups, strict=True):
        for cells, color in zip(resolutions, PALETTE, strict=False):
            for depth, mark in zip(depths, MARKERS, strict=False):
                # A line joins the networks of one resolution and depth, from narrow to wide.
                widths = sorted(shape[2] for shape in dots if shape[:2] == (cells, depth))
                places = [[dots[cells, depth, width][name] for width in widths] for name in (across, up)]
                label = f"{cells} cells, depth {depth}, widths {', '.join(map(str, widths))}"
                if widths:
                    axis.plot(*places, color=color, marker=mark, markersize=4.5, linewidth=0.9, alpha=0.85, label=label)
                for width, *place in zip(widths, *places, strict=True):
                    axis.annotate(str(width), place, textcoords="offset points", xytext=(4, 3), fontsize=6.5)
        axis.set_xscale("log")
        axis.xaxis.set_minor_locator(NullLocator())
        _decades(axis, [figures[across] for figures in dots.values()])
        axis.set_xlabel(across, fontsize=9)
        axis.set_ylabel(up, fontsize=9)
        axis.grid(linewidth=0.4, color="#cccccc")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return png_of(figure, _MAP_COLORS)


def _decades(axis: Axes, values: Sequence[float]) -> None:
    """Put ticks at 1, 2 and 5 of each decade, labeled with plain numbers."""
    low, high = min(values), max(values)
    ticks = [m * 10.0**e for e in range(-4, 6) for m in (1, 2, 5) if low / 1.6 <= m * 10.0**e <= high * 1.6]
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks], fontsize=8)
    axis.tick_params(axis="y", labelsize=8)


CaseValue = Callable[[Domain[Any], str, Case], float]
"""The value of a method in a case that a curve shows."""

Violins = Mapping[str, tuple[F64, F64]]
"""One panel: by label, the values of all samples, (S,) benign and (T,) attacked; NaN is left out."""

Curves = Mapping[str, Mapping[str, float]]
"""One panel: by label and name of the step, a value; NaN leaves a gap."""


@dataclass(frozen=True, slots=True, eq=False)
class PictureRow:
    """One row of pictures: an attacked sweep over the truth, then the claims of the estimators."""

    title: str  # of the row
    grid: BevGrid  # of the masks
    truth: Mask  # (cells, cells) bool
    known: Mask  # (cells, cells) bool, cells with truth
    points: NDArray[np.float32]  # (N, 2) x and y of the returns in meters
    added: Mask  # (N,) bool, forged returns
    wedge: tuple[float, float] | None  # azimuth and width in radians, or None
    claims: Mapping[str, Mask]  # by estimator, (cells, cells) bool


def violins_of(domain: Domain[Any], methods: Mapping[str, str], attacked: Sequence[Case]) -> dict[str, Violins]:
    """Return panels of precision and AUPRC of the single sweeps of a domain, by title.

    Args:
        domain: results of the sweeps.
        methods: names of the methods by label.
        attacked: the attacked cases, which share one side of the violins.
    """

    def precisions(method: str, case: Case) -> F64:
        return domain.results.each(domain.series(method, case), precision)

    def areas(method: str, case: Case) -> F64:
        return np.asarray(domain.results.numbers(domain.series(method, case), "auprc"))

    return {
        f"{domain.name}: {word}": {
            label: (values(name, BENIGN), np.concatenate([values(name, case) for case in attacked]))
            for label, name in methods.items()
        }
        for word, values in (("precision", precisions), ("AUPRC", areas))
    }


def violin_figure(panels: Mapping[str, Violins], across: int, attacked: str) -> bytes:
    """Return a PNG of violins, benign on the left and ``attacked`` (its name) on the right of each label."""
    figure, axes = _page(len(panels), across, (6.4, 2.9))
    for axis, (title, pairs) in zip(axes, panels.items(), strict=False):
        for position, (benign, spoilt) in enumerate(pairs.values()):
            for values, side, color in ((benign, "low", _BENIGN), (spoilt, "high", _ATTACKED)):
                _half(axis, values[~np.isnan(values)], position, side, color)
        axis.set_xticks(range(len(pairs)), pairs, rotation=35, ha="right", fontsize=7.5)
        axis.set_xlim(-0.6, len(pairs) - 0.4)
        _rates(axis, title)
    handles = [Patch(color=_BENIGN, label="benign"), Patch(color=_ATTACKED, label=attacked)]
    figure.legend(handles=handles, loc="lower center", ncols=2, frameon=False, fontsize=9)
    return png_of(figure, _COLORS)


def _half(axis: Axes, values: F64, position: int, side: Any, color: str) -> None:
    """Draw half a violin and its median; values that hardly differ have no density and are only a line."""
    if len(values) == 0:
        return
    if np.ptp(values) > 1e-6:
        violin: Any = axis.violinplot([values], [position], widths=0.85, showextrema=False, side=side)
        for body in violin["bodies"]:
            body.set(facecolor=color, edgecolor="none", alpha=0.55)
    reach = (-0.3, 0.0) if side == "low" else (0.0, 0.3)
    median = float(np.median(values))
    axis.plot([position + reach[0], position + reach[1]], [median, median], color=color, linewidth=1.6)


def curves_of(domain: Domain[Any], methods: Sequence[str], cases: Mapping[str, Case], value: CaseValue) -> Curves:
    """Return one curve per method of a value over some cases; ``cases`` are the steps by name."""
    return {name: {step: value(domain, name, case) for step, case in cases.items()} for name in methods}


def curve_figure(panels: Mapping[str, Curves], across: int, label: str) -> bytes:
    """Return a PNG of panels of curves with ``label`` at the vertical axis and a common legend."""
    across = max(3, min(across, len(panels)))
    figure, axes = _page(len(panels), across, (2.7, 2.15), legend=0.75)
    names = list(dict.fromkeys(name for panel in panels.values() for name in panel))
    for number, (axis, (title, panel)) in enumerate(zip(axes, panels.items(), strict=False)):
        for name, values in panel.items():
            axis.plot(range(len(values)), list(values.values()), **_line(names.index(name)))
        steps = next(iter(panel.values()), {})
        axis.set_xticks(range(len(steps)), steps, fontsize=6.5, rotation=35)
        _rates(axis, title)
        if number % across == 0:
            axis.set_ylabel(label, fontsize=8)
    handles = [Line2D([], [], label=name, **_line(number)) for number, name in enumerate(names)]
    figure.legend(handles=handles, loc="lower center", ncols=min(len(names), 5), frameon=False, fontsize=8)
    return png_of(figure, _COLORS)


def _line(number: int) -> dict[str, Any]:
    color, style = PALETTE[number % len(PALETTE)], DASHES[number % len(DASHES)]
    return {"color": color, "linestyle": style, "linewidth": 1.3, "marker": "o", "markersize": 2.2}


def scene_figure(scenes: Sequence[PictureRow]) -> bytes:
    """Return a PNG with one row per scene: the truth with returns, forged ones in red, then the estimators."""
    names = list(dict.fromkeys(name for scene in scenes for name in scene.claims))
    figure, axes = _page(len(scenes) * (len(names) + 1), len(names) + 1, (1.75, 1.75), legend=0.35)
    for row, scene in enumerate(scenes):
        cells = axes[row * (len(names) + 1) : (row + 1) * (len(names) + 1)]
        _raster(cells[0], scene, scene.truth)
        _returns(cells[0], scene)
        cells[0].set_ylabel(scene.title, fontsize=7.5)
        for axis, name in zip(cells[1:], names, strict=True):
            _raster(axis, scene, scene.claims[name])
        if row == 0:
            for axis, name in zip(cells, ["truth and returns", *names], strict=True):
                axis.set_title(name, fontsize=8.5, pad=3)
    words = {"both visible": AGREE, "only claimed": OVER, "only true": UNDER, "neither": HIDDEN}
    handles: list[Any] = [Patch(color=color, label=word) for word, color in words.items()]
    handles.append(Line2D([], [], color="red", marker=".", linestyle="none", label="the attacker's returns"))
    figure.legend(handles=handles, loc="lower center", ncols=5, frameon=False, fontsize=8)
    return png_of(figure, _COLORS)


def compared(claimed: Mask, truth: Mask, known: Mask) -> NDArray[np.float64]:
    """Return the colors (cells, cells, 3) of a claim against the truth."""
    image = np.full((*truth.shape, 3), HIDDEN, np.float64)
    image[claimed & truth], image[claimed & ~truth], image[~claimed & truth] = AGREE, OVER, UNDER
    image[~known] = OUTSIDE
    return image


def _raster(axis: Axes, scene: PictureRow, claimed: Mask) -> None:
    """Draw cells with forward up and left on the left, and the edges of the wedge."""
    half = scene.grid.half_extent_m
    image = compared(claimed, scene.truth, scene.known)[::-1, ::-1]
    axis.imshow(image, extent=(half, -half, -half, half), interpolation="nearest", aspect="equal")
    axis.set(xticks=[], yticks=[], xlim=(half, -half), ylim=(-half, half))
    if scene.wedge is not None and scene.wedge[1] < 6.28:
        for edge in (scene.wedge[0] - scene.wedge[1] / 2, scene.wedge[0] + scene.wedge[1] / 2):
            axis.plot([0, 1.5 * half * np.sin(edge)], [0, 1.5 * half * np.cos(edge)], color="black", linewidth=0.5)


def _returns(axis: Axes, scene: PictureRow) -> None:
    for rows, color, size in ((~scene.added, "#555555", 0.1), (scene.added, "red", 0.9)):
        axis.scatter(scene.points[rows, 1], scene.points[rows, 0], s=size, c=color, linewidths=0, rasterized=True)


def _rates(axis: Axes, title: str) -> None:
    axis.set_title(title, fontsize=8.5, pad=3)
    axis.set_ylim(-0.02, 1.02)
    axis.tick_params(axis="y", labelsize=7)
    axis.grid(axis="y", linewidth=0.4, color="#cccccc")
    axis.set_axisbelow(True)


def _page(panels: int, across: int, size: tuple[float, float], legend: float = 0.3) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels of ``size`` inches, ``across`` in a row, with room for a legend below."""
    down = -(-max(panels, 1) // across)
    height = down * size[1] + legend
    engine = ConstrainedLayoutEngine(rect=(0.0, legend / height, 1.0, 1.0 - legend / height))
    figure = Figure(figsize=(across * size[0], height), dpi=_DPI, layout=engine)
    axes = list(figure.subplots(down, across, squeeze=False).ravel())
    for unused in axes[panels:]:
        unused.set_visible(False)
    return figure, axes[:panels]


def png_of(figure: Figure, colors: int | None = None) -> bytes:
    """Return the figure as a PNG; a palette of ``colors`` saves some hundred kilobytes."""
    full, buffer = io.BytesIO(), io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(full, format="png")
    if colors is None:
        return full.getvalue()
    image = Image.open(full).convert("RGB").quantize(colors, dither=Image.Dither.NONE)
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()
