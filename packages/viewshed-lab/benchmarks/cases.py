"""The measured steps, each with its target, its alternatives and the minimum number of bytes that it moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import alternatives, clouds
from viewshed import ESTIMATORS, GRIDS, BevGrid, Sweep, read_sweep
from viewshed.fov.polygons import polygon_of_mask
from viewshed.geometry import Rigid
from viewshed.preprocess.leveling import level

GRID: BevGrid = GRIDS["road"]
HEIGHTS_M = (-2.5, 2.0)
MAX_RANGE_M = 64.0
POINT_BYTES, CELL_BYTES = 12, 1 + 4
QUICK_MS, SHADOW_MS = {"35k": 1.0, "120k": 2.0}, {"35k": 3.0, "120k": 6.0}
QUICK = ("farthest", "continuous", "quantized", "first_blocker", "trimmed")


@dataclass(frozen=True, slots=True)
class Case:
    """One row: a step with its input size, target and alternatives."""

    step: str  # description of the step
    size: str  # "35k" or "120k"
    job: Callable[[], object]  # runs the step once
    floor_bytes: int  # minimum number of bytes read and written
    target_ms: float | None = None  # maximum milliseconds, or None
    target_ratio: tuple[str, float] | None = None  # maximum (name of an alternative, multiple of its time), or None
    others: Mapping[str, Callable[[], object]] = field(default_factory=dict)  # the alternatives by name


def all_cases(folder: Path, rng: np.random.Generator) -> Iterator[Case]:
    """Yield every case on simulated sweeps of 35k and 120k points, then on real ones; files go into ``folder``."""
    for size in clouds.SENSORS:
        sweep = clouds.synthetic(size, rng)
        yield from _reading(size, sweep, folder)
        yield _counting(size, sweep)
        yield from _estimating(size, sweep)
        yield _polygon(size, ESTIMATORS["shadow_map"](GRID).estimate(sweep).visible())
    for size, sweep in clouds.real().items():
        for case in _estimating(size, sweep):
            yield replace(case, size=f"{size}, real")


def _reading(size: str, sweep: Sweep, folder: Path) -> Iterator[Case]:
    nuscenes = clouds.write_nuscenes(sweep, folder / f"{size}.pcd.bin")
    kitti = clouds.write_kitti(sweep, folder / f"{size}.bin")
    for name, path in (("nuScenes", nuscenes), ("KITTI", kitti)):
        yield Case(
            f"read {name} sweep",
            size,
            lambda path=path: read_sweep(path),  # type: ignore[misc]
            path.stat().st_size,
            target_ratio=("numpy.fromfile", 2.0),
            others={"numpy.fromfile": lambda path=path: np.fromfile(path, np.float32)},  # type: ignore[misc]
        )


def _counting(size: str, sweep: Sweep) -> Case:
    transform = Rigid(np.eye(3), np.zeros(3))
    points = sweep.points

    def ours() -> NDArray[np.int32]:
        return GRID.count(points, transform, max_range_m=MAX_RANGE_M, height_m=HEIGHTS_M)

    def by(count: Callable[..., NDArray[Any]]) -> Callable[[], NDArray[Any]]:
        return lambda: count(points, transform, GRID, MAX_RANGE_M, HEIGHTS_M)

    others = {
        "np.histogram2d": by(alternatives.count_by_histogram2d),
        "np.bincount": by(alternatives.count_by_bincount),
    }
    for name, other in others.items():
        # Beams straight back lie on the edge of cells, where float32 and float64 may differ.
        _same(name, float(np.abs(ours() - other()).sum()) / len(points), at_most=0.003)
    floor = POINT_BYTES * len(points) + 4 * GRID.cells**2
    return Case("project, filter, count", size, ours, floor, {"35k": 0.15, "120k": 0.4}[size], others=others)


def _estimating(size: str, sweep: Sweep) -> Iterator[Case]:
    floor = POINT_BYTES * len(sweep) + CELL_BYTES * GRID.cells**2
    yield Case("level and ground", size, lambda: level(sweep, GRID), 2 * POINT_BYTES * len(sweep))
    for name, make in ESTIMATORS.items():
        estimator = make(GRID)
        target = SHADOW_MS[size] if name == "shadow_map" else 10.0 if name == "concave_hull" else None
        yield Case(
            f"`{name}`: points to estimate",
            size,
            lambda estimator=estimator: estimator.estimate(sweep),  # type: ignore[misc]
            floor,
            QUICK_MS[size] if name in QUICK else target,
            others=alternatives.hulls(sweep, GRID) if name == "concave_hull" else {},
        )


def _polygon(size: str, mask: NDArray[np.bool_]) -> Case:
    others = {
        "rasterio shapes": lambda: alternatives.polygon_by_rasterio(mask, GRID),
        "contourpy (smooths corners)": lambda: alternatives.polygon_by_contourpy(mask, GRID),
    }
    area = float(mask.sum()) * GRID.cell_area_m2
    _same("polygon_of_mask", polygon_of_mask(mask, GRID).area / area - 1.0, at_most=1e-9)
    _same("rasterio shapes", others["rasterio shapes"]().area / area - 1.0, at_most=1e-9)
    return Case(
        "polygon with holes of a mask", size, lambda: polygon_of_mask(mask, GRID), GRID.cells**2, 2.0, others=others
    )


def _same(name: str, difference: float, at_most: float) -> None:
    if abs(difference) > at_most:
        raise RuntimeError(f"{name} does another job than ours (difference {difference}): its time says nothing")
