"""
The native core: from points to estimate, a stage a file (packages/viewshed/src/core).
"""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray


VERSION: str = '0.4.0'

def threads() -> int:
    """How many threads a stage may use."""

def set_threads(count: int) -> None:
    """Let a stage use up to this number of threads, 1 to 4."""

def range_image(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)], columns: int, rings: int, near_m: float, far_m: float) -> tuple[Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.uint8], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')] | None, bool]:
    """
    Column, counts, nearest_m2, phase, isolated, behind, clutter (or None) of points (N, 3) by ring (N,); and whether rings are as full as columns are many.
    """

def silent_columns(counts: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.bool_], dict(order='C')]:
    """Columns (columns,) of counts (rings, columns) that hardly fired."""

def least_confirmations(mean: float) -> int:
    """
    Least number that a Poisson variable of a mean reaches with a chance of at most 1 %.
    """

def pixels_without(ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)], left_out: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)], column: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], counts: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.uint8], dict(order='C')]]:
    """
    Column (N,) and counts (rings, columns) without the returns left_out (N,).
    """

def sensing_reach(range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], left_out: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, most_m: float) -> float:
    """
    Reach that ranges (M,) up to most_m show; those left out, by themselves or by their rows, do not count.
    """

def identify_by_rings(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], rings: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], columns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], expected: int) -> tuple[Annotated[NDArray[numpy.int16], dict(order='C')] | None, int]:
    """
    The ring of each point (N, 3) as the table's beams, or None where they are the known rings (N,), and the number of the table that the rings agree with, -1 for none. Tables follow each other: elevation (K,) and origin_m (K,) of the beams, rings (T,) and columns (T,) of each table.
    """

def identify_by_points(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], rings: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], columns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], expected: int) -> tuple[Annotated[NDArray[numpy.int16], dict(order='C')] | None, int]:
    """
    The ring of each point (N, 3), or None, and the number of the table that explains them, -1 for none.
    """

def rings_of_points(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int16], dict(order='C')] | None:
    """
    The ring of each point (N, 3) by their order or their elevations, or None.
    """

def beams_of_sensor(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int16], dict(order='C')] | None:
    """The beam of each point (N, 3) of a sensor that is known, or None."""

def infer_sensor(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], rings: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], columns: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[int, float]:
    """
    The number of the table that explains points (N, 3) best, -1 for none, and its score.
    """

def recover_rings(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], columns: int) -> tuple[Annotated[NDArray[numpy.int16], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')], int, Annotated[NDArray[numpy.float64], dict(order='C')], int, int, int]:
    """
    Ring (N,), column (N,), columns, elevation (rings,), returns with a ring, those alone in their pixel, source. A table of no beams is none.
    """

def polar(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """Azimuth, slope and horizontal range (N,) of points (N, 3)."""

def match_beams(slope: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.int16], dict(order='C')], Annotated[NDArray[numpy.int64], dict(order='C')], float]:
    """
    The nearest beam of each return (N,), the returns close to each beam, and their share less chance.
    """

def find_clusters(azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], slope: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], float] | None:
    """
    Elevations at which returns (N,) gather, heights of their origin, and sharpness; or None.
    """

def find_motion(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> tuple[float, float, float, float, float] | None:
    """
    The way (3), seam and reference by which elevations of points (N, 3) gather; or None.
    """

def undo_motion(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], x_m: float, y_m: float, z_m: float, seam: float, reference: float) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """Points (N, 3) as a sensor in motion measured them."""

def ground_of_lows(lows_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], rise_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_m: float, height_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')], tuple[float, float, float], float, float]:
    """
    Heights, deviations, seen nodes (n, n), plane, support, and level (or NaN) of the ground, by low points (n, n, 3) and the rise (n, n) from each to the highest return of its node.
    """

