"""Read ROS 1 bags, ROS 2 bags and MCAP files: sweeps from clouds, packets and scans, poses from tf and odometry."""

from __future__ import annotations

import math
import os
import struct
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from viewshed._extras import needed_for
from viewshed.arrays import F64
from viewshed.geometry import Rigid
from viewshed.io._input import one_line
from viewshed.io.messages.hesai import PANDAR, sweep_of_hesai
from viewshed.io.messages.laserscan import sweep_of_scan
from viewshed.io.messages.livox import sweep_of_livox
from viewshed.io.messages.packets import UNSUPPORTED, sweep_of_ouster, sweep_of_velodyne
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.io.ouster_packets import OusterDecoder, OusterMetadata
from viewshed.recordings.read.bag_files import BagFile, Message, bags_in, open_bag
from viewshed.recordings.read.source import RecordingSource, SweepRef, note_damage
from viewshed.recordings.read.tf_tree import MAX_GAP_NS, WORLDS, TransformBuffer, nearest
from viewshed.sweep import Sweep

CLOUD, ODOMETRY = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"
TRANSFORMS = (TF, "tf/msg/tfMessage")

VELODYNE, SCAN, STRING = "velodyne_msgs/msg/VelodyneScan", "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
OUSTER = ("ouster_sensor_msgs/msg/PacketMsg", "ouster_ros/msg/PacketMsg")

LIVOX = ("livox_ros_driver2/msg/CustomMsg", "livox_ros_driver/msg/CustomMsg")

RETURNS = ((CLOUD,), (VELODYNE, *OUSTER, *PANDAR, *LIVOX), (SCAN,))
"""Message types with LiDAR returns, in order of preference: a sensor recorded in two types is read once."""

OUSTER_FRAME = "os_sensor"
"""Frame of the returns in Ouster's packets, as their messages have no header."""

FOOTPRINT = "base_footprint"
"""Frame on the ground below a robot (ROS enhancement proposal 120); gives the height of the sensor.

With several robots it has the prefix of the sensor's frame: ``car_0/base_footprint``."""

_ODOMETRY_CHILD = "base_link"


@lru_cache(maxsize=2)
def decoder(encoding: str) -> Callable[[bytes, str], Any]:
    """Return the deserializer: (bytes of a message, name of its type) → message object."""
    with needed_for("reading a bag"):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    if encoding == "ros1":
        store = get_typestore(Stores.ROS1_NOETIC)
        if TF not in store.types:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    else:
        store = get_typestore(Stores.ROS2_FOXY)
    for kind, definition in _DEFINITIONS.items():
        store.register(get_types_from_msg(definition, kind))
    return store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr


_DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    VELODYNE: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    **dict.fromkeys(OUSTER, "uint8[] buf"),
    **{
        kind.replace("PandarScan", "PandarPacket"): "builtin_interfaces/Time stamp\nuint8[1500] data\nuint32 size"
        for kind in PANDAR
    },
    **{kind: f"std_msgs/Header header\n{kind.partition('/')[0]}/PandarPacket[] packets" for kind in PANDAR},
    **{
        kind.replace("CustomMsg", "CustomPoint"): (
            "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
        )
        for kind in LIVOX
    },
    **{
        kind: "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
        f"{kind.partition('/')[0]}/CustomPoint[] points"
        for kind in LIVOX
    },
}
"""Definitions of message types that rosbags lacks."""


_MAX_TILT_DEG = 10.0
"""Tilts below this are normal for a 2-D laser, for example of a robot that drives over a curb."""


@dataclass(frozen=True, slots=True)
class _Cloud:
    """One listed sweep: topic and type of its message, its header, and the position of the message in the bag.

    If a revolution spans several messages, ``where`` has the positions of all, separated by blanks.
    """

    topic: str
    kind: str
    t_ns: int
    frame: str
    where: str


