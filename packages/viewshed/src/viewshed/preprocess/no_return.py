"""Beams without a return: which ones a sweep lacks, where they aimed, and how far each of them is likely to have gone.

The beams are the pixels of a range image, ring by azimuth column. A pixel without a return is a no-return beam, unless
one within four columns of its ring holds two: then the azimuth only jittered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.fov.visibility import Beams
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, range_limits
from viewshed.preprocess.range_image import RangeImage, range_image_by_rings
from viewshed.preprocess.ring_recovery import recover_rings
from viewshed.sweep import PlanarScan

JITTER_COLUMNS = _core.JITTER_COLUMNS
"""A point may lie this many columns from the firing that it belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamsByEvidence:
    """The beams of a sweep by what is known of their depth.

    Attributes:
        measured: beams of returns; those of isolated ones point straight up and meet nothing.
        inferred: without a return, as deep as :func:`beams_by_evidence` infers.
        unresolved: all others that aim no higher than a target's top; +inf deep, since where they ended is not known.
    """

    measured: Beams
    inferred: Beams
    unresolved: Beams


def no_return_beams(leveled: LeveledSweep, *, fill: bool) -> Beams:
    """Return the beams that did not return, in the ``level`` frame.

    Without ``fill`` the depth is +inf; with it, that of the nearer of the two neighbors in the ring within 16 columns,
    and beams without such neighbors are left out.
    """
    if leveled.sweep.planar is not None:
        return _open_beams(leveled, leveled.sweep.planar)
    # Isolated returns are returns here; clutter is not.
    image = _image_of_beams(leveled)
    return Beams(
        *_core.no_return_beams(
            image.ring, image.column, image.counts, _clutter(leveled), image.phase, image.elevation, image.origin_m,
            leveled.level_from_sensor.rotation, leveled.range_m, leveled.height_m, leveled.rows, fill,
        )
    )  # fmt: skip


def beams_by_evidence(leveled: LeveledSweep, top_m: float) -> BeamsByEvidence:
    """Split the beams of a sweep, in ``level``, into measured, inferred and unresolved depth.

    An isolated return is no evidence of a depth: its beam counts as one without a return, and what is learned is
    learned without it. A beam without a return is inferred from its surroundings:

    1. A gap narrower than 1.5 m between two returns of similar range, in a ring, or in a column between two returns
       from obstacles: as far as the nearer of the two.
    2. A beam that aims above the ground, or at ground from which few beams return (by range, learned from the sweep):
       as far as that ground, but no farther than an obstacle beside it in its ring or next above it, nor than a beam
       of the same gap stopped by rule 1 within 1.5 m, nor than twice as far as the sweep has returns (in fog the last
       returns are of grazed ground; a target faces the beams and is seen from twice as far).
    3. All others are unresolved: those at ground that should have returned, and beams above one of them (something
       that swallows light, glass, an attack). Rings and columns without any return (dead, dropped) have no beams.

    Beams that pass above targets of height ``top_m`` wherever they stand are left out. Of a cloud without a ring column
    and without a model it is not known which beams it lacks: it has measured ones alone. A scan in one plane says
    itself which beams met nothing, and how far they went.
    """
    none = Beams(*np.zeros((3, 0), np.float32))
    if leveled.sweep.planar is not None:
        return BeamsByEvidence(leveled.beams(), _open_beams(leveled, leveled.sweep.planar), none)
    image = None if leveled.sensor_id.ring is None else _image_of_beams(leveled)
    if image is None or not image.pixels_are_beams:
        return BeamsByEvidence(leveled.beams(), none, none)
    ground = leveled.ground
    slope, inferred, unresolved = _core.beams_by_evidence(
        image.ring, image.column, image.counts, image.isolated, _clutter(leveled), image.phase, image.elevation,
        image.origin_m, leveled.level_from_sensor.rotation, leveled.points, leveled.range_m, leveled.height_m,
        leveled.rows, leveled.sensor_height_m, ground.heights_m, ground.half_extent_m, top_m, OBSTACLE_HEIGHTS_M[0],
    )  # fmt: skip
    return BeamsByEvidence(Beams(leveled.azimuth, slope, leveled.range_m), Beams(*inferred), Beams(*unresolved))


def _open_beams(leveled: LeveledSweep, planar: PlanarScan) -> Beams:
    """Return the beams of a scan in one plane that met nothing, as deep as the sensor measures."""
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
    rings = recover_rings(sweep, sensor_id.model, sensor_id.ring)
    return range_image_by_rings(sweep.points, rings, range_limits(sweep))


def _clutter(leveled: LeveledSweep) -> NDArray[np.bool_] | None:
    """Return the clutter (N,) that the leveled sweep lacks, None where there is none."""
    return None if leveled.range_image is None else leveled.range_image.clutter
