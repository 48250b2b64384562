"""Pictures of single scenes (ground, cut, states, errors), and reliability diagrams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from viewshed.arrays import Mask
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import CellState
from viewshed.fov.visibility import TARGETS
from viewshed.grid import BevGrid
from viewshed.metrics import BINS
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab.studies.figures import png_of
from viewshed_lab.studies.wild.evaluate import estimator_named, ground_error_m
from viewshed_lab.studies.wild.jobs import scene_of
from viewshed_lab.studies.wild.pool import Pool


def picture_of(row: Any, methods: Sequence[str]) -> bytes:
    """Return a PNG of a row's scene: exact ground, error of the estimated one, a cut, true states, errors.

    The errors are those of measured beams alone, and of each method.
    """
    seen = scene_of((row.set_name, row.domain, row.scene.split("-")[2], "0")).observe(row.sweep)
    sample, grid, target = seen.sample(row.told), seen.truth.grid, TARGETS[row.target]
    leveled = level(sample.sweep, grid)
    error = ground_error_m(leveled, sample)
    half = grid.half_extent_m
    extent = (half, -half, -half, half)
    named = [(method, estimator_named(method, row.domain, row.target)) for method in methods]
    judged = [(method, estimator) for method, estimator in named if estimator is not None]
    judged.insert(0, ("measured beams alone", ShadowMap(grid, target, "unknown")))

    figure = Figure((4.0 * (4 + len(judged)), 4.2), dpi=80, layout="constrained")
    axes = figure.subplots(1, 4 + len(judged))
    panels = [("exact ground, m", sample.ground_m, "terrain", None), ("estimated less exact, m", error, "RdBu", 2.0)]
    for axis, (title, values, colors, limit) in zip(axes, panels, strict=False):
        limits = {} if limit is None else {"vmin": -limit, "vmax": limit}
        shown = axis.imshow(np.asarray(values)[::-1, ::-1], extent=extent, cmap=colors, **limits)
        figure.colorbar(shown, ax=axis, shrink=0.7)
        axis.set_title(title)
    aimed = seen.known & (seen.truth.state[target.name] != CellState.UNKNOWN)
    _cut(axes[2], leveled, grid, error, aimed)
    points = leveled.points[np.abs(leveled.points[:, :2]).max(axis=1) < half]
    axes[3].scatter(points[:, 1], points[:, 0], s=0.3, c="0.2")
    names = ["unknown", "free", "surface", "hidden", "truth not known"]
    states = np.where(seen.known, seen.truth.state[target.name], len(CellState))
    _classes(axes[3], states, extent, ListedColormap(["white", "#9bd", "#36c", "#ddd", "#fd8"]), names)
    axes[3].set_title("true states and returns")
    for axis, (method, estimator) in zip(axes[4:], judged, strict=True):
        claimed, true = estimator.estimate(leveled).visible(), seen.truth.visible(target)
        agree = np.where(seen.known, claimed + 2 * true, 4)
        names = ["hidden for both", "claimed wrongly", "missed", "visible for both", "truth not known"]
        _classes(axis, agree, extent, ListedColormap(["white", "#d33", "#e9a", "#9bd", "#fd8"]), names)
        axis.set_title(method)
    return png_of(figure)


def reliability_of(pool: Pool) -> bytes:
    """Return a PNG of the share of visible cells over the estimated probability of each method."""
    figure = Figure((4.2, 4.2), dpi=80, layout="constrained")
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], c="0.7", lw=1)
    for method in pool.names("method"):
        part = pool.of(method=method)
        cells, visible, prob = part.bins().reshape(BINS, -1, 3).sum(axis=1).T
        used = cells > 0
        axis.plot(
            prob[used] / cells[used], visible[used] / cells[used], marker=".", label=f"{method}, {part.ece():.3f}"
        )
    axis.set(xlabel="probability stated", ylabel="share of cells visible", xlim=(0, 1), ylim=(0, 1))
    axis.legend(title="calibration error", fontsize=7)
    return png_of(figure)


def _cut(axis: Any, leveled: LeveledSweep, grid: BevGrid, error_m: NDArray[np.float64], judged: Mask) -> None:
    """Draw exact and estimated ground and returns along the line through the sensor with the largest mean error."""
    half_m = leveled.ground.half_extent_m
    run_m = np.linspace(-half_m, half_m, 257)
    lines = [run_m[:, None] * [np.cos(turn), np.sin(turn)] for turn in np.arange(0.0, np.pi, np.pi / 36)]

    def along(values: NDArray[Any], xy: NDArray[np.float64]) -> NDArray[Any]:
        cells, inside = grid.index(xy)
        return np.where(inside, values[cells[..., 0], cells[..., 1]], np.nan)

    xy = max(lines, key=lambda line: float(np.nanmean(along(np.where(judged, np.abs(error_m), 0.0), line))))
    low_m, estimated_m, high_m = (leveled.ground.shifted(by).at(xy) - leveled.sensor_height_m for by in (-1, 0, 1))
    axis.fill_between(run_m, low_m, high_m, color="#9bd", alpha=0.6, lw=0)
    axis.plot(run_m, estimated_m, c="#36c", label="estimated, one deviation")
    axis.plot(run_m, estimated_m - along(error_m, xy), c="k", lw=1, label="exact")
    forward = xy[-1] / np.linalg.norm(xy[-1])
    beside_m = leveled.points[:, :2] @ [-forward[1], forward[0]]
    near = np.abs(beside_m) < half_m / 64
    z = leveled.points[near, 2] - leveled.sensor_height_m
    axis.scatter(leveled.points[near, :2] @ forward, z, s=2, c="#d80", label="returns")
    axis.set(title="a cut through the sensor, m", ylim=(np.nanmin(estimated_m) - 4, np.nanmax(estimated_m) + 6))
    axis.legend(fontsize=6, loc="lower left", framealpha=0.8)


def _classes(axis: Any, values: NDArray[Any], extent: tuple[float, ...], colors: Any, names: Sequence[str]) -> None:
    """Draw classes (cells, cells) with a legend; forward is up and left is left."""
    axis.imshow(values[::-1, ::-1], extent=extent, cmap=colors, vmin=0, vmax=len(names) - 1, interpolation="nearest")
    patches = [Patch(facecolor=colors(k), edgecolor="0.5", label=name) for k, name in enumerate(names)]
    axis.legend(handles=patches, fontsize=6, loc="lower left", framealpha=0.8)