def fill_ground(walked_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], accepted: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], plane: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], half_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Heights and standard deviations (n, n) of the ground between and beyond the accepted nodes (n, n).
    """

def free_plane(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], float]:
    """
    Unit normal (3,) of the ground below a sensor tilted by up to 60°, and the share of area of points (n, 3) on it.
    """

def guess_inputs(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], heights_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], seen: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_m: float, sensor_height_m: float) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Inputs (1, 192, n / 4, n / 4) of the network that guesses the ground, from level points (M, 3) and the ground (n, n) that returns show.
    """

def guessed_ground(outputs: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, None), order='C', device='cpu', writable=False)], inputs: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None, None), order='C', device='cpu', writable=False)], heights_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], seen: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Heights and standard deviations (n, n) of the ground that outputs (1, 80, n / 4, n / 4) of the network stand for.
    """

def held_ground(heights_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], std_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], seen: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_m: float, before_heights_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], before_std_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], before_seen: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], before_half_m: float, before_from_now: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], now_from_before: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], variance_m2: float, plane: Sequence[float], height_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')]] | None:
    """
    Heights, deviations and seen nodes (n, n) of the present ground with what only an earlier sweep saw; None where nothing is taken.
    """

EGO_LENGTH_M: float = 2.7

EGO_WIDTH_M: float = 1.1

LEAST_EGO_HEIGHT_M: float = 1.2

MOST_EGO_HEIGHT_M: float = 3.0

def vehicle_heading(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], rotation: Annotated[NDArray[numpy.float32], dict(shape=(3, 3), order='C', device='cpu', writable=False)]) -> float:
    """
    Heading of the own vehicle in radians, of points (N, 3) and the rotation (3, 3) to a level frame.
    """

def level_points(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], clutter: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, level_from_sensor: Annotated[NDArray[numpy.float32], dict(shape=(3, 4), order='C', device='cpu', writable=False)], near_m: float, far_m: float, heading: float, ground_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_extent_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')]]:
    """
    Level points (M, 3), range, azimuth, height above the ground and row (M,) of the points (N, 3) that count.
    """

def beam_slopes(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], sensor_height_m: float, left_out: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Rise over range (M,) of level points (M, 3); +inf for rows that are left out.
    """

def obstacle_cells(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], x0_m: float, y0_m: float, cells_per_m: float, low_m: float, high_m: float, cells: int) -> Annotated[NDArray[numpy.bool_], dict(order='C')]:
    """
    Mask (cells, cells) of cells that hold a point (N, 3) between two heights above the ground.
    """

LEVEL_TILT: float = 0.10471975511965977

def level_sweep(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, rings: int, columns: int, near_m: float, far_m: float, attitude: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)] | None, height_m: float | None, yaw: float | None, half_extent_m: float) -> tuple[tuple[Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.uint8], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')] | None, bool] | None, Annotated[NDArray[numpy.float64], dict(order='C')], float, tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')], tuple[float, float, float], float], tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')]]]:
    """
    Range image (as range_image gives it, or None), rotation (3, 3) to level, height of the sensor, ground (heights, deviations, seen nodes, plane, support), and level points (as level_points gives them) of points (N, 3).
    """

JITTER_COLUMNS: int = 4

def beams_by_evidence(ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)], column: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], counts: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)], isolated: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)], clutter: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, phase: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], rotation: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], sensor_height_m: float, ground_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_extent_m: float, top_m: float, obstacle_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Slope (M,) of measured beams; azimuth, slope, early, likely and late depth (B,) of beams without a return.
    """

def no_return_groups(ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)], column: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], counts: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)], isolated: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)], clutter: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, phase: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], rotation: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], sensor_height_m: float, ground_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_extent_m: float, top_m: float, obstacle_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Azimuth, slope, beams that may meet a target (G,), features (G, F) and logarithms of the ranges of stops (G, S) of groups of beams without a return.
    """

def no_return_beams(ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)], column: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], counts: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)], clutter: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, phase: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], rotation: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], fill: bool) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """Azimuth, slope and depth of the beams without a return."""

def count_points(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], rotation: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], translation: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], *, cells: int, cell_m: float, origin_x_m: float, origin_y_m: float, low_m: float, high_m: float, max_range_m: float, null_range_m: float) -> Annotated[NDArray[numpy.int32], dict(order='C')]:
    """
    Counts (cells, cells) int32 of points (N, 3) after a transform to level, by height there and by range.
    """

