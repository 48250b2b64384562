"""Evaluates estimates against exact truth and exact ground, and the shadow map with a ladder of exact knowledge.

A row has keys (set, domain, scene, sweep; style, sensor and mounting; given data, target, method), counts over the
cells with known truth (the fields of ``ConfusionCounts``, and ``bins``: 150 × 3, by bin of probability: cells, visible
cells and sum of probabilities), and further figures. Areas are in square meters, over cells with known truth:

- ``flat``: 1 if 95 % of the ground within half of the grid's extent is within 1 m of that below the sensor.
- ``auroc``, ``aurc``: of doubt as a predictor of errors (best: 1; 0); ``auroc_std``: of the deviation, if there is
  one. Cells at which fewer than ``min_returns`` beams aim are left out.
- ``clear_both``, ``clear_over``, ``clear_under``: cells whose true number of returns differs from ``min_returns`` by
  more than 2, called visible by both, only the estimate, only the truth.
- ``known_m2``, ``claimed_m2``, ``beyond_m2``, ``beyond_reach_m2``: all; claimed; claimed beyond the sensor's maximum
  range; claimed beyond the range at which it detects a target of 10 % every second time.
- ``off_m2``, ``off_sure_m2``: estimated ground wrong by more than 1 m; of that, claimed with p ≥ 0.8.
- ``unaimed``, ``unaimed_hidden``: cells at which fewer than ``min_returns`` beams aim; of those, called HIDDEN.
- ``height_error_m``: height of the sensor above the ground, estimated minus exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators import Estimator, load_estimator
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import TARGETS, Beams, Target, expected_returns, probability_of_visible
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.grid import GRIDS, BevGrid, polar_of_cells
from viewshed.metrics import ConfusionCounts, Scores
from viewshed.monitor.roc import auroc
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab.data.wild import WildObservation, WildSample
from viewshed_lab.sim.lidar.optics import optics_of
from viewshed_lab.studies.records import Row
from viewshed_lab.studies.wild.plan import WildPlan
from viewshed_lab.studies.wild.pool import FINE_BINS

OFF_M, SURE, FLAT_M, CLEAR = 1.0, 0.8, 1.0, 2

AS_GIVEN = "shadow_map"

LADDER = ("+ exact rings and beams' table", "+ exact height and attitude", "+ exact ground", "exact ends of all beams",
          "all of it: the counting kernel alone")  # fmt: skip
"""Exact knowledge of the shadow map: the first three are cumulative; the fourth has estimated ground; the last all."""


def rows_of(seen: WildObservation, plan: WildPlan) -> Iterator[Row]:
    """Yield the rows of one sweep: every method, target and knowledge of the plan, and the ladder."""
    grid = seen.truth.grid
    for given in plan.told:
        sample = seen.sample(given)
        leveled = level(sample.sweep, grid)
        for target in plan.targets:
            for name, method in zip(plan.judged, (*plan.methods, *plan.networks), strict=True):
                estimator = estimator_named(method, seen.scene.domain.name, target)
                if estimator is not None:
                    yield row_of(seen, sample, estimator.estimate(leveled), leveled, name)
    # No ladder in a base frame: its offset is unknown, so there are no exact beams from its origin.
    if plan.ladder and seen.mounting.family.frame != "base":
        for target in plan.targets:
            yield from _ladder(seen, TARGETS[target])


def row_of(seen: WildObservation, sample: WildSample, estimate: FovEstimate, leveled: LeveledSweep, method: str) -> Row:
    """Return the row of an estimate from a sample of a sweep; this also compares the ground of ``leveled``."""
    grid, target, reach_m = seen.truth.grid, estimate.target, reach_of(seen)
    range_m, max_range_m = polar_of_cells(grid)[0], seen.sensor.model.max_range_m
    known = seen.known & (range_m <= reach_m)
    true, claimed, prob = seen.truth.visible(target), estimate.visible(), estimate.visible_prob
    unaimed = known & (seen.truth.state[target.name] == CellState.UNKNOWN)
    scores, judged = Scores(), known & ~unaimed
    std = None if estimate.std is None or np.isnan(estimate.std).any() else estimate.std
    scores.add(prob[judged], true[judged])
    wrong = (claimed != true)[judged]
    numbers = {
        "flat": float(_is_flat(sample)), "aurc": scores.aurc(), "auroc": _auroc(estimate.doubt()[judged], wrong),
        "auroc_std": float("nan") if std is None else _auroc(std[judged], wrong),
    }  # fmt: skip
    gap = np.abs(seen.truth.expected_returns[target.name].astype(np.int16) - target.min_returns)
    clear = ConfusionCounts.of(claimed, true, known & (gap > CLEAR), grid.cell_area_m2)
    numbers |= {f"clear_{name}": float(getattr(clear, name)) for name in ("both", "over", "under")}
    # Areas: beyond the sensor's reach, and over wrongly estimated ground.
    off = known & (np.abs(ground_error_m(leveled, sample)) > OFF_M)
    areas = {
        "known_m2": known, "claimed_m2": seen.known & claimed,
        "beyond_m2": seen.known & claimed & (range_m > max_range_m + grid.cell_m),
        "beyond_reach_m2": seen.known & claimed & (range_m > reach_m + grid.cell_m), "off_m2": off,
        "off_sure_m2": off & claimed & (prob >= SURE),
    }  # fmt: skip
    numbers |= {name: float(mask.sum()) * grid.cell_area_m2 for name, mask in areas.items()}
    numbers["unaimed"] = float(unaimed.sum())
    numbers["unaimed_hidden"] = float((unaimed & (estimate.state == CellState.HIDDEN)).sum())
    numbers["height_error_m"] = leveled.sensor_height_m - sample.origin_height_m
    return {
        "set_name": seen.scene.domain.set_name, "domain": seen.scene.domain.name, "scene": sample.scene,
        "sweep": seen.number, "style": sample.style, "sensor": sample.sensor, "mounting": sample.mounting,
        "told": sample.given, "target": target.name, "method": method,
        **asdict(ConfusionCounts.of(claimed, true, known, grid.cell_area_m2)),
        "bins": _bins(prob[known], true[known]).round(3).ravel().tolist(), **numbers,
    }  # fmt: skip


def reach_of(seen: WildObservation) -> float:
    """Return the maximum range in meters of scored cells: farther away the sensor does not detect dark targets."""
    model = seen.sensor.model
    return min(optics_of(model).reach_m, model.max_range_m)


def ground_error_m(leveled: LeveledSweep, sample: WildSample) -> NDArray[np.float64]:
    """Return the estimated minus the exact ground height (cells, cells) in meters, at the estimate's cells.

    The estimated ground is rotated into the exact level frame first: with a wrong attitude, ground that follows the
    returns counts as correct.
    """
    grid = sample.truth.grid
    # The estimated surface below each cell, relative to the origin of the points, in the exact level frame.
    z = leveled.ground.at(grid.centers) - leveled.sensor_height_m
    surface = np.concatenate([grid.centers, z[..., None]], axis=-1)
    turn = rotation_from_quaternion(sample.attitude) @ leveled.level_from_sensor.rotation.T
    turned = surface @ turn.T
    # The exact ground there; outside the grid that of the nearest cell.
    cells = np.floor((turned[..., :2] - grid.origin_m) / grid.cell_m).astype(np.intp).clip(0, grid.cells - 1)
    exact = sample.ground_m[cells[..., 0], cells[..., 1]] - sample.origin_height_m
    error: NDArray[np.float64] = turned[..., 2] - exact
    return error


def _ladder(seen: WildObservation, target: Target) -> Iterator[Row]:
    """Yield the shadow map's rows with more and more exact knowledge."""
    grid, sample = seen.truth.grid, seen.sample("rings")
    exact_height, exact_ground = sample.origin_height_m, sample.exact_ground
    as_given = level(sample.sweep, grid)
    rings = sample.sweep.replace(model=seen.sensor.table)
    upright = rings.replace(sensor_height_m=exact_height, attitude=sample.attitude)
    steps = [level(rings, grid), level(upright, grid)]
    steps.append(replace(steps[1], ground=exact_ground))
    estimator = ShadowMap(grid, target)
    for name, leveled in zip(LADDER, steps, strict=False):
        yield row_of(seen, sample, estimator.estimate(leveled), leveled, name)
    # Every beam to its exact end, over the estimated ground and over the exact one.
    beams = exact_beams(seen)
    for name, leveled in zip(LADDER[3:], (as_given, steps[2]), strict=True):
        counts, aimed = expected_returns(beams, leveled.sensor_height_m, leveled.ground, grid, target)
        yield row_of(seen, sample, _counted(counts, aimed, grid, target), leveled, name)


