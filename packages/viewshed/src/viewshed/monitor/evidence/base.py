"""What a monitor looks at: kinds of evidence, each a number for every sector of azimuth around the sensor."""

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
"""Earlier sweeps that evidence is given at most."""

ABSTAINS: F32 = np.full(SECTORS, np.nan, np.float32)
"""What evidence says that cannot be had of this sweep (without earlier sweeps, rings or a pose)."""
ABSTAINS.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class MonitoredSweep:
    """What evidence is handed.

    Attributes:
        leveled: the sweep now.
        earlier: sweeps of the same sensor before it, leveled, the oldest first; those without a pose or a time help
            only evidence that needs neither.
        memory: of the sweeps before it; None for none.
    """

    leveled: LeveledSweep
    earlier: tuple[LeveledSweep, ...] = ()
    memory: CellMemory | None = None


@dataclass(frozen=True, slots=True)
class Evidence:
    """One kind of evidence.

    Attributes:
        name: of the evidence, as in ``EVIDENCE``.
        measure: returns (SECTORS,) float32 numbers of a monitored sweep; NaN in sectors, or everywhere, where it
            abstains. What is of the whole sweep is the same in all sectors.
        grain: numbers that differ by less say the same; numbers are compared as log(1 + number / grain).
        sentence: why one would worry, with places for ``{value}``, the number of its strongest sector, and
            ``{degrees}``, the middle of that sector's azimuth.
        two_sided: a smaller number than before is as suspicious as a larger one; else only a larger one is.
        of_place: it changes as well where the sensor comes to another place, together with the others that do: all of
            them count as one.
        version: raised by one when ``measure`` gives other numbers: monitors that were calibrated on those before are
            void then.
    """

    name: str
    measure: Callable[[MonitoredSweep], F32]
    grain: float
    sentence: str
    two_sided: bool = False
    of_place: bool = False
    version: int = 1

    def reason(self, sectors: F32) -> str:
        """Return the sentence about the strongest sector of what was measured (SECTORS,)."""
        strongest = int(np.nanargmax(sectors))
        degrees = (strongest + 0.5) * 360.0 / SECTORS - 180.0
        return self.sentence.format(value=float(sectors[strongest]), degrees=degrees)


def sector_of(azimuth: NDArray[np.floating[Any]]) -> NDArray[np.intp]:
    """Return the sector (…) in [0, SECTORS) of azimuths (…), radians.

    >>> sector_of(np.array([-np.pi, -np.pi + 0.1, 0.0, np.pi])).tolist()
    [0, 1, 36, 0]
    """
    return np.floor((np.asarray(azimuth, np.float64) + np.pi) * (SECTORS / (2 * np.pi))).astype(np.intp) % SECTORS