def polar_of_cells(cells: int, cell_m: float, x0_m: float, y0_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Range in meters and azimuth in [-pi, pi) (cells, cells) of the centers of cells.
    """

def lattice_positions(xy: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_extent_m: float, nodes: int) -> tuple[Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')]]:
    """
    Node (N,) before each of N points, and how far beyond it in i and in j (N,), of a lattice.
    """

def interpolate(heights_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], node: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C', device='cpu', writable=False)], down: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], right: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """Heights (N,) at positions of a lattice, bilinear."""

AZIMUTH_COLUMNS: int = 2048

GROUND_SECTORS: int = 128

class CellWindows:
    """The windows of azimuth of a target in each cell of a grid."""

    def __init__(self, range_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], cell_m: float, width_m: float) -> None: ...

THRESHOLD: float = 0.5

UNSURE_M: float = 0.5

def poisson_table(min_returns: int) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    P(N >= min_returns), N Poisson, at means 0, 1/32, 2/32 and so on, until it is 1.
    """

def probability_of_visible(counts: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], table: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """Probability (N,) at mean counts (N,), from a poisson_table."""

def expected_returns(windows: CellWindows, beams: tuple[Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]], heights_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], half_extent_m: float, sensor_height_m: float, target_height_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Expected returns (cells, cells) of a target in each cell, and the beams (cells, cells) that aim at it.
    """

def beam_evidence(windows: CellWindows, measured: tuple[Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]], lost: tuple[Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]], heights_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], std_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], *, half_extent_m: float, sensor_height_m: float, target_height_m: float, table: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], reach_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.bool_], dict(order='C')]]:
    """
    Measured, inferred, late, aimed, visible_prob, within_reach (cells, cells) of a target in each cell, from measured beams (azimuth, slope, depth), and lost ones (azimuth, slope, likely, early and late depth).
    """

def states(measured: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], late: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], aimed: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], visible_prob: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], within_reach: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], visible: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], denied: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], obstacle: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], *, table: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.uint8], dict(order='C')]:
    """
    States (cells, cells) uint8 of cells that an estimator calls visible, or not, and that hold an obstacle or not.
    """

def claims(state: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)], measured: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], node: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order='C', device='cpu', writable=False)], std_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], *, table: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[int, int, int]:
    """
    How many cells (cells, cells) are free or surface; how many of these lie over ground, at a node of std_m, that is unsure; and how many measured returns alone would not support.
    """

class TargetColumns:
    """The columns of azimuth that fall on a target in each cell."""

    def __init__(self, range_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], fired: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)] | None, rings: int, columns: int, cell_m: float, width_m: float, farthest_m: float) -> None: ...

class SentBeams:
    """The beams that are sent through a target in each cell."""

    def __init__(self, columns: TargetColumns, low_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], high_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], slope: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], start_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None: ...

def nearest_returns(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)] | None, rotation: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], tangent: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], columns: int, near_m: float, far_m: float) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Horizontal range (rings, 2 * columns) of the nearest return of each beam, the circle twice; +inf for none.
    """

def envelope_margins(sent: SentBeams, nearest: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int32], dict(order='C')]:
    """
    Beams (cells, cells) that are sent through a target and not blocked before it.
    """

def cells_of_beams(sent: SentBeams, nearest: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], margins: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order='C', device='cpu', writable=False)], counts: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], least: int, most: int, opens: bool) -> Annotated[NDArray[numpy.float64], dict(order='C')]:
    """
    For each beam (rings, columns), the sum of 1 / beams needed over the cells that it helps to change.
    """

def wedge_changes(sent: SentBeams, nearest: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], margins: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order='C', device='cpu', writable=False)], counts: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], least: int, wide: int, opens: bool) -> tuple[int, Annotated[NDArray[numpy.bool_], dict(order='C')]]:
    """
    How many cells one wedge of columns changes at most, and which (cells, cells) any does.
    """

