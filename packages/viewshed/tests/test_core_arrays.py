"""The functions of the native core: arrays that do not fit are refused, and answers are the same on any threads."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.agents.test_fov_code import street as street_view
from tests.objects.scenes import car, person, seen
from tests.preprocess.random_sensors import rosette
from tests.preprocess.test_expected_returns import random_beams, random_boxes

from viewshed import BevGrid, Sweep, _core
from viewshed.agents.fov_code import encode_fov
from viewshed.fov.visibility import cell_windows
from viewshed.grid import polar_of_cells
from viewshed.objects.detector import Detector
from viewshed.preprocess.azimuth_bins import bins_of_cells
from viewshed.preprocess.leveling import level
from viewshed.preprocess.no_return import beams_by_evidence, no_return_beams
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction

F4, I4, I2, U1 = np.float32, np.int32, np.int16, np.uint8
GRID, BIG = BevGrid(32, 16.0, (2.0, -1.0)), BevGrid(256, 64.0)
N, RINGS, COLUMNS, NODES = 6, 4, 8, 64
POINTS, LONG, SHORT, MASK = np.ones((N, 3), F4), np.zeros(N, F4), np.zeros(N - 1, F4), np.zeros(N, np.bool_)
ROWS, FLAT, SQUARE = np.arange(N, dtype=I4), np.zeros((NODES, NODES), F4), np.ones((NODES, NODES), np.bool_)
HALF = np.tile(np.arange(NODES) >= NODES // 2, (NODES, 1))
NAN, INF = float("nan"), float("inf")
MIDDLES = np.arange(NODES, dtype=F4) + F4(0.5 - NODES / 2)
LOWS = np.stack([*np.meshgrid(MIDDLES, MIDDLES, indexing="ij"), FLAT - F4(1.8)], axis=-1)
VLP16 = lidar_model("vlp16")
TABLE = {"elevation": VLP16.elevation, "origin_m": VLP16.origin_m}
CELLS = {"cell_range_m": polar_of_cells(GRID)[0]}
BINS = bins_of_cells(GRID, 90)
MASK3, RING, BEGIN, RANGES = np.ones((3, 3), np.bool_), np.zeros((4, 2)), np.array([0, 4]), np.ones(8)
CLOUD = np.zeros((4, 3), F4), np.ones(4, F4), np.eye(3, 4, dtype=F4)
KIND = (LONG, LONG, LONG)
PLANE = np.zeros((4, 4), U1)
BOX, CORNER = np.array([[6.0, 2.0, 0.8, 4.0, 1.8, 1.5, 0.3]]), {"x_m": -2.0, "y_m": -2.0, "cell_m": 1.0}
APEX = {"x_m": 0.0, "y_m": 0.0, "cell_m": 1.0, "apex_x_m": 1.5, "apex_y_m": 1.5, "half_m": 0.5, "bins": 8}

EVIDENCE: dict[str, Any] = {
    "evidence": (np.full(GRID.shape, 0.4, F4),) * 6, "returns": KIND, "low_m": 0.3, "high_m": 3.0, "heights_m": FLAT,
}  # fmt: skip

GOOD: dict[str, dict[str, Any]] = {
    "range_image": {"points": POINTS, "ring": np.zeros(N, I2),
     "columns": 16, "rings": 4, "near_m": 0.5, "far_m": 100.0},
    "level_points": {
        "points": POINTS, "clutter": None, "level_from_sensor": np.eye(3, 4, dtype=F4), "near_m": 0.5, "far_m": 250.0,
        "heading": 0.0, "ground_m": FLAT, "half_extent_m": 32.0},
    "beams_by_evidence": {
        "ring": np.arange(N, dtype=I2) % RINGS, "column": ROWS, "counts": np.ones((RINGS, COLUMNS), U1),
        "isolated": MASK, "clutter": None, "phase": np.zeros(RINGS, F4), "elevation": np.linspace(-0.3, 0.0, RINGS),
        "origin_m": np.zeros(RINGS), "rotation": np.eye(3), "points": POINTS, "height_m": LONG,
        "range_m": LONG + F4(5.0), "rows": ROWS, "sensor_height_m": 1.8, "ground_m": FLAT,
        "half_extent_m": 32.0, "top_m": 1.5, "obstacle_m": 0.3},
    "vehicle_heading": {"points": POINTS, "rotation": np.eye(3, dtype=F4)},
    "beam_slopes": {"points": POINTS, "range_m": LONG + 1, "sensor_height_m": 1.8, "left_out": None, "rows": ROWS},
    "obstacle_cells": {"points": POINTS, "height_m": LONG, "x0_m": -2.0, "y0_m": -2.0, "cells_per_m": 1.0, "low_m": 0.3,
                       "high_m": 3.0, "cells": 4},
    "level_sweep": {"points": POINTS, "ring": np.arange(N, dtype=I2) % RINGS, "rings": RINGS, "columns": COLUMNS,
                    "near_m": 0.5, "far_m": 100.0, "attitude": None, "height_m": None, "yaw": None,
                    "half_extent_m": 32.0},
    "ground_of_lows": {"lows_m": LOWS, "rise_m": FLAT, "half_m": 32.0, "height_m": 1.8},
    "held_ground": {
        "heights_m": FLAT - F4(1.8), "std_m": np.where(HALF, F4(0.1), F4(1.0)), "seen": HALF,
        "half_m": 32.0, "before_heights_m": FLAT - F4(1.8), "before_std_m": FLAT + F4(0.1), "before_seen": SQUARE,
        "before_half_m": 32.0, "before_from_now": np.eye(2, 4, dtype=F4), "now_from_before": np.array([0, 0, 1, 0], F4),
        "variance_m2": 0.0025},
    "map_returns": {"points": POINTS, "azimuth": LONG, "range_m": LONG + 2, "sensor_height_m": 1.8, "heights_m": FLAT,
                    "seen": HALF, "half_m": 32.0},
    "predict_ground": {"maps": np.zeros((8, 128, 96), F4), "sensor_height_m": 1.8},
    "complete_ground": {"points": POINTS, "azimuth": LONG, "range_m": LONG + 2, "left_out": None, "rows": ROWS,
                        "sensor_height_m": 1.8, "heights_m": FLAT, "std_m": FLAT, "seen": HALF, "half_m": 32.0},
    "identify_sensor": {"points": POINTS, "ring": None, "is_inferred": True, "expected": -1,
                        "held_elevation": TABLE["elevation"], "held_origin_m": TABLE["origin_m"]} | TABLE,
    "infer_sensor": {"points": POINTS, "ring": None},
    "recover_rings": {"points": POINTS, "ring": None, "columns": 1800} | TABLE,
    "match_beams": {"slope": LONG, "range_m": LONG} | TABLE,
    "find_clusters": {"azimuth": LONG, "slope": LONG, "range_m": LONG}, "polar": {"points": POINTS},
    "obstacle_image": {"clouds": [CLOUD], "least_m": 0.3, "sensor_height_m": 1.8},
    "end_at_obstacles": {"image": _core.obstacle_image([], 0.3, 1.8), "azimuth": LONG, "slope": LONG, "depth_m": LONG},
    "confirmed_cells": {
        "seen": np.ones((4, 4), np.bool_), "earlier_from_now": np.eye(2, 3, dtype=F4), "origin_x_m": 0.0,
        "origin_y_m": 0.0, "cell_m": 1.0, "in_view": np.ones((4, 4), F4), "whole": np.ones((4, 4), F4)},
    "azimuth_bins_filled": {"azimuth": LONG},
    "farthest_in_bins": {"azimuth": LONG, "range_m": LONG, "bins": 5, "drop": 0},
    "first_blocker": {"azimuth": LONG, "range_m": LONG, "height_m": LONG, "low_m": 0.0, "high_m": 1.0, "bins": None,
                      "rank": 1, "median_bins": 0, "reach_m": None, "margin_m": 0.0},
    "cells_within": {"limit_m": np.zeros(90, F4), "cell_bin": BINS} | CELLS,
    "trace_windows": {"azimuth": LONG, "range_m": LONG, "slices": 90, "window": 0.5, "margin_m": 0.0,
                      "cell_azimuth": polar_of_cells(GRID)[1], "cell_slice": BINS} | CELLS,
    "any_return_on": {"points": POINTS, "range_m": LONG, "far_m": 1.0, "low_m": 0.0, "high_m": 1.0, "sensor_m": 0.0,
                      "x0_m": 0.0, "y0_m": 0.0, "cells_per_m": 1.0, "cells": 4},
    "concave_hull": {"points": POINTS, "range_m": LONG, "concavity": 1.0, "length_m": 1.0, "x_m": -8.0, "y_m": -8.0,
                     "cell_m": 0.5, "cells": 32},
    "thin_returns": {"points": POINTS, "range_m": LONG, "x_m": 0.0, "y_m": 0.0, "cell_m": 1.0},
    "fill_rings": {"edges": np.zeros((1, 4)), "x_m": 0.0, "y_m": 0.0, "cell_m": 1.0, "cells": 4},
    "mean_and_deviation": {"probability": np.zeros((2, 5), F4)},
    "rings_of_mask": {"mask": MASK3, "regions": np.ones((3, 3), I4)},
    "cells_inside": {"points": RING, "begin": BEGIN, "cells": 5},
    "cells_met": {"points": RING, "begin": BEGIN, "cells": 5},
    "best_sectors": {"ranges": RANGES, "sectors": 2, "inner": 0.0},
    "star_vertices": {"ranges": RANGES, "price_m2": 1.0}, "free_ranges": {"mask": MASK3, "is_solid": True} | APEX,
    "beam_evidence": {
        "measured": KIND, "lost": (LONG,) * 5, "returns": KIND, "heights_m": FLAT, "std_m": FLAT,
        "low_m": 0.3, "high_m": 3.0, "half_extent_m": 20.0, "sensor_height_m": 1.8, "target_height_m": 1.5,
        "table": _core.poisson_table(5), "reach_m": 60.0},
    "cell_features": EVIDENCE,
    "CellWindows": {"range_m": np.ones((4, 4), F4), "azimuth": np.ones((4, 4), F4), "cell_m": 0.5, "width_m": 1.8},
    "interpolate": {"heights_m": FLAT, "node": np.zeros(1, I4), "down": np.zeros(1), "right": np.zeros(1)},
    "lattice_positions": {"xy": np.zeros((1, 2), F4), "half_extent_m": 1.0, "nodes": 8},
    "object_candidates": {"points": POINTS, "height_m": LONG, "range_m": LONG, "sensor_height_m": 1.8},
    "visible_before": {"prob": np.ones((4, 4), F4), "boxes": BOX} | CORNER,
    "look_at_boxes": {"states": PLANE, "pose": np.zeros(4), "boxes": BOX, "place_x_m": 0.0, "place_y_m": 0.0,
                      "along": 5, "across": 3} | CORNER,
    "surface_cells": {"states": PLANE + U1(2), "nearest_m": 0.0, "farthest_m": 9.0} | CORNER,
    "mark_surfaces": {"seen_by": np.zeros((8, 8), np.uint32), "surfaces": RING, "pose": np.zeros(4), "cell_m": 0.5,
                      "bit": 2, "wide": True, "erase": False},
    "best_shift": {"now": SQUARE, "before": HALF, "most": 4},
    "range_noise": {"points": POINTS, "step_share": 0.03, "step_m": 0.05, "least": 1},
    "count_met": {"surfaces": RING, "headings": np.zeros(3), "x_m": np.zeros(5), "y_m": np.zeros(5), "cell_m": 0.5,
                  "seen_by": np.ones((8, 8), np.uint32), "own_bit": 2},
    "compare_view": {
        "states": PLANE, "heights_m": FLAT, "half_extent_m": 32.0, "pose": np.zeros(4), "places_m": RING + 3.0,
        "ground_m": np.zeros(4), "owner": np.arange(4, dtype=I4) // 2, "is_free": np.arange(4) % 2 == 0, "own": 1,
        "agents": 3, "blockers": RING, "from_above": False, "nearest_m": 2.0, "farthest_m": 40.0,
        "same_ground_m": 0.4} | CORNER,
    "compare_past": {"states": PLANE, "last_states": PLANE, "last_x_m": -2.0, "last_y_m": -2.0, "last_cell_m": 1.0,
                     "last_from_now": np.zeros(4), "places": RING} | CORNER,
    "encode_view": {"state": PLANE, "level": PLANE, "deviation": PLANE, "row": 1, "column": 2},
    "decode_view": {"code": np.zeros(3, U1), "cells": 4, "row": 0, "column": 0, "prob": np.zeros(16, F4),
                    "std": np.zeros(9, F4)},
}  # fmt: skip
"""Function → arguments that it takes."""

OF_VIEWS = ("surface_cells", "visible_before", "look_at_boxes", "compare_view", "compare_past")
ANY_LENGTH = {
    "level_points": ("points",), "vehicle_heading": ("points",), "identify_sensor": ("points",),
    "infer_sensor": ("points",), "recover_rings": ("points",),
    "polar": ("points",), "azimuth_bins_filled": ("azimuth",), "fill_rings": ("edges",),
    "mean_and_deviation": ("probability",), "best_sectors": ("ranges",),
    "star_vertices": ("ranges",), "beam_evidence": ("table",),
    "cell_features": ("heights_m",), "lattice_positions": ("xy",),
    "visible_before": ("boxes",), "look_at_boxes": ("boxes",), "mark_surfaces": ("surfaces",),
    "count_met": ("surfaces", "headings", "x_m", "y_m"), "compare_view": ("blockers",), "compare_past": ("places",),
    "decode_view": ("code",), "range_noise": ("points",),
}  # fmt: skip
"""Function → arrays that may be of any length, whatever the others are."""

BAD_CELLS = [
    {"evidence": EVIDENCE["evidence"][1:]}, {"evidence": (np.zeros((4, 4), F4),) * 6}, {"returns": (LONG, LONG, SHORT)},
    {"evidence": (*EVIDENCE["evidence"][1:], np.zeros((4, 4), F4))},
]  # fmt: skip

REFUSED: dict[str, list[dict[str, Any]]] = {
    "range_image": [{"ring": np.full(N, 4, I2)}, {"ring": np.full(N, -2, I2)}, {"columns": 0}, {"columns": 1 << 40},
                    {"rings": 0}],
    "level_points": [{"points": np.zeros((N, 2), F4)}, {"clutter": MASK[1:]}, {"clutter": MASK.astype(U1)},
                     {"level_from_sensor": np.eye(4, dtype=F4)}, {"heading": NAN}, {"ground_m": FLAT[:, :32].copy()},
                     {"ground_m": FLAT[:1, :1].copy()}, {"half_extent_m": 0.0}, {"half_extent_m": NAN}],
    "beams_by_evidence": [
        {"ring": np.full(N, RINGS, I2)}, {"ring": np.full(N, -1, I2)},
        {"ring": np.full(N, RINGS, I2), "isolated": ~MASK},
        {"column": np.full(N, COLUMNS, I4)}, {"counts": np.ones((0, COLUMNS), U1)},
        {"counts": np.ones((RINGS + 1, COLUMNS), U1)}, {"clutter": MASK[1:]}, {"elevation": np.full(RINGS, NAN)},
        {"rotation": np.full((3, 3), INF)}, {"rows": ROWS + 1}, {"rows": ROWS - 1},
        {"points": np.zeros((N + 1, 3), F4)}, {"ground_m": FLAT[:, :2].copy()}, {"half_extent_m": -1.0}],
    "vehicle_heading": [{"rotation": np.eye(2, dtype=F4)}],
    "beam_slopes": [{"left_out": MASK[1:]}, {"left_out": MASK, "rows": ROWS - 1}, {"left_out": MASK[:0]}],
    "obstacle_cells": [{"cells": 0}, {"cells": 1 << 20}],
    "level_sweep": [{"attitude": np.eye(2, 3)}, {"attitude": np.eye(3, dtype=F4)}, {"attitude": np.full((3, 3), NAN)},
                    {"far_m": INF}, {"far_m": NAN}, {"half_extent_m": 0.0}, {"half_extent_m": NAN}, {"height_m": NAN},
                    {"yaw": INF}, {"ring": np.full(N, RINGS, I2)}, {"columns": 0}],
    "ground_of_lows": [{"lows_m": LOWS * F4(3.0)}],
    "held_ground": [{"before_heights_m": FLAT * F4(NAN)}, {"before_from_now": FLAT}],
    "map_returns": [{"azimuth": LONG[1:]}, {"seen": HALF[1:]}, {"half_m": 0.0}, {"half_m": INF},
                    {"sensor_height_m": NAN}],
    "predict_ground": [{"maps": np.zeros((7, 128, 96), F4)}, {"sensor_height_m": INF}],
    "complete_ground": [{"rows": ROWS[1:]}, {"left_out": MASK[:0]}, {"heights_m": FLAT * F4(NAN)}, {"half_m": 0.0}],
    "identify_sensor": [{"ring": np.zeros(N - 1, I2)}, {"expected": 99}, {"expected": -2},
                        {"held_origin_m": np.zeros(2)}, {"held_elevation": TABLE["elevation"][::-1].copy()}],
    "recover_rings": [{"ring": np.full(N, 4096, I2)}, {"columns": 0}],
    "infer_sensor": [{"ring": np.full(N, -2, I2)}],
    "match_beams": [{"elevation": TABLE["elevation"][::-1].copy()}, {"elevation": np.array([0.0, NAN]),
                    "origin_m": np.zeros(2)}, {"elevation": np.array([0.0, 2.0]), "origin_m": np.zeros(2)}],
    "obstacle_image": [{"clouds": [cloud]} for cloud in (
        (CLOUD[0][:, :2].copy(), *CLOUD[1:]), (CLOUD[0].astype(float), *CLOUD[1:]), (CLOUD[0], CLOUD[1][:3], CLOUD[2]),
        (*CLOUD[:2], np.eye(4, dtype=F4)))],
    "end_at_obstacles": [{"image": np.zeros((3, 3), F4)}],
    "farthest_in_bins": [{"bins": 0}, {"bins": 40_000}, {"drop": 1001}, {"bins": None, "drop": 1}],
    "first_blocker": [{"rank": 0}, {"median_bins": 1001}],
    "cells_within": [{"limit_m": np.zeros(3, F4)}, {"limit_m": LONG[:0]}],
    "trace_windows": [{"window": NAN}, {"margin_m": -1.0}, {"window": 0.01}, {"window": 3.1}, {"slices": 89}],
    "concave_hull": [{"points": POINTS * F4(NAN)}, {"concavity": 0.0}, {"length_m": NAN}, {"x_m": INF}],
    "thin_returns": [{"cell_m": 0.0}],
    "fill_rings": [{"cells": 5000}, {"edges": np.zeros((1, 3))}],
    "mean_and_deviation": [{"probability": np.zeros((0, 5), F4)}],
    "rings_of_mask": [{"mask": MASK3[:2], "regions": np.ones((2, 3), I4)}, {"regions": -np.ones((3, 3), I4)},
                      {"mask": MASK3[:0, :0], "regions": np.ones((0, 0), I4)}],
    "cells_inside": [{"points": np.zeros((4, 3))}, {"begin": np.array([0, 5])}],
    "cells_met": [{"begin": np.array([0, 3, 1, 4])}, {"begin": BEGIN[:0]}, {"cells": 0}],
    "best_sectors": [{"ranges": RANGES[:0]}, {"ranges": RANGES * NAN}, {"sectors": 0}, {"inner": INF}],
    "star_vertices": [{"ranges": -RANGES}, {"price_m2": NAN}],
    "free_ranges": [{"mask": None}, {"x_m": NAN}, {"apex_y_m": INF}, {"half_m": 0.0}, {"bins": 0}],
    "beam_evidence": [
        {"lost": KIND}, {"measured": (LONG, LONG, SHORT)}, {"lost": (LONG, LONG, LONG, LONG, SHORT)},
        {"returns": (LONG, LONG, SHORT)},
        {"measured": (LONG.astype(float), LONG, LONG)},
        {"heights_m": FLAT[:1, :1].copy(), "std_m": FLAT[:1, :1].copy()},
        {"std_m": FLAT[:7, :7].copy()}, {"table": np.zeros(0, F4)}, {"half_extent_m": NAN}],
    "cell_features": BAD_CELLS,
    "CellWindows": [{"range_m": np.full((4, 4), -1, F4)}, {"range_m": np.full((4, 4), NAN, F4)},
                    {"azimuth": np.full((4, 4), 9, F4)}, {"range_m": np.full((4, 4), 1e9, F4)}, {"cell_m": 0.0},
                    {"range_m": np.ones((0, 4), F4), "azimuth": np.ones((0, 4), F4)}],
    "interpolate": [{"node": np.array([NODES * NODES - 1], I4)}],
    "lattice_positions": [{"nodes": 1}, {"xy": np.zeros((1, 1), F4)}],
    "object_candidates": [{"sensor_height_m": NAN}],
    "look_at_boxes": [{"along": 1}, {"boxes": BOX[:, :6].copy()}],
    "visible_before": [{"boxes": BOX[:, :6].copy()}],
    "count_met": [{"seen_by": np.ones((6, 6), np.uint32)}, {"headings": np.zeros(65)}, {"surfaces": np.zeros((4, 3))}],
    "mark_surfaces": [{"seen_by": np.zeros((8, 4), np.uint32)}, {"cell_m": NAN}, {"pose": np.zeros(5)}],
    "compare_view": [{"owner": np.full(4, 3, I4)}, {"pose": np.full(4, NAN)}, {"agents": 0}],
    "encode_view": [{"state": np.zeros((4, 5), U1)}, {"level": np.zeros((5, 5), U1)}, {"state": PLANE + U1(4)},
                    {"level": PLANE + U1(16)}, {"deviation": PLANE + U1(9)}, {"row": 4},
                    {"state": np.zeros((0, 0), U1)}],
    "decode_view": [{"prob": np.zeros(15, F4)}, {"std": np.zeros(8, F4)}, {"cells": 513}],
}  # fmt: skip
"""Function → changes of its good arguments, each of which is refused."""
for name in OF_VIEWS:
    REFUSED.setdefault(name, []).extend(({"x_m": NAN}, {"cell_m": 0.0}))


OF_WINDOWS = ("beam_evidence", "cell_features")


def call(name: str, **changes: Any) -> Any:
    """Call a function of the core; nobody keeps the windows of cells, so that they end before it does."""
    windows = {"windows": cell_windows(GRID, 1.8)} if name in OF_WINDOWS else {}
    return getattr(_core, name)(**GOOD[name] | windows | changes)


def arrays_of(name: str) -> list[tuple[str, NDArray[Any]]]:
    return [(key, given) for key, given in GOOD[name].items() if isinstance(given, np.ndarray)]


@pytest.mark.parametrize("name", GOOD)
def test_good_arguments_are_taken(name: str) -> None:
    call(name)


OTHER = {"f4": "f8", "f8": "f4", "i2": "i8", "i4": "i8", "i8": "i4", "u1": "i1", "u4": "i8", "b1": "u1"}


@pytest.mark.parametrize("name", GOOD)
def test_arrays_of_another_kind_or_too_short_are_refused(name: str) -> None:
    """Of another type, with a dimension more, with holes between their rows, or a row short of what goes with it."""
    for key, given in arrays_of(name):
        wrongs = [given.astype(OTHER[given.dtype.str[1:]]), given[None]]
        if len(given) > 1:
            wrongs.append(np.repeat(given, 2, axis=0)[::2])
        for wrong in wrongs:
            with pytest.raises(TypeError, match="incompatible function arguments"):
                call(name, **{key: wrong})
        if key not in ANY_LENGTH.get(name, ()):
            with pytest.raises((TypeError, ValueError)):
                call(name, **{key: given[:-1].copy()})


@pytest.mark.parametrize("name", REFUSED)
def test_arguments_that_do_not_fit_are_refused(name: str) -> None:
    for changes in REFUSED[name]:
        with pytest.raises((TypeError, ValueError)):
            call(name, **changes)


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e30, 1e-40])
@pytest.mark.parametrize("name", GOOD)
def test_any_numbers_are_answered_or_refused(name: str, value: float) -> None:
    """Whatever stands in an array, in all of it or here and there: no crash, and nothing but a ValueError."""
    rng = np.random.default_rng(0)
    for key, given in arrays_of(name):
        if given.dtype.kind == "f":
            for share in (1.0, 0.3):
                wild = np.where(rng.random(given.shape) < share, value, given).astype(given.dtype)
                with suppress(ValueError):
                    call(name, **{key: wild})


STREET = cast(VLP16, junction(), 1.8)
FULL = cast(lidar_model("hdl64e"), junction(), 1.8)
THINNED = FULL.select(np.random.default_rng(3).random(len(FULL)) > 0.1)
CLOUDS = {
    "rings in order": np.concatenate([STREET.points] * 3), "no rings": rosette(np.random.default_rng(1), 70_000),
    "shuffled": np.random.default_rng(1).permutation(np.concatenate([STREET.points] * 3)),
}  # fmt: skip


def azimuth_answers(azimuth: NDArray[np.float32], range_m: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """What each function of azimuth bins answers."""
    height_m = (range_m * F4(0.01)).astype(F4)
    cells = polar_of_cells(BIG)
    return [
        np.array([_core.azimuth_bins_filled(azimuth)], F4),
        *(_core.farthest_in_bins(azimuth, range_m, bins, 0) for bins in (None, 1, 36, 777)),
        _core.farthest_in_bins(azimuth, range_m, 360, 3),
        _core.first_blocker(azimuth, range_m, height_m, 0.3, 3.0, None, 2, 5, None, 0.5),
        _core.first_blocker(azimuth, range_m, height_m, -0.5, 0.5, 216, 1, 0, 40.0, 0.0),
        _core.cells_within(_core.farthest_in_bins(azimuth, range_m, 360, 0), cells[0], bins_of_cells(BIG, 360)),
        _core.trace_windows(azimuth, range_m, 5027, 0.01, 0.5, *cells, bins_of_cells(BIG, 5027)),
        _core.trace_windows(azimuth, range_m, 34, 1.5, 0.0, *cells, bins_of_cells(BIG, 34)),
    ]


def many_azimuths() -> Any:
    rng = np.random.default_rng(8)
    return azimuth_answers(rng.uniform(-np.pi, np.pi, 70_000).astype(F4), rng.gamma(2.0, 12.0, 70_000).astype(F4))


def level_beams(sweep: Sweep) -> Any:
    leveled = level(sweep, BevGrid(128, 32.0))
    beams = beams_by_evidence(leveled, 1.5)
    assert len(leveled.points) > 20_000
    kinds = (beams.measured, beams.inferred, beams.early, beams.late, no_return_beams(leveled, fill=True))
    columns = [leveled.points, leveled.range_m, leveled.azimuth, leveled.height_m, leveled.rows]
    return [*columns, *(array for kind in kinds for array in (kind.azimuth, kind.slope, kind.depth_m))]


def street_points() -> NDArray[np.float32]:
    """Points (60,000, 3) of level ground 1.8 m below the sensor, with a step, and of things that stand on it."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-40, 40, (60_000, 3))
    points[:, 2] = -1.8 + 0.2 * (points[:, 1] > 5) + rng.normal(0, 0.02, len(points))
    points[::7, 2] += rng.uniform(0, 2, len(points[::7]))
    return points.astype(F4)


