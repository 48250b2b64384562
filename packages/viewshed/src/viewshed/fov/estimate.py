"""FovEstimate: visibility of each cell of a grid to one sweep; and the protocol FovEstimator."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from viewshed import _core, _outputs
from viewshed._files import write_atomic
from viewshed.arrays import Mask, as_int, frozen
from viewshed.fov.visibility import CAR, Target
from viewshed.geometry import FloatArray, Rigid
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep

if TYPE_CHECKING:
    from shapely import MultiPolygon

    from viewshed.preprocess.leveling import LeveledSweep


THRESHOLD = _core.THRESHOLD
"""Minimum probability of a visible cell."""


UNSURE_M = _core.UNSURE_M
"""Ground height with a larger standard deviation is unsure; a third of a car's height."""

HeightSource = Literal["given", "estimated", "held", "assumed"]
"""Source of a sensor's height: stated with the sweep, its returns, earlier sweeps of its stream, or a default."""

_HEIGHT_SOURCES = get_args(HeightSource)


class CellState(IntEnum):
    """State of a cell. Visible means FREE or SURFACE."""

    UNKNOWN = 0
    """No evidence: outside coverage, too few beams, or no-return beams of unknown cause."""
    FREE = 1
    """Visible and empty."""
    SURFACE = 2
    """Visible, and occupied by the first surface that the beams hit."""
    HIDDEN = 3
    """Within range and coverage, but occluded by a nearer surface."""


def is_visible(states: NDArray[np.uint8]) -> Mask:
    """Return the mask (…) of the states (…) that are FREE or SURFACE."""
    return np.asarray((states == CellState.FREE) | (states == CellState.SURFACE))