class BeamsByAzimuth:
    """Beams (B,) sorted by azimuth."""

    def __init__(self, azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], slope: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None: ...

    def expected_returns(self, boxes: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], sensor_height_m: float, leave_out_own: bool) -> Annotated[NDArray[numpy.int32], dict(order='C')]:
        """
        Beams (K,) int32 that would meet each box (K, 7): center, length, width, height, yaw in level.
        """

def object_candidates(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], sensor_height_m: float) -> tuple[Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Candidates for objects: rows (P,) by candidate, first, last, parent (C,), sides (C, 6) and shapes (C, 32).
    """

def shape_probabilities(shapes: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], mean: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], scale: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], first: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], first_bias: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], second: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], second_bias: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], third: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], third_bias: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Probability (C, classes) of each class for shapes (C, S), by a network of three layers.
    """

def obstacle_image(clouds: Sequence[tuple[Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)]]], least_m: float, sensor_height_m: float) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Range (rows, columns) of the nearest obstacle by slope and azimuth; +inf for none. Of sweeps (points, height_m, transform), each with returns higher than least_m.
    """

def end_at_obstacles(image: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], slope: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Depth (B,) of beams, none deeper than the obstacle of an image in its direction.
    """

def sight_lines() -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Azimuth and slope (L,) of lines of sight in every other row and column of the image of obstacles.
    """

def confirmed_cells(seen: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], earlier_from_now: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], origin_x_m: float, origin_y_m: float, cell_m: float, in_view: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], whole: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.bool_], dict(order='C')]:
    """
    Cells (cells, cells) that an earlier sweep saw, and to which enough of the whole view is open.
    """

def feature_maps(features: Sequence[tuple[str, tuple[Any, ...]]], cell_range_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], cell_bin: Annotated[NDArray[numpy.int16], dict(shape=(None, None), order='C', device='cpu', writable=False)], x_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], y_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], half_extent_m: float, fold: int) -> Annotated[NDArray[numpy.uint8], dict(order='C')]:
    """
    Codes (features, cells, cells) of features, or of fold > 0 in blocks (side, side, features · fold²).
    """

def height_codes(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], x0_m: float, y0_m: float, cells_per_m: float, cells: int) -> tuple[Annotated[NDArray[numpy.uint8], dict(order='C')], Annotated[NDArray[numpy.uint8], dict(order='C')]]:
    """
    Codes (cells, cells) of the lowest and the highest return of each cell, 0 for none.
    """

def fold_maps(maps: Annotated[NDArray[numpy.uint8], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], fold: int) -> Annotated[NDArray[numpy.uint8], dict(order='C')]:
    """
    Maps (features, cells, cells) in blocks (side, side, features · fold²).
    """

def mean_and_deviation(probability: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """Mean and standard deviation (cells,) of probabilities (passes, cells)."""

def azimuth_bins_filled(azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> int:
    """How many azimuth bins returns (M,) fill without gaps."""

def farthest_in_bins(azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], bins: int | None, drop: int) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Range (bins,) of the farthest return but `drop` of each azimuth bin; -1 where there are no more.
    """

def first_blocker(azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], low_m: float, high_m: float, bins: int | None, rank: int, median_bins: int, reach_m: float | None, margin_m: float) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    Range (bins,) up to which each azimuth is visible before its blocker; -1 without a return.
    """

def ranges_in_bins(azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], low_m: float, high_m: float) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
    """
    Range (bins,) of the farthest return, -1 where none, and of the nearest obstacle, +inf where none, by the azimuth bins that the returns fill.
    """

def cells_within(limit_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], cell_range_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], cell_bin: Annotated[NDArray[numpy.int16], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    1 in cells (rows, columns) no farther than the limit (bins,) of their azimuth bin, 0 elsewhere.
    """