def moments() -> Any:
    passes = np.random.default_rng(1).random((20, 50_000), F4)
    found = _core.mean_and_deviation(passes)
    np.testing.assert_allclose(found, (passes.mean(axis=0), passes.std(axis=0)), atol=1e-6)
    return found


def evidence(*counts: int) -> Any:
    measured, lost = (random_beams(np.random.default_rng(7 + k), count).arrays for k, count in enumerate(counts))
    found = call("beam_evidence", measured=measured, lost=(*lost, lost[2] / 2, lost[2] * 2))
    assert (found[0].sum() > 0) == (counts[0] > 0)
    return found


def boxes_met() -> Any:
    rng = np.random.default_rng(3)
    beams, boxes = random_beams(rng, 20_000), random_boxes(rng, 200)
    found = _core.BeamsByAzimuth(*beams.arrays).expected_returns(boxes, 1.8, True)
    assert found.sum() > 1000
    return found


NO_TABLE = {name: np.zeros(0) for name in ("elevation", "origin_m")}
NOTHING_HELD = {name: np.zeros(0) for name in ("held_elevation", "held_origin_m")}
SENSOR_CALLS: dict[str, Callable[[Any], Any]] = {
    "identify_sensor": lambda points: call("identify_sensor", points=points, expected=0, **NO_TABLE, **NOTHING_HELD),
    "identify_sensor by rings": lambda points: call(
        "identify_sensor", points=points, ring=np.zeros(len(points), I2), expected=0, **NO_TABLE, **NOTHING_HELD
    ),
    "identify_sensor by a layout": lambda points: call("identify_sensor", points=points, **NO_TABLE),
    "identify_sensor by a table": lambda points: call("identify_sensor", points=points),
    "rings of points": lambda points: call(
        "identify_sensor", points=points, is_inferred=False, **NO_TABLE, **NOTHING_HELD
    ),
    "infer_sensor": lambda points: call("infer_sensor", points=points),
    "recover_rings": lambda points: call(
        "recover_rings", points=points, elevation=np.zeros(0), origin_m=np.zeros(0), columns=0
    ),
    "recover_rings by a table": lambda points: call("recover_rings", points=points),
    "find_clusters": lambda points: _core.find_clusters(*_core.polar(points)),
}


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e30, 1e-40, 0.0])
@pytest.mark.parametrize("name", [*SENSOR_CALLS, "level_sweep", "azimuth bins"])
def test_clouds_of_any_numbers_and_of_few_points_are_answered(name: str, value: float) -> None:
    of_bins: dict[str, Callable[[Any], Any]] = {
        "azimuth bins": lambda points: azimuth_answers(points[:, 0].copy(), points[:, 1].copy()),
        "level_sweep": lambda points: call("level_sweep", points=points, ring=None),
    }
    answer = (SENSOR_CALLS | of_bins)[name]
    for share in (1.0, 0.1):
        points = STREET.points[:6000].copy()
        points[np.random.default_rng(0).random(points.shape) < share] = value
        answer(points)
    for count in (0, 1, 255, 256):
        answer(np.full((count, 3), value, F4))


