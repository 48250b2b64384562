"""Evidence of the beams of one sweep: what they pass, what stands alone before a surface, where they do not return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, damped_share, sector_of
from viewshed.preprocess.leveling import LeveledSweep

_LEAST_RETURNS = 20
"""Returns that a sector must have for its share of isolated ones to mean anything."""

_FEW_PIXELS, _FEW_RETURNS = 30, 20
"""Pixels and returns that draw a share toward 0."""


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
    """Return the image of a leveled sweep's returns, made once; None where its rings are not known."""
    image = leveled.range_image
    if image is None:
        return None
    made: ReturnImage | None = leveled.derived.get(("return_image",))
    if made is None:
        pixels = _core.beam_image(
            leveled.sweep.points, image.ring, image.column, leveled.rows, leveled.height_m, len(image.elevation),
            image.columns,
        )  # fmt: skip
        # Column 0 begins behind the sensor.
        azimuth = (np.arange(image.columns) + 0.5) * (2 * np.pi / image.columns) - np.pi
        x, y = leveled.level_from_sensor.rotation[:2, :2] @ np.stack([np.cos(azimuth), np.sin(azimuth)])
        made = ReturnImage(*pixels, sector_of(np.arctan2(y, x)).astype(np.int16))
        leveled.derived[("return_image",)] = made
    return made


def measure_isolated(monitored: MonitoredSweep) -> F32:
    """Return the share of isolated returns by sector (SECTORS,); abstains where the rings are not known.

    No neighboring beam confirms them: noise, rain and free points, not surfaces.
    """
    image = monitored.leveled.range_image
    if image is None:
        return ABSTAINS
    isolated, every = _core.count_chosen(monitored.leveled.sweep.points, image.isolated, SECTORS)
    return np.where(every >= _LEAST_RETURNS, isolated / np.maximum(every, 1), 0.0).astype(np.float32)


def measure_behind_surface(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of the pixels within a surface that lie behind it; abstains without rings.

    A beam whose eight neighbors meet one surface cannot have passed it. A spoofer wins only a share of the beams that
    it aims at (.985 for a VLP-16, .44 for an OS1-32, docs/attacks.md): between them the sensor still sees what stands
    behind. Windows, fences and trees have gaps too, but around those the surface is rarely whole.
    """
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    return damped_share(*_core.count_holes(image.range_m, image.sector, SECTORS), _FEW_PIXELS)


def measure_before_surface(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of pixels before their neighbors and in line; abstains without rings.

    A spoofer that removes a wall, or pushes it away, loses some beams (docs/attacks.md), and these still return from
    the wall: single returns in the air, at one range. Points that are added in a wedge at one range look the same. Rain
    and snow return from anywhere along the beam, so few are in line; posts and leaves are, but there are few of them.
    """
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    return damped_share(*_core.count_specks(image.range_m, image.sector, SECTORS), _FEW_PIXELS)


def measure_double_returns(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of pixels with two returns above the sweep's median; abstains without beams.

    A sensor that reports one return a beam has none; free points are added to beams that returned already. The columns
    of a real sensor jitter, so that a return may fall into its neighbor's pixel and leave its own empty: pixels beside
    an empty one do not count. A sensor with dual returns has such pixels all around, hence the median.
    """
    image, known = return_image_of(monitored.leveled), monitored.leveled.range_image
    if image is None or known is None or not known.pixels_are_beams:
        return ABSTAINS
    counts = _core.count_double_returns(image.range_m, image.farthest_m, image.sector, SECTORS)
    share = damped_share(*counts, _FEW_PIXELS)
    return np.asarray(np.maximum(share - np.float32(np.median(share)), np.float32(0.0)))


def measure_off_beam(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of returns that lie on no beam; abstains without rings.

    Their elevation is not that of their ring, nor of a neighbor: free points lie anywhere. Motion and vibration tilt
    beams too, but neighbors of similar range alike. The rings' elevations are measured in the sweep, so a sensor with
    a calibration of its own has none.
    """
    leveled, image = monitored.leveled, monitored.leveled.range_image
    if image is None:
        return ABSTAINS
    off_beam = _core.find_off_beam(
        leveled.sweep.points, image.ring, image.column, image.origin_m, leveled.rows, image.columns
    )
    return damped_share(*_core.count_chosen(leveled.points, off_beam, SECTORS), _FEW_RETURNS)


def measure_empty_runs(monitored: MonitoredSweep) -> F32:
    """Return the longest run of empty columns through each sector (SECTORS,) in degrees; abstains without rings.

    In neighboring columns most rings that return elsewhere do not: returns that are pushed inside the minimum range are
    dropped by the sensor (physical removal); a lost packet looks alike. So this is evidence of a worse view, whatever
    its cause.
    """
    image = return_image_of(monitored.leveled)
    return ABSTAINS if image is None else np.rad2deg(_core.measure_empty_runs(image.range_m, image.sector, SECTORS))


def measure_straight_edges(monitored: MonitoredSweep) -> F32:
    """Return the largest share of rings that jump at one column of each sector (SECTORS,); abstains without rings.

    What an attacker changes ends at the borders of its wedge, vertically and in all rings. Corners of buildings are
    vertical as well, but the rings below them meet the ground and go on.
    """
    image = return_image_of(monitored.leveled)
    return ABSTAINS if image is None else _core.measure_breaks(image.range_m, image.sector, SECTORS)