def trace_windows(azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], slices: int, window: float, margin_m: float, cell_range_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], cell_azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], cell_slice: Annotated[NDArray[numpy.int16], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    1 in cells (rows, columns) that a return within a window of their azimuth reaches, 0 elsewhere.
    """

def any_return_on(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], far_m: float, low_m: float, high_m: float, sensor_m: float, x0_m: float, y0_m: float, cells_per_m: float, cells: float) -> bool:
    """
    Whether a return within limits of range, and of height from the sensor, lies on a grid of cells².
    """

def concave_hull(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], concavity: float, length_m: float, x_m: float, y_m: float, cell_m: float, cells: int) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
    """
    1 in cells (cells, cells) inside the concave hull of returns (M, 3), 0 elsewhere.
    """

def thin_returns(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], x_m: float, y_m: float, cell_m: float) -> tuple[Annotated[NDArray[numpy.float64], dict(order='C')], bool]:
    """
    Points (K, 2) in meters, the farthest of each cell; and whether they are three or more, not on one line.
    """

def fill_rings(edges: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], x_m: float, y_m: float, cell_m: float, cells: int) -> Annotated[NDArray[numpy.bool_], dict(order='C')]:
    """
    Cells (cells, cells) inside closed rings of edges (E, 4), by the even-odd rule.
    """

def label_regions(mask: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], diagonal: bool) -> Annotated[NDArray[numpy.int32], dict(order='C')]:
    """Number (rows, columns) of each cell's connected region, 0 for none."""

def squared_depth(mask: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int64], dict(order='C')]:
    """Squared distance (rows, columns) to the nearest false cell, in cells."""

def rings_of_mask(mask: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], regions: Annotated[NDArray[numpy.int32], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.int16], dict(order='C')], Annotated[NDArray[numpy.int64], dict(order='C')], Annotated[NDArray[numpy.int32], dict(order='C')]]:
    """
    Corners (V, 2) of the rings around a mask's true cells, where rings begin (R + 1,), and the region of each (R,), negative where it is a hole.
    """

def cells_inside(points: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], begin: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], cells: int) -> Annotated[NDArray[numpy.bool_], dict(order='C')]:
    """
    Cells (cells, cells) whose center lies inside closed rings of points (V, 2), by the even-odd rule.
    """

def cells_met(points: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], begin: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C', device='cpu', writable=False)], cells: int) -> Annotated[NDArray[numpy.bool_], dict(order='C')]:
    """
    Cells (cells, cells) that an edge of closed rings of points (V, 2) passes through, or merely meets.
    """

def best_sectors(ranges: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], sectors: int, inner: float) -> tuple[Annotated[NDArray[numpy.int64], dict(order='C')], Annotated[NDArray[numpy.int64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')]]:
    """
    First bin, end bin and range of the sectors below ranges (bins,) whose union is the largest.
    """

def free_ranges(mask: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), order='C', device='cpu', writable=False)], x_m: float, y_m: float, cell_m: float, apex_x_m: float, apex_y_m: float, half_m: float, bins: int, is_solid: bool) -> Annotated[NDArray[numpy.float64], dict(order='C')]:
    """
    How far (bins,) each wedge reaches from an apex before boxes about the false cells of a mask.
    """

def star_vertices(ranges: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)], price_m2: float) -> Annotated[NDArray[numpy.float64], dict(order='C')]:
    """
    Angle and range (V, 2) of the star polygon below ranges (bins,) with the most area less a price a vertex.
    """

def split_xyzi(rows: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], points: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')], intensity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')]) -> None:
    """
    Split rows of x, y, z, intensity into points (3 N,) and intensity (N,).
    """

def split_xyzir(rows: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], points: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')], intensity: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu')], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu')], quarter_turn: bool) -> int:
    """
    Split rows of x, y, z, intensity, ring; how many rings are no whole numbers. With quarter_turn points are (y, -x, z).
    """

def spread_of_rings(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], ring: Annotated[NDArray[numpy.int16], dict(shape=(None,), order='C', device='cpu', writable=False)], half_width: float) -> tuple[int, float, float, float]:
    """
    Returns in four narrow sectors, their elevations' standard deviation, and the mean difference of the rings of neighbors and of any two.
    """

def all_finite(values: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> bool:
    """Whether all of the values (N, K) are finite."""

def plausible_rows(rows: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], columns: int) -> bool:
    """
    Whether rows (N · columns,) read as meters within 10 km, an intensity and, if five, a ring in 0…127.
    """

