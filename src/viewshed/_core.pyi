"""The native core: from points to estimate. Each function checks its arrays and raises ValueError or TypeError."""

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

# visibility.cpp

# history.cpp

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
def spread_of_rings(
    points: NDArray[np.float32], ring: NDArray[np.int16], half_width: float
) -> tuple[int, float, float, float]: ...
def plausible_rows(rows: NDArray[np.float32], columns: int) -> bool: ...
def move_points(points: NDArray[np.float32], rotation: NDArray[np.float64], shift: NDArray[np.float64]) -> None: ...
def unpack_lzf(packed: NDArray[np.uint8], unpacked: NDArray[np.uint8]) -> int: ...
