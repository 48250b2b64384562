"""What about a sweep cannot well be as it was read: units, height, sensor, origin. One sentence each, for a person."""

from __future__ import annotations

import numpy as np

from viewshed.grid import GRIDS
from viewshed.preprocess.beam_matching import match_beams, polar
from viewshed.preprocess.elevation_clusters import find_clusters
from viewshed.preprocess.leveling import EGO_BOX_M, LeveledSweep, level, range_limits
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

PLAUSIBLE_HEIGHTS_M = (0.1, 10.0)
"""Heights at which robots, cars and masts carry sensors."""

_MILLIMETERS_M, _KILOMETERS_M = 500.0, 0.5
"""Half of the returns of a file in meters are nearer than the one, and some are farther than the other."""

_FEWEST, _MANY = 100, 10_000

_TURNED_SUPPORT = 0.6
"""Of 66 real sweeps, 58 have ground with more support than this, and none has it upside down."""

_MOST_TILT_DEG = 6.0
"""A 2-D laser on a robot that drives up a ramp is tilted by less."""


_NO_MATCH = 0.15
"""A named sensor whose beams explain less of the returns than this is another one, ..."""

_MATCH = 0.6
"""... and one that explains less than this share of what the elevations at which the returns gather explain."""

_MOST_OUTSIDE, _FIELD_SLACK = 0.05, np.deg2rad(3.0)
"""More returns so far above or below the field of a sensor without rings are another sensor's."""

_BELOW_M, _BELOW_SHARE = 0.1, 0.01
"""Of a sensor above the ground more than this share of the points lie lower than this below it."""

_LOW_M = 0.6
"""Sensors that seem to stand lower than this, and whose returns gather at no beams, may not be at the origin."""


def check_units(sweep: Sweep) -> None:
    """Check that a sweep can be in meters and in the sensor's frame.

    Raises:
        ValueError: it cannot; nothing that is estimated from it would mean anything.

    >>> check_units(Sweep(np.zeros((500, 3))))
    Traceback (most recent call last):
    ValueError: nearly all points lie at the origin: are they returns at all?
    """
    problem = _problem_of_units(sweep) if len(sweep) >= _FEWEST else ""
    if problem:
        raise ValueError(problem)


def doubts(leveled: LeveledSweep) -> tuple[str, ...]:
    """Return what a reader should doubt about a sweep, a sentence each; none for most.

    >>> from viewshed import BevGrid, Sweep
    >>> from viewshed.preprocess.leveling import level
    >>> doubts(level(Sweep(np.full((5, 3), 4.0)), BevGrid(64, 32.0)))
    ()
    """
    sweep = leveled.sweep
    if len(sweep) < _FEWEST:
        return ()
    units = _problem_of_units(sweep)
    if units:
        return (units,)
    if sweep.planar is not None:
        tilt = _doubt_of_plane(leveled)
        return (tilt,) if tilt else ()
    upside_down = _doubt_of_axes(leveled)
    if upside_down:
        return (upside_down,)
    found = (_doubt_of_height(leveled), _doubt_of_sensor(sweep), _doubt_of_origin(leveled))
    # What lies wrong by its origin or sensor shows no beams either.
    return tuple(doubt for doubt in found if doubt) or _doubt_of_beams(leveled)


