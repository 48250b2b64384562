"""Figures of training: learning curves, and scores of cross-validation."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

if TYPE_CHECKING:
    from viewshed_lab.training.log import Epoch


_TRAIN, _VALIDATION, _F1, _IOU = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
_COLORS = 64


def curve_figure(name: str, history: Sequence[Epoch]) -> bytes:
    """Return a PNG of the losses, validation F1 and validation IoU over the epochs; the best epoch is marked."""
    figure = Figure(figsize=(8.0, 3.0), dpi=100, layout="constrained")
    losses, scores = figure.subplots(1, 2)
    best = min(history, key=lambda epoch: epoch.validation_loss)
    _lines(losses, history, {"train_loss": _TRAIN, "validation_loss": _VALIDATION}, best)
    _lines(scores, history, {"f1": _F1, "iou": _IOU}, best)
    losses.set_title(f"{name}: loss", fontsize=9)
    scores.set_title("validation scores", fontsize=9)
    return _png(figure)


def fold_figure(name: str, values: Mapping[str, Sequence[float]], chosen: str) -> bytes:
    """Return a PNG with one box per setting over the best F1 of its folds (dots); the chosen setting is colored."""
    figure = Figure(figsize=(max(4.0, 0.34 * len(values) + 1.5), 4.0), dpi=100, layout="constrained")
    axis = figure.subplots()
    for index, (setting, folds) in enumerate(values.items()):
        color = _VALIDATION if setting == chosen else _TRAIN
        box = axis.boxplot([list(folds)], positions=[index], widths=0.6, showfliers=False, patch_artist=True)
        box["boxes"][0].set(facecolor=color, alpha=0.4)
        axis.scatter([index] * len(folds), folds, s=9, color=color, zorder=3)
    axis.set_xticks(range(len(values)), list(values), rotation=90, fontsize=7)
    axis.set_ylabel("F1 of the held-out scenes", fontsize=8)
    axis.set_title(f"{name}: {len(next(iter(values.values())))} folds by scene", fontsize=9)
    _grid(axis)
    return _png(figure)


def convergence_figure(curves: Mapping[str, Sequence[Sequence[float]]]) -> bytes:
    """Return a PNG with one panel per setting: the validation loss of each fold over the epochs."""
    columns = min(len(curves), 3)
    rows = -(-len(curves) // columns)
    figure = Figure(figsize=(3.0 * columns, 2.2 * rows), dpi=100, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axis, (setting, folds) in zip(panels, curves.items(), strict=False):
        for losses in folds:
            axis.plot(range(1, len(losses) + 1), losses, color=_VALIDATION, linewidth=1.0, marker="o", markersize=2.0)
        axis.set_title(f"{setting}: {len(folds)} folds", fontsize=7)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        _grid(axis)
    for axis in panels[len(curves) :]:
        axis.set_visible(False)
    figure.supxlabel("epoch", fontsize=8)
    figure.supylabel("validation loss", fontsize=8)
    return _png(figure)


def _lines(axis: Axes, history: Sequence[Epoch], columns: Mapping[str, str], best: Epoch) -> None:
    numbers = [epoch.number for epoch in history]
    for column, color in columns.items():
        values = [getattr(epoch, column) for epoch in history]
        axis.plot(numbers, values, color=color, marker="o", markersize=2.5, linewidth=1.3, label=column)
    axis.axvline(best.number, color="#999999", linewidth=0.8, linestyle=":")
    axis.set_xlabel("epoch", fontsize=8)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.legend(frameon=False, fontsize=8)
    _grid(axis)


def _grid(axis: Axes) -> None:
    axis.tick_params(labelsize=7)
    axis.grid(axis="y", linewidth=0.4, color="#cccccc")
    axis.set_axisbelow(True)


def _png(figure: Figure) -> bytes:
    raw, buffer = io.BytesIO(), io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(raw, format="png")
    Image.open(raw).convert("RGB").quantize(_COLORS, dither=Image.Dither.NONE).save(buffer, "png", optimize=True)
    return buffer.getvalue()