@dataclass(slots=True, eq=False)
class _Contents:
    """Contents of a bag, collected in one pass."""

    clouds: list[_Cloud] = field(default_factory=list)
    transforms: TransformBuffer = field(default_factory=TransformBuffer)
    odometry: dict[str, list[Any]] = field(default_factory=dict)
    # child frame of odometry with covariance → ascending times, and covariances (6, 6)
    covariances: dict[str, tuple[list[int], list[F64]]] = field(default_factory=dict)
    worlds: list[str] = field(default_factory=lambda: list(WORLDS))
    metadata: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """Index of one bag."""

    root: Path  # root of the recording
    path: Path  # its location
    refs: tuple[SweepRef, ...]  # its clouds, in time order
    # for each ref: ``world_from_sensor``, covariance (6, 6) of that from odometry, and sensor height above the ground;
    # None if unknown
    places: tuple[tuple[Rigid | None, F64 | None, float | None], ...]
    encoding: str  # serialization of its messages, ``cdr`` or ``ros1``
    kinds: Mapping[str, str]  # topic with sweeps → message type
    metadata: Mapping[str, str]  # topic with Ouster packets → metadata JSON
    notes: tuple[str, ...] = ()  # missing data, and topics that are not read


_MAX_LATE_NS = 500_000_000
"""Stamps that lie further before earlier ones of their topic are those of a clock that restarted."""


def scan_bag(
    root: Path, scene: str, path: Path, damage: list[str], topic: str | None = None, last: str | None = None
) -> Bag | None:
    """Index a bag in one pass; None if it has no clouds. Problems are appended to ``damage``.

    If the clock restarts, what follows is left out: its stamps would mix with those before.

    Args:
        root: root of the recording.
        scene: scene name of the bag.
        path: the bag.
        damage: one line is appended for each problem.
        topic: topic to read; None reads all topics of the preferred message type.
        last: position of the last message to read; None reads all.
    """
    try:
        file = open_bag(root, path)
    except (ValueError, OSError) as error:
        note_damage(damage, str(error))
        return None
    contents, encoding = _Contents(), "cdr"
    try:
        for message in file.messages((*_CONVERTERS, STRING, ODOMETRY, *TRANSFORMS)):
            encoding = message.encoding
            _add_message(contents, message, damage)
            if message.where == last:
                break
        if not any(cloud.kind == CLOUD for cloud in contents.clouds) and set(OUSTER) & set(file.types.values()):
            encoding = _add_ouster(contents, file, path, damage)
    except (ValueError, OSError) as error:
        note_damage(damage, f"{one_line(error)}; {len(contents.clouds)} clouds before that are kept")
        if not contents.clouds:
            return None
    finally:
        types = file.types
        file.close()
    _note_topics(types, contents, damage, topic)
    restart = None if last is not None else _restart(contents.clouds)
    if restart is not None:
        first, count = contents.clouds[restart], len(contents.clouds) - restart
        line = f"the clock of {first.topic} restarts at {first.t_ns / 1e9:.3f} s: {count} of {len(contents.clouds)}"
        note_damage(damage, f"{line} sweeps, from there on, are left out; split the bag there to read them")
        again: list[str] = []
        bag = scan_bag(root, scene, path, again, topic, contents.clouds[restart - 1].where)
        damage += [problem for problem in again if problem not in damage]
        return bag
    return _build_bag(root, scene, path, contents, encoding, damage) if contents.clouds else None


def _restart(clouds: list[_Cloud]) -> int | None:
    """Return the index of the first cloud after a restart of the clock, None if there is none; clouds in file order.

    It and the next one of its topic lie before two earlier ones, so that a single wrong stamp is no restart.
    """
    by_topic = defaultdict[str, list[tuple[int, int]]](list)
    for index, cloud in enumerate(clouds):
        if cloud.kind not in OUSTER:  # their packets have no stamp
            by_topic[cloud.topic].append((cloud.t_ns, index))
    restarts = []
    for own in by_topic.values():
        latest: list[float] = [-math.inf, -math.inf]
        for k, (t_ns, index) in enumerate(own):
            if max(own[k : k + 2])[0] < latest[0] - _MAX_LATE_NS:
                restarts.append(index)
                break
            latest = sorted((*latest, t_ns))[1:]
    return min(restarts, default=None)