def _problem_of_units(sweep: Sweep) -> str:
    some = sweep.points[:: max(len(sweep) // 4096, 1)].astype(np.float64)
    half_m, most_m = np.quantile(np.linalg.norm(some, axis=1), (0.5, 0.99))
    if half_m > _MILLIMETERS_M:
        middle_m = np.median(some, axis=0)
        if np.median(np.linalg.norm(some - middle_m, axis=1)) < _MILLIMETERS_M:
            where = ", ".join(f"{value:.0f}" for value in middle_m)
            return (
                f"the points lie around ({where}) m: are they in a map's coordinates? Subtract the sensor's position"
                " before they are written, or say with --origin X,Y,Z where it is"
            )
        return (
            f"half of the points are farther than {half_m:.0f} m: is the file in millimeters or centimeters? Convert it"
            " to meters"
        )
    if most_m == 0.0:
        return "nearly all points lie at the origin: are they returns at all?"
    if most_m < _KILOMETERS_M:
        return f"nearly all points are nearer than {most_m:.3f} m: is the file in kilometers? Convert it to meters"
    return ""


def _doubt_of_plane(leveled: LeveledSweep) -> str:
    """Return a sentence where the plane of a 2-D laser is far from level: its scans belong to different heights."""
    tilt_deg = float(np.rad2deg(np.arccos(min(leveled.level_from_sensor.rotation[2, 2], 1.0))))
    if tilt_deg <= _MOST_TILT_DEG:
        return ""
    return (
        f"the plane of this 2-D laser is tilted by {tilt_deg:.0f}°, so its view is that of a slanted plane; if it tilts"
        " to and fro, put the scans of one sweep together in a cloud first"
    )


def _doubt_of_axes(leveled: LeveledSweep) -> str:
    """Return a sentence where ground is found once the sweep is turned upside down, and hardly any as it is."""
    if leveled.is_sure_of_height:
        return ""
    turned = level(Sweep(leveled.sweep.points * np.array([1, -1, -1], np.float32)), GRIDS["road"])
    if turned.ground.support < _TURNED_SUPPORT:
        return ""
    return (
        f"the ground seems to lie {turned.sensor_height_m:.1f} m above the sensor: does z point down? Leave"
        " --file-frame out if it is given, else try --file-frame carla"
    )


def _doubt_of_height(leveled: LeveledSweep) -> str:
    height_m, given = leveled.sensor_height_m, leveled.sweep.sensor_height_m is not None
    low_m, high_m = PLAUSIBLE_HEIGHTS_M
    support = leveled.ground.support
    if support > 0 and not leveled.is_sure_of_height:
        return (
            f"the sensor's height of {height_m:.2f} m rests on a plane that only {support:.0%} of the near ground lies"
            " on: give --height if it is known"
        )
    if not given and support == 0:
        if len(leveled.points) == 0:
            return _doubt_of_box(leveled)
        if _lies_on_the_ground(leveled.sweep):
            return ""
        return (
            f"no ground is seen, and the sensor is taken to be {height_m:.2f} m above it: give --height if it is known"
        )
    if low_m <= height_m <= high_m:
        return ""
    found = "is given as" if given else "comes out as"
    return f"the sensor's height {found} {height_m:.2f} m, outside of {low_m:g} to {high_m:g} m: check --height"


def _doubt_of_box(leveled: LeveledSweep) -> str:
    """Return a sentence where the vehicle that is assumed below the sensor swallows all returns."""
    length_m, width_m = EGO_BOX_M
    near_m, _ = range_limits(leveled.sweep)
    x, y, _ = np.abs(leveled.sweep.points[np.linalg.norm(leveled.sweep.points, axis=1) >= near_m]).T
    if len(x) == 0 or np.hypot(x, y).max() > np.hypot(length_m, width_m):
        return ""
    return (
        f"all {len(x)} returns lie within {length_m:g} m ahead or behind and {width_m:g} m aside, where a sensor that"
        f" is taken to be {leveled.sensor_height_m:.2f} m high sees its own vehicle: give --height if it is lower"
    )


def _doubt_of_sensor(sweep: Sweep) -> str:
    if sweep.model is None:
        return ""
    if not sweep.model.fires_rings:
        return _doubt_of_field(sweep, sweep.model)
    azimuth, slope, range_m = polar(sweep.points)
    share = match_beams(slope, range_m, sweep.model).excess
    # Where elevations gather, a sensor's own beams explain about as much as they do; else it may have moved.
    clusters = find_clusters(azimuth, slope, range_m)
    if share >= (_NO_MATCH if clusters is None else _MATCH * clusters.sharpness):
        return ""
    return f"the returns do not lie at the beams of {sweep.model.name}: name another --sensor, or none"


def _doubt_of_field(sweep: Sweep, model: LidarModel) -> str:
    """Return a sentence where many returns lie above or below a sensor's field of view."""
    _, slope, _ = polar(sweep.points)
    low, high = model.elevation[[0, -1]]
    outside = float(np.mean((np.arctan(slope) < low - _FIELD_SLACK) | (np.arctan(slope) > high + _FIELD_SLACK)))
    if outside <= _MOST_OUTSIDE:
        return ""
    field = f"{model.name}, {np.rad2deg(low):.0f}° to {np.rad2deg(high):.0f}°"
    return f"{outside:.0%} of the returns lie outside of the field of {field}: name another --sensor, or none"


def _doubt_of_beams(leveled: LeveledSweep) -> tuple[str, ...]:
    """Return a sentence where many points show no rings: then beams without a return are not known."""
    sweep = leveled.sweep
    if sweep.model is not None or leveled.sensor_id.ring is not None or len(sweep) < _MANY:
        return ()
    return (
        f"no beams can be told apart among {len(sweep)} points, so those without a return are not known and far ground"
        " may be missed: name --sensor if it is known; of several sensors in one cloud give each by itself, with"
        " --together",
    )


def _lies_on_the_ground(sweep: Sweep) -> bool:
    """Whether no more than a few points lie below the origin."""
    return bool(np.quantile(sweep.points[:, 2], _BELOW_SHARE) > -_BELOW_M)


def _doubt_of_origin(leveled: LeveledSweep) -> str:
    sweep = leveled.sweep
    if sweep.sensor_height_m is None and leveled.ground.support == 0 and _lies_on_the_ground(sweep):
        return (
            "no point lies below the origin: are the points counted from the road? Say with --origin X,Y,Z where the"
            " sensor is"
        )
    if sweep.sensor_height_m is not None or leveled.sensor_height_m > _LOW_M or leveled.sensor_id.model is not None:
        return ""
    # A low robot's returns gather at its beams; points counted from the axle or the road gather nowhere.
    if find_clusters(*polar(sweep.points)) is not None:
        return ""
    return (
        f"the origin seems to lie {leveled.sensor_height_m:.2f} m above the ground, and the returns gather at no beams"
        " around it: are the points counted from the axle or the road? Say with --origin X,Y,Z where the sensor is"
    )
