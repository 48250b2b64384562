"""How a sensor moved about a sweep, by the poses next to it in time; which sweeps of a drive stand for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid

MAX_GAP_S = 1.5
"""Poses farther apart than this say nothing about the motion in between."""

MAX_SPEED_MPS = 70.0
"""Poses that could only be reached faster do not belong together."""

POST_S = 2.0
"""Most time between sweeps that stand for all."""

_SHORT_S = 0.15
"""Uncertainty of times when speeds are judged."""


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """How a sensor moves about its reference pose, in the axes of its ``level`` frame."""

    velocity_mps: NDArray[np.float64]  # (3,) float64
    yaw_rate: float  # radians a second, counter-clockwise from above


@dataclass(frozen=True, slots=True, eq=False)
class StampedPose:
    """Where a sensor was, and when."""

    world_from_sensor: Rigid | None  # its pose, or None
    t_ns: int | None  # its time, or None

    def seconds_to(self, other: StampedPose) -> float:
        """Return the seconds from this time to another's; 0 where a time is not known."""
        return 0.0 if self.t_ns is None or other.t_ns is None else (other.t_ns - self.t_ns) * 1e-9

    def meters_to(self, other: StampedPose) -> float:
        """Return the meters to another; infinite where a pose is not known."""
        if self.world_from_sensor is None or other.world_from_sensor is None:
            return float("inf")
        return float(np.linalg.norm(other.world_from_sensor.translation - self.world_from_sensor.translation))


AT_REST = Drift(np.zeros(3), 0.0)
"""No motion, or none that is known."""


def drift_of(before: StampedPose | None, now: StampedPose, after: StampedPose | None) -> Drift:
    """Return the motion at ``now`` by differences of the poses next to it; at rest where they are not known.

    >>> pose = Rigid.from_yaw(np.pi / 2)
    >>> later = StampedPose(Rigid.from_yaw(np.pi / 2, (0.0, 2.0, 0.0)), 100_000_000)
    >>> drift_of(None, StampedPose(pose, 0), later).velocity_mps.round(6).tolist()
    [20.0, 0.0, 0.0]
    """
    posed = [one for one in (before, now, after) if one is not None and one.world_from_sensor is not None]
    pose = now.world_from_sensor
    if pose is None or len(posed) < 2 or not _reachable(posed[0], posed[-1]):
        return AT_REST
    first, last = posed[0].world_from_sensor, posed[-1].world_from_sensor
    seconds = posed[0].seconds_to(posed[-1])
    if first is None or last is None or not 1e-3 < seconds <= 2 * MAX_GAP_S:
        return AT_REST
    turned = Rigid(last.rotation @ first.rotation.T, np.zeros(3)).yaw
    velocity = (last.translation - first.translation) / seconds
    return Drift(velocity @ Rigid.from_yaw(pose.yaw).rotation, turned / seconds)


def _reachable(one: StampedPose, other: StampedPose) -> bool:
    return one.meters_to(other) <= MAX_SPEED_MPS * max(abs(one.seconds_to(other)), _SHORT_S)


def well_spaced(poses: Sequence[StampedPose | None], spacing_m: float) -> list[int]:
    """Return the places of the poses that stand for all: each ``spacing_m`` meters or two seconds from the one before.

    Those that are not known, and those that could only be reached faster than 70 m/s, stand for nothing.

    >>> at = [StampedPose(Rigid.from_yaw(0.0, (x, 0.0, 0.0)), int(x * 1e8)) for x in (0.0, 1.0, 2.0, 2.5, 4.0)]
    >>> well_spaced(at, 2.0)
    [0, 2, 4]
    """
    posts: list[int] = []
    last: StampedPose | None = None
    for place, pose in enumerate(poses):
        if pose is None or pose.world_from_sensor is None:
            continue
        if last is None or (
            _reachable(last, pose) and (last.meters_to(pose) >= spacing_m or last.seconds_to(pose) >= POST_S)
        ):
            posts.append(place)
            last = pose
    return posts