def move_points(points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')], rotation: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C', device='cpu', writable=False)], shift: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> None:
    """
    Replace points (N, 3) by rotation @ point + shift, computed in float64.
    """

def unpack_lzf(packed: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], unpacked: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu')]) -> int:
    """Decode an LZF stream; the bytes written, or -1 where it is damaged."""

class SweepView:
    """What a sweep saw, to be held against sweeps before and after it."""

    def __init__(self, squared_m2: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], phase: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], elevation: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], origin_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], points: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], height_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], range_m: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], azimuth: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], isolated: Annotated[NDArray[numpy.bool_], dict(shape=(None,), order='C', device='cpu', writable=False)], sensor_from_level: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)]) -> None: ...

    @property
    def rings(self) -> int: ...

    @property
    def columns(self) -> int: ...

    @property
    def obstacles(self) -> int: ...

    def follow(self, views: Sequence[SweepView], transforms: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], gaps_s: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], around: SweepView, around_from_self: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], sectors: int) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
        """
        Speed m/s that obstacles need to be found as these views found them (sectors,), by azimuth about the sweep `around`.
        """

    def jumps(self, views: Sequence[SweepView], transforms: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], gaps_s: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], sectors: int) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
        """
        How far surfaces jump (sectors,) m against constant speeds, over the two views before.
        """

    def repeats(self, views: Sequence[SweepView], sectors: int) -> Annotated[NDArray[numpy.float32], dict(order='C')]:
        """
        Share of the ranges that repeat those of other views, less what noise repeats (views, sectors); NaN where too few beams returned in both.
        """

    def new_ranges(self, views: Sequence[SweepView], turned: Sequence[float], sectors: int) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
        """
        Share of the returns nearer, and farther, than all that beams about them had in other views, and of the beams that returned in all of those and do not now (sectors,); turned is by how many radians the sensor turned since each.
        """

    def register_on(self, views: Sequence[SweepView], transforms: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.float64], dict(order='C')], Annotated[NDArray[numpy.int64], dict(order='C')]]:
        """
        Turn and shift (K, 3) that lay the obstacles on the surfaces of each of other views, the information about them (K, 3, 3), the deviation of a return in meters (K,), and how many were used (K,).
        """

class CellMemory:
    """The obstacles of the last seconds of a stream, in cells of the world."""

    def __init__(self) -> None: ...

    def copy(self) -> CellMemory: ...

    @property
    def cells(self) -> int: ...

    def check(self, now: SweepView, now_from_memory: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], t_s: float, views: Sequence[SweepView], transforms: Annotated[NDArray[numpy.float32], dict(shape=(None, None, None), order='C', device='cpu', writable=False)], gaps_s: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], sectors: int) -> tuple[Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')]]:
        """
        Meters of standing surfaces that the sweep looks through, area m2 of obstacles that are new and came fast (sectors,), by azimuth about the sweep.
        """

    def add(self, now: SweepView, memory_from_now: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], now_from_memory: Annotated[NDArray[numpy.float32], dict(shape=(None, None), order='C', device='cpu', writable=False)], t_s: float) -> None:
        """
        Remember the obstacles of a sweep; forget what was not seen for ten seconds.
        """

def encode_view(state: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)], level: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)], deviation: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), order='C', device='cpu', writable=False)], row: int, column: int) -> bytes:
    """
    The code of a view: state 0…3, level of the probability 0…15 and, unless (0, 0), deviation 0…8 of each cell. Empty where it would take too many decisions.
    """

def decode_view(code: Annotated[NDArray[numpy.uint8], dict(shape=(None,), order='C', device='cpu', writable=False)], cells: int, row: int, column: int, prob: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)], std: Annotated[NDArray[numpy.float32], dict(shape=(None,), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.uint8], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')], Annotated[NDArray[numpy.float32], dict(order='C')] | None] | None:
    """
    State, probability and deviation (None without values for it) of each cell; None where the code is none.
    """
