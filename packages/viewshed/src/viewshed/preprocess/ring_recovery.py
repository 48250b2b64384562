"""Which beam and which column each return belongs to: the range image of a sweep, recovered from its points.

Column 0 starts at azimuth -π (behind the sensor) and columns count counter-clockwise: the middle of column c is at
``(c + 0.5) * azimuth_step - π``. The column is that of the return itself, not of the firing.
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
"""In the order of the core's ``RingSource``."""

DEFAULT_COLUMNS = 1024
"""Columns of a revolution where neither the points nor a model tell."""

_NO_BEAMS = np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class RingAssignment:
    """The beam and the column of each return."""

    ring: NDArray[np.int16]  # (N,) int16 beam of each return, 0 the lowest; -1 where no beam explains the return
    column: NDArray[np.int32]  # (N,) int32 azimuth column of each return, in [0, columns)
    columns: int  # azimuth columns in a revolution
    # (rings,) float64 radians: median direction of the beam's returns seen from the sensor's origin; the model's, or
    # interpolated, for beams without a return
    elevation: NDArray[np.float64]
    placed_share: float  # share of the returns that have a beam
    alone_share: float  # share of the placed returns that are alone in their pixel (ring, column)
    source: Source  # how the rings were found

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

    Rings are ``known`` (N,), -1 where no beam explains a return; else they come from the sweep's own ring column; else
    from the order of the points (ring after ring, as in KITTI files); else from the nearest beam of ``model`` (or the
    sweep's model), if the elevations gather at its beams; else, without a model, from the elevations at which the
    returns themselves gather; else from bins of elevation. All but the order do not depend on the order of the points.

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
    """Return the beams of ``sweep`` where its rings are known, not guessed from elevations alone.

    Raises:
        ValueError: the sweep has no rings, and neither the order of its points nor a sensor's table tells them.
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