def exact_beams(seen: WildObservation) -> Beams:
    """Return every fired beam that does not hit the own vehicle, up to its end or the maximum range."""
    scan = seen.scan
    keep = scan.thing != seen.agent.carrier
    if scan.model.fired is not None:
        keep &= scan.model.fired
    depth = np.minimum(scan.depth_m[keep], np.float32(scan.model.max_range_m))
    stop = scan.origin_m[keep] + scan.direction[keep] * depth[:, None]
    x, y, z = (stop @ Rigid.from_yaw(scan.world_from_sensor.yaw).rotation.astype(np.float32)).T
    azimuth = np.arctan2(y, x)
    azimuth[azimuth >= np.pi] = -np.pi
    range_m = np.maximum(np.hypot(x, y), np.float32(1e-3))
    return Beams(azimuth, z / range_m, range_m)


def _counted(returns: NDArray[np.float32], aimed: NDArray[np.float32], grid: BevGrid, target: Target) -> FovEstimate:
    """Return the estimate from expected returns (cells, cells), by the rule of the shadow map."""
    prob = probability_of_visible(returns, target.min_returns)
    enough = probability_of_visible(aimed, target.min_returns) >= 0.5
    state = np.where(enough, np.uint8(CellState.HIDDEN), np.uint8(CellState.UNKNOWN))
    state[prob >= 0.5] = CellState.FREE
    return FovEstimate(grid, prob, state, target=target)


