"""Compares estimators with independent truth: a city's surveyed ground, and boxes that people drew.

A claim is only right if the estimated ground is: where the surveyed ground is at another height, the claim is about
another place. A box with enough returns was visible; one without any was not. The bottom of a box is on the ground.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from viewshed.arrays import F64
from viewshed.fov.estimate import THRESHOLD, FovEstimator
from viewshed.fov.visibility import Target
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS, BevGrid
from viewshed.io._input import open_input
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.recordings.read.source import ObjectBox, SweepSource
from viewshed.sweep import Sweep
from viewshed_lab._page import facts
from viewshed_lab.studies.formatting import by_name, format_number, format_rate, lines, pivot
from viewshed_lab.studies.pages import Table, fill_template

OnError = Callable[[str, Exception], None]

OFF_M = 0.3
"""A claim is off if its ground differs from the surveyed ground by more than this."""

BANDS_M = ((0.0, 16.0), (16.0, 32.0), (32.0, 48.0), (48.0, 64.0))

VEHICLE_M = (3.0, 1.4, 1.2)
"""Minimum length, width and height of a vehicle, whatever the class in its data set."""

_INSIDE_M = 0.3
"""A box is looked up this far behind its point nearest to the sensor."""

_CATCH_M = 0.1
"""Margin around a box when its returns are counted: boxes are drawn to a few centimeters."""

_MAX_BYTES = 200_000_000


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedGround:
    """Ground of a city on a raster, NaN where it was not surveyed."""

    z_m: F64  # (rows, columns) float64 height in the city's frame
    shift_m: F64  # (2,) column and row are ((x, y) + shift_m) * per_m in the city's frame
    per_m: float  # pixels per meter

    @classmethod
    def read(cls, log: Path) -> Self:
        """Return the surveyed ground in the folder ``map`` of an Argoverse 2 log.

        Raises:
            ValueError: a file is missing or damaged.
        """
        rasters, places = (
            sorted((log / "map").glob(name)) for name in ("*_ground_height_surface_*.npy", "*_Sim2_city.json")
        )
        if len(rasters) != 1 or len(places) != 1:
            raise ValueError(
                f"{log}: must hold map/*_ground_height_surface_*.npy and map/*_Sim2_city.json once each,"
                f" got {len(rasters)} and {len(places)}"
            )
        with open_input(places[0]) as source:
            place = json.loads(source.content(_MAX_BYTES))
            if not isinstance(place, dict) or [float(r) for r in place["R"]] != [1.0, 0.0, 0.0, 1.0]:
                raise ValueError("R must be the identity; rotated rasters are not supported")
            shift_m, per_m = np.array(place["t"], np.float64), float(place["s"])
        with open_input(rasters[0]) as source:
            if source.size > _MAX_BYTES:
                raise ValueError(f"must be at most {_MAX_BYTES} bytes, got {source.size}")
            z_m = np.load(source.file, allow_pickle=False).astype(np.float64)
        if z_m.ndim != 2 or shift_m.shape != (2,):
            raise ValueError(f"{rasters[0]}: must have rows and columns, got shape {z_m.shape}")
        return cls(z_m, shift_m, per_m)

    def at(self, xyz: F64) -> F64:
        """Return the ground height (…,) at points (…, 3) of the city's frame; NaN where it was not surveyed."""
        column, row = np.moveaxis(np.floor((xyz[..., :2] + self.shift_m) * self.per_m).astype(np.int64), -1, 0)
        rows, columns = self.z_m.shape
        is_on = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.where(is_on, self.z_m[np.where(is_on, row, 0), np.where(is_on, column, 0)], np.nan)


def ground_table(sweeps: Sequence[pd.DataFrame]) -> Table:
    """Return the table of ground errors of several sweeps, for seen and unseen ground by range."""
    rows = pd.concat(sweeps)
    parts = {
        f"{word}, {low:g} to {high:g} m": rows[(rows["seen"] == seen) & rows["range_m"].between(low, high, "left")]
        for word, seen in (("seen", True), ("unseen", False))
        for low, high in BANDS_M
    }
    figures: dict[str, Callable[[pd.DataFrame], str]] = {
        "heights": lambda part: f"{len(part)}",
        "median of the absolute error, m": lambda part: _quantile(part["off_m"], 0.5),
        "90 %, m": lambda part: _quantile(part["off_m"], 0.9),
        "within one standard deviation": lambda part: format_rate(float((part["off_m"] <= part["std_m"]).mean())),
        "90 % where the estimate states at most .1 m": lambda part: _quantile(part["off_m"][part["std_m"] <= 0.1], 0.9),
    }
    return lines("ground", parts, figures)


