"""The native core: from points to estimate. Each function checks its arrays and raises ValueError or TypeError."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__version__: str

def threads() -> int: ...
def set_threads(count: int) -> None: ...

# range_image.cpp

_RangeImage = tuple[
    NDArray[np.int32],
    NDArray[np.uint8],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.bool_],
    NDArray[np.bool_],
    NDArray[np.bool_] | None,
    bool,
]

def range_image(
    points: NDArray[np.float32], ring: NDArray[np.int16], columns: int, rings: int, near_m: float, far_m: float
) -> _RangeImage: ...
def silent_columns(counts: NDArray[np.uint8]) -> NDArray[np.bool_]: ...
def least_confirmations(mean: float) -> int: ...
def pixels_without(
    ring: NDArray[np.int16], left_out: NDArray[np.bool_], column: NDArray[np.int32], counts: NDArray[np.uint8]
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]: ...

# sensor_id.cpp

def identify_by_rings(
    points: NDArray[np.float32],
    ring: NDArray[np.int16],
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    rings: NDArray[np.int64],
    columns: NDArray[np.int64],
    expected: int,
) -> tuple[NDArray[np.int16] | None, int]: ...
def identify_by_points(
    points: NDArray[np.float32],
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    rings: NDArray[np.int64],
    columns: NDArray[np.int64],
    expected: int,
) -> tuple[NDArray[np.int16] | None, int]: ...
def rings_of_points(points: NDArray[np.float32]) -> NDArray[np.int16] | None: ...
def beams_of_sensor(
    points: NDArray[np.float32], elevation: NDArray[np.float64], origin_m: NDArray[np.float64]
) -> NDArray[np.int16] | None: ...
def infer_sensor(
    points: NDArray[np.float32],
    ring: NDArray[np.int16] | None,
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    rings: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> tuple[int, float]: ...
def recover_rings(
    points: NDArray[np.float32],
    ring: NDArray[np.int16] | None,
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    columns: int,
) -> tuple[NDArray[np.int16], NDArray[np.int32], int, NDArray[np.float64], int, int, int]: ...
def polar(points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
def match_beams(
    slope: NDArray[np.float32],
    range_m: NDArray[np.float32],
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
) -> tuple[NDArray[np.int16], NDArray[np.int64], float]: ...
def find_clusters(
    azimuth: NDArray[np.float32], slope: NDArray[np.float32], range_m: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float] | None: ...
def find_motion(points: NDArray[np.float32]) -> tuple[float, float, float, float, float] | None: ...
def undo_motion(
    points: NDArray[np.float32], x_m: float, y_m: float, z_m: float, seam: float, reference: float
) -> NDArray[np.float32]: ...

# ground.cpp

_Ground = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], tuple[float, float, float], float, float]

def ground_of_lows(
    lows_m: NDArray[np.float32], rise_m: NDArray[np.float32], half_m: float, height_m: float
) -> _Ground: ...
def fill_ground(
    walked_m: NDArray[np.float32], accepted: NDArray[np.bool_], plane: NDArray[np.float32], half_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def guess_inputs(
    points: NDArray[np.float32],
    azimuth: NDArray[np.float32],
    range_m: NDArray[np.float32],
    heights_m: NDArray[np.float32],
    seen: NDArray[np.bool_],
    half_m: float,
    sensor_height_m: float,
) -> NDArray[np.float32]: ...
def guessed_ground(
    outputs: NDArray[np.float32],
    inputs: NDArray[np.float32],
    heights_m: NDArray[np.float32],
    seen: NDArray[np.bool_],
    half_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def free_plane(points: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]: ...
def held_ground(
    heights_m: NDArray[np.float32],
    std_m: NDArray[np.float32],
    seen: NDArray[np.bool_],
    half_m: float,
    before_heights_m: NDArray[np.float32],
    before_std_m: NDArray[np.float32],
    before_seen: NDArray[np.bool_],
    before_half_m: float,
    before_from_now: NDArray[np.float32],
    now_from_before: NDArray[np.float32],
    variance_m2: float,
    plane: tuple[float, float, float],
    height_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]] | None: ...

# reach.cpp

def range_quantile(
    range_m: NDArray[np.float32],
    left_out: NDArray[np.bool_],
    rows: NDArray[np.int32] | None,
    most_m: float,
    share: float,
) -> float: ...

# leveling.cpp

EGO_BOX_M: tuple[float, float]
EGO_HEIGHTS_M: tuple[float, float]

def vehicle_heading(points: NDArray[np.float32], rotation: NDArray[np.float32]) -> float: ...

_LevelPoints = tuple[
    NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]
]

def level_points(
    points: NDArray[np.float32],
    clutter: NDArray[np.bool_] | None,
    level_from_sensor: NDArray[np.float32],
    near_m: float,
    far_m: float,
    heading: float,
    ground_m: NDArray[np.float32],
    half_extent_m: float,
) -> _LevelPoints: ...

LEVEL_TILT: float

def level_sweep(
    points: NDArray[np.float32],
    ring: NDArray[np.int16] | None,
    rings: int,
    columns: int,
    near_m: float,
    far_m: float,
    attitude: NDArray[np.float64] | None,
    height_m: float | None,
    yaw: float | None,
    half_extent_m: float,
) -> tuple[
    _RangeImage | None,
    NDArray[np.float64],
    float,
    tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], tuple[float, float, float], float],
    _LevelPoints,
]: ...
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

class NoReturnModel:
    def __init__(
        self,
        mean: NDArray[np.float32],
        scale: NDArray[np.float32],
        first: NDArray[np.float32],
        first_bias: NDArray[np.float32],
        second: NDArray[np.float32],
        second_bias: NDArray[np.float32],
        third: NDArray[np.float32],
        third_bias: NDArray[np.float32],
    ) -> None: ...

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
    model: NoReturnModel,
) -> tuple[
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
]: ...
def no_return_groups(
    ring: NDArray[np.int16],
    column: NDArray[np.int32],
    counts: NDArray[np.uint8],
    isolated: NDArray[np.bool_],
    clutter: NDArray[np.bool_] | None,
    phase: NDArray[np.float32],
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    rotation: NDArray[np.float64],
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
    NDArray[np.float32],
    NDArray[np.int32],
    NDArray[np.float32],
    NDArray[np.float32],
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
def polar_of_cells(
    cells: int, cell_m: float, x0_m: float, y0_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...

# height_map.cpp

def lattice_positions(
    xy: NDArray[np.float32], half_extent_m: float, nodes: int
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]: ...
def interpolate(
    heights_m: NDArray[np.float32], node: NDArray[np.int32], down: NDArray[np.float64], right: NDArray[np.float64]
) -> NDArray[np.float32]: ...

# visibility.cpp

AZIMUTH_COLUMNS: int
GROUND_SECTORS: int

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
    kinds: tuple[_Beams, _Beams, _Beams, _Beams],
    heights_m: NDArray[np.float32],
    std_m: NDArray[np.float32],
    *,
    half_extent_m: float,
    sensor_height_m: float,
    target_height_m: float,
    ground_steps: tuple[tuple[float, float], tuple[float, float]],
    end_weights: tuple[float, float],
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
def claims(
    state: NDArray[np.uint8],
    measured: NDArray[np.float32],
    node: NDArray[np.int32],
    std_m: NDArray[np.float32],
    *,
    table: NDArray[np.float32],
    threshold: float,
    unsure_m: float,
) -> tuple[int, int, int]: ...
def states(
    measured: NDArray[np.float32],
    late: NDArray[np.float32],
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

# boxes.cpp

class BeamsByAzimuth:
    def __init__(
        self, azimuth: NDArray[np.float32], slope: NDArray[np.float32], depth_m: NDArray[np.float32]
    ) -> None: ...
    def expected_returns(
        self, boxes: NDArray[np.float32], sensor_height_m: float, leave_out_own: bool
    ) -> NDArray[np.int32]: ...

# object_candidates.cpp

def object_candidates(
    points: NDArray[np.float32],
    height_m: NDArray[np.float32],
    range_m: NDArray[np.float32],
    sensor_height_m: float,
) -> tuple[
    NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]
]: ...

# shape_classifier.cpp

def shape_probabilities(
    shapes: NDArray[np.float32],
    mean: NDArray[np.float32],
    scale: NDArray[np.float32],
    first: NDArray[np.float32],
    first_bias: NDArray[np.float32],
    second: NDArray[np.float32],
    second_bias: NDArray[np.float32],
    third: NDArray[np.float32],
    third_bias: NDArray[np.float32],
) -> NDArray[np.float32]: ...

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

# fov_code.cpp

def encode_view(
    state: NDArray[np.uint8], level: NDArray[np.uint8], deviation: NDArray[np.uint8], row: int, column: int
) -> bytes: ...
def decode_view(
    code: NDArray[np.uint8],
    cells: int,
    row: int,
    column: int,
    prob: NDArray[np.float32],
    std: NDArray[np.float32],
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32] | None] | None: ...

# polygons.cpp

def label_regions(mask: NDArray[np.bool_], diagonal: bool) -> NDArray[np.int32]: ...
def squared_depth(mask: NDArray[np.bool_]) -> NDArray[np.int64]: ...
def rings_of_mask(
    mask: NDArray[np.bool_], regions: NDArray[np.int32]
) -> tuple[NDArray[np.int16], NDArray[np.int64], NDArray[np.int32]]: ...
def cells_inside(points: NDArray[np.float64], begin: NDArray[np.int64], cells: int) -> NDArray[np.bool_]: ...
def cells_met(points: NDArray[np.float64], begin: NDArray[np.int64], cells: int) -> NDArray[np.bool_]: ...
def best_sectors(
    ranges: NDArray[np.float64], sectors: int, inner: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]: ...
def free_ranges(
    mask: NDArray[np.bool_],
    x_m: float,
    y_m: float,
    cell_m: float,
    apex_x_m: float,
    apex_y_m: float,
    half_m: float,
    bins: int,
    is_solid: bool,
) -> NDArray[np.float64]: ...
def star_vertices(ranges: NDArray[np.float64], price_m2: float) -> NDArray[np.float64]: ...

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
def all_finite(values: NDArray[np.float32]) -> bool: ...
def plausible_rows(rows: NDArray[np.float32], columns: int) -> bool: ...
def move_points(points: NDArray[np.float32], rotation: NDArray[np.float64], shift: NDArray[np.float64]) -> None: ...
def unpack_lzf(packed: NDArray[np.uint8], unpacked: NDArray[np.uint8]) -> int: ...

# temporal_evidence.cpp

class SweepView:
    def __init__(
        self,
        squared_m2: NDArray[np.float32],
        phase: NDArray[np.float32],
        elevation: NDArray[np.float32],
        origin_m: NDArray[np.float32],
        points: NDArray[np.float32],
        height_m: NDArray[np.float32],
        range_m: NDArray[np.float32],
        azimuth: NDArray[np.float32],
        isolated: NDArray[np.bool_],
        sensor_from_level: NDArray[np.float32],
    ) -> None: ...
    @property
    def rings(self) -> int: ...
    @property
    def columns(self) -> int: ...
    @property
    def obstacles(self) -> int: ...
    def follow(
        self,
        views: Sequence[SweepView],
        transforms: NDArray[np.float32],
        gaps_s: NDArray[np.float32],
        around: SweepView,
        around_from_self: NDArray[np.float32],
        sectors: int,
    ) -> NDArray[np.float32]: ...
    def jumps(
        self, views: Sequence[SweepView], transforms: NDArray[np.float32], gaps_s: NDArray[np.float32], sectors: int
    ) -> NDArray[np.float32]: ...
    def repeats(self, views: Sequence[SweepView], sectors: int) -> NDArray[np.float32]: ...
    def new_ranges(
        self, views: Sequence[SweepView], turned: Sequence[float], sectors: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
    def register_on(
        self, views: Sequence[SweepView], transforms: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]: ...

class CellMemory:
    def __init__(self) -> None: ...
    def copy(self) -> CellMemory: ...
    @property
    def cells(self) -> int: ...
    def check(
        self,
        now: SweepView,
        now_from_memory: NDArray[np.float32],
        t_s: float,
        views: Sequence[SweepView],
        transforms: NDArray[np.float32],
        gaps_s: NDArray[np.float32],
        sectors: int,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    def add(
        self,
        now: SweepView,
        memory_from_now: NDArray[np.float32],
        now_from_memory: NDArray[np.float32],
        t_s: float,
    ) -> None: ...

# guarantees.cpp

class TargetColumns:
    def __init__(
        self,
        range_m: NDArray[np.float32],
        azimuth: NDArray[np.float32],
        fired: NDArray[np.uint8] | None,
        rings: int,
        columns: int,
        cell_m: float,
        width_m: float,
        farthest_m: float,
    ) -> None: ...

class SentBeams:
    def __init__(
        self,
        columns: TargetColumns,
        low_m: NDArray[np.float32],
        high_m: NDArray[np.float32],
        slope: NDArray[np.float32],
        start_m: NDArray[np.float32],
    ) -> None: ...

def nearest_returns(
    points: NDArray[np.float32],
    ring: NDArray[np.int16] | None,
    rotation: NDArray[np.float32],
    tangent: NDArray[np.float32],
    origin_m: NDArray[np.float32],
    columns: int,
    near_m: float,
    far_m: float,
) -> NDArray[np.float32]: ...
def envelope_margins(sent: SentBeams, nearest: NDArray[np.float32]) -> NDArray[np.int32]: ...
def cells_of_beams(
    sent: SentBeams,
    nearest: NDArray[np.float32],
    margins: NDArray[np.int32],
    counts: NDArray[np.bool_],
    least: int,
    most: int,
    opens: bool,
) -> NDArray[np.float64]: ...
def wedge_changes(
    sent: SentBeams,
    nearest: NDArray[np.float32],
    margins: NDArray[np.int32],
    counts: NDArray[np.bool_],
    least: int,
    wide: int,
    opens: bool,
) -> tuple[int, NDArray[np.bool_]]: ...