@lru_cache(maxsize=64)
def estimator_named(method: str, grid: str, target: str) -> Estimator | None:
    """Return an estimator, or None for a network that has no weights for the grid and target."""
    try:
        return load_estimator(method, grid=GRIDS[grid], target=target)
    except ValueError:
        return None


def _is_flat(sample: WildSample) -> bool:
    """Return whether 95 % of the ground within half of the grid's extent is within 1 m of that below the sensor."""
    near = sample.known & (polar_of_cells(sample.truth.grid)[0] <= sample.truth.grid.half_extent_m / 2)
    return bool(near.any() and (np.abs(sample.ground_m[near]) <= FLAT_M).mean() >= 0.95)


def _auroc(doubt: NDArray[np.float32], wrong: NDArray[np.bool_]) -> float:
    """Return the AUROC of doubts (K,) as predictors of errors (K,); NaN if all are right, or all wrong."""
    return auroc(doubt[~wrong], doubt[wrong]) if wrong.any() and not wrong.all() else float("nan")


def _bins(prob: NDArray[np.float32], true: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return a table (150, 3) by bin of probability: cells, visible cells and sum of probabilities."""
    bins = np.minimum((prob * FINE_BINS).astype(np.intp), FINE_BINS - 1)
    sums = [np.bincount(bins, weights, FINE_BINS) for weights in (np.ones(len(prob)), true, prob)]
    return np.stack(sums, axis=1)
