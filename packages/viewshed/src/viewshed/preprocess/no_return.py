"""Beams without a return: which ones a sweep lacks, where they aimed, and how far each of them is likely to have gone.

The beams are the pixels of a range image, ring by azimuth column. A pixel without a return is a no-return beam, unless
one within four columns of its ring holds two: then the azimuth only jittered.
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
"""A point may lie this many columns from the firing that it belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamsByEvidence:
    """The beams of a sweep by what is known of their depth.

    Attributes:
        measured: beams of returns; those of isolated ones point straight up and meet nothing.
        inferred: without a return, as deep as they went with a probability of .5; at most 1.5 times the range beyond
            which one return in a thousand lies, since the sweep does not show that its sensor sees farther.
        early: the same, as deep as they went with a probability of .8.
        late: the same, as deep as they went with a probability of .2.
    """

    measured: Beams
    inferred: Beams
    early: Beams
    late: Beams


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
    """Split the beams of a sweep, in ``level``, into those with a return and those without; guess how far these went.

    An isolated return is no evidence of a depth: its beam counts as one without a return.

    A beam without a return ended at the return beside it in its ring, at the next one below or above it, at the ground,
    at the middle range around it, at the farthest return of its azimuth, at something unseen, or nothing stopped it. A
    small network (:mod:`viewshed_lab.training.no_return` fits it to exact ends of simulated beams) says how likely
    each is, from what returned around the beam at several scales, and from the share of the ground that returns. Fail
    safe: a beam at ground that returns elsewhere, and those above it, hardly went on, whatever the network says.

    Beams that pass above targets of height ``top_m`` wherever they stand are left out. Rings and columns without any
    return (dead, dropped) have no beams. Of a cloud without a ring column and without a model it is not known which
    beams it lacks: it has measured ones alone. So has a sweep whose height is not given and rests on hardly any ground:
    the guesses need that ground. A scan in one plane says itself which beams met nothing, and how far they went.
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
    """What the network is fed with: G groups of neighboring beams without a return.

    Attributes:
        azimuth: (G,) float32 of the middle beam in ``level``.
        slope: (G,) float32 of it.
        beams: (G,) int32 beams of the group that may meet a target.
        feature: (G, F) float32.
        stop: (G, S) float32 logarithms (base 2) of the ranges in meters at which they may have ended; 8 for none.
    """

    azimuth: F32
    slope: F32
    beams: NDArray[np.int32]
    feature: F32
    stop: F32


def no_return_groups(leveled: LeveledSweep, top_m: float) -> NoReturnGroups | None:
    """Return what the network is fed with of a sweep; None where it is not known which beams the sweep lacks."""
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
    # A table that does not explain the rings is none of them.
    told = sweep if sensor_id.model is not None else sweep.replace(model=None)
    rings = recover_rings(told, sensor_id.model, sensor_id.ring)
    return range_image_by_rings(sweep.points, rings, range_limits(sweep))


def _pixels(leveled: LeveledSweep) -> RangeImage | None:
    """Return the range image of a sweep, None where its pixels are no beams."""
    image = None if leveled.sensor_id.ring is None else _image_of_beams(leveled)
    return image if image is not None and image.pixels_are_beams else None


def _clutter(leveled: LeveledSweep) -> NDArray[np.bool_] | None:
    """Return the clutter (N,) that the leveled sweep lacks, None where there is none."""
    return None if leveled.range_image is None else leveled.range_image.clutter
