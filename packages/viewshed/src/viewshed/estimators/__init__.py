"""Estimators of the field of view by name: ``ESTIMATORS[name](grid, target)``, or :func:`load_estimator`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Protocol, cast

from numpy.typing import ArrayLike

from viewshed._extras import load, plugins
from viewshed.estimators.base import EarlierSweeps, Estimator
from viewshed.estimators.concave_hull import ConcaveHull
from viewshed.estimators.delaunay import Delaunay
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.majority_vote import MajorityVote
from viewshed.estimators.ray_trace import ContinuousRayTrace, QuantizedRayTrace, TrimmedRayTrace
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.unet import LEARNED, load_network
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.union import union_of_views
from viewshed.fov.visibility import CAR, TARGETS, Target
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS, BevGrid
from viewshed.preprocess.azimuth_bins import Crop
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.preprocess.plausibility import check_units, doubts
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep, sweep_of_points


class EstimatorFactory(Protocol):
    """Protocol of a function that returns an estimator on a grid."""

    def __call__(self, grid: BevGrid, target: Target = CAR) -> Estimator:
        """Return the estimator of ``target`` on ``grid`` with default parameters."""
        ...


CLASSICAL: dict[str, EstimatorFactory] = {
    "continuous": ContinuousRayTrace,
    "quantized": QuantizedRayTrace,
    "concave_hull": ConcaveHull,
    "delaunay": Delaunay,
    "first_blocker": FirstBlocker,
    "first_blocker_median": partial(FirstBlocker, median_bins=5, name="first_blocker_median"),
    "trimmed": TrimmedRayTrace,
    "shadow_map": ShadowMap,
    "majority_vote": MajorityVote,
}
"""Classical estimators. Rays start at the sensor, bins follow the measured azimuth step, no return means UNKNOWN."""

ESTIMATORS: dict[str, EstimatorFactory] = {**CLASSICAL, **LEARNED}
"""All estimators. Networks exist only for the grids and targets of the shipped weights."""

DEFAULT_ESTIMATOR = "shadow_map"
"""Default method; docs/which_method.md gives the rule by which it was chosen."""

FORMER_NAMES = {
    "vote": "majority_vote", "polygon_fit": "delaunay", "mcd": "mc_dropout", "viewnet": DEFAULT_ESTIMATOR,
}  # fmt: skip
"""Name in version 0.3 → current name; version 0.4 accepts both. ``viewnet`` was a network that has been removed."""


def current_name(method: str) -> str:
    """Return the current name of an estimator; warn if the name now refers to another estimator.

    >>> current_name("vote"), current_name("trimmed")
    ('majority_vote', 'trimmed')
    """
    if method == "viewnet":
        warnings.warn(
            f"method viewnet was removed, and {DEFAULT_ESTIMATOR}, whose probability is calibrated, is used; version"
            " 0.5 will refuse the name",
            FutureWarning,
            stacklevel=3,
        )
    return FORMER_NAMES.get(method, method)


def paper_estimators(max_range_m: float) -> dict[str, EstimatorFactory]:
    """Return the estimators with the settings of arXiv 2503.07375 and its code, for returns up to ``max_range_m``.

    They use returns within ±3 m of the sensor's height, after leveling. ``paper_label`` is the published label: rays
    from the centroid of the points. The paper's threshold is ``PAPER_THRESHOLD``; these estimates are 0 or 1.
    """
    crop = Crop(max_range_m, (-3.0, 3.0))
    label = partial(QuantizedRayTrace, azimuth_bins=100, range_bins=100, max_range_m=max_range_m, about_centroid=True)
    quantized = partial(QuantizedRayTrace, azimuth_bins=128, range_bins=128, max_range_m=min(70.0, max_range_m))
    return {
        "paper_label": partial(label, crop=crop, name="paper_label"),
        "paper_quantized": partial(quantized, crop=crop, name="paper_quantized"),
        "paper_continuous": partial(ContinuousRayTrace, window=0.05, margin_m=0.0, crop=crop, name="paper_continuous"),
        "paper_concave_hull": partial(
            ConcaveHull, concavity=1.0, length_threshold_m=4.0, crop=crop, name="paper_concave_hull"
        ),
        "paper_delaunay": partial(Delaunay, crop=crop, name="paper_delaunay"),
    }


PAPER_THRESHOLD = 0.7
"""Minimum probability of a visible cell in the paper."""

PAPER_ESTIMATORS: dict[str, EstimatorFactory] = paper_estimators(100.0)
"""The paper's estimators for cars on roads."""

