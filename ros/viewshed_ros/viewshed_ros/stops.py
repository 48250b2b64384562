"""Messages that claim nothing: they replace what was published of a view that is too old, and nav2 stops by them.

Nothing of viewshed is imported, so that the watchdog is a small process of its own.
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
"""Reliable, and who comes late is given the last message."""

CHECK_S = 0.05
"""Between two looks at the age of what was published, and between two heartbeats."""

STALE_S, STALE_PERIODS = 0.5, 2.0
"""A view is stale when it is older than both: seconds, and times the period of its sensor."""

MASK_STOPS = {"speed_mask": 1, "keepout_mask": 100}
"""Values by which nav2 stops: 1 percent of the greatest speed, as 0 is no limit, and lethal. It skips cells of -1."""

_FARTHEST_M, _COARSE_CELLS = 1e7, 21
"""Reach from the map's origin, and cells a side, of masks before any pose is known: nav2's KeepoutFilter leaves out
half a cell at the lower edges."""


def everywhere() -> MapMetaData:
    """Return cells that cover the whole map, for masks before any pose is known."""
    side_m = 2.0 * _FARTHEST_M / (_COARSE_CELLS - 1)
    corner = Point(x=-_COARSE_CELLS * side_m / 2, y=-_COARSE_CELLS * side_m / 2)
    return MapMetaData(resolution=side_m, width=_COARSE_CELLS, height=_COARSE_CELLS, origin=Pose(position=corner))


def stop_mask(header: Header, area: MapMetaData, value: int) -> OccupancyGrid:
    """Return a mask with one value in every cell; ``area.map_load_time`` is that of the newest sweep."""
    message = OccupancyGrid(header=header, info=area)
    message.data = array("b", bytes([value])) * (area.width * area.height)
    return message


@dataclass(frozen=True, slots=True)
class Stale:
    """Why nothing is claimed."""

    what: str  # is too old
    age_s: float  # of it; infinite where there was none yet
    limit_s: float  # from which it is too old
    unseen_mps: float  # how fast one may drive where nothing is seen

    def line(self) -> str:
        """Return it in one line.

        >>> Stale("view with a pose", 0.614, 0.5, 1.0).line()
        'nothing is claimed: the newest view with a pose is 0.61 s old, limit 0.5 s'
        """
        if math.isinf(self.age_s):
            return f"nothing is claimed: there is no {self.what} yet"
        return f"nothing is claimed: the newest {self.what} is {self.age_s:.2f} s old, limit {self.limit_s:.3g} s"


def stale_alarm(name: str, stale: Stale, beside: Iterable[KeyValue] = ()) -> DiagnosticStatus:
    """Return the alarm of a view that is too old, with what else was to be reported."""
    values: Mapping[str, str] = {
        "caution": "STALE", "speed in m/s": "0.00", "speed limit in m/s": f"{stale.unseen_mps:.2f}",
        "age in s": f"{stale.age_s:.2f}", "limit of age in s": f"{stale.limit_s:.2f}",
    }  # fmt: skip
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    pairs += [each for each in beside if each.key not in values]
    return DiagnosticStatus(level=DiagnosticStatus.STALE, name=name, message=stale.line(), values=pairs)
