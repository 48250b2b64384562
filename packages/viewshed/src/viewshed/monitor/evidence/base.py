"""Interface of evidence: each kind measures one number for every sector of azimuth around the sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.preprocess.leveling import LeveledSweep

if TYPE_CHECKING:
    from viewshed.monitor.evidence.cells import CellMemory

SECTORS = 72
"""Sectors of azimuth in the level frame, 5° each; sector 0 begins behind the sensor, at -π, counter-clockwise."""

EARLIER_SWEEPS = 5
"""Maximum number of earlier sweeps given to evidence."""

ABSTAINS: F32 = np.full(SECTORS, np.nan, np.float32)
"""Evidence that cannot be measured on this sweep (without earlier sweeps, rings or a pose)."""
ABSTAINS.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class MonitoredSweep:
    """Input of evidence.

    Attributes:
        leveled: the current sweep.
        earlier: earlier sweeps of the same sensor, leveled, the oldest first; those without a pose or a time serve
            only evidence that needs neither.
        memory: cells of the earlier sweeps, or None.
    """

    leveled: LeveledSweep
    earlier: tuple[LeveledSweep, ...] = ()
    memory: CellMemory | None = None


@dataclass(frozen=True, slots=True)
class Evidence:
    """One kind of evidence.

    Attributes:
        name: as in ``EVIDENCE``.
        measure: returns (SECTORS,) float32 numbers of a monitored sweep; NaN in sectors, or everywhere, where it
            abstains. A number of the whole sweep is repeated in all sectors.
        grain: resolution; numbers are compared as log(1 + number / grain).
        sentence: reason for a report, with placeholders ``{value}``, the number of the strongest sector, and
            ``{degrees}``, the center of that sector's azimuth.
        two_sided: a decrease is as suspicious as an increase; else only an increase is.
        of_place: also changes when the sensor comes to another place. All such kinds count as one, because they change
            together.
        version: raised by one when ``measure`` gives other numbers, which invalidates existing calibrations.
    """

    name: str
    measure: Callable[[MonitoredSweep], F32]
    grain: float
    sentence: str
    two_sided: bool = False
    of_place: bool = False
    version: int = 1

    def reason(self, sectors: F32) -> str:
        """Return the sentence about the strongest of the measured sectors (SECTORS,)."""
        strongest = int(np.nanargmax(sectors))
        degrees = (strongest + 0.5) * 360.0 / SECTORS - 180.0
        return self.sentence.format(value=float(sectors[strongest]), degrees=degrees)


def sector_of(azimuth: NDArray[np.floating[Any]]) -> NDArray[np.intp]:
    """Return the sector (…) in [0, SECTORS) of azimuths (…), radians.

    >>> sector_of(np.array([-np.pi, -np.pi + 0.1, 0.0, np.pi])).tolist()
    [0, 1, 36, 0]
    """
    return np.floor((np.asarray(azimuth, np.float64) + np.pi) * (SECTORS / (2 * np.pi))).astype(np.intp) % SECTORS
