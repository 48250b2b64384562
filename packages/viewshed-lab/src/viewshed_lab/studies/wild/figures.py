"""Pictures of single scenes: exact ground, how far the estimated one is off, true states, and mistakes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState
from viewshed.fov.visibility import TARGETS
from viewshed.preprocess.leveling import level
from viewshed_lab.studies.wild.evaluate import estimator_named, ground_error_m
from viewshed_lab.studies.wild.jobs import scene_of


def picture_of(row: Any, methods: Sequence[str]) -> bytes:
    """Return a PNG of a row's scene: exact ground, error of the estimated one, true states, each method's mistakes."""
    seen = scene_of((row.set_name, row.domain, row.scene.split("-")[2], "0")).observe(row.sweep)
    sample, grid, target = seen.sample(row.told), seen.truth.grid, TARGETS[row.target]
    leveled = level(sample.sweep, grid)
    error = ground_error_m(leveled, sample)
    half = grid.half_extent_m
    extent = (half, -half, -half, half)

    figure, axes = plt.subplots(1, 3 + len(methods), figsize=(4.0 * (3 + len(methods)), 4.2), layout="constrained")
    panels = [("exact ground, m", sample.ground_m, "terrain", None), ("estimated less exact, m", error, "RdBu", 2.0)]
    for axis, (title, values, colors, most) in zip(axes, panels, strict=False):
        limits = {} if most is None else {"vmin": -most, "vmax": most}
        shown = axis.imshow(np.asarray(values)[::-1, ::-1], extent=extent, cmap=colors, **limits)
        figure.colorbar(shown, ax=axis, shrink=0.7)
        axis.set_title(title)
    points = leveled.points[np.abs(leveled.points[:, :2]).max(axis=1) < half]
    axes[2].scatter(points[:, 1], points[:, 0], s=0.3, c="0.2")
    names = ["unknown", "free", "surface", "hidden", "truth not known"]
    states = np.where(seen.known, seen.truth.state[target.name], len(CellState))
    _classes(axes[2], states, extent, ListedColormap(["white", "#9bd", "#36c", "#ddd", "#fd8"]), names)
    axes[2].set_title("true states and returns")
    for axis, method in zip(axes[3:], methods, strict=True):
        estimator = estimator_named(method, row.domain, row.target)
        if estimator is None:
            continue
        claimed, true = estimator.estimate(leveled).visible(), seen.truth.visible(target)
        agree = np.where(seen.known, claimed + 2 * true, 4)
        names = ["hidden for both", "claimed wrongly", "missed", "visible for both", "truth not known"]
        _classes(axis, agree, extent, ListedColormap(["white", "#d33", "#e9a", "#9bd", "#fd8"]), names)
        axis.set_title(method)
    png = io.BytesIO()
    figure.savefig(png, dpi=80, metadata={"Software": None})
    plt.close(figure)
    return png.getvalue()


def _classes(axis: Any, values: NDArray[Any], extent: tuple[float, ...], colors: Any, names: Sequence[str]) -> None:
    """Draw classes (cells, cells), forward up and left at the left, with their names as a legend."""
    axis.imshow(values[::-1, ::-1], extent=extent, cmap=colors, vmin=0, vmax=len(names) - 1, interpolation="nearest")
    patches = [Patch(facecolor=colors(k), edgecolor="0.5", label=name) for k, name in enumerate(names)]
    axis.legend(handles=patches, fontsize=6, loc="lower left", framealpha=0.8)
