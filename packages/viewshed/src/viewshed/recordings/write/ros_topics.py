"""The topics of a bag: name and ROS message type of each, and how the message is made from a moment.

Names are those of the bags of arXiv 2503.07375; every ROS installation has the message types.

- ``/agent_names``, ``/attacked_agents``: String (JSON list), in simulated drives and attacked ones.
- ``/object_truth``: MarkerArray, in simulated drives: a cube for each object, ``id`` is its number, ``ns`` its
  category.
- ``/{agent}/state``: Odometry, in simulated drives: pose of the vehicle in ``map``, velocity in its own frame.
- ``/{agent}/lidar/data``: PointCloud2, or LaserScan for a planar laser: points as read, with intensity, ring, azimuth
  and time if the sweep has them.
- ``/{agent}/lidar/object_truth``: MarkerArray, in simulated drives: objects with at least five returns of this sensor.
- ``/{agent}/lidar/fov``: PolygonStamped, one ring within the visible cells, star-shaped about the sensor with 360
  wedges.
- ``/{agent}/lidar/visibility``, ``state``, ``doubt``: OccupancyGrid: probability in percent, UNKNOWN -1; UNKNOWN -1,
  FREE 0, HIDDEN 50, SURFACE 100; probability in percent (0 to 50) that the likelier answer is wrong.
- ``/{agent}/lidar/detections``, ``tracks``, ``explained``: MarkerArray, MarkerArray, String (JSON), with object
  tracking: cubes in ``{agent}/level``; cubes in the color of their explanation (``ns``), with its reason as ``text``.
- ``/{agent}/lidar/alarms``: DiagnosticArray, with a monitor: a status for each reason, only during an alarm or a
  degraded view.
- ``/metrics/{agent}``, ``/metrics/{agent}/gospa``: String, Float64: tracks of simulated drives against the truth.
- ``/command_center/tracks``, ``visibility``, ``picture``, ``lies``, ``/trust/{agent}``: fusion of several agents:
  MarkerArray, OccupancyGrid, String, DiagnosticArray, Float64.
- ``/diagnostics``: DiagnosticArray: summary and numbers of each sweep.
- ``/tf``, ``/tf_static``: TFMessage: ``map`` to ``{agent}/base_link`` or ``{agent}/lidar`` if poses are known,
  ``{agent}/lidar`` to ``{agent}/base_footprint`` if the sensor height is known, and to ``{agent}/level``; mountings.

Grids and polygons are in ``{agent}/level``. A sweep decoded from packets is written as a cloud, which loses data such
as the beam table of an Ouster. Characters that ROS does not allow in names are replaced by ``_``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed.agents.legend import LEGEND, ShownTracks, tracks_of_center
from viewshed.detections import BOX_COLUMNS, Detections, ObjectKind
from viewshed.fov.polygons import star_ring
from viewshed.geometry import Rigid, quaternion_from_rotation
from viewshed.grid import BevGrid
from viewshed.io.export.ros import visibility_layer
from viewshed.io.messages.laserscan import scan_of_sweep
from viewshed.io.messages.pointcloud2 import cloud_table
from viewshed.recordings.write.bag_writers import Schema
from viewshed.recordings.write.moment import MAP, Moment, ObjectTruth, Transform
from viewshed.sweep import Sweep

CLOUD, FIELD, SCAN = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointField", "sensor_msgs/msg/LaserScan"
GRID, POLYGON = "nav_msgs/msg/OccupancyGrid", "geometry_msgs/msg/PolygonStamped"
ODOMETRY, TF, STRING = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"
NUMBER = "std_msgs/msg/Float64"
MARKERS, DIAGNOSTICS = "visualization_msgs/msg/MarkerArray", "diagnostic_msgs/msg/DiagnosticArray"

_DATATYPES = {"f4": 7, "u2": 4}


@dataclass(frozen=True, slots=True)
class Encoded:
    """A message that is already serialized."""

    __msgtype__: str  # message type; the attribute name of rosbags
    raw: bytes  # serialized bytes


class RosMessages:
    """Makes and serializes messages of ROS 1 (Noetic) or ROS 2 (Humble).

    Raises:
        ImportError: rosbags is not installed.
    """

    def __init__(self, *, ros1: bool) -> None:
        with needed_for("writing a bag"):
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if TF not in self.store.types:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        self._ros1 = ros1
        self._fields: dict[str, dict[str, Any]] = {}

    def encode(self, message: Any) -> bytes:
        """Serialize a message."""
        if isinstance(message, Encoded):
            return message.raw
        serialize = self.store.serialize_ros1 if self._ros1 else self.store.serialize_cdr
        return bytes(serialize(message, message.__msgtype__))

    def definition(self, kind: str) -> str:
        """Return the definition of a type and its nested types, in the format of MCAP."""
        return str(self.store.generate_msgdef(kind, ros_version=2)[0])

    def make(self, kind: str, **given: Any) -> Any:
        """Make a message; fields that are not given are zero or empty."""
        fields = self._fields.get(kind)
        if fields is None:
            fields = self._fields[kind] = dict(self.store.get_msgdef(kind).fields)
        values = {name: given.pop(name) if name in given else self._default(form) for name, form in fields.items()}
        if given:
            raise TypeError(f"{kind} has no field {', '.join(given)}")
        return self.store.types[kind](**values)

    def _default(self, form: Any) -> Any:
        """Return the default value of a field; ``form`` is its (node, arguments) in rosbags' tables."""
        node, rest = form
        match node.name:
            case "BASE":
                return {"string": "", "bool": False}.get(rest[0], 0.0 if rest[0].startswith("float") else 0)
            case "NAME":
                return self.make(rest)
        (inner, name), count = rest
        is_number = inner.name == "BASE" and name[0] != "string"
        return np.zeros(count, name[0]) if is_number else [self._default((inner, name)) for _ in range(count)]

    def header(self, t_ns: int, frame: str) -> Any:
        """Make a Header."""
        return self.make("std_msgs/msg/Header", stamp=self.stamp(t_ns), frame_id=frame)

    def stamp(self, t_ns: int) -> Any:
        """Make a Time."""
        return self.make("builtin_interfaces/msg/Time", sec=t_ns // 1_000_000_000, nanosec=t_ns % 1_000_000_000)

    def pose(self, rigid: Rigid) -> Any:
        """Make a Pose."""
        position, orientation = self._vector("Point", rigid.translation), self._quaternion(rigid)
        return self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)

    def cloud(self, sweep: Sweep, t_ns: int, frame: str) -> Any:
        """Make a PointCloud2 with the points and columns of a sweep."""
        table = cloud_table(sweep)
        columns: dict[str, Any] = dict(table.dtype.fields or {})
        fields = [
            self.make(FIELD, name=name, offset=offset, datatype=_DATATYPES[form.str[1:]], count=1)
            for name, (form, offset) in columns.items()
        ]
        data = table.view(np.uint8).reshape(-1) if table.size else np.zeros(0, np.uint8)
        return self.make(
            CLOUD, header=self.header(t_ns, frame), height=1, width=len(table), fields=fields,
            point_step=table.dtype.itemsize, row_step=data.size, data=data, is_dense=True,
        )  # fmt: skip

    def returns(self, sweep: Sweep, t_ns: int, frame: str) -> Any:
        """Make a LaserScan of a planar sweep, else a PointCloud2."""
        if sweep.planar is None:
            return self.cloud(sweep, t_ns, frame)
        return self.make(SCAN, header=self.header(t_ns, frame), **scan_of_sweep(sweep))

    def grid(
        self, layer: NDArray[np.int8], grid: BevGrid, t_ns: int, frame: str, frame_from_grid: Rigid | None = None
    ) -> Any:
        """Make an OccupancyGrid (``data`` x fastest) of a layer (cells, cells), x first."""
        header = self.header(t_ns, frame)
        corner = Rigid(np.eye(3), np.array([*grid.origin_m, 0.0]))
        if frame_from_grid is not None:
            corner = frame_from_grid @ corner
        info = self.make(
            "nav_msgs/msg/MapMetaData", map_load_time=header.stamp, resolution=grid.cell_m, width=grid.cells,
            height=grid.cells, origin=self.pose(corner),
        )  # fmt: skip
        return self.make(GRID, header=header, info=info, data=np.ascontiguousarray(layer.T).ravel())

    def polygon(self, corners: NDArray[np.float64], t_ns: int, frame: str) -> Encoded:
        """Make a serialized PolygonStamped of corners (V, 2); a thousand Point32 objects would be too slow."""
        empty = self.encode(self.make(POLYGON, header=self.header(t_ns, frame)))
        # The points are the last field: their number, then x, y, z of each.
        points = np.zeros((len(corners), 3), "<f4")
        points[:, :2] = corners
        return Encoded(POLYGON, empty[:-4] + len(points).to_bytes(4, "little") + points.tobytes())

    def transforms(self, transforms: list[Transform], t_ns: int) -> Any:
        """Make a TFMessage; None if there are no transforms."""
        return None if not transforms else self.make(TF, transforms=[
            self.make(
                "geometry_msgs/msg/TransformStamped", header=self.header(t_ns, edge.parent), child_frame_id=edge.child,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self._vector("Vector3", edge.parent_from_child.translation),
                    rotation=self._quaternion(edge.parent_from_child),
                ),
            )
            for edge in transforms
        ])  # fmt: skip

    def odometry(self, moment: Moment) -> Any:
        """Make an Odometry of an agent's vehicle, or of its sensor on a mast; None without ground truth."""
        if moment.truth is None:
            return None
        linear = self._vector("Vector3", moment.truth.velocity_mps)
        return self.make(
            ODOMETRY, header=self.header(moment.t_ns, MAP), child_frame_id=moment.carrier_frame,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(moment.truth.world_from_carrier)),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=self.make("geometry_msgs/msg/Twist", linear=linear)
            ),
        )  # fmt: skip

    def boxes(self, objects: tuple[ObjectTruth, ...], t_ns: int) -> Any:
        """Make a MarkerArray of objects as cubes: number as id, category as namespace and text."""
        color = self.make("std_msgs/msg/ColorRGBA", r=0.2, g=0.8, b=1.0, a=0.5)
        return self.make(MARKERS, markers=[
            self.make(
                "visualization_msgs/msg/Marker", header=self.header(t_ns, MAP), ns=item.category, id=item.number,
                type=1, pose=self.pose(item.world_from_box), scale=self._vector("Vector3", item.size_m), color=color,
                text=item.category,
            )
            for item in objects
        ])  # fmt: skip

    def detections(self, detections: Detections, t_ns: int, frame: str) -> Any:
        """Make a MarkerArray of detections as cubes: index as id, kind as namespace, number of returns as text."""
        kinds = [ObjectKind(kind).name.lower() for kind in detections.kinds]
        texts = [f"{count} returns" for count in detections.returns.tolist()]
        rows = zip(range(len(detections)), kinds, detections.boxes, texts, strict=True)
        return self._cubes([(*row, (0.6, 0.6, 0.6)) for row in rows], t_ns, frame)

    def tracks(self, tracks: ShownTracks, t_ns: int, frame: str) -> Any:
        """Make a MarkerArray of tracks as cubes: explanation as color and namespace, reason as text."""
        rows = zip(tracks.ids.tolist(), tracks.legend.tolist(), tracks.boxes, tracks.reasons, strict=True)
        return self._cubes(
            [(number, LEGEND[i].word, box, text, LEGEND[i].color) for number, i, box, text in rows], t_ns, frame
        )

    def _cubes(self, rows: list[tuple[int, str, Any, str, tuple[float, float, float]]], t_ns: int, frame: str) -> Any:
        """Make a MarkerArray of cubes (number, namespace, box, text, color) that replaces all previous ones."""
        header, kind = self.header(t_ns, frame), "visualization_msgs/msg/Marker"
        delete_all = self.make(kind, header=header, action=3)
        return self.make(MARKERS, markers=[delete_all, *(
            self.make(
                kind, header=header, ns=namespace, id=number, type=1, text=text, pose=self.pose(rigid_of_box(box)),
                scale=self._vector("Vector3", box[3:6]),
                color=self.make("std_msgs/msg/ColorRGBA", r=color[0], g=color[1], b=color[2], a=0.6),
            )
            for number, namespace, box, text, color in rows
        )])  # fmt: skip

    def number(self, value: float) -> Any:
        """Make a Float64."""
        return self.make(NUMBER, data=float(value))

    def lies(self, moment: Moment) -> Any:
        """Make a DiagnosticArray: a status for each accusation and dispute of the round; None if there is none."""
        completed = moment.round
        if completed is None:
            return None
        values = {f"trust of {name}": f"{row['trust']:.3f}" for name, row in completed.numbers()["agents"].items()}
        return self._statuses(completed.sentences(), completed.t_ns, values, level=1, name="viewshed: command_center")

    def diagnostics(self, moment: Moment, sentences: list[str]) -> Any:
        """Make a DiagnosticArray: a status for each sentence, with the numbers of the answer; None if there is none."""
        fields = {
            "level": int(moment.verdict()),
            "name": f"viewshed: {moment.agent}",
            "hardware_id": moment.sensor_frame,
        }
        return self._statuses(sentences, moment.t_ns, moment.numbers(), **fields)

    def _statuses(self, sentences: list[str], t_ns: int, numbers: dict[str, str], **fields: Any) -> Any:
        """Make a DiagnosticArray: a status for each sentence, all with the same numbers; None if there is none."""
        kind, pair = "diagnostic_msgs/msg/DiagnosticStatus", "diagnostic_msgs/msg/KeyValue"
        values = [self.make(pair, key=key, value=value) for key, value in numbers.items()]
        status = [self.make(kind, message=sentence, values=values, **fields) for sentence in sentences]
        return self.make(DIAGNOSTICS, header=self.header(t_ns, ""), status=status) if status else None

    def text(self, value: object) -> Any:
        """Make a String of a value as JSON."""
        return self.make(STRING, data=json.dumps(value, ensure_ascii=False))

    def _vector(self, name: str, xyz: Any) -> Any:
        x, y, z = (float(value) for value in xyz)
        return self.make(f"geometry_msgs/msg/{name}", x=x, y=y, z=z)

    def _quaternion(self, rigid: Rigid) -> Any:
        w, x, y, z = quaternion_from_rotation(rigid.rotation).tolist()
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a bag."""

    name: str  # may contain ``{agent}``
    make: Callable[[RosMessages, Moment], Any]  # makes the message of a moment, or None if there is none
    # written once, and again when more agents are attacked; late subscribers receive it too
    latched: bool = False
    per_time: bool = False  # written once at each time, for all agents together


def _layer(name: str) -> Callable[[RosMessages, Moment], Any]:
    def make(ros: RosMessages, moment: Moment) -> Any:
        estimate = moment.answer.estimate
        if estimate is None:
            return None
        return ros.grid(visibility_layer(estimate, name), estimate.grid, moment.t_ns, moment.level_frame)

    return make


def _fov(ros: RosMessages, moment: Moment) -> Any:
    estimate = moment.answer.estimate
    if estimate is None:
        return None
    return ros.polygon(star_ring(estimate.visible(), estimate.grid), moment.t_ns, moment.level_frame)


def _detections(ros: RosMessages, moment: Moment) -> Any:
    objects = moment.answer.objects
    return None if objects is None else ros.detections(objects.detections, moment.t_ns, moment.level_frame)


def _tracks(ros: RosMessages, moment: Moment) -> Any:
    tracks = moment.tracks()
    return None if tracks is None else ros.tracks(tracks, moment.t_ns, moment.tracks_frame)


def _joint_tracks(ros: RosMessages, moment: Moment) -> Any:
    completed = moment.round
    return None if completed is None else ros.tracks(tracks_of_center(completed.picture), completed.t_ns, MAP)


def _joint_view(ros: RosMessages, moment: Moment) -> Any:
    """Make the grid of the joint field of view in the map, at the height of the ground."""
    completed = moment.round
    if completed is None:
        return None
    estimate, pose = completed.joint.estimate(completed.t_ns), completed.joint.world_from_grid
    return ros.grid(visibility_layer(estimate, "visibility"), estimate.grid, completed.t_ns, MAP, pose)


TOPICS = (
    Topic("/agent_names", lambda ros, m: m.truth and ros.text(list(m.truth.mounts)), latched=True),
    Topic("/attacked_agents", lambda ros, m: ros.text(m.attacked) if m.truth or m.attacked else None, latched=True),
    Topic("/object_truth", lambda ros, m: m.truth and ros.boxes(m.truth.objects, m.t_ns), per_time=True),
    Topic("/tf_static", lambda ros, m: ros.transforms(m.static_transforms(), m.t_ns), latched=True),
    Topic("/tf", lambda ros, m: ros.transforms(m.transforms(), m.t_ns)),
    Topic("/{agent}/state", lambda ros, m: ros.odometry(m)),
    Topic("/{agent}/lidar/data", lambda ros, m: ros.returns(m.sweep, m.t_ns, m.sensor_frame)),
    Topic("/{agent}/lidar/object_truth", lambda ros, m: m.truth and ros.boxes(m.truth.seen, m.t_ns)),
    Topic("/{agent}/lidar/fov", _fov),
    Topic("/{agent}/lidar/visibility", _layer("visibility")),
    Topic("/{agent}/lidar/state", _layer("state")),
    Topic("/{agent}/lidar/doubt", _layer("doubt")),
    Topic("/{agent}/lidar/alarms", lambda ros, m: ros.diagnostics(m, m.alarms())),
    Topic("/{agent}/lidar/detections", _detections),
    Topic("/{agent}/lidar/tracks", _tracks),
    Topic("/{agent}/lidar/explained", lambda ros, m: None if (rows := m.explained()) is None else ros.text(rows)),
    Topic("/metrics/{agent}", lambda ros, m: ros.text(dict(m.metrics)) if m.metrics else None),
    Topic("/metrics/{agent}/gospa", lambda ros, m: ros.number(m.metrics["gospa_m"]) if m.metrics else None),
    Topic("/command_center/tracks", _joint_tracks),
    Topic("/command_center/visibility", _joint_view),
    Topic("/command_center/picture", lambda ros, m: m.round and ros.text(m.round.numbers())),
    Topic("/command_center/lies", lambda ros, m: ros.lies(m)),
    Topic("/trust/{agent}", lambda ros, m: None if m.trust is None else ros.number(m.trust)),
    Topic("/diagnostics", lambda ros, m: ros.diagnostics(m, [m.summary()])),
)
"""The topics of a bag, in the order in which they are written for each sweep."""


def rigid_of_box(box: NDArray[np.float64]) -> Rigid:
    """Return the pose of a box (7,): origin at its center, x along its heading."""
    return Rigid.from_yaw(float(box[BOX_COLUMNS.index("yaw")]), box[:3])


def ros_name(name: str) -> str:
    """Replace the characters that ROS does not allow in a name.

    >>> ros_name("/car-1/top lidar/data")
    '/car_1/top_lidar/data'
    """
    return re.sub(r"[^A-Za-z0-9_/]", "_", name)


class RosTable:
    """Serializes moments in the order of :data:`TOPICS`, each latched message once."""

    def __init__(self, *, ros1: bool) -> None:
        self._messages, self._encoding = RosMessages(ros1=ros1), "ros1" if ros1 else "cdr"
        self._sent: dict[str, int] = {}
        self._schemas: dict[str, Schema] = {}

    def of(self, moment: Moment) -> Iterator[tuple[str, Schema, bytes, bool]]:
        """Yield (topic, schema, bytes, is latched) of the messages of a moment."""
        for topic in TOPICS:
            name = ros_name(topic.name.format(agent=moment.agent))
            if topic.latched or topic.per_time:
                state = moment.t_ns if topic.per_time else len(moment.attacked)
                if self._sent.get(name) == state:
                    continue
                self._sent[name] = state
            message = topic.make(self._messages, moment)
            if message is not None:
                schema = self._schema(message.__msgtype__)
                yield name, schema, self._messages.encode(message), topic.latched

    def _schema(self, kind: str) -> Schema:
        if kind not in self._schemas:
            definition = b"" if self._encoding == "ros1" else self._messages.definition(kind).encode()
            self._schemas[kind] = Schema(kind, "ros2msg", self._encoding, definition)
        return self._schemas[kind]
