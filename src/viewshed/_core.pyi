"""The native core: from points to estimate. Each function checks its arrays and raises ValueError or TypeError."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__version__: str

def threads() -> int: ...
def set_threads(count: int) -> None: ...

# range_image.cpp

def range_image(
    points: NDArray[np.float32], ring: NDArray[np.int16], columns: int, rings: int, near_m: float, far_m: float
) -> tuple[
    NDArray[np.int32],
    NDArray[np.uint8],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.bool_],
    NDArray[np.bool_],
    NDArray[np.bool_] | None,
    bool,
]: ...
def silent_columns(counts: NDArray[np.uint8]) -> NDArray[np.bool_]: ...
def least_confirmations(mean: float) -> int: ...
def pixels_without(
    ring: NDArray[np.int16], left_out: NDArray[np.bool_], column: NDArray[np.int32], counts: NDArray[np.uint8]
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]: ...

# sensor_id.cpp

# ground.cpp

# leveling.cpp

EGO_BOX_M: tuple[float, float]
EGO_HEIGHTS_M: tuple[float, float]

def vehicle_heading(points: NDArray[np.float32], rotation: NDArray[np.float32]) -> float: ...
def level_points(
    points: NDArray[np.float32],
    clutter: NDArray[np.bool_] | None,
    level_from_sensor: NDArray[np.float32],
    near_m: float,
    far_m: float,
    heading: float,
    ground_m: NDArray[np.float32],
    half_extent_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]: ...
def beam_slopes(
    points: NDArray[np.float32],
    range_m: NDArray[np.float32],
    sensor_height_m: float,
    left_out: NDArray[np.bool_] | None,
    rows: NDArray[np.int32],
) -> NDArray[np.float32]: ...
def obstacle_cells(
    points: NDArray[np.float32],
    height_m: NDArray[np.float32],
    x0_m: float,
    y0_m: float,
    cells_per_m: float,
    low_m: float,
    high_m: float,
    cells: int,
) -> NDArray[np.bool_]: ...

# no_return.cpp

JITTER_COLUMNS: int

def beams_by_evidence(
    ring: NDArray[np.int16],
    column: NDArray[np.int32],
    counts: NDArray[np.uint8],
    isolated: NDArray[np.bool_],
    clutter: NDArray[np.bool_] | None,
    phase: NDArray[np.float32],
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    rotation: NDArray[np.float64],
    points: NDArray[np.float32],
    range_m: NDArray[np.float32],
    height_m: NDArray[np.float32],
    rows: NDArray[np.int32],
    sensor_height_m: float,
    ground_m: NDArray[np.float32],
    half_extent_m: float,
    top_m: float,
    obstacle_m: float,
) -> tuple[
    NDArray[np.float32],
    tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
]: ...
def no_return_beams(
    ring: NDArray[np.int16],
    column: NDArray[np.int32],
    counts: NDArray[np.uint8],
    clutter: NDArray[np.bool_] | None,
    phase: NDArray[np.float32],
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    rotation: NDArray[np.float64],
    range_m: NDArray[np.float32],
    height_m: NDArray[np.float32],
    rows: NDArray[np.int32],
    fill: bool,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...

# visibility.cpp

# history.cpp

# features.cpp

def feature_maps(
    features: Sequence[tuple[str, tuple[NDArray[Any], ...]]],
    cell_range_m: NDArray[np.float32],
    cell_bin: NDArray[np.int16],
    x_m: NDArray[np.float32],
    y_m: NDArray[np.float32],
    half_extent_m: float,
    fold: int,
) -> NDArray[np.uint8]: ...
def height_codes(
    points: NDArray[np.float32],
    height_m: NDArray[np.float32],
    x0_m: float,
    y0_m: float,
    cells_per_m: float,
    cells: int,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]: ...
def fold_maps(maps: NDArray[np.uint8], fold: int) -> NDArray[np.uint8]: ...

# mc_dropout.cpp

def mean_and_deviation(probability: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...

# ray_trace.cpp

def azimuth_bins_filled(azimuth: NDArray[np.float32]) -> int: ...
def farthest_in_bins(
    azimuth: NDArray[np.float32], range_m: NDArray[np.float32], bins: int | None, drop: int
) -> NDArray[np.float32]: ...
def first_blocker(
    azimuth: NDArray[np.float32],
    range_m: NDArray[np.float32],
    height_m: NDArray[np.float32],
    low_m: float,
    high_m: float,
    bins: int | None,
    rank: int,
    median_bins: int,
    reach_m: float | None,
    margin_m: float,
) -> NDArray[np.float32]: ...
def ranges_in_bins(
    azimuth: NDArray[np.float32],
    range_m: NDArray[np.float32],
    height_m: NDArray[np.float32],
    low_m: float,
    high_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def cells_within(
    limit_m: NDArray[np.float32], cell_range_m: NDArray[np.float32], cell_bin: NDArray[np.int16]
) -> NDArray[np.float32]: ...
def trace_windows(
    azimuth: NDArray[np.float32],
    range_m: NDArray[np.float32],
    slices: int,
    window: float,
    margin_m: float,
    cell_range_m: NDArray[np.float32],
    cell_azimuth: NDArray[np.float32],
    cell_slice: NDArray[np.int16],
) -> NDArray[np.float32]: ...
def any_return_on(
    points: NDArray[np.float32],
    range_m: NDArray[np.float32],
    far_m: float,
    low_m: float,
    high_m: float,
    sensor_m: float,
    x0_m: float,
    y0_m: float,
    cells_per_m: float,
    cells: float,
) -> bool: ...

# concave_hull.cpp

def concave_hull(
    points: NDArray[np.float32],
    range_m: NDArray[np.float32],
    concavity: float,
    length_m: float,
    x_m: float,
    y_m: float,
    cell_m: float,
    cells: int,
) -> NDArray[np.float32]: ...
def thin_returns(
    points: NDArray[np.float32], range_m: NDArray[np.float32], x_m: float, y_m: float, cell_m: float
) -> tuple[NDArray[np.float64], bool]: ...
def fill_rings(edges: NDArray[np.float64], x_m: float, y_m: float, cell_m: float, cells: int) -> NDArray[np.bool_]: ...

# polygons.cpp

# files.cpp

def split_xyzi(rows: NDArray[np.float32], points: NDArray[np.float32], intensity: NDArray[np.float32]) -> None: ...
def split_xyzir(
    rows: NDArray[np.float32],
    points: NDArray[np.float32],
    intensity: NDArray[np.float32],
    ring: NDArray[np.int16],
    quarter_turn: bool,
) -> int: ...
def spread_of_rings(
    points: NDArray[np.float32], ring: NDArray[np.int16], half_width: float
) -> tuple[int, float, float, float]: ...
def plausible_rows(rows: NDArray[np.float32], columns: int) -> bool: ...
def move_points(points: NDArray[np.float32], rotation: NDArray[np.float64], shift: NDArray[np.float64]) -> None: ...
def unpack_lzf(packed: NDArray[np.uint8], unpacked: NDArray[np.uint8]) -> int: ...