def _add_message(contents: _Contents, message: Message, damage: list[str]) -> None:
    try:
        if message.encoding not in ("cdr", "ros1"):
            raise ValueError(f"messages must be written as cdr or ros1, got {message.encoding!r}")
        if message.kind in _CONVERTERS:
            t_ns, frame = _header(message)
            contents.clouds.append(_Cloud(message.topic, message.kind, t_ns, frame, message.where))
            return
        if message.kind == STRING:
            if message.topic.endswith(_METADATA):
                contents.metadata[message.topic] = decoder(message.encoding)(message.raw, STRING).data
            return
        decoded = decoder(message.encoding)(message.raw, TF if message.kind in TRANSFORMS else message.kind)
        if message.kind == ODOMETRY:
            contents.odometry.setdefault(message.topic, []).append(decoded)
        else:
            _add_transforms(contents, decoded, message.topic.endswith("static"), damage)
    except Exception as error:  # the decoder of rosbags raises a dozen types on damaged messages
        note_damage(damage, f"{message.topic}: a message is damaged and left out: {one_line(error)}")


def _header(message: Message) -> tuple[int, str]:
    """Return stamp (ns) and frame of a message that begins with a header; a zero stamp gives the recording time.

    Reads only the header, so that a bag is indexed without decoding its clouds.
    """
    raw = message.raw
    little = message.encoding == "ros1" or raw[1:2] in (b"\x01", b"\x03")
    seconds, nanoseconds, length = struct.unpack_from("<III" if little else ">III", raw, 4)
    if length > len(raw) - 16:
        raise ValueError("its header is cut off")
    name = raw[16 : 16 + length].rstrip(b"\x00").decode("utf-8", "replace")
    return seconds * 1_000_000_000 + nanoseconds or message.t_ns, name.lstrip("/")


def _add_transforms(contents: _Contents, decoded: Any, static: bool, damage: list[str]) -> None:
    for transform in decoded.transforms:
        try:
            _add(contents.transforms, transform.header, transform.child_frame_id, transform.transform.translation,
                 transform.transform.rotation, static=static)  # fmt: skip
        except ValueError as error:
            note_damage(damage, f"tf: {one_line(error)}; left out")


def _add(buffer: TransformBuffer, header: Any, child: str, position: Any, q: Any, *, static: bool = False) -> None:
    t_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    translation = (position.x, position.y, position.z)
    buffer.add(header.frame_id, child, t_ns, translation, (q.w, q.x, q.y, q.z), static=static)


_METADATA = "/metadata"
"""Last part of the topic on which Ouster's drivers publish the metadata."""


def _add_ouster(contents: _Contents, file: BagFile, path: Path, damage: list[str]) -> str:
    """Group Ouster packets to revolutions and add these as clouds; return the serialization of the messages.

    The first and the last revolution of a topic are dropped if they have fewer packets than the longest one.
    """
    encoding = "cdr"
    decoders: dict[str, OusterDecoder | None] = {}
    revolutions: dict[str, list[list[_Cloud]]] = {}  # by topic: the packets of each revolution
    numbers: dict[str, tuple[int | None, int | None]] = {}  # by topic: frame number of the previous and this revolution
    for message in file.messages(OUSTER):
        topic, encoding = message.topic, message.encoding
        if topic not in decoders:
            decoders[topic] = _ouster_decoder(contents, topic, path, damage)
        decode = decoders[topic]
        number = None if decode is None else decode.frame_number(_packet_of(message.raw, encoding))
        previous, current = numbers.get(topic, (None, None))
        if number is None or number == previous:  # another kind of packet, or a late one
            continue
        packet = _Cloud(topic, message.kind, message.t_ns, OUSTER_FRAME, message.where)
        if number != current:
            revolutions.setdefault(topic, []).append([])
            numbers[topic] = current, number
        revolutions[topic][-1].append(packet)
    for groups in revolutions.values():
        max_packets = max(map(len, groups))
        for index, packets in enumerate(groups):
            if len(packets) == max_packets or index not in (0, len(groups) - 1):
                contents.clouds.append(replace(packets[0], where=" ".join(packet.where for packet in packets)))
    return encoding


