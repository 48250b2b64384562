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

# no_return.cpp

# visibility.cpp

# history.cpp

# features.cpp

# ray_trace.cpp

# polygons.cpp

# files.cpp
