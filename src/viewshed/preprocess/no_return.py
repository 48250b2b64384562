"""Beams without a return: which ones a sweep lacks, where they aimed, and how far each of them is likely to have gone.

The beams are the pixels of a range image, ring by azimuth column. A pixel without a return is missing, unless one
within four columns of its ring holds two: then the azimuth only jittered.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.height_map import Places, places_of
from viewshed.fov.visibility import Beams
from viewshed.preprocess import _no_return_kernels as hints
from viewshed.preprocess import range_image as kernels
from viewshed.preprocess.isolated_returns import Placed, placed, taken_out
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, range_limits
from viewshed.preprocess.ring_recovery import recover_rings

FILL_COLUMNS = 16
"""A gap is filled from returns in the same ring at most this many columns away."""

EXPECTED_SHARE = 0.9
"""Where a larger share of the ground gives returns, a beam without one did not meet the ground."""

STEEP = 4.0
"""Ground nearer than this many sensor heights (seen at 14° or more) is always expected to return."""

REACH_SHARE = 0.001
"""Beyond some range lies only this share of the returns: that far the sensor reaches in this air, ..."""

BEYOND_REACH = 2.0
"""... and so much farther a target would still be seen, for it faces the beams, which graze the ground."""

_SECTORS = 128

_RANGES_M = np.geomspace(1.0, 128.0, 113)

Floats = NDArray[np.float32]

Doubles = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    """Pixels (rings, columns) of a sweep.

    Attributes:
        guessed: the rings are no beams of a sensor, but bins of elevation.
        tangent: (rings,) tangent of each ring's elevation.
        rise_m: (rings,) height of each ring's beams above the sensor's origin at range 0.
        phase: (rings,) where in a column its firings lie, in columns.
        counts: returns in each pixel, up to 255.
        depth_m: horizontal range of the nearest one that the level sweep kept, +inf for none.
        obstacle_m: the same among those on obstacles.
        ground_tally: returns from ground in each sector and bin of range.
        meter_tally: returns in each meter of range.
        lone: (N,) the sweep's lone returns.
    """

    guessed: bool
    tangent: Doubles
    rise_m: Doubles
    phase: Floats
    counts: NDArray[np.uint8]
    depth_m: Floats
    obstacle_m: Floats
    ground_tally: NDArray[np.int64]
    meter_tally: NDArray[np.int64]
    isolated: NDArray[np.bool_]

    @property
    def columns(self) -> int:
        """Columns of a revolution."""
        return int(self.counts.shape[1])


def no_return_beams(leveled: LeveledSweep, *, fill: bool) -> Beams:
    """Return the beams that did not return, in the ``level`` frame.

    Without ``fill`` the depth is +inf; with it, that of the nearer of the two neighbors in the ring within 16 columns,
    and beams without such neighbors are left out.
    """
    image = _image(leveled, alone=True)
    pixels, ends_m, steps = kernels.find_no_return(image.counts, image.depth_m, False)
    azimuth, slope = _aims(leveled, image, pixels)
    if not fill:
        return Beams(azimuth, slope, np.full(len(pixels), np.inf, np.float32))
    depth_m = np.where(steps <= FILL_COLUMNS, ends_m, np.float32(np.inf)).min(axis=1, initial=np.float32(np.inf))
    keep = depth_m < np.inf
    return Beams(azimuth[keep], slope[keep], depth_m[keep])


def inferred_beams(leveled: LeveledSweep, top_m: float) -> Beams:
    """Return the beams without a return that their surroundings explain, and how far each went, in ``level``.

    1. A gap narrower than 1.5 m between two returns of like range, in a ring, or in a column between two returns from
       obstacles: as far as the nearer of the two.
    2. A beam that aims above the ground, or at ground from which few beams return (by range, learned from the sweep):
       as far as that ground, but no farther than an obstacle beside it in its ring or next above it, nor than a beam
       of the same gap stopped by rule 1 within 1.5 m, nor than twice as far as the sweep has returns.
    3. All others are left out: those at ground that should have returned, and beams above one of them (something that
       swallows light, glass, an attack); rings and columns without any return (dead, dropped).

    Lone returns count as none here, and what is learned is learned without them.
    Beams that pass above targets of height ``top_m`` wherever they stand are left out, too. A cloud without a ring
    column and without a model has none: nothing tells which beams it lacks.
    """
    image = _sensor_image(leveled)
    return _no_beams() if image is None else _split_beams(leveled, image, top_m)[0]


def measured_and_inferred_beams(leveled: LeveledSweep, top_m: float) -> Beams:
    """Return the beams of returns that are not lone and, as for missing ones, those that :func:`inferred_beams` has.

    A lone return is no evidence of a depth: its beam counts as one without a return.
    """
    told = beams_by_evidence(leveled, top_m)
    return told.measured + told.inferred if len(told.inferred.azimuth) else told.measured


@dataclass(frozen=True, slots=True, eq=False)
class BeamsByEvidence:
    """The beams of a sweep by what is known of them.

    Attributes:
        confirmed: of returns; those of lone ones point straight up and meet nothing.
        explained: without a return, as far as :func:`inferred_beams` tells.
        unexplained: all others that aim no higher than a target's top; +inf deep, since nothing tells where they ended.
    """

    measured: Beams
    inferred: Beams
    unresolved: Beams


def beams_by_evidence(leveled: LeveledSweep, top_m: float) -> BeamsByEvidence:
    """Return the beams of a sweep by what is known of them; ``top_m`` as in :func:`inferred_beams`."""
    image = _sensor_image(leveled)
    if image is None:
        return BeamsByEvidence(leveled.beams(), _no_beams(), _no_beams())
    return BeamsByEvidence(leveled.beams(image.isolated), *_split_beams(leveled, image, top_m))


def _no_beams() -> Beams:
    return Beams(*np.zeros((3, 0), np.float32))


def _sensor_image(leveled: LeveledSweep) -> _Image | None:
    """Return the range image without lone returns, or None where nothing tells which beams there are."""
    image = None if leveled.told.ring is None else _image(leveled, alone=False)
    return None if image is None or image.guessed else image


def _split_beams(leveled: LeveledSweep, image: _Image, top_m: float) -> tuple[Beams, Beams]:
    """Return the explained and the unexplained beams."""
    profile = _profile(leveled)
    highest = _highest(profile, top_m)
    rings = _rings_below(float(highest.max()), image, leveled.level_from_sensor.rotation)
    pixels, ends_m, steps = kernels.find_no_return(image.counts[:rings], image.depth_m, True)
    azimuth, slope = _aims(leveled, image, pixels)
    rise_m = image.rise_m[pixels[:, 0]].astype(np.float32)
    between_m, bound_m = _obstructions(image, pixels, ends_m, steps)
    told = between_m, bound_m, hints.meet(azimuth, slope, rise_m, profile, _RANGES_M)
    near_m = np.float32(STEEP * leveled.sensor_height_m)
    share = hints.shares(image.ground_tally, pixels, told, near_m, image.columns)
    limits = EXPECTED_SHARE, near_m, BEYOND_REACH * _reach_m(image.meter_tally)
    depth_m = hints.infer_depths(pixels, told, share, limits, image.counts)
    known, rest = hints.split_by_height((azimuth, slope, rise_m, depth_m), highest, near_m)
    return Beams(*known), Beams(*rest)


def _obstructions(
    image: _Image, pixels: NDArray[np.int32], ends_m: Floats, steps: NDArray[np.int32]
) -> tuple[Floats, Floats]:
    """Return where beams in narrow gaps ended (M,), NaN for others, and the nearest obstacle around each beam (M,)."""
    between_m = hints.narrow(ends_m, steps, image.columns)
    hints.enclose(pixels, image.obstacle_m, image.counts, image.tangent, between_m)
    bound_m = hints.bounds(pixels, image.obstacle_m)
    hints.spread(pixels, between_m, bound_m, image.columns)
    return between_m, bound_m


def _image(leveled: LeveledSweep, alone: bool) -> _Image:
    """Return the range image, lone returns in it or not: by the rings and the sensor if they fit, else recovered."""
    sweep, (ring, model), found = leveled.sweep, (leveled.told.ring, leveled.told.model), leveled.placed
    if found is not None and found.fits and ring is not None and model is not None:
        return _filled(leveled, ring, _thinned(ring, found, alone), (False, model.elevation, model.origin_m))
    beams = recover_rings(sweep, model)
    known = None if found is None else found.clutter
    found = placed(sweep.points, beams.ring, (beams.rings, beams.columns), range_limits(sweep))
    found = found if known is None else taken_out(found, beams.ring, known)
    lines = beams.source == "elevation bins", beams.elevation, np.zeros(beams.rings)
    return _filled(leveled, beams.ring, _thinned(beams.ring, found, alone), lines)


def _thinned(ring: NDArray[np.int16], found: Placed, alone: bool) -> Placed:
    """Return the places without those of lone returns, unless these stay (``alone``)."""
    return found if alone else taken_out(found, ring, found.isolated)


def _filled(
    leveled: LeveledSweep,
    ring: NDArray[np.int16],
    found: Placed,
    lines: tuple[bool, NDArray[np.float64], NDArray[np.float64]],
) -> _Image:
    """Return the range image of returns that have a ring and a column."""
    images = [np.full(found.counts.shape, np.inf, np.float32) for _ in range(2)]
    tallies = np.zeros((kernels.SHARE_SECTORS, kernels.SHARE_BINS), np.int64), np.zeros(512, np.int64)
    limits = np.float32(OBSTACLE_HEIGHTS_M[0]), np.float32(STEEP * leveled.sensor_height_m)
    pixel, returns = (ring, found.column), (leveled.rows, leveled.range_m, leveled.height_m)
    kernels.put(pixel, returns, limits, (images[0], images[1]), tallies)
    guessed, elevation, rise_m = lines
    return _Image(
        guessed, np.tan(elevation), rise_m, found.phase, found.counts, images[0], images[1], *tallies, found.isolated
    )


def _aims(leveled: LeveledSweep, image: _Image, pixels: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Return azimuth (M,) and slope (M,) of beams in ``level``, seen from the sensor."""
    rotation = leveled.level_from_sensor.rotation
    azimuth, slope = kernels.aim(pixels, image.tangent, image.phase, rotation, image.columns)
    return azimuth, slope


