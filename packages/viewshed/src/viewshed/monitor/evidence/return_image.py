"""The return image: returns by ring and column, which evidence of one sweep reads; made once for a sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import SECTORS, sector_of
from viewshed.preprocess.leveling import LeveledSweep


@dataclass(frozen=True, slots=True, eq=False)
class ReturnImage:
    """Leveled returns on an image of rings × columns, without the rings that hardly returned; A rings are left.

    Attributes:
        range_m: (A, columns) float32 meters from the sensor to the nearest return of each pixel; +inf for none.
        farthest_m: (A, columns) float32 the same to the farthest.
        height_m: (A, columns) float32 height above local ground of the nearest return; NaN for none.
        sector: (columns,) int16 sector of the level frame that each column looks into, at the horizon.
    """

    range_m: F32
    farthest_m: F32
    height_m: F32
    sector: NDArray[np.int16]


def return_image_of(leveled: LeveledSweep) -> ReturnImage | None:
    """Return the image of a leveled sweep's returns; None where its rings are not known."""
    image = leveled.range_image
    if image is None:
        return None
    key = ("return_image",)
    made: ReturnImage | None = leveled.derived.get(key)
    if made is None:
        pixels = _core.beam_image(
            leveled.sweep.points,
            image.ring,
            image.column,
            leveled.rows,
            leveled.height_m,
            len(image.elevation),
            image.columns,
        )
        made = ReturnImage(*pixels, _sectors_of_columns(leveled, image.columns))
        leveled.derived[key] = made
    return made


def _sectors_of_columns(leveled: LeveledSweep, columns: int) -> NDArray[np.int16]:
    """Return the sector (columns,) of each column; column 0 begins behind the sensor."""
    azimuth = (np.arange(columns) + 0.5) * (2 * np.pi / columns) - np.pi
    x, y = leveled.level_from_sensor.rotation[:2, :2] @ np.stack([np.cos(azimuth), np.sin(azimuth)])
    return (sector_of(np.arctan2(y, x)) % SECTORS).astype(np.int16)