PAPER_INDOOR_ESTIMATORS: dict[str, EstimatorFactory] = paper_estimators(20.0)
"""The paper's estimators for its indoor robot."""

_INDOOR_HALF_EXTENT_M = 20.0
"""Maximum half extent of an indoor grid."""


def paper_estimators_on(grid: BevGrid) -> dict[str, EstimatorFactory]:
    """Return the paper's estimators for a grid: the indoor ones for half extents up to 20 m, else those for roads."""
    return PAPER_INDOOR_ESTIMATORS if grid.half_extent_m <= _INDOOR_HALF_EXTENT_M else PAPER_ESTIMATORS


def load_estimator(
    name: str | Path | None = None,
    *,
    grid: str | BevGrid | None = None,
    target: str | Target | None = None,
    device: str = "cpu",
    weights: str | Path | None = None,
    passes: int | None = None,
    seed: int | None = None,
    abstain_below: float | None = None,
) -> Estimator:
    """Return an estimator by name.

    Args:
        name: name in :data:`ESTIMATORS`, in the paper's estimators or of an installed plugin; or the path of a
            network. None is :data:`DEFAULT_ESTIMATOR`, or ``unet`` if ``weights`` are given.
        grid: name in :data:`GRIDS`, or a grid; None is the grid of the weights, or ``road``.
        target: name in :data:`TARGETS`, or a target; None is the target of the weights, or ``car``.
        device: ``cpu`` or ``cuda``, for a network.
        weights: path, or name of shipped weights, for a network.
        passes: number of passes for ``mc_dropout``, at least 2.
        seed: seed of the dropout masks for ``mc_dropout``.
        abstain_below: for ``shadow_map`` or a network: in [.5, 1]; cells where neither visible nor not visible has at
            least this probability are UNKNOWN.

    Raises:
        ValueError: a name is unknown, or the estimator does not take a given option; the message names it.
        ImportError: the runtime of networks on the device is not installed.

    >>> load_estimator("shadow_map", grid="indoor", target="pedestrian").name
    'shadow_map'
    """
    bev_grid, target_box = None if grid is None else grid_named(grid), None if target is None else target_named(target)
    if isinstance(name, Path) or (name is not None and str(name).endswith(".onnx")):
        if weights is not None:
            raise ValueError(f"weights must be left out where a file is named, got {name} and {weights}; name one")
        name, weights = None, name
    if name is None:
        name = DEFAULT_ESTIMATOR if weights is None else "unet"
    method = current_name(str(name)).replace("paper_polygon_fit", "paper_delaunay")
    options = {"weights": weights, "passes": passes, "seed": seed, "device": None if device == "cpu" else device}
    given = {option: value for option, value in options.items() if value is not None}
    if method == "unet" and seed is not None:
        raise ValueError(f"seed must be left out for unet, which samples no masks, got {seed}; use mc_dropout")
    if method in LEARNED:
        estimator: Estimator = load_network(
            method, bev_grid, target_box, weights=weights, passes=passes, seed=seed or 0, device=device
        )
    else:
        bev_grid, target_box = bev_grid or grid_named("road"), target_box or target_named("car")
        known = {**CLASSICAL, **paper_estimators_on(bev_grid)}
        if method not in known:
            added = plugins("estimators")
            if method not in added:
                raise ValueError(f"method must be one of {', '.join([*known, *LEARNED, *added])}, got {method!r}")
            known[method] = load(added[method], callable, "a class or a function")
        if given:
            raise ValueError(f"{', '.join(given)} must be left out for {method}, which is no network; use unet")
        estimator = known[method](bev_grid, target_box)
    return estimator if abstain_below is None else estimator.with_abstention(abstain_below)