def _profile(leveled: LeveledSweep) -> Floats:
    """Return the slope from the sensor to the ground (sectors, ranges)."""
    ground = leveled.ground
    places = _places(ground.half_extent_m, len(ground.heights_m))
    slope = (ground.on(places) - np.float32(leveled.sensor_height_m)) / _RANGES_M.astype(np.float32)
    return slope.astype(np.float32, copy=False)


def _highest(profile: Floats, top_m: float) -> Floats:
    """Return the steepest slope (sectors,) from the sensor to the top of a target, wherever it stands."""
    highest: Floats = (profile + (top_m / _RANGES_M).astype(np.float32)).max(axis=1)
    return highest


def _rings_below(slope: float, image: _Image, rotation: Doubles) -> int:
    """Return how many rings, from the lowest and at least one, may have a beam below ``slope`` in ``level``."""
    tilt = np.arccos(np.clip(rotation[2, 2], -1.0, 1.0))
    below = np.flatnonzero(np.arctan(image.tangent) - tilt <= np.arctan(slope))
    return int(below[-1]) + 1 if below.size else 1


@lru_cache(maxsize=8)
def _places(half_extent_m: float, nodes: int) -> Places:
    """Return where the ground is looked up (sectors, ranges)."""
    azimuth = (np.arange(_SECTORS) + 0.5) * (2 * np.pi / _SECTORS) - np.pi
    xy = np.stack([np.outer(np.cos(azimuth), _RANGES_M), np.outer(np.sin(azimuth), _RANGES_M)], -1)
    return places_of(xy, half_extent_m, nodes)


def _reach_m(meter_tally: NDArray[np.int64]) -> float:
    """Return the range beyond which lies ``REACH_SHARE`` of the returns."""
    beyond = np.cumsum(meter_tally[::-1])[::-1]
    return float(np.count_nonzero(beyond > REACH_SHARE * beyond[0]))
