"""Convert sweeps, times and poses from and to messages; messages of estimates are in :mod:`viewshed_ros.layers`."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from viewshed.geometry import Rigid, quaternion_from_rotation, rotation_from_quaternion
from viewshed.io.messages.laserscan import sweep_of_scan
from viewshed.io.messages.packets import sweep_of_velodyne
from viewshed.io.messages.pointcloud2 import cloud_table, sweep_of_cloud
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

NANOSECONDS = 1_000_000_000


def nanoseconds_of(stamp: Time) -> int:
    """Return a stamp in nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def stamp_of(t_ns: int) -> Time:
    """Return nanoseconds as a stamp."""
    seconds, rest = divmod(t_ns, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


@dataclass(frozen=True, slots=True)
class Input:
    """A message type of a sensor."""

    packages: tuple[str, ...]  # packages of the message; the first installed one is used
    name: str  # of the message type
    # converts a message to a sweep without its time; None if a message holds a single packet
    sweep_of: Callable[..., Sweep] | None
    packet: str = ""  # attribute with the bytes of a packet; empty if a message holds a sweep
    by_model: bool = False  # whether the conversion also takes the sensor's beam table

    def message_type(self) -> type[Any]:
        """Return the message class."""
        for package in self.packages:
            try:
                return getattr(import_module(f"{package}.msg"), self.name)  # type: ignore[no-any-return]
            except ImportError:
                continue
        raise ValueError(f"type {self.name} needs the package {' or '.join(self.packages)}, which is not installed")

    def sweep(self, message: Any, **known: Any) -> Sweep:
        """Return the sweep of a message, with the time of its header and known attributes."""
        if self.sweep_of is None:
            raise ValueError(f"a message of {self.name} holds a packet, not a sweep")
        arguments = (message, known.get("model")) if self.by_model else (message,)
        return self.sweep_of(*arguments).replace(t_ns=nanoseconds_of(message.header.stamp), **known)


@dataclass(slots=True)
class _Cloud:
    """A cloud whose data is a numpy view, without a copy."""

    height: int
    width: int
    fields: Any
    is_bigendian: bool
    point_step: int
    row_step: int
    data: NDArray[np.uint8]


def _sweep_of_cloud(message: PointCloud2, model: LidarModel | None) -> Sweep:
    data = np.frombuffer(message.data, np.uint8)
    return sweep_of_cloud(
        _Cloud(
            message.height, message.width, message.fields, message.is_bigendian, message.point_step,
            message.row_step, data,
        ),
        model,
    )  # fmt: skip


INPUTS = {
    "cloud": Input(("sensor_msgs",), "PointCloud2", _sweep_of_cloud, by_model=True),
    "scan": Input(("sensor_msgs",), "LaserScan", sweep_of_scan),
    "velodyne": Input(("velodyne_msgs",), "VelodyneScan", sweep_of_velodyne),
    "ouster": Input(("ouster_sensor_msgs", "ouster_ros"), "PacketMsg", None, packet="buf"),
    "ouster_bytes": Input(("std_msgs",), "UInt8MultiArray", None, packet="data"),
}
"""Message types of sensors, by the value of the parameter ``type``."""


_CODES = {"<f4": PointField.FLOAT32, "<u2": PointField.UINT16}


def cloud_of(sweep: Sweep, like: PointCloud2) -> PointCloud2:
    """Return a sweep as a cloud with all columns that it has, and with the header of ``like``."""
    table = cloud_table(sweep)
    places: dict[str, Any] = dict(table.dtype.fields or {})
    fields = [
        PointField(name=name, offset=offset, datatype=_CODES[form.str], count=1)
        for name, (form, offset) in places.items()
    ]
    size = table.dtype.itemsize
    return PointCloud2(
        header=like.header, height=1, width=len(sweep), fields=fields, point_step=size, row_step=size * len(sweep),
        is_dense=True, data=array("B", table.tobytes()),
    )  # fmt: skip


def rigid_of(position: Any, orientation: Any) -> Rigid:
    """Return the transform of a position (Point, Vector3) and a Quaternion."""
    quaternion = [getattr(orientation, name) for name in "wxyz"]
    return Rigid(rotation_from_quaternion(quaternion), np.array([getattr(position, name) for name in "xyz"]))


def pose_of(rigid: Rigid) -> Pose:
    """Return a transform as a Pose."""
    w, x, y, z = quaternion_from_rotation(rigid.rotation).tolist()
    tx, ty, tz = rigid.translation.tolist()
    return Pose(position=Point(x=tx, y=ty, z=tz), orientation=Quaternion(w=w, x=x, y=y, z=z))
