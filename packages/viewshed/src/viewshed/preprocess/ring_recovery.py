"""Recovery of ring and column of each return from the points of a sweep.

Column 0 starts at azimuth -π (behind the sensor) and columns count counter-clockwise: the center of column c is at
``(c + 0.5) * azimuth_step - π``. The column is that of the return's azimuth, not of the firing azimuth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

Source = Literal["file", "file order", "beam table", "elevation clusters", "elevation bins"]

_SOURCES: tuple[Source, ...] = ("file", "file order", "beam table", "elevation clusters", "elevation bins")
"""Sources in the order of the core's ``RingSource``."""

DEFAULT_COLUMNS = 1024
"""Number of columns of a revolution if neither the points nor a model determine it."""

_NO_BEAMS = np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class RingAssignment:
    """The beam and the column of each return."""

    ring: NDArray[np.int16]  # (N,) int16 beam of each return, 0 the lowest; -1 if it matches no beam
    column: NDArray[np.int32]  # (N,) int32 azimuth column of each return, in [0, columns)
    columns: int  # number of azimuth columns of a revolution
    # (rings,) float64 radians: median elevation of the beam's returns from the sensor's origin; for beams without a
    # return that of the model, or interpolated
    elevation: NDArray[np.float64]
    placed_share: float  # share of the returns that have a beam
    alone_share: float  # share of these that are the only return of their pixel (ring, column)
    source: Source  # source of the rings

    @property
    def rings(self) -> int:
        """Number of beams in a column."""
        return len(self.elevation)

    @property
    def azimuth_step(self) -> float:
        """Width of a column in radians."""
        return 2.0 * np.pi / self.columns


def recover_rings(
    sweep: Sweep, model: LidarModel | None = None, known: NDArray[np.int16] | None = None
) -> RingAssignment:
    """Return the beam and column of every return of ``sweep``.

    The rings are the first of these: ``known`` (N,), with -1 for returns that match no beam; the sweep's ring column;
    the order of the points (ring after ring, as in KITTI files); the nearest beam of ``model`` (or the sweep's model),
    if the elevations match its beams; without a model, clusters of the elevations; else bins of elevation. Except for
    recovery from the order, the result does not depend on the order of the points.

    >>> points = np.array([[10.0, 1.0, -1.0], [0.0, 10.0, 1.0]])
    >>> recover_rings(Sweep(points, ring=np.array([0, 1]))).ring.tolist()
    [0, 1]
    """
    model = sweep.model if model is None else model
    table = (_NO_BEAMS, _NO_BEAMS, 0) if model is None else (model.elevation, model.origin_m, model.azimuth_columns)
    ring, column, columns, elevation, placed, alone, source = _core.recover_rings(
        sweep.points, sweep.ring if known is None else known, *table
    )
    return RingAssignment(
        ring=_frozen(ring),
        column=_frozen(column),
        columns=columns,
        elevation=_frozen(elevation),
        placed_share=placed / len(sweep) if len(sweep) else 0.0,
        alone_share=alone / placed if placed else 0.0,
        source=_SOURCES[source],
    )


def rings_of_sweep(sweep: Sweep) -> RingAssignment:
    """Return the rings of ``sweep``; elevation bins do not count as rings.

    Raises:
        ValueError: the sweep has no rings, and none can be recovered.
    """
    beams = recover_rings(sweep)
    if beams.source == "elevation bins":
        raise ValueError(
            "the sweep must have rings, got none that can be recovered; give its ring column or name its sensor"
        )
    return beams


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
