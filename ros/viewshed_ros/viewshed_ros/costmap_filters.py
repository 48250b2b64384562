"""Filter infos that tell nav2's costmap filters how to read a mask; published if nav2_msgs is installed.

Otherwise nav2's own ``costmap_filter_info_server`` publishes them, with ``config/nav2_filter_info.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from viewshed_ros.nav2 import SpeedLimits

KEEPOUT, SPEED_IN_MPS = 0, 2
"""Values of ``CostmapFilterInfo.type``."""

_INFOS = {"keepout_filter_info": "keepout_mask", "speed_filter_info": "speed_mask"}


def info_types() -> dict[str, type[Any]]:
    """Return the topics of infos and their type; empty if nav2_msgs is not installed."""
    try:
        from nav2_msgs.msg import CostmapFilterInfo
    except ImportError:
        return {}
    return dict.fromkeys(_INFOS, CostmapFilterInfo)


def publish_infos(publishers: Mapping[str, Any], limits: SpeedLimits) -> None:
    """Publish the infos of a sensor's masks."""
    types = info_types()
    for info, mask in _INFOS.items():
        if info in types:
            publishers[info].publish(info_of(types[info](), mask, publishers[mask].topic_name, limits))


def info_of(message: Any, mask: str, topic: str, limits: SpeedLimits) -> Any:
    """Fill the info of a mask and return it; the speed in m/s is ``multiplier`` times the value of the mask."""
    message.type = SPEED_IN_MPS if mask == "speed_mask" else KEEPOUT
    message.filter_mask_topic = topic
    message.base = 0.0
    message.multiplier = limits.most_mps / 100.0 if mask == "speed_mask" else 1.0
    return message
