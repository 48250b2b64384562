"""Stop messages, which claim nothing: they replace messages of a stale view and make nav2 stop.

Imports nothing of viewshed, so that the watchdog is a small process.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose
from nav_msgs.msg import MapMetaData, OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Reliable, and late subscribers receive the last message."""

CHECK_S = 0.05
"""Period of checks for stale messages, and of heartbeats."""

STALE_S, STALE_PERIODS = 0.5, 2.0
"""A view is stale if it is older than both: this many seconds, and this many periods of its sensor."""

MASK_STOPS = {"speed_mask": 1, "keepout_mask": 100}
"""Mask values that stop nav2: 1 % of the maximum speed (0 means no limit), and lethal. nav2 skips cells of -1."""

_FARTHEST_M, _COARSE_CELLS = 1e7, 21
"""Half extent around the map's origin, and cells a side, of masks before any pose is known: nav2's KeepoutFilter leaves
out half a cell at the lower edges."""


def everywhere() -> MapMetaData:
    """Return an area that covers the whole map, for masks before any pose is known."""
    side_m = 2.0 * _FARTHEST_M / (_COARSE_CELLS - 1)
    corner = Point(x=-_COARSE_CELLS * side_m / 2, y=-_COARSE_CELLS * side_m / 2)
    return MapMetaData(resolution=side_m, width=_COARSE_CELLS, height=_COARSE_CELLS, origin=Pose(position=corner))


def stop_mask(header: Header, area: MapMetaData, value: int) -> OccupancyGrid:
    """Return a mask with one value in every cell; ``area.map_load_time`` is the time of the newest sweep."""
    message = OccupancyGrid(header=header, info=area)
    message.data = array("b", bytes([value])) * (area.width * area.height)
    return message


@dataclass(frozen=True, slots=True)
class Stale:
    """Why nothing is claimed: something is too old."""

    what: str  # what is too old
    age_s: float  # its age; infinite if there was none yet
    limit_s: float  # maximum age
    unseen_mps: float  # speed limit in cells that are not seen

    def line(self) -> str:
        """Return one line of text.

        >>> Stale("view with a pose", 0.614, 0.5, 1.0).line()
        'nothing is claimed: the newest view with a pose is 0.61 s old, limit 0.5 s'
        """
        if math.isinf(self.age_s):
            return f"nothing is claimed: there is no {self.what} yet"
        return f"nothing is claimed: the newest {self.what} is {self.age_s:.2f} s old, limit {self.limit_s:.3g} s"


def stale_alarm(name: str, stale: Stale, beside: Iterable[KeyValue] = ()) -> DiagnosticStatus:
    """Return the alarm of a stale view, with additional pairs ``beside``."""
    values: Mapping[str, str] = {
        "caution": "STALE", "speed in m/s": "0.00", "speed limit in m/s": f"{stale.unseen_mps:.2f}",
        "age in s": f"{stale.age_s:.2f}", "limit of age in s": f"{stale.limit_s:.2f}",
    }  # fmt: skip
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    pairs += [pair for pair in beside if pair.key not in values]
    return DiagnosticStatus(level=DiagnosticStatus.STALE, name=name, message=stale.line(), values=pairs)
