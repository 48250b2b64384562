"""Messages for tests."""

from array import array

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from viewshed_ros.conversions import stamp_of


def cloud(points: NDArray[np.float32], t_ns: int = 10**9, frame: str = "lidar") -> PointCloud2:
    """Return a cloud of points (N, 3)."""
    message = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points), is_dense=True)
    message.header.stamp, message.header.frame_id = stamp_of(t_ns), frame
    message.fields = [PointField(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
    message.data = array("B", np.ascontiguousarray(points, "<f4").tobytes())
    return message