SAME: dict[str, Callable[[], Any]] = {
    "azimuth bins": many_azimuths, "beams of a known sensor": lambda: level_beams(THINNED),
    "beams of a bare cloud": lambda: level_beams(Sweep(THINNED.points)),
    "ground": lambda: call("level_sweep", points=street_points(), ring=None),
    "lows": lambda: call("ground_of_lows"), "moments": moments,
    "held ground": lambda: call("held_ground"), "boxes": boxes_met,
    "completed ground": lambda: call("complete_ground"),
    "view": lambda: encode_fov(street_view(with_std=True)),
    "objects": lambda: Detector().detect(seen(*car(14.0, 2.0), *car(-8.0, 7.0, 0.6), person(9.0, 1.0))).boxes,
    **{f"evidence of {counts}": lambda counts=counts: evidence(*counts)  # type: ignore[misc]
       for counts in ((0, 0), (1, 0), (0, 1), (40_000, 9000))},
    **{f"{name} of {cloud}": lambda call=call, points=points: call(points)  # type: ignore[misc]
       for name, call in SENSOR_CALLS.items() for cloud, points in CLOUDS.items()},
}  # fmt: skip


@pytest.fixture
def threads_as_before() -> Iterator[None]:
    before = _core.threads()
    yield
    _core.set_threads(before)


@pytest.mark.usefixtures("threads_as_before")
@pytest.mark.parametrize("name", SAME)
def test_answers_do_not_depend_on_the_number_of_threads(name: str) -> None:
    answers = []
    for count in (1, 2, 4):
        _core.set_threads(count)
        answers.append(SAME[name]())
    for other in answers[1:]:
        np.testing.assert_equal(other, answers[0])