def _ouster_decoder(contents: _Contents, topic: str, path: Path, damage: list[str]) -> OusterDecoder | None:
    """Return the decoder of a topic's packets, with metadata from the bag or the JSON file beside it; else None."""
    try:
        metadata = contents.metadata.get(topic.rpartition("/")[0] + _METADATA)
        if metadata is None:
            file = path.with_suffix(".json")
            if not file.is_file():
                raise ValueError(f"its metadata must be in the bag or beside it as {file.name}")
            metadata = file.read_text(encoding="utf-8")
        ouster_decoder = OusterDecoder(OusterMetadata.parse(metadata))
    except ValueError as error:
        note_damage(damage, f"topic {topic} has Ouster packets that cannot be read: {one_line(error)}")
        return None
    contents.metadata[topic] = metadata
    return ouster_decoder


def _packet_of(raw: bytes, encoding: str) -> bytes:
    """Return the packet in a serialized PacketMsg, a message with a single byte array."""
    start = 4 if encoding == "ros1" else 8
    order: Literal["little", "big"] = "little" if encoding == "ros1" or raw[1:2] in (b"\x01", b"\x03") else "big"
    return raw[start : start + int.from_bytes(raw[start - 4 : start], order)]


def _note_topics(types: dict[str, str], contents: _Contents, damage: list[str], requested: str | None) -> None:
    """Keep the clouds of the requested topic, or those of the preferred types; report the topics that are not read."""
    if requested is not None:
        topics = Counter(cloud.topic for cloud in contents.clouds)
        contents.clouds = [cloud for cloud in contents.clouds if cloud.topic.strip("/") == requested.strip("/")]
        if not contents.clouds:
            known = ", ".join(f"{topic} ({count} sweeps)" for topic, count in sorted(topics.items())) or "none"
            note_damage(damage, f"topic must be one with sweeps, {known}, got {requested!r}")
        return
    recorded = {cloud.kind for cloud in contents.clouds}
    preferred = next((kinds for kinds in RETURNS if recorded & set(kinds)), ())
    contents.clouds = [cloud for cloud in contents.clouds if cloud.kind in preferred]
    with_clouds = {cloud.topic for cloud in contents.clouds}
    for topic, kind in sorted(types.items()):
        if kind in UNSUPPORTED:
            line = f"topic {topic} has {UNSUPPORTED[kind]} ({kind}), which are not read; record PointCloud2"
            note_damage(contents.notes if with_clouds else damage, line)
        elif kind == CLOUD and topic not in with_clouds:
            note_damage(contents.notes if with_clouds else damage, f"topic {topic} has no cloud")
        elif preferred and kind in _CONVERTERS and topic not in with_clouds:
            line = f"topic {topic} ({kind}) is not read beside {', '.join(sorted(with_clouds))}"
            note_damage(contents.notes, line)
    if not with_clouds and CLOUD not in types.values():
        existing = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(types.items())) or "none"
        expected = "sensor_msgs/msg/PointCloud2 or LaserScan, packets of Velodyne, Ouster or Hesai"
        note_damage(damage, f"no topic has {expected}; topics that exist: {existing}")


def _add_odometry(contents: _Contents, damage: list[str]) -> None:
    """Add odometry as transforms, with covariances, unless tf already has its child frame."""
    topic_of, covariances = dict[str, str](), defaultdict[str, dict[int, F64]](dict)
    for topic, messages in sorted(contents.odometry.items()):
        for odometry in messages:
            child = (odometry.child_frame_id or _ODOMETRY_CHILD).lstrip("/")
            if contents.transforms.has_parent(child) and topic_of.get(child) != topic:
                continue
            topic_of[child] = topic
            pose = odometry.pose.pose
            try:
                _add(contents.transforms, odometry.header, child, pose.position, pose.orientation)
                contents.worlds.append(odometry.header.frame_id.lstrip("/"))
                t_ns = odometry.header.stamp.sec * 1_000_000_000 + odometry.header.stamp.nanosec
                covariance = np.array(odometry.pose.covariance, np.float64).reshape(6, 6)
                # All zeros mean unknown in ROS; invalid matrices are ignored.
                if covariance.any() and np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance)[0] >= -1e-9:
                    covariances[child][t_ns] = (covariance + covariance.T) / 2.0
            except ValueError as error:
                note_damage(damage, f"{topic}: {one_line(error)}; left out")
    contents.worlds = list(dict.fromkeys(contents.worlds))
    for frame, by_time in covariances.items():
        times_ns = sorted(by_time)
        contents.covariances[frame] = times_ns, [by_time[t_ns] for t_ns in times_ns]


