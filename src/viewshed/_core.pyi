"""The native core: from points to estimate. Each function checks its arrays and raises ValueError or TypeError."""

from collections.abc import Sequence

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

# no_return.cpp

# grid.cpp

def count_points(
    points: NDArray[np.float32],
    rotation: NDArray[np.float32],
    translation: NDArray[np.float32],
    *,
    cells: int,
    cell_m: float,
    origin_x_m: float,
    origin_y_m: float,
    low_m: float,
    high_m: float,
    max_range_m: float,
    null_range_m: float,
) -> NDArray[np.int32]: ...

# height_map.cpp

def lattice_positions(
    xy: NDArray[np.float32], half_extent_m: float, nodes: int
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]: ...
def interpolate(
    heights_m: NDArray[np.float32], node: NDArray[np.int32], down: NDArray[np.float64], right: NDArray[np.float64]
) -> NDArray[np.float32]: ...

# visibility.cpp

_Beams = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]

class CellWindows:
    def __init__(
        self, range_m: NDArray[np.float32], azimuth: NDArray[np.float32], cell_m: float, width_m: float
    ) -> None: ...

# evidence.cpp

def poisson_table(min_returns: int) -> NDArray[np.float32]: ...
def probability_of_visible(counts: NDArray[np.float32], table: NDArray[np.float32]) -> NDArray[np.float32]: ...
def returns_by_kind(
    windows: CellWindows,
    kinds: Sequence[_Beams],
    heights_m: NDArray[np.float32],
    half_extent_m: float,
    sensor_height_m: float,
    target_height_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def beam_evidence(
    windows: CellWindows,
    kinds: tuple[_Beams, _Beams, _Beams],
    heights_m: NDArray[np.float32],
    std_m: NDArray[np.float32],
    *,
    half_extent_m: float,
    sensor_height_m: float,
    target_height_m: float,
    ground_steps: tuple[tuple[float, float], tuple[float, float]],
    table: NDArray[np.float32],
    threshold: float,
    reach_m: float,
) -> tuple[
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.bool_],
]: ...
def states(
    measured: NDArray[np.float32],
    inferred: NDArray[np.float32],
    aimed: NDArray[np.float32],
    visible_prob: NDArray[np.float32],
    within_reach: NDArray[np.bool_],
    visible: NDArray[np.bool_],
    denied: NDArray[np.bool_],
    obstacle: NDArray[np.bool_],
    *,
    table: NDArray[np.float32],
    threshold: float,
    sure_aim: float,
) -> NDArray[np.uint8]: ...

# history.cpp

def obstacle_image(
    clouds: Sequence[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]],
    least_m: float,
    sensor_height_m: float,
) -> NDArray[np.float32]: ...
def end_at_obstacles(
    image: NDArray[np.float32], azimuth: NDArray[np.float32], slope: NDArray[np.float32], depth_m: NDArray[np.float32]
) -> NDArray[np.float32]: ...
def sight_lines() -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def confirmed_cells(
    seen: NDArray[np.bool_],
    earlier_from_now: NDArray[np.float32],
    origin_x_m: float,
    origin_y_m: float,
    cell_m: float,
    in_view: NDArray[np.float32],
    whole: NDArray[np.float32],
) -> NDArray[np.bool_]: ...

# features.cpp

# ray_trace.cpp

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
def plausible_rows(rows: NDArray[np.float32], columns: int) -> bool: ...
def move_points(points: NDArray[np.float32], rotation: NDArray[np.float64], shift: NDArray[np.float64]) -> None: ...
def unpack_lzf(packed: NDArray[np.uint8], unpacked: NDArray[np.uint8]) -> int: ...