def estimate(
    sweep: Sweep | LeveledSweep | Sequence[Sweep] | ArrayLike | str | Path,
    *,
    method: str | Path | None = None,
    grid: str | BevGrid = "road",
    target: str | Target = "car",
    history: EarlierSweeps = None,
    device: str = "cpu",
    sensor: str | LidarModel | None = None,
    sensor_height_m: float | None = None,
    world_from_sensor: Rigid | None = None,
) -> FovEstimate:
    """Return the field of view of one sweep by :data:`DEFAULT_ESTIMATOR`, or by ``method``.

    Estimators are cached; use :func:`load_estimator` for the options of networks. Implausible input from points or a
    file raises warnings (:mod:`viewshed.preprocess.plausibility`).

    Args:
        sweep: a Sweep; a file that :func:`viewshed.read_sweep` reads; or points (N, 3+) in meters, x forward, y left,
            z up, the sensor at the origin; a fourth column is intensity. Or a list of sweeps, one per LiDAR of one
            vehicle, with their mountings as ``world_from_sensor`` in one frame (:mod:`viewshed.fov.union`).
        method: as ``name`` of :func:`load_estimator`.
        grid: name in :data:`GRIDS`, or a grid.
        target: name in :data:`TARGETS`, or a target.
        history: earlier sweeps of the sensor with poses, for a method that uses them.
        device: ``cpu`` or ``cuda``, for a network.
        sensor: for points or a file: beam table or its name (see :func:`viewshed.lidar_model`); None infers it.
        sensor_height_m: for points or a file: height of the sensor above the ground, if known.
        world_from_sensor: for points or a file: pose of the sensor in the map, if known.

    Raises:
        OSError: the file cannot be opened.
        ValueError: the points are invalid or not in meters, a name is unknown, ``sensor``, ``sensor_height_m`` or
            ``world_from_sensor`` is given with a Sweep, or sweeps of one vehicle lack mountings or differ in time.

    >>> import numpy as np
    >>> estimate(np.zeros((0, 4)), sensor="vlp16", world_from_sensor=Rigid.identity()).method
    'shadow_map'
    """
    estimator = _loaded(method, grid_named(grid), target_named(target), device)
    metadata: dict[str, Any] = {
        "sensor": sensor, "sensor_height_m": sensor_height_m, "world_from_sensor": world_from_sensor,
    }  # fmt: skip
    has_metadata = any(value is not None for value in metadata.values())
    items = sweep if isinstance(sweep, list | tuple) else ()
    sweeps = [item for item in items if isinstance(item, Sweep)]
    if sweeps:
        if len(sweeps) < len(items) or history is not None or has_metadata:
            raise ValueError(
                "several LiDARs must be Sweeps that state their own height and mounting, without history; leave out"
                " all but method, grid, target and device"
            )
        return union_of_views([estimator.estimate(item) for item in sweeps])
    if isinstance(sweep, Sweep | LeveledSweep):
        if has_metadata:
            raise ValueError(
                "sensor, sensor_height_m and world_from_sensor are for points, got a Sweep; set them there:"
                " sweep.replace(model=viewshed.lidar_model(NAME), …)"
            )
        return estimator.estimate(sweep, history)
    if isinstance(sweep, str | Path):
        from viewshed.io import read_sweep

        measured = read_sweep(sweep, **metadata)
    else:
        measured = sweep_of_points(cast("ArrayLike", sweep), **metadata)
    check_units(measured)
    leveled = level(measured, estimator.grid)
    for doubt in doubts(leveled):
        warnings.warn(doubt, stacklevel=2)
    return estimator.estimate(leveled, history)


@lru_cache(maxsize=4)
def _loaded(method: str | Path | None, grid: BevGrid, target: Target, device: str) -> Estimator:
    return load_estimator(method, grid=grid, target=target, device=device)


def grid_named(grid: str | BevGrid) -> BevGrid:
    """Return a grid by its name in :data:`GRIDS`, or the grid itself."""
    if isinstance(grid, BevGrid):
        return grid
    if grid not in GRIDS:
        raise ValueError(f"grid must be one of {', '.join(GRIDS)}, got {grid!r}")
    return GRIDS[grid]


def target_named(target: str | Target) -> Target:
    """Return a target by its name in :data:`TARGETS`, or the target itself."""
    if isinstance(target, Target):
        return target
    if target not in TARGETS:
        raise ValueError(f"target must be one of {', '.join(TARGETS)}, got {target!r}")
    return TARGETS[target]


__all__ = [
    "CLASSICAL", "DEFAULT_ESTIMATOR", "ESTIMATORS", "FORMER_NAMES", "LEARNED", "PAPER_ESTIMATORS",
    "PAPER_INDOOR_ESTIMATORS", "PAPER_THRESHOLD", "Estimator", "EstimatorFactory", "current_name", "estimate",
    "grid_named", "load_estimator", "paper_estimators", "paper_estimators_on", "target_named",
]  # fmt: skip