def _covariance(contents: _Contents, cloud: _Cloud, world: str | None, pose: Rigid | None) -> F64 | None:
    """Return the covariance (6, 6) of a sensor's pose, from the odometry of its vehicle that is nearest in time."""
    child = next((frame for frame in contents.transforms.chain(cloud.frame) if frame in contents.covariances), None)
    if child is None or world is None or pose is None:
        return None
    vehicle = contents.transforms.lookup(world, child, cloud.t_ns)
    if vehicle is None:
        return None
    times_ns, covariances = contents.covariances[child]
    # Propagate to the sensor: with a lever arm (x, y, z), rotation errors of the vehicle become position errors.
    x, y, z = pose.translation - vehicle.translation
    jacobian = np.eye(6)
    jacobian[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return np.asarray(jacobian @ covariances[nearest(times_ns, cloud.t_ns)] @ jacobian.T, np.float64)


def _build_bag(root: Path, scene: str, path: Path, contents: _Contents, encoding: str, damage: list[str]) -> Bag:
    _add_odometry(contents, damage)
    clouds = sorted(contents.clouds, key=lambda cloud: (cloud.t_ns, cloud.topic))
    topics = dict.fromkeys(cloud.topic for cloud in clouds)
    refs = tuple(
        SweepRef(scene, index, str(path), cloud.t_ns, cloud.topic.strip("/") if len(topics) > 1 else "ego",
                 cloud.topic, key=cloud.where)
        for index, cloud in enumerate(clouds)
    )  # fmt: skip
    worlds = {frame: _world(contents, frame) for frame in dict.fromkeys(cloud.frame for cloud in clouds)}
    poses = tuple(
        None if (world := worlds[cloud.frame]) is None else contents.transforms.lookup(world, cloud.frame, cloud.t_ns)
        for cloud in clouds
    )
    for topic in topics:
        own_poses = [poses[index] for index, cloud in enumerate(clouds) if cloud.topic == topic and worlds[cloud.frame]]
        if own_poses.count(None):
            problem = (
                f"lie outside the times of the transforms or in a gap over {MAX_GAP_NS // 10**9} s, without a pose"
            )
            note_damage(contents.notes, f"{own_poses.count(None)} of {len(own_poses)} clouds of {topic} {problem}")
    _note_tilting(contents, clouds)
    places = tuple(
        (pose, _covariance(contents, cloud, worlds[cloud.frame], pose), _height_m(contents, cloud))
        for cloud, pose in zip(clouds, poses, strict=True)
    )
    kinds = {cloud.topic: cloud.kind for cloud in clouds}
    metadata = {topic: text for topic, text in contents.metadata.items() if topic in kinds}
    return Bag(root, path, refs, places, encoding, kinds, metadata, tuple(contents.notes))


def _world(contents: _Contents, frame: str) -> str | None:
    try:
        return contents.transforms.world_of(frame, contents.worlds)
    except ValueError as error:
        note_damage(contents.notes, f"clouds have no pose: {error}")
        return None


def _note_tilting(contents: _Contents, clouds: list[_Cloud]) -> None:
    """Add a note for each topic of a tilting 2-D laser: each scan sees only its own slanted plane."""
    scans = [cloud for cloud in clouds if cloud.kind == SCAN]
    for topic, frame in dict.fromkeys((cloud.topic, cloud.frame) for cloud in scans):
        times_ns = [cloud.t_ns for cloud in scans if cloud.topic == topic]
        tilt_deg = math.degrees(contents.transforms.tilt_rad(frame, times_ns))
        if tilt_deg > _MAX_TILT_DEG:
            line = f"the 2-D laser of {topic} tilts by {tilt_deg:.0f}°, so each scan sees its own slanted plane"
            note_damage(contents.notes, f"{line}; combine the scans of one sweep into a cloud first")


def _height_m(contents: _Contents, cloud: _Cloud) -> float | None:
    frames = contents.transforms.frames()
    prefixed = f"{cloud.frame.rpartition('/')[0]}/{FOOTPRINT}"
    footprint = prefixed if prefixed in frames else FOOTPRINT
    if footprint not in frames:
        return None
    try:
        pose = contents.transforms.lookup(footprint, cloud.frame, cloud.t_ns)
    except ValueError:
        return None
    return None if pose is None or pose.translation[2] <= 0 else float(pose.translation[2])


_CONVERTERS: dict[str, Callable[[Any], Sweep]] = {
    CLOUD: sweep_of_cloud, VELODYNE: sweep_of_velodyne, SCAN: sweep_of_scan, **dict.fromkeys(LIVOX, sweep_of_livox),
    **dict.fromkeys(PANDAR, sweep_of_hesai),
}  # fmt: skip
"""Message type → conversion to a sweep."""


@lru_cache(maxsize=4)
def _cached_decoder(metadata: str) -> OusterDecoder:
    return OusterDecoder(OusterMetadata.parse(metadata))


class BagRecording(RecordingSource):
    """One or more bags, opened by :meth:`open`; each bag is a scene, each topic with sweeps an agent.

    One pass over a bag indexes its clouds and transforms; clouds are decoded when they are read.
    """

    def __init__(self, place: Path, bags: Mapping[str, Bag], problems: Sequence[str]) -> None:
        self.place, self._bags = place, bags
        self.problems = problems
        self.sweeps = {name: bag.refs for name, bag in bags.items()}
        self.remarks = tuple(dict.fromkeys(f"{bag.path}: {line}" for bag in bags.values() for line in bag.notes))
        self._open: dict[str, BagFile] = {}
        self._process = os.getpid()

    def __reduce__(self) -> tuple[Any, ...]:
        return BagRecording, (self.place, self._bags, self.problems)

    @classmethod
    def open(cls, place: Path, topic: str | None = None) -> BagRecording:
        """Open the bags at a place; raise a one-line ValueError if none has a cloud (of the topic)."""
        decoder("cdr")
        root = place if place.is_dir() else place.parent
        damage: dict[str, None] = {}
        bags: dict[str, Bag] = {}
        for path in bags_in(place) or [place]:
            problems: list[str] = []
            scene = path.stem if path.stem not in bags else path.name
            bag = scan_bag(root, scene, path, problems, topic)
            damage |= dict.fromkeys(f"{path}: {line}" for line in problems)
            if bag is not None:
                bags[scene] = bag
        if not bags:
            raise ValueError("; ".join(damage))
        return cls(place, bags, tuple(damage))

    def _read(self, ref: SweepRef) -> Sweep:
        """Read a sweep in the frame of its header, with its pose if the transforms give it."""
        bag = self._bags[ref.scene]
        try:
            sweep = self._sweep(bag, ref)
        except (OSError, ImportError):
            raise
        except Exception as error:  # the decoder of rosbags raises a dozen types on damaged messages
            raise ValueError(f"{ref.file}: {ref.sensor} at {ref.t_ns} ns: {one_line(error)}") from error
        pose, covariance, height_m = bag.places[ref.index]
        return sweep.replace(
            agent=ref.agent, t_ns=ref.t_ns, world_from_sensor=pose, sensor_height_m=height_m, pose_covariance=covariance
        )

    def _sweep(self, bag: Bag, ref: SweepRef) -> Sweep:
        kind, decode = bag.kinds[ref.sensor], decoder(bag.encoding)
        messages = [decode(self._file(bag).message(where), kind) for where in ref.key.split(" ")]
        if kind in OUSTER:
            return sweep_of_ouster(messages, _cached_decoder(bag.metadata[ref.sensor]))
        return _CONVERTERS[kind](messages[0])

    def _file(self, bag: Bag) -> BagFile:
        """Return the open bag file; at most one is kept open, and reopened after a fork."""
        if self._process != os.getpid():
            self._open, self._process = {}, os.getpid()
        name = str(bag.path)
        if name not in self._open:
            for file in self._open.values():
                file.close()
            self._open = {name: open_bag(bag.root, bag.path)}
        return self._open[name]
