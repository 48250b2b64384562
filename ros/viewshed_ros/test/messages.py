"""Messages for tests."""

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from viewshed.sweep import Sweep
from viewshed_ros.conversions import cloud_of, stamp_of


def cloud(points: NDArray[np.float32], t_ns: int = 10**9, frame: str = "lidar") -> PointCloud2:
    """Return a cloud of points (N, 3)."""
    return cloud_of(Sweep(points), PointCloud2(header=Header(stamp=stamp_of(t_ns), frame_id=frame)))