def survey_page(log: Path, source: SweepSource, estimators: Mapping[str, FovEstimator], target: Target) -> str:
    """Return the page of an Argoverse 2 log: claims on its surveyed ground, and its boxes.

    Raises:
        ValueError: the log has no surveyed ground, no sweep or no pose; the message names the file.
    """
    grid, errors = GRIDS["road"], list[pd.DataFrame]()
    # By band: claimed cells, those of them on surveyed ground, and those of these that are off.
    claims = {name: np.zeros((3, len(BANDS_M))) for name in estimators}
    sweeps = list[tuple[Sweep, Sequence[ObjectBox]]]()
    range_m = np.hypot(grid.centers[..., 0], grid.centers[..., 1])
    for sweep, boxes, leveled, error_m in surveyed(log, source, grid):
        sweeps.append((sweep, boxes))
        known = np.isfinite(error_m)
        errors.append(ground_errors(leveled, grid.centers[known], error_m[known]))
        for name, estimator in estimators.items():
            claimed = np.nan_to_num(estimator.estimate(sweep).at(grid.centers)) >= THRESHOLD
            masks = (claimed, claimed & known, claimed & known & (np.abs(error_m) > OFF_M))
            claims[name] += [[np.count_nonzero(mask & (range_m >= low) & (range_m < high)) for low, high in BANDS_M]
                             for mask in masks]  # fmt: skip
    page = fill_template(
        "judges.md", title="Judged by others: surveyed ground and boxes", sweeps=len(sweeps),
        scenes=len(source.scenes()), off_m=OFF_M, target=target, off=_off_table(claims), unknown=_unknown_share(claims),
        ground=ground_table(errors), **_box_tables(sweeps, estimators, target),
    )  # fmt: skip
    return page.markdown(facts(log=log.name, target=target.name))


def surveyed(
    log: Path, source: SweepSource, grid: BevGrid
) -> Iterator[tuple[Sweep, Sequence[ObjectBox], LeveledSweep, F64]]:
    """Yield the sweeps of an Argoverse 2 log with boxes, the leveled sweep, and the ground error (cells, cells).

    The error is estimated minus surveyed height in meters, NaN where there is no survey.
    """
    survey = SurveyedGround.read(log)
    for sweep, boxes in annotated(source, None):
        leveled = level(sweep, grid)
        if leveled.world_from_level is None:
            raise ValueError(
                f"{log}: every sweep must have a pose, got one without; look at city_SE3_egovehicle.feather"
            )
        ground_m = leveled.ground.at(grid.centers).astype(np.float64)
        in_city = leveled.world_from_level @ np.dstack([grid.centers, ground_m])
        yield sweep, boxes, leveled, in_city[..., 2] - survey.at(in_city)


def boxes_page(
    place: Path, source: SweepSource, estimators: Mapping[str, FovEstimator], target: Target, limit: int,
    on_error: OnError,
) -> str:  # fmt: skip
    """Return the page of a recording with annotated boxes; unreadable sweeps are reported and skipped.

    Raises:
        ValueError: the recording has no annotated boxes.
    """
    sweeps = list(annotated(source, limit, on_error))
    if not any(boxes for _, boxes in sweeps):
        raise ValueError(f"{place}: must hold annotated boxes, got {len(sweeps)} sweeps without one")
    page = fill_template(
        "judges.md", title="Judged by boxes that people drew", sweeps=len(sweeps), scenes=len(source.scenes()),
        off_m=OFF_M, target=target, off=None, unknown="", ground=None, **_box_tables(sweeps, estimators, target),
    )  # fmt: skip
    return page.markdown(facts(recording=place.name, target=target.name))


