"""A monitor's report on one sweep: two verdicts, suspect sectors and cells, and reasons; GeoJSON of suspect cells."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import Mask
from viewshed.fov.polygons import local_crs, polygon_of_mask
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.monitor.evidence.base import SECTORS, sector_of


@dataclass(frozen=True, slots=True, eq=False)
class IntegrityReport:
    """A monitor's report on one sweep. It only reports; reactions are decided elsewhere (``viewshed.pipeline``).

    Attributes:
        monitor: name of the monitor.
        score: anomaly score; larger is worse.
        threshold: the sweep is inconsistent if its score is above this.
        p_value: share of benign sweeps, this one included, that score at least as high; NaN if the monitor keeps no
            benign scores.
        degraded: the view is smaller or worse than it should be, whatever the cause.
        degraded_p_value: p-value of the degraded verdict; NaN if the monitor does not give one.
        suspect: (SECTORS,) bool, suspect sectors of azimuth.
        grid: of the suspect cells; None if no grid was given.
        suspect_cells: (cells, cells) bool on the grid; (0, 0) without one.
        reasons: one sentence each, the strongest first.
        notes: one sentence each: data that the report had to do without, and what was done instead.
        evidence: (E, SECTORS) float32 surprise of each kind of evidence in each sector; (0, SECTORS) if the monitor
            uses no evidence.

    Raises:
        ValueError: score or threshold is not a number, a p-value lies outside (0, 1], or a mask does not fit.

    >>> report = IntegrityReport("by hand", score=2.0, threshold=1.5)
    >>> report.inconsistent, report.degraded, report.suspect.any()
    (True, False, np.False_)
    """

    monitor: str
    score: float
    threshold: float
    p_value: float = math.nan
    degraded: bool = False
    degraded_p_value: float = math.nan
    suspect: Mask = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    grid: BevGrid | None = None
    suspect_cells: Mask = field(default_factory=lambda: np.zeros((0, 0), np.bool_))
    reasons: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    evidence: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, SECTORS), np.float32))

    def __post_init__(self) -> None:
        if math.isnan(self.score) or math.isnan(self.threshold):
            raise ValueError(f"score and threshold must be numbers, got {self.score} and {self.threshold}")
        for name in ("p_value", "degraded_p_value"):
            value = getattr(self, name)
            if value <= 0.0 or value > 1.0:
                raise ValueError(f"{name} must lie in (0, 1] or be NaN, got {value}")
        shape = (0, 0) if self.grid is None else self.grid.shape
        for name, expected in (("suspect", (SECTORS,)), ("suspect_cells", shape)):
            mask = getattr(self, name)
            if mask.dtype != np.bool_ or mask.shape != expected:
                raise ValueError(f"{name} must be bool {expected}, got {mask.dtype} {mask.shape}")
            mask = mask.view()
            mask.setflags(write=False)
            object.__setattr__(self, name, mask)

    @property
    def inconsistent(self) -> bool:
        """Whether the sweep is impossible or contradicted by time: its score lies above the threshold."""
        return self.score > self.threshold

    @property
    def alarm(self) -> bool:
        """The same as ``inconsistent``; a degraded view alone is no alarm, because it has honest causes."""
        return self.inconsistent

    @property
    def suspect_m2(self) -> float:
        """Area of the suspect cells in square meters; NaN without a grid."""
        return math.nan if self.grid is None else float(self.suspect_cells.sum()) * self.grid.cell_area_m2


def cells_of_sectors(sectors: Mask, grid: BevGrid) -> Mask:
    """Return the mask (cells, cells) of cells whose centers lie in one of the sectors (SECTORS,) bool.

    >>> front_left = np.zeros(SECTORS, np.bool_)
    >>> front_left[36:54] = True  # 0° to 90°
    >>> cells_of_sectors(front_left, BevGrid(4, 2.0)).astype(int)
    array([[0, 0, 0, 0],
           [0, 0, 0, 0],
           [0, 0, 1, 1],
           [0, 0, 1, 1]])
    """
    mask: Mask = sectors[sector_of(polar_of_cells(grid)[1])]
    return mask


def sector_corners(sectors: Mask, reach_m: float) -> NDArray[np.float64]:
    """Return the corners (3 K, 2) of a triangle from the sensor for each of K sectors (SECTORS,) bool.

    >>> sector_corners(np.arange(SECTORS) == SECTORS // 2, 10.0).round(3).tolist()
    [[0.0, 0.0], [10.0, 0.0], [9.962, 0.872]]
    """
    step = 2 * np.pi / SECTORS
    start = np.flatnonzero(sectors) * step - np.pi
    ends = [np.column_stack([np.cos(angle), np.sin(angle)]) * reach_m for angle in (start, start + step)]
    return np.stack([np.zeros((len(start), 2)), *ends], axis=1).reshape(-1, 2)


def sectors_of_cells(cells: Mask, grid: BevGrid) -> Mask:
    """Return the mask (SECTORS,) of sectors that contain the center of one of the cells (cells, cells) bool."""
    counts = np.bincount(sector_of(polar_of_cells(grid)[1][cells]), minlength=SECTORS)
    return counts > 0


def suspects_geojson(report: IntegrityReport) -> bytes:
    """Return a GeoJSON Feature (UTF-8) of the suspect cells: a MultiPolygon, with score and alarm as properties.

    Coordinates are meters in the ``level`` frame (x forward, y left), not degrees, as in the other exports.

    Raises:
        ValueError: the report is on no grid.
    """
    from shapely.geometry import mapping

    if report.grid is None:
        raise ValueError("report must be on a grid, got none; check a sweep together with its estimate")
    properties = {
        "monitor": report.monitor,
        "score": report.score,
        "threshold": report.threshold,
        "alarm": report.alarm,
        "p_value": None if math.isnan(report.p_value) else report.p_value,
        "degraded": report.degraded,
        "reasons": list(report.reasons),
    }
    frame = {
        "name": "level",
        "coordinates": "meters in level frame, not WGS84",
        "axes": "x forward, y left of the sensor",
    }
    shape = mapping(polygon_of_mask(report.suspect_cells, report.grid))
    feature = {
        "type": "Feature",
        "crs": local_crs("level"),
        "viewshed:frame": frame,
        "properties": properties,
        "geometry": shape,
    }
    return json.dumps(feature, allow_nan=False).encode()
