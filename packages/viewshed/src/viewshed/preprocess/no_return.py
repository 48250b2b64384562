"""No-return beams: which beams of a sweep have no return, their direction, and their likely depth.

The beams are the pixels of a range image, ring by azimuth column. A pixel without a return is a no-return beam, unless
a pixel of its ring within four columns has two returns: that is jitter of the azimuth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.visibility import Beams
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, range_limits
from viewshed.preprocess.range_image import RangeImage, range_image_by_rings
from viewshed.preprocess.ring_recovery import recover_rings
from viewshed.sweep import PlanarScan

JITTER_COLUMNS = _core.JITTER_COLUMNS
"""Maximum distance in columns between a return and the firing that it belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamsByEvidence:
    """The beams of a sweep, with measured and with inferred depth.

    Attributes:
        measured: beams with a return; those of isolated returns point straight up and hit nothing.
        inferred: no-return beams at the depth that they reached with probability .5. It is at most 1.5 times the range
            beyond which one return in a thousand lies, because nothing shows that the sensor sees farther.
        early: no-return beams at the depth that they reached with probability .8.
        late: no-return beams at the depth that they reached with probability .2.
    """

    measured: Beams
    inferred: Beams
    early: Beams
    late: Beams


def no_return_beams(leveled: LeveledSweep, *, fill: bool) -> Beams:
    """Return the no-return beams in the ``level`` frame.

    Without ``fill`` their depth is +inf. With it, the depth is that of the nearer of the two neighbors in the ring
    within 16 columns; beams without such neighbors are left out.
    """
    if leveled.sweep.planar is not None:
        return _open_beams(leveled, leveled.sweep.planar)
    # Here isolated returns count as returns, clutter does not.
    image = _image_of_beams(leveled)
    return Beams(
        *_core.no_return_beams(
            image.ring, image.column, image.counts, _clutter(leveled), image.phase, image.elevation, image.origin_m,
            leveled.level_from_sensor.rotation, leveled.range_m, leveled.height_m, leveled.rows, fill,
        )
    )  # fmt: skip


def beams_by_evidence(leveled: LeveledSweep, top_m: float) -> BeamsByEvidence:
    """Split the beams of a sweep, in ``level``, into those with a return and those without; infer the depth of these.

    An isolated return is no evidence of a depth: its beam counts as a no-return beam.

    A no-return beam may have ended at the depth of the return beside it in its ring, of the next one below or above it,
    of the ground, of the median range around it, of the farthest return of its azimuth, at something unseen, or
    nowhere. A small network (fitted by :mod:`viewshed_lab.training.no_return` to exact depths of simulated beams) gives
    the probability of each, from the returns around the beam at several scales and from the share of the ground that
    returns. Fail-safe: if ground returns elsewhere, a beam aimed at ground and those above it are hardly extended,
    whatever the output of the network.

    Beams that stay above targets of height ``top_m`` are left out. Rings and columns without any return (dead, dropped)
    have no beams. There are only measured beams if the no-return beams are unknown (no ring column and no sensor), or
    if the sensor's height is not given and poorly supported, because the inference needs the ground. A planar scan
    states its no-return beams and their depth.
    """
    none = Beams(*np.zeros((3, 0), np.float32))
    if leveled.sweep.planar is not None:
        open_beams = _open_beams(leveled, leveled.sweep.planar)
        return BeamsByEvidence(leveled.beams(), open_beams, open_beams, open_beams)
    image = _pixels(leveled) if leveled.is_sure_of_height else None
    if image is None:
        return BeamsByEvidence(leveled.beams(), none, none, none)
    ground = leveled.ground
    slope, azimuth, slopes, early_m, depth_m, late_m = _core.beams_by_evidence(
        image.ring, image.column, image.counts, image.isolated, _clutter(leveled), image.phase, image.elevation,
        image.origin_m, leveled.level_from_sensor.rotation, leveled.points, leveled.range_m, leveled.height_m,
        leveled.rows, leveled.sensor_height_m, ground.heights_m, ground.half_extent_m, top_m, OBSTACLE_HEIGHTS_M[0],
    )  # fmt: skip
    measured = Beams(leveled.azimuth, slope, leveled.range_m)
    return BeamsByEvidence(measured, *(Beams(azimuth, slopes, end_m) for end_m in (depth_m, early_m, late_m)))


@dataclass(frozen=True, slots=True, eq=False)
class NoReturnGroups:
    """Input of the network: G groups of neighboring no-return beams.

    Attributes:
        azimuth: (G,) float32 azimuth of the group's middle beam in ``level``.
        slope: (G,) float32 slope of the middle beam.
        beams: (G,) int32 number of beams of the group that may hit a target.
        feature: (G, F) float32 features.
        stop: (G, S) float32 base-2 logarithms of the candidate depths in meters; 8 for none.
    """

    azimuth: F32
    slope: F32
    beams: NDArray[np.int32]
    feature: F32
    stop: F32


def no_return_groups(leveled: LeveledSweep, top_m: float) -> NoReturnGroups | None:
    """Return the input of the network for a sweep; None if its no-return beams are unknown."""
    image, ground = _pixels(leveled), leveled.ground
    if image is None:
        return None
    return NoReturnGroups(
        *_core.no_return_groups(
            image.ring, image.column, image.counts, image.isolated, _clutter(leveled), image.phase, image.elevation,
            image.origin_m, leveled.level_from_sensor.rotation, leveled.range_m, leveled.height_m, leveled.rows,
            leveled.sensor_height_m, ground.heights_m, ground.half_extent_m, top_m, OBSTACLE_HEIGHTS_M[0],
        )
    )  # fmt: skip


def _open_beams(leveled: LeveledSweep, planar: PlanarScan) -> Beams:
    """Return the no-return beams of a planar scan, with the sensor's maximum range as depth."""
    azimuth = planar.open_azimuth.astype(np.float64)
    directions = np.column_stack((np.cos(azimuth), np.sin(azimuth))) @ leveled.level_from_sensor.rotation[:, :2].T
    x, y, z = directions.astype(np.float32).T
    run = np.maximum(np.hypot(x, y), np.float32(1e-6))
    return Beams(np.arctan2(y, x), z / run, np.full(len(azimuth), planar.max_range_m, np.float32))


def _image_of_beams(leveled: LeveledSweep) -> RangeImage:
    """Return the sweep's range image if its pixels are beams, else one by its rings and measured columns."""
    image = leveled.range_image
    if image is not None and image.pixels_are_beams:
        return image
    sweep, sensor_id = leveled.sweep, leveled.sensor_id
    # Ignore the sweep's own beam table if it does not match the rings.
    matching = sweep if sensor_id.model is not None else sweep.replace(model=None)
    rings = recover_rings(matching, sensor_id.model, sensor_id.ring)
    return range_image_by_rings(sweep.points, rings, range_limits(sweep))


def _pixels(leveled: LeveledSweep) -> RangeImage | None:
    """Return the range image of a sweep, None if its pixels are not beams."""
    image = None if leveled.sensor_id.ring is None else _image_of_beams(leveled)
    return image if image is not None and image.pixels_are_beams else None


def _clutter(leveled: LeveledSweep) -> NDArray[np.bool_] | None:
    """Return the mask (N,) of clutter, which leveling dropped; None if there is none."""
    return None if leveled.range_image is None else leveled.range_image.clutter