def annotated(
    source: SweepSource, limit: int | None, on_error: OnError | None = None
) -> Iterable[tuple[Sweep, Sequence[ObjectBox]]]:
    """Yield sweeps of a recording with their boxes: at most ``limit`` keyframes, spread evenly.

    ``on_error`` is called with the file and the error of an unreadable sweep, which is skipped; without it the error
    is raised.
    """
    refs = [ref for scene in source.scenes() for ref in source.refs(scene) if ref.keyframe]
    count = len(refs) if limit is None else min(limit, len(refs))
    for ref in (refs[k * len(refs) // count] for k in range(count)):
        try:
            sweep, boxes = source.read(ref), source.boxes(ref) or ()
        except (ValueError, OSError) as error:
            if on_error is None:
                raise
            on_error(ref.file, error)
        else:
            yield sweep, boxes


def ground_errors(leveled: LeveledSweep, xy: F64, error_m: F64) -> pd.DataFrame:
    """Return a table of the errors (N,) of a sweep's ground at places (N, 2) in the level frame.

    Columns: absolute error ``off_m``; estimated standard deviation ``std_m``; ``seen``, whether the estimate there
    rests on returns; and ``range_m`` from the sensor.
    """
    ground = leveled.ground
    nodes = BevGrid(len(ground.heights_m), ground.half_extent_m)
    row, column = np.clip(np.floor((xy + ground.half_extent_m) / nodes.cell_m), 0, nodes.cells - 1).astype(int).T
    return pd.DataFrame({
        "off_m": np.abs(error_m), "std_m": ground.std_m[row, column].astype(np.float64),
        "seen": ground.seen[row, column], "range_m": np.hypot(xy[:, 0], xy[:, 1]),
    })  # fmt: skip


def _box_tables(
    sweeps: Sequence[tuple[Sweep, Sequence[ObjectBox]]],
    estimators: Mapping[str, FovEstimator],
    target: Target,
) -> dict[str, Any]:
    """Return the tables of vehicles with enough returns, of those without any, and of the ground below all boxes."""
    rows: list[tuple[str, int, float, bool]] = []
    errors: list[pd.DataFrame] = []
    left_out = 0
    for sweep, boxes in sweeps:
        leveled = level(sweep, GRIDS["road"])
        # Without a pose, the boxes are in the sensor's frame.
        level_from_world = leveled.level_from_sensor @ (sweep.world_from_sensor or Rigid.identity()).inverse()
        within = [box for box in boxes if np.hypot(*(level_from_world @ box.center)[:2]) < BANDS_M[-1][1]]
        if within:
            bottoms = np.stack(
                [level_from_world @ (box.world_from_box @ np.array([0.0, 0.0, -box.size_m[2] / 2])) for box in within]
            )
            errors.append(
                ground_errors(leveled, bottoms[:, :2], leveled.ground.at(bottoms).astype(np.float64) - bottoms[:, 2])
            )
        vehicles = [
            box for box in within if all(size >= minimum for size, minimum in zip(box.size_m, VEHICLE_M, strict=True))
        ]
        returns = [judged_returns(box, sweep) for box in vehicles]
        left_out += sum(0 < count < target.min_returns for count in returns)
        near = np.array([near_point(level_from_world, box) for box in vehicles])
        for name, estimator in estimators.items() if vehicles else ():
            claimed = np.nan_to_num(estimator.estimate(sweep).at(near)) >= THRESHOLD
            rows += [(name, *row) for row in zip(returns, np.hypot(*near.T), claimed, strict=True)]
    vehicle_rows = pd.DataFrame(rows, columns=["method", "returns", "range_m", "claimed"])

    def shares(part: pd.DataFrame) -> Table:
        """Return the share of vehicles that stand in claimed cells, by method and range."""

        def share(name: str, band: tuple[float, float]) -> str:
            claimed = part["claimed"][(part["method"] == name) & part["range_m"].between(*band, "left")]
            return f"{format_rate(float(claimed.mean()))} of {len(claimed)}" if len(claimed) else "–"

        heads = {f"{low:g} to {high:g} m": (low, high) for low, high in BANDS_M}
        return pivot("", by_name(estimators), heads, share)

    return {
        "seen": shares(vehicle_rows[vehicle_rows["returns"] >= target.min_returns]),
        "without": shares(vehicle_rows[vehicle_rows["returns"] == 0]),
        "bottoms": ground_table(errors) if errors else None,
        "left_out": left_out,
    }


def judged_returns(box: ObjectBox, sweep: Sweep) -> int:
    """Return the number of returns in a box: the annotated one, or without it the counted one.

    If the annotation is 0 but returns lie at the edge of the box, it is 1: too few for visible, too many for hidden.
    """
    counted = returns_in(box, sweep)
    return counted if box.returns is None else box.returns or min(counted, 1)


def returns_in(box: ObjectBox, sweep: Sweep) -> int:
    """Return the number of returns of a sweep in a box, with a margin of ``_CATCH_M``."""
    sensor_from_world = (sweep.world_from_sensor or Rigid.identity()).inverse()
    inside = (sensor_from_world @ box.world_from_box).inverse() @ sweep.points.astype(np.float64)
    return int((np.abs(inside) <= np.array(box.size_m) / 2 + _CATCH_M).all(axis=1).sum())


def near_point(level_from_world: Rigid, box: ObjectBox) -> F64:
    """Return the point (2,) in the level frame at which a box is looked up: just inside its side toward the sensor.

    Its center is no use, as a vehicle hides its own center.
    """
    level_from_box = level_from_world @ box.world_from_box
    half = np.array(box.size_m) / 2
    sensor = level_from_box.inverse() @ np.zeros(3)
    nearest = np.clip(sensor, -half, half)
    nearest[2] = 0.0
    point, center = (level_from_box @ nearest)[:2], level_from_box.translation[:2]
    inward = center - point
    length = float(np.hypot(*inward))
    return np.asarray(point + inward * min(_INSIDE_M / max(length, 1e-9), 1.0))


def _off_table(claims: Mapping[str, F64]) -> Table:
    """Return the table of the share of claims on surveyed ground that are off, by method and band."""
    heads = {f"{low:g} to {high:g} m": k for k, (low, high) in enumerate(BANDS_M)}

    def share(counts: F64, band: int) -> str:
        _, surveyed, off = counts[:, band]
        return f"{format_rate(off / surveyed)} of {surveyed:.0f}" if surveyed else "–"

    return pivot("", claims, heads, share)


def _unknown_share(claims: Mapping[str, F64]) -> str:
    """Return the share of all claims on ground that was not surveyed, as text."""
    cells, surveyed, _ = sum(counts.sum(axis=1) for counts in claims.values())
    return format_rate(1.0 - surveyed / cells, 2) if cells else "–"


def _quantile(values: pd.Series[float], share: float) -> str:
    return format_number(float(values.quantile(share)), 2)