@dataclass(frozen=True, slots=True)
class Basis:
    """Quality of the inputs of an estimate: sensor height, ground, inferred beams, reach."""

    sensor_height_m: float  # height of the sensor above the ground below it
    # ``given`` with the sweep, ``estimated`` from its returns, ``held`` (carried over from earlier sweeps of the
    # stream), or ``assumed`` if no ground was seen
    height_source: HeightSource
    ground_support: float  # share in [0, 1] of the near ground that lies on the ground plane below the sensor
    unsure_ground_share: float  # share in [0, 1] of the visible cells whose ground height has a std above UNSURE_M
    inferred_share: float  # share in [0, 1] of the visible cells that depend on inferred beams
    reach_m: float  # maximum range of a dark target; no cell beyond is claimed

    def __post_init__(self) -> None:
        if self.height_source not in _HEIGHT_SOURCES:
            raise ValueError(f"height_source must be one of {', '.join(_HEIGHT_SOURCES)}, got {self.height_source!r}")
        for name in ("ground_support", "unsure_ground_share", "inferred_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        if not (isfinite(self.sensor_height_m) and self.reach_m >= 0.0):
            raise ValueError(
                f"sensor_height_m must be finite and reach_m not negative, got {self.sensor_height_m}, {self.reach_m}"
            )

    @property
    def height_line(self) -> str:
        """One line of text: sensor height, its source and support, and the reach.

        >>> Basis(1.84, "estimated", 0.63, 0.04, 0.07, 80.0).height_line
        'sensor 1.84 m above the ground (estimated, 63% of the near ground agrees), reach 80 m'
        """
        height, reach = f"{self.sensor_height_m:.2f} m above", f"reach {self.reach_m:.0f} m"
        if self.height_source == "assumed":
            return f"ground not seen, sensor taken to be {height} it, {reach}"
        support = f", {self.ground_support:.0%} of the near ground agrees" if self.height_source == "estimated" else ""
        return f"sensor {height} the ground ({self.height_source}{support}), {reach}"

    @property
    def view_line(self) -> str:
        """One line of text: shares of the visible cells on unsure ground and by inferred beams.

        >>> Basis(1.84, "estimated", 0.63, 0.04, 0.07, 80.0).view_line
        '4% of the view over ground unsure by 0.5 m, 7% by inferred beams'
        """
        return (
            f"{self.unsure_ground_share:.0%} of the view over ground unsure by {UNSURE_M:g} m,"
            f" {self.inferred_share:.0%} by inferred beams"
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FovEstimate:
    """The field of view of one sweep on a :class:`BevGrid` in the ``level`` frame.

    Attributes:
        grid: grid of the cells.
        visible_prob: (cells, cells) float32 in [0, 1]: probability that a target in the cell would have given at
            least ``target.min_returns`` returns (the definition of visible).
        std: (cells, cells) float32 standard deviation of that probability over the model's posterior (``mc_dropout``:
            over its passes); NaN if the estimator has none.
        state: (cells, cells) uint8 of :class:`CellState`.
        method: name of the estimator.
        target: the target whose visibility is estimated.
        threshold: minimum probability in (0, 1] of a cell that the estimator calls visible.
        world_from_level: pose of the ``level`` frame in the map, or None.
        t_ns: time of the sweep in nanoseconds, or None.
        agent: agent of the sweep.
        basis: quality of the inputs; None if the estimate was not made from a sweep.

    Raises:
        ValueError: a shape differs from the grid's, or a value is out of range.
    """

    grid: BevGrid
    visible_prob: NDArray[np.float32]
    state: NDArray[np.uint8]
    std: NDArray[np.float32] | None = None
    method: str = ""
    target: Target = CAR
    threshold: float = THRESHOLD
    world_from_level: Rigid | None = None
    t_ns: int | None = None
    agent: str = "ego"
    basis: Basis | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.threshold <= 1.0:
            raise ValueError(f"threshold must lie in (0, 1], got {self.threshold}")
        object.__setattr__(self, "threshold", float(self.threshold))
        if self.t_ns is not None:
            object.__setattr__(self, "t_ns", as_int("t_ns", self.t_ns))
        state = np.asarray(self.state)  # before the cast, which would wrap
        if state.size and not (state.min() >= 0 and state.max() <= max(CellState)):
            raise ValueError(f"state must lie in [0, {max(CellState):d}], got {state.min()}…{state.max()}")
        self._store("visible_prob", self.visible_prob, np.float32)
        std: Any = _nan_plane(self.grid.cells) if self.std is None else self.std
        self._store("std", std, np.float32)
        self._store("state", self.state, np.uint8)
        # min and max propagate NaN, which fails both comparisons.
        if not (self.visible_prob.min() >= 0 and self.visible_prob.max() <= 1):
            raise ValueError("visible_prob must lie in [0, 1] and not be NaN")
        if self.std is not None and (np.asarray(std) < 0).any():
            raise ValueError("std must not be negative; NaN means that the estimator has none")

    def _store(self, name: str, value: Any, dtype: type[np.generic]) -> None:
        array = np.asarray(value, dtype)
        if array.shape != self.grid.shape:
            raise ValueError(f"{name} must have the grid's shape {self.grid.shape}, got {array.shape}")
        object.__setattr__(self, name, frozen(array))

    def __repr__(self) -> str:
        shares = ", ".join(f"{self.share(state):.0%} {state.name.lower()}" for state in reversed(CellState))
        size_m = 2 * self.grid.half_extent_m
        return (
            f"FovEstimate({self.method or 'no method'}: a {self.target.name} is visible on {self.area_m2():.0f} m² of"
            f" {size_m:g} × {size_m:g} m; {shares})"
        )

    def _repr_png_(self) -> bytes:
        """Return a PNG for notebooks."""
        return self.plot()

    def show(self) -> Path:
        """Open the picture of :meth:`plot` in the viewer or browser of this machine; return the file."""
        import tempfile
        import webbrowser

        path = self.save(Path(tempfile.mkdtemp(prefix="viewshed")) / f"{self.method or 'estimate'}.png")
        webbrowser.open(path.as_uri())
        return path

    def visible(self, threshold: float | None = None) -> NDArray[np.bool_]:
        """Return the mask (cells, cells) of cells with probability ≥ ``threshold``, by default the estimate's own."""
        threshold = self.threshold if threshold is None else threshold
        if not 0.0 < threshold <= 1.0:
            raise ValueError(f"threshold must lie in (0, 1], got {threshold}")
        mask: NDArray[np.bool_] = self.visible_prob >= np.float32(threshold)
        return mask

    def doubt(self) -> NDArray[np.float32]:
        """Return the uncertainty min(p, 1 - p) (cells, cells) float32 in [0, 0.5]: probability that the mask is wrong.

        It is as reliable as ``visible_prob``: ``shadow_map`` is calibrated, estimators of 0/1 masks give 0 everywhere.

        >>> prob = np.array([[0.25, 0.75], [0.0, 1.0]])
        >>> FovEstimate(BevGrid(2, 1.0), prob, np.zeros((2, 2))).doubt().tolist()
        [[0.25, 0.25], [0.0, 0.0]]
        """
        doubt: NDArray[np.float32] = np.minimum(self.visible_prob, np.float32(1.0) - self.visible_prob)
        return doubt

    def area_m2(self, threshold: float | None = None) -> float:
        """Return the visible area in square meters."""
        return float(self.visible(threshold).sum()) * self.grid.cell_area_m2

    def share(self, state: CellState) -> float:
        """Return the share of the grid's cells in ``state``, in [0, 1]."""
        return float((self.state == state).mean())

    def at(self, xy: FloatArray) -> NDArray[np.float32]:
        """Return the probability of visible (…,) of the cells at points (…, 2+) in ``level``; NaN outside the grid."""
        cells, inside = self.grid.index(xy)
        prob = self.visible_prob[cells[..., 0], cells[..., 1]]
        return np.where(inside, prob, np.float32(np.nan)).astype(np.float32)

    def polygon(self, threshold: float | None = None) -> MultiPolygon:
        """Return the exact outline of the visible cells as a valid polygon with holes, in meters in ``level``."""
        from viewshed.fov.polygons import polygon_of_mask

        return polygon_of_mask(self.visible(threshold), self.grid)

    def inner_polygon(self, max_vertices: int, threshold: float | None = None) -> MultiPolygon:
        """Return a polygon of at most ``max_vertices`` vertices that lies within the visible cells."""
        from viewshed.fov.polygons import inner_polygon_of_mask

        return inner_polygon_of_mask(self.visible(threshold), self.grid, max_vertices)

    def save(self, path: str | Path) -> Path:
        """Write the estimate to ``path`` in the format of its suffix, and return the path.

        ``.png`` is the picture of :meth:`plot`, ``.npz`` all arrays, ``.geojson`` polygons, ``.cpm.json`` an ETSI
        perception region; ``viewshed.io.export.EXPORTERS`` has all formats.

        Raises:
            ValueError: no format has this suffix.
        """
        path = Path(path)
        if path.suffix == ".png":
            write_atomic(path, self.plot())
        else:
            _outputs.save(self, path)
        return path

    def plot(self, leveled: LeveledSweep | None = None, title: str | None = None, dark: bool = False) -> bytes:
        """Return a PNG of the states; also of probability and uncertainty, unless the probabilities are 0 or 1.

        Args:
            leveled: the sweep of the estimate, to draw its returns.
            title: title above the picture; None is method and target.
            dark: whether the background is dark.
        """
        return _outputs.draw(self, leveled, f"{self.method}, {self.target.name}" if title is None else title, dark)


@lru_cache(maxsize=8)
def _nan_plane(cells: int) -> NDArray[np.float32]:
    """Return a cached read-only (cells, cells) array of NaN, the ``std`` of estimators that have none."""
    plane = np.full((cells, cells), np.nan, np.float32)
    plane.setflags(write=False)
    return plane


class FovEstimator(Protocol):
    """Protocol of an object that estimates the field of view of a sweep on its own grid."""

    @property
    def grid(self) -> BevGrid:
        """Grid of all its estimates."""
        ...

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the field of view of one sweep. Must not modify ``sweep``."""
        ...
