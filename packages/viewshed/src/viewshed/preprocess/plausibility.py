"""Plausibility checks of a sweep: units, height, sensor, origin; each gives one sentence for the user."""

from __future__ import annotations

import numpy as np

from viewshed.grid import GRIDS
from viewshed.preprocess.beam_matching import match_beams, polar
from viewshed.preprocess.elevation_clusters import find_clusters
from viewshed.preprocess.leveling import EGO_BOX_M, LeveledSweep, level, range_limits
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

PLAUSIBLE_HEIGHTS_M = (0.1, 10.0)
"""Plausible heights of sensors on robots, cars and masts."""

_MAX_MEDIAN_M, _MIN_FAR_M = 500.0, 0.5
"""Maximum median range and minimum 99 % quantile of the ranges of a file in meters."""

_MIN_POINTS, _MANY_POINTS = 100, 10_000

_TURNED_SUPPORT = 0.6
"""Minimum ground support to detect an upside-down sweep; 58 of 66 real sweeps exceed it, none of them upside down."""

_MAX_TILT_DEG = 6.0
"""Maximum tilt of a 2-D laser; a robot on a ramp is tilted less."""


_MIN_MATCH = 0.15
"""Minimum share of returns that match the named sensor's beams, if the elevations form no clusters."""

_MIN_MATCH_RATIO = 0.6
"""Minimum ratio of the share that matches the named sensor's beams to the share in elevation clusters."""

_MAX_OUTSIDE, _FIELD_TOLERANCE = 0.05, np.deg2rad(3.0)
"""Maximum share of returns outside the field of view of a sensor without rings, and the tolerance of the field."""

_BELOW_M, _BELOW_SHARE = 0.1, 0.01
"""At a sensor above the ground, more than ``_BELOW_SHARE`` of the points lie ``_BELOW_M`` or more below it."""

_LOW_M = 0.6
"""Sensors estimated below this height, whose returns match no beams, may not be at the origin."""


def check_units(sweep: Sweep) -> None:
    """Check that a sweep is plausibly in meters and in the sensor's frame.

    Raises:
        ValueError: it is not; estimates from it would be meaningless.

    >>> check_units(Sweep(np.zeros((500, 3))))
    Traceback (most recent call last):
    ValueError: nearly all points lie at the origin: are they returns at all?
    """
    problem = _problem_of_units(sweep) if len(sweep) >= _MIN_POINTS else ""
    if problem:
        raise ValueError(problem)


def doubts(leveled: LeveledSweep) -> tuple[str, ...]:
    """Return warnings about implausible properties of a sweep, one sentence each; usually none.

    >>> from viewshed import BevGrid, Sweep
    >>> from viewshed.preprocess.leveling import level
    >>> doubts(level(Sweep(np.full((5, 3), 4.0)), BevGrid(64, 32.0)))
    ()
    """
    sweep = leveled.sweep
    if len(sweep) < _MIN_POINTS:
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
    warnings = (_doubt_of_height(leveled), _doubt_of_sensor(sweep), _doubt_of_origin(leveled))
    # A wrong origin or sensor also explains missing rings, so check these last.
    return tuple(warning for warning in warnings if warning) or _doubt_of_beams(leveled)


