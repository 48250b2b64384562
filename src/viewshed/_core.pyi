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

class BeamTable:
    def __init__(self, elevation: NDArray[np.float64], origin_m: NDArray[np.float64], columns: int) -> None: ...

class BeamTables:
    def __init__(self, tables: list[BeamTable]) -> None: ...

def identify_by_rings(
    points: NDArray[np.float32], ring: NDArray[np.int16], tables: BeamTables
) -> tuple[NDArray[np.int16] | None, int]: ...
def identify_by_points(points: NDArray[np.float32], tables: BeamTables) -> tuple[NDArray[np.int16] | None, int]: ...
def rings_of_points(points: NDArray[np.float32]) -> NDArray[np.int16] | None: ...
def beams_of_sensor(points: NDArray[np.float32], table: BeamTable) -> NDArray[np.int16] | None: ...
def infer_sensor(
    points: NDArray[np.float32], ring: NDArray[np.int16] | None, tables: BeamTables
) -> tuple[int, float]: ...
def recover_rings(
    points: NDArray[np.float32], ring: NDArray[np.int16] | None, table: BeamTable | None
) -> tuple[NDArray[np.int16], NDArray[np.int32], int, NDArray[np.float64], int, int, int]: ...
def polar(points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
def match_beams(
    slope: NDArray[np.float32], range_m: NDArray[np.float32], table: BeamTable
) -> tuple[NDArray[np.int16], NDArray[np.int64], float]: ...
def find_clusters(
    azimuth: NDArray[np.float32], slope: NDArray[np.float32], range_m: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float] | None: ...
def find_motion(points: NDArray[np.float32]) -> tuple[float, float, float, float, float] | None: ...
def undo_motion(
    points: NDArray[np.float32], x_m: float, y_m: float, z_m: float, seam: float, reference: float
) -> NDArray[np.float32]: ...

# ground.cpp

# leveling.cpp

# no_return.cpp

# visibility.cpp

# history.cpp

# features.cpp

# ray_trace.cpp

# polygons.cpp

# files.cpp
