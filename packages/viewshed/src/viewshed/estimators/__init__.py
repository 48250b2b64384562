"""The estimators by name, classical and learned: ``ESTIMATORS[name](grid, target)``, or :func:`load_estimator`."""

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
    """Makes an estimator on a grid."""

    def __call__(self, grid: BevGrid, target: Target = CAR) -> Estimator:
        """Return the estimator of ``target`` on ``grid``, with sound parameters."""
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
"""The classical ones. Rays start at the sensor, bins follow the measured azimuth step, no return means UNKNOWN."""

ESTIMATORS: dict[str, EstimatorFactory] = {**CLASSICAL, **LEARNED}
"""All of them. A network is made for the grids and targets that weights are shipped for."""

DEFAULT_ESTIMATOR = "shadow_map"
"""The method that is taken where none is named; docs/which_method.md says by which rule."""

FORMER_NAMES = {
    "vote": "majority_vote", "polygon_fit": "delaunay", "mcd": "mc_dropout", "viewnet": DEFAULT_ESTIMATOR,
}  # fmt: skip
"""Names of version 0.3, taken as well in version 0.4. ``viewnet`` was a network, which is gone."""


def current_name(method: str) -> str:
    """Return the name of now of an estimator, with a warning where it is another estimator now.

    >>> current_name("vote"), current_name("trimmed")
    ('majority_vote', 'trimmed')
    """
    if method == "viewnet":
        warnings.warn(
            f"method viewnet is gone, and {DEFAULT_ESTIMATOR} is taken, whose probability is calibrated; version 0.5"
            " will refuse the name",
            FutureWarning,
            stacklevel=3,
        )
    return FORMER_NAMES.get(method, method)


def paper_estimators(max_range_m: float) -> dict[str, EstimatorFactory]:
    """Return the estimators with the settings of arXiv 2503.07375 and its code, for returns up to ``max_range_m``.

    Returns from 3 m below to 3 m above the sensor count, in its level attitude. ``paper_label`` is the published
    label: rays from the centroid of the points. The threshold there is ``PAPER_THRESHOLD``; these estimates are 0 or 1.
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
"""Probability from which the paper calls a cell visible."""

PAPER_ESTIMATORS: dict[str, EstimatorFactory] = paper_estimators(100.0)
"""The paper's, for cars on roads."""

PAPER_INDOOR_ESTIMATORS: dict[str, EstimatorFactory] = paper_estimators(20.0)
"""The paper's, for its indoor robot."""

_ROOM_M = 20.0
"""Grids that reach no farther than this are a room's."""


def paper_estimators_on(grid: BevGrid) -> dict[str, EstimatorFactory]:
    """Return the paper's estimators for a grid: those of its indoor robot on the grid of a room."""
    return PAPER_INDOOR_ESTIMATORS if grid.half_extent_m <= _ROOM_M else PAPER_ESTIMATORS


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
    """Return an estimator, ready to use.

    Args:
        name: of :data:`ESTIMATORS`, of the paper's estimators or of an installed package's; a network's file; None is
            :data:`DEFAULT_ESTIMATOR`, or ``unet`` with ``weights``.
        grid: a name of :data:`GRIDS`, or a grid; None is that of the weights, or ``road``.
        target: a name of :data:`TARGETS`, or a target; None is that of the weights, or ``car``.
        device: of a network, ``cpu`` or ``cuda``.
        weights: of a network: a file, or a name of shipped weights.
        passes: of ``mc_dropout``, at least 2.
        seed: of the dropout masks of ``mc_dropout``.
        abstain_below: of ``shadow_map`` or a network: cells of which it is less sure than this are UNKNOWN, in [.5, 1].

    Raises:
        ValueError: a name is unknown, or an option is given that the estimator does not take; the message says which.
        ImportError: what runs networks on the device is not installed.

    >>> load_estimator("shadow_map", grid="indoor", target="pedestrian").name
    'shadow_map'
    """
    cells, thing = None if grid is None else grid_named(grid), None if target is None else target_named(target)
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
        raise ValueError(f"seed must be left out for unet, which draws no masks, got {seed}; use mc_dropout")
    if method in LEARNED:
        estimator: Estimator = load_network(
            method, cells, thing, weights=weights, passes=passes, seed=seed or 0, device=device
        )
    else:
        cells, thing = cells or grid_named("road"), thing or target_named("car")
        known = {**CLASSICAL, **paper_estimators_on(cells)}
        if method not in known:
            added = plugins("estimators")
            if method not in added:
                raise ValueError(f"method must be one of {', '.join([*known, *LEARNED, *added])}, got {method!r}")
            known[method] = load(added[method], callable, "a class or a function")
        if given:
            raise ValueError(f"{', '.join(given)} must be left out for {method}, which is no network; use unet")
        estimator = known[method](cells, thing)
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

    The estimator is loaded once and kept; for options of networks take :func:`load_estimator`. What cannot well be as
    it was read, of points or a file, is a warning.

    Args:
        sweep: a Sweep; a file that :func:`viewshed.read_sweep` reads; or points (N, 3+) in meters, x forward, y left,
            z up, the sensor at the origin; a fourth column is intensity. Or a list of sweeps, one of each LiDAR of
            one vehicle, with their mountings as ``world_from_sensor`` in one frame (:mod:`viewshed.fov.union`).
        method: as ``name`` of :func:`load_estimator`.
        grid: a name of :data:`GRIDS`, or a grid.
        target: a name of :data:`TARGETS`, or a target.
        history: earlier sweeps of the sensor with poses, for a method that uses them.
        device: of a network, ``cpu`` or ``cuda``.
        sensor: of points or a file, beam table or its name (see :func:`viewshed.lidar_model`); None infers it.
        sensor_height_m: of points or a file, height of the sensor above the ground, if it is known.
        world_from_sensor: of points or a file, pose of the sensor in the map, if it is known.

    Raises:
        OSError: the file cannot be opened.
        ValueError: the points are no sweep or not in meters, a name is unknown, a value is given for a Sweep that has
            its own, or sweeps of one vehicle have no mountings or are of different times.

    >>> import numpy as np
    >>> estimate(np.zeros((0, 4)), sensor="vlp16", world_from_sensor=Rigid.identity()).method
    'shadow_map'
    """
    estimator = _loaded(method, grid_named(grid), target_named(target), device)
    stated: dict[str, Any] = {
        "sensor": sensor, "sensor_height_m": sensor_height_m, "world_from_sensor": world_from_sensor,
    }  # fmt: skip
    is_stated = any(value is not None for value in stated.values())
    listed = sweep if isinstance(sweep, list | tuple) else ()
    several = [each for each in listed if isinstance(each, Sweep)]
    if several:
        if len(several) < len(listed) or history is not None or is_stated:
            raise ValueError(
                "of several LiDARs each must be a Sweep that says its own height and mounting, without history; leave"
                " out all but method, grid, target and device"
            )
        return union_of_views([estimator.estimate(each) for each in several])
    if isinstance(sweep, Sweep | LeveledSweep):
        if is_stated:
            raise ValueError(
                "sensor, sensor_height_m and world_from_sensor go with points, got a Sweep; say them there:"
                " sweep.replace(model=viewshed.lidar_model(NAME), …)"
            )
        return estimator.estimate(sweep, history)
    if isinstance(sweep, str | Path):
        from viewshed.io import read_sweep

        measured = read_sweep(sweep, **stated)
    else:
        measured = sweep_of_points(cast("ArrayLike", sweep), **stated)
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