def _problem_of_units(sweep: Sweep) -> str:
    sample = sweep.points[:: max(len(sweep) // 4096, 1)].astype(np.float64)
    median_m, far_m = np.quantile(np.linalg.norm(sample, axis=1), (0.5, 0.99))
    if median_m > _MAX_MEDIAN_M:
        center_m = np.median(sample, axis=0)
        if np.median(np.linalg.norm(sample - center_m, axis=1)) < _MAX_MEDIAN_M:
            center = ", ".join(f"{value:.0f}" for value in center_m)
            return (
                f"the points lie around ({center}) m: are they in a map's coordinates? Subtract the sensor's"
                " position before you save them, or give it with --origin X,Y,Z"
            )
        return (
            f"half of the points are farther than {median_m:.0f} m: is the file in millimeters or centimeters? Convert"
            " it to meters"
        )
    if far_m == 0.0:
        return "nearly all points lie at the origin: are they returns at all?"
    if far_m < _MIN_FAR_M:
        return f"nearly all points are nearer than {far_m:.3f} m: is the file in kilometers? Convert it to meters"
    return ""


def _doubt_of_plane(leveled: LeveledSweep) -> str:
    """Return a warning if the plane of a 2-D laser is far from level."""
    tilt_deg = float(np.rad2deg(np.arccos(min(leveled.level_from_sensor.rotation[2, 2], 1.0))))
    if tilt_deg <= _MAX_TILT_DEG:
        return ""
    return (
        f"the plane of this 2-D laser is tilted by {tilt_deg:.0f}°, so its view is that of a slanted plane; if it"
        " nods, combine the scans of one sweep into a cloud first"
    )


def _doubt_of_axes(leveled: LeveledSweep) -> str:
    """Return a warning if the sweep has clear ground only when turned upside down."""
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
    verb = "is given as" if given else "comes out as"
    return f"the sensor's height {verb} {height_m:.2f} m, outside of {low_m:g} to {high_m:g} m: check --height"


def _doubt_of_box(leveled: LeveledSweep) -> str:
    """Return a warning if all returns lie in the box of the vehicle that is assumed below the sensor."""
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
    # The right beams match about as many returns as the elevation clusters; without clusters (a moving sensor) fewer.
    clusters = find_clusters(azimuth, slope, range_m)
    if share >= (_MIN_MATCH if clusters is None else _MIN_MATCH_RATIO * clusters.sharpness):
        return ""
    return f"the returns do not lie at the beams of {sweep.model.name}: name another --sensor, or none"


def _doubt_of_field(sweep: Sweep, model: LidarModel) -> str:
    """Return a warning if many returns lie above or below the sensor's field of view."""
    _, slope, _ = polar(sweep.points)
    low, high = model.elevation[[0, -1]]
    elevation = np.arctan(slope)
    outside = float(np.mean((elevation < low - _FIELD_TOLERANCE) | (elevation > high + _FIELD_TOLERANCE)))
    if outside <= _MAX_OUTSIDE:
        return ""
    field = f"{model.name}, {np.rad2deg(low):.0f}° to {np.rad2deg(high):.0f}°"
    return f"{outside:.0%} of the returns lie outside of the field of {field}: name another --sensor, or none"


def _doubt_of_beams(leveled: LeveledSweep) -> tuple[str, ...]:
    """Return a warning if a large cloud shows no rings, so that its no-return beams are unknown."""
    sweep = leveled.sweep
    if sweep.model is not None or leveled.sensor_id.ring is not None or len(sweep) < _MANY_POINTS:
        return ()
    return (
        f"the beams of the {len(sweep)} points cannot be identified, so beams without a return are not known and far"
        " ground may be missed: give --sensor if it is known; if the cloud merges several sensors, give one file for"
        " each, with --together",
    )


def _lies_on_the_ground(sweep: Sweep) -> bool:
    """Return whether hardly any points lie below the origin."""
    return bool(np.quantile(sweep.points[:, 2], _BELOW_SHARE) > -_BELOW_M)


def _doubt_of_origin(leveled: LeveledSweep) -> str:
    sweep = leveled.sweep
    if sweep.sensor_height_m is None and leveled.ground.support == 0 and _lies_on_the_ground(sweep):
        return (
            "no point lies below the origin: are the points relative to the road? Give the sensor's position with"
            " --origin X,Y,Z"
        )
    if sweep.sensor_height_m is not None or leveled.sensor_height_m > _LOW_M or leveled.sensor_id.model is not None:
        return ""
    # Returns of a low robot form elevation clusters; points relative to the axle or the road do not.
    if find_clusters(*polar(sweep.points)) is not None:
        return ""
    return (
        f"the origin seems to lie {leveled.sensor_height_m:.2f} m above the ground, and the returns do not lie on"
        " beams around it: are the points relative to the axle or the road? Give the sensor's position with --origin"
        " X,Y,Z"
    )
