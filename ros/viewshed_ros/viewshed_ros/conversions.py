"""Messages from estimates, and sweeps and poses from messages. Arrays of messages are set from ``array.array``: from
numpy they would be checked element by element, a thousand times slower."""

from __future__ import annotations

import math
from array import array

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Point32, Polygon, PolygonStamped, Pose, Quaternion
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from viewshed import Rigid
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import quaternion_from_rotation, rotation_from_quaternion
from viewshed.integrity.evidence import SECTORS
from viewshed.integrity.report import IntegrityReport
from viewshed.io.messages.laserscan import sweep_of_scan
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.pipeline import Answer, Caution
from viewshed.sweep import Sweep

UNKNOWN = -1
"""Of an OccupancyGrid: nothing is known."""

STATE_VALUES = {CellState.UNKNOWN: UNKNOWN, CellState.FREE: 0, CellState.SURFACE: 100, CellState.HIDDEN: 50}
"""Of the layer ``state``: HIDDEN is told from UNKNOWN."""

MOST_VERTICES = 100
"""Of the inner polygon, all parts together."""


def nanoseconds(stamp: Time) -> int:
    """Return a stamp in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamp_of(t_ns: int) -> Time:
    """Return nanoseconds as a stamp."""
    seconds, rest = divmod(t_ns, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def sweep_of(message: PointCloud2 | LaserScan) -> Sweep:
    """Return the sweep of a cloud or of a scan, with its time.

    Raises:
        ValueError: the message contradicts itself; its first sentence says how.
    """
    sweep = sweep_of_scan(message) if isinstance(message, LaserScan) else sweep_of_cloud(_Readable(message))
    return sweep.replace(t_ns=nanoseconds(message.header.stamp))


class _Readable:
    """A cloud whose data numpy sees without copying."""

    def __init__(self, cloud: PointCloud2) -> None:
        self.height, self.width, self.fields = cloud.height, cloud.width, cloud.fields
        self.is_bigendian, self.point_step, self.row_step = cloud.is_bigendian, cloud.point_step, cloud.row_step
        self.data: NDArray[np.uint8] = np.frombuffer(cloud.data, np.uint8)


def rigid_of(position: object, orientation: object) -> Rigid:
    """Return the transform of a position (Point, Vector3) and a Quaternion.

    Raises:
        ValueError: a number is not finite or the quaternion has not the norm 1.
    """
    quaternion = [getattr(orientation, name) for name in "wxyz"]
    translation = np.array([getattr(position, name) for name in "xyz"], np.float64)
    if not np.isfinite(translation).all():
        raise ValueError(f"a position must be finite, got {translation.tolist()}")
    return Rigid(rotation_from_quaternion(quaternion), translation)


def pose_of(rigid: Rigid) -> Pose:
    """Return a transform as a Pose."""
    w, x, y, z = quaternion_from_rotation(rigid.rotation).tolist()
    tx, ty, tz = rigid.translation.tolist()
    return Pose(position=Point(x=tx, y=ty, z=tz), orientation=Quaternion(w=w, x=x, y=y, z=z))


def grid_messages(estimate: FovEstimate, header: Header, frame_from_level: Rigid) -> dict[str, OccupancyGrid]:
    """Return the layers of an estimate as OccupancyGrids: ``visibility``, ``state`` and ``doubt``.

    ``visibility`` is the probability in percent and ``doubt`` that of the likelier answer being wrong (0 to 50), both
    -1 where UNKNOWN; ``state`` has the values of ``STATE_VALUES``.

    Args:
        estimate: in the ``level`` frame.
        header: of the messages; its frame is ``frame``.
        frame_from_level: where the ``level`` frame stands in it.
    """
    unknown = estimate.state == CellState.UNKNOWN
    values = np.array([STATE_VALUES[CellState(state)] for state in range(len(CellState))], np.int8)
    layers = {
        "visibility": np.where(unknown, UNKNOWN, np.rint(100.0 * estimate.visible_prob)).astype(np.int8),
        "state": values[estimate.state],
        "doubt": np.where(unknown, UNKNOWN, np.rint(100.0 * estimate.doubt())).astype(np.int8),
    }
    corner = Rigid(np.eye(3), np.array([*estimate.grid.origin_m, 0.0]))
    origin = pose_of(frame_from_level @ corner)
    return {name: _grid_message(layer, estimate.grid.cell_m, header, origin) for name, layer in layers.items()}


def _grid_message(values: NDArray[np.int8], cell_m: float, header: Header, origin: Pose) -> OccupancyGrid:
    """Return values (cells, cells), x first, as a grid, whose data go along x first."""
    message = OccupancyGrid(header=header)
    message.info.map_load_time = header.stamp
    message.info.resolution = cell_m
    message.info.width, message.info.height = values.shape
    message.info.origin = origin
    message.data = array("b", np.ascontiguousarray(values.T).tobytes())
    return message


def polygon_message(estimate: FovEstimate, header: Header, frame_from_level: Rigid) -> PolygonStamped:
    """Return the largest part of the inner polygon, without its holes' insides: a polygon that claims no cell too much.

    A Polygon has no holes. A part with holes is cut open along its bridges by the estimate's own inner polygon; where
    one is left, the part is not published.
    """
    parts = [part for part in estimate.inner_polygon(MOST_VERTICES).geoms if not part.interiors]
    corners = np.zeros((0, 2))
    if parts:
        corners = np.asarray(max(parts, key=lambda part: part.area).exterior.coords)[:-1]
    points = frame_from_level @ np.column_stack([corners, np.zeros(len(corners))])
    polygon = Polygon(points=[Point32(x=float(x), y=float(y), z=float(z)) for x, y, z in points])
    return PolygonStamped(header=header, polygon=polygon)
