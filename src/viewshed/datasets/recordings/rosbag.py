"""One pass over a bag: which clouds it has, and where the sensor was at each.

Messages of one MCAP file, read record by record: a file that was cut off gives what lies before the cut.

Source: https://mcap.dev/spec. Every length is checked against what is there.

One bag as a stream of messages: ROS 1 files and ROS 2 folders through rosbags, single MCAP files by ourselves.

ROS 1 bags, ROS 2 bags and MCAP files: PointCloud2 as sweeps, poses from tf and odometry.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from viewshed.datasets.recordings.source import ObjectBox, SweepRef
from viewshed.datasets.recordings.tf_tree import WORLDS, TransformBuffer
from viewshed.geometry import Rigid
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.sweep import Sweep

MAGIC = b"\x89MCAP0\r\n"

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _END = 0x03, 0x04, 0x05, 0x06, (0x02, 0x0F)

_MAX_CHUNK_BYTES = 2_000_000_000


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it is stored.

    Attributes:
        topic: what it belongs to.
        kind: its type, as ROS 2 writes it.
        encoding: ``cdr`` or ``ros1``.
        t_ns: when it was recorded, nanoseconds.
        where: how :meth:`McapFile.message` finds it again.
        raw: its bytes.
    """

    topic: str
    kind: str
    encoding: str
    t_ns: int
    where: str
    raw: bytes


class McapFile:
    """One MCAP file, read from its start.

    Args:
        path: the file.

    Raises:
        ValueError: it does not begin like one.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = io.BytesIO()
        self._file = path.open("rb")
        self._size = path.stat().st_size
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, str]] = {}
        self._chunk: tuple[int, bytes] = (-1, b"")
        if self._file.read(len(MAGIC)) != MAGIC:
            self.close()
            raise ValueError("is no MCAP file: its first bytes are others")

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages, of the channels that were met so far."""
        return {topic: kind for topic, kind, _ in self._channels.values()}

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in the order of the file.

        Raises:
            ValueError: the file is damaged or cut off there; the messages before have been yielded.
        """
        for opcode, start, record in self._records():
            if opcode != _CHUNK:
                yield from self._take(opcode, record, f"{start}", kinds)
                continue
            content = self._unpacked(start, record)
            for inner, at, body in _split(content):
                yield from self._take(inner, body, f"{start}:{at}", kinds)

    def message(self, where: str) -> bytes:
        """Return the bytes of one message.

        Raises:
            ValueError: there is none, or its chunk is damaged.
        """
        start, _, at = where.partition(":")
        record = self._record_at(int(start))
        if not at:
            return record[22:]
        content = self._unpacked(int(start), record)
        (length,) = struct.unpack_from("<Q", content, int(at) - 8)
        return content[int(at) + 22 : int(at) + length]

    def _records(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield (opcode, first byte of the content, content) of each record; chunks are not unpacked."""
        at = len(MAGIC)
        while at < self._size:
            self._file.seek(at)
            head = self._file.read(9)
            if len(head) < 9:
                raise ValueError(f"is cut off at byte {at}")
            opcode, length = struct.unpack("<BQ", head)
            if opcode in _END:
                return
            if length > self._size - at - 9:
                raise ValueError(
                    f"is cut off: a record at byte {at} has {length} bytes, {self._size - at - 9} are left"
                )
            if opcode in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK):
                yield opcode, at + 9, self._file.read(length)
            at += 9 + length
        raise ValueError("is cut off: its end is missing")

    def _record_at(self, start: int) -> bytes:
        self._file.seek(start - 8)
        (length,) = struct.unpack("<Q", self._file.read(8))
        if length > self._size - start:
            raise ValueError(f"is cut off: a record at byte {start} has {length} bytes")
        return self._file.read(length)

    def _take(self, opcode: int, record: bytes, where: str, kinds: Collection[str]) -> Iterator[Message]:
        try:
            if opcode == _SCHEMA:
                self._schemas[struct.unpack_from("<H", record)[0]] = _text(record, 2)[0]
            elif opcode == _CHANNEL:
                self._take_channel(record)
            elif opcode == _MESSAGE:
                number, _, t_ns = struct.unpack_from("<HIQ", record)
                topic, kind, encoding = self._channels[number]
                if kind in kinds:
                    yield Message(topic, kind, encoding, t_ns, where, record[22:])
        except (struct.error, KeyError) as error:
            raise ValueError(f"is damaged: the record at {where} does not hold what it should: {error!r}") from error

    def _take_channel(self, record: bytes) -> None:
        number, schema = struct.unpack_from("<HH", record)
        topic, at = _text(record, 4)
        encoding, _ = _text(record, at)
        self._channels[number] = (topic, _ros2_name(self._schemas.get(schema, "")), encoding)

    def _unpacked(self, start: int, record: bytes) -> bytes:
        if self._chunk[0] == start:
            return self._chunk[1]
        try:
            (size,) = struct.unpack_from("<Q", record, 16)
            packing, at = _text(record, 28)
            (length,) = struct.unpack_from("<Q", record, at)
        except struct.error as error:
            raise ValueError(f"is damaged: the chunk at byte {start} is too short") from error
        packed = record[at + 8 : at + 8 + length]
        if len(packed) < length or size > _MAX_CHUNK_BYTES:
            raise ValueError(f"is damaged: the chunk at byte {start} names {length} and {size} bytes")
        self._chunk = (start, _unpack(packed, packing, size, start))
        return self._chunk[1]


def _unpack(packed: bytes, packing: str, size: int, start: int) -> bytes:
    import pyarrow as pa

    if packing not in ("", "lz4", "zstd"):
        raise ValueError(f"has a chunk packed as {packing!r}, which is not read")
    try:
        content = packed if not packing else pa.Codec(packing).decompress(packed, size, asbytes=True)
    except (OSError, ValueError, MemoryError) as error:
        raise ValueError(f"is damaged: the chunk at byte {start} does not unpack: {error}") from error
    if len(content) != size:
        raise ValueError(f"is damaged: the chunk at byte {start} unpacks to {len(content)} bytes, not {size}")
    return bytes(content)


def _split(content: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield (opcode, first byte of the content, content) of each record in an unpacked chunk."""
    at = 0
    while at < len(content):
        if at + 9 > len(content):
            raise ValueError("is damaged: a chunk ends within a record")
        opcode, length = struct.unpack_from("<BQ", content, at)
        if length > len(content) - at - 9:
            raise ValueError(f"is damaged: a record of {length} bytes leaves its chunk")
        yield opcode, at + 9, content[at + 9 : at + 9 + length]
        at += 9 + length


def _text(record: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", record, at)
    return record[at + 4 : at + 4 + length].decode("utf-8", "replace"), at + 4 + length


def _ros2_name(name: str) -> str:
    """Return a type's name as ROS 2 writes it.

    >>> _ros2_name("nav_msgs/Odometry")
    'nav_msgs/msg/Odometry'
    """
    package, _, rest = name.partition("/")
    return name if not rest or "/" in rest else f"{package}/msg/{rest}"


SUFFIXES = (".bag", ".mcap", ".db3")

TF = "tf2_msgs/msg/TFMessage"

_METADATA = "metadata.yaml"


class BagFile(Protocol):
    """One bag."""

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages; of an MCAP file those that were met so far."""
        ...

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types; a ValueError where the bag is damaged."""
        ...

    def message(self, where: str) -> bytes:
        """Return the bytes of one message; a ValueError where it is not there."""
        ...

    def close(self) -> None:
        """Close the bag."""
        ...


def bags_in(place: Path) -> list[Path]:
    """Return the bags at a place, by names alone: itself, or those in the folder, in alphabetical order."""
    if place.is_file():
        return [place] if place.suffix in SUFFIXES else []
    if _is_ros2(place):
        return [place]
    return sorted(path for path in place.iterdir() if path.suffix in SUFFIXES or (path.is_dir() and _is_ros2(path)))


def _is_ros2(folder: Path) -> bool:
    return (folder / _METADATA).is_file()


def open_bag(path: Path) -> BagFile:
    """Return an opened bag.

    Raises:
        ValueError: it is damaged or of no kind that is read.
        ImportError: the extra ``bags`` is not installed.
        OSError: it cannot be read.
    """
    decoder("cdr")
    if path.is_dir() and not _is_ros2(path):
        raise ValueError(f"has no {_METADATA}; write it with: ros2 bag reindex")
    if path.suffix == ".db3" and path.is_file():
        raise ValueError(f"is one file of a ROS 2 bag; name its folder, which must hold {_METADATA}")
    return McapFile(path) if path.suffix == ".mcap" and path.is_file() else RosbagFile(path)


@lru_cache(maxsize=2)
def decoder(encoding: str) -> Callable[[bytes, str], Any]:
    """Return what turns the bytes of a message and the name of its type into an object.

    Raises:
        ImportError: the extra ``bags`` is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise ImportError("bags need rosbags: pip install 'viewshed[bags]'") from error
    if encoding == "ros1":
        store = get_typestore(Stores.ROS1_NOETIC)
        if TF not in store.types:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        return store.deserialize_ros1
    return get_typestore(Stores.ROS2_FOXY).deserialize_cdr


class RosbagFile:
    """A ROS 1 bag or the folder of a ROS 2 bag.

    Args:
        path: where it lies.

    Raises:
        ValueError: it is damaged.
    """

    def __init__(self, path: Path) -> None:
        from rosbags import rosbag1, rosbag2

        self._encoding = "cdr" if path.is_dir() else "ros1"
        self._reader: Any = None
        try:
            self._reader = rosbag2.Reader(path) if path.is_dir() else rosbag1.Reader(path)
            self._reader.open()
        except Exception as error:  # rosbags raises a dozen types on damaged bags
            self.close()
            raise ValueError(_problem(error)) from error

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Close the bag."""
        with contextlib.suppress(Exception):  # rosbags asserts that it was open
            self._reader.close()

    @property
    def types(self) -> dict[str, str]:
        """Topic → type of its messages."""
        return {connection.topic: connection.msgtype for connection in self._reader.connections}

    def messages(self, kinds: Collection[str]) -> Iterator[Message]:
        """Yield the messages of some types, in the order of recording.

        Raises:
            ValueError: the bag is damaged there; the messages before have been yielded.
        """
        topics = sorted({connection.topic for connection in self._reader.connections})
        last: dict[str, tuple[int, int]] = {}
        wanted = [connection for connection in self._reader.connections if connection.msgtype in kinds]
        for connection, t_ns, raw in self._read(wanted):
            topic = connection.topic
            before = last.get(topic, (t_ns, -1))
            last[topic] = (t_ns, before[1] + 1 if before[0] == t_ns else 0)
            where = f"{topics.index(topic)}:{t_ns}:{last[topic][1]}"
            yield Message(topic, connection.msgtype, self._encoding, t_ns, where, bytes(raw))

    def message(self, where: str) -> bytes:
        """Return the bytes of one message.

        Raises:
            ValueError: it is not there any more, or damaged.
        """
        number, t_ns, nth = map(int, where.split(":"))
        topic = sorted({connection.topic for connection in self._reader.connections})[number]
        same = [connection for connection in self._reader.connections if connection.topic == topic]
        for at, (_, _, raw) in enumerate(self._read(same, t_ns)):
            if at == nth:
                return bytes(raw)
        raise ValueError(f"{topic} has no message at {t_ns} ns any more")

    def _read(self, connections: list[Any], t_ns: int | None = None) -> Iterator[tuple[Any, int, bytes]]:
        if not connections:
            return
        stop = None if t_ns is None else t_ns + 1
        try:
            yield from self._reader.messages(connections=connections, start=t_ns, stop=stop)
        except Exception as error:  # as when opening
            raise ValueError(_problem(error)) from error


def _problem(error: Exception) -> str:
    words = " ".join(str(error).split())
    return f"is damaged or of a kind that is not read: {words or type(error).__name__}"


CLOUD, ODOMETRY = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"

TRANSFORMS = (TF, "tf/msg/tfMessage")

PACKETS = ("velodyne_msgs/msg/VelodyneScan", "pandar_msgs/msg/PandarScan", "ouster_ros/msg/PacketMsg",
           "ouster_sensor_msgs/msg/PacketMsg", "livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg",
           "nebula_msgs/msg/NebulaPackets")  # fmt: skip
"""Types of messages that hold a LiDAR's returns and are not read."""

FOOTPRINT = "base_footprint"
"""The frame on the ground below a robot (ROS enhancement proposal 120); it tells the height of the sensor."""

_ODOMETRY_CHILD = "base_link"


@dataclass(frozen=True, slots=True)
class _Cloud:
    """One cloud as listed: its topic, its header, where it is."""

    topic: str
    t_ns: int
    frame: str
    where: str


@dataclass(slots=True, eq=False)
class _Found:
    """What one pass over a bag gives."""

    clouds: list[_Cloud] = field(default_factory=list)
    transforms: TransformBuffer = field(default_factory=TransformBuffer)
    odometry: dict[str, list[Any]] = field(default_factory=dict)
    worlds: list[str] = field(default_factory=lambda: list(WORLDS))


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """One bag as listed.

    Attributes:
        path: where it lies.
        refs: its clouds, in the order of time.
        poses: ``world_from_sensor`` of each, or None.
        heights_m: height of the sensor above the ground at each, or None.
        encoding: how its messages are written, ``cdr`` or ``ros1``.
    """

    path: Path
    refs: tuple[SweepRef, ...]
    poses: tuple[Rigid | None, ...]
    heights_m: tuple[float | None, ...]
    encoding: str


def scan_bag(scene: str, path: Path, damage: list[str]) -> Bag | None:
    """Return what a bag holds, or None where it has no clouds; what is wrong is added to a list."""
    try:
        file = open_bag(path)
    except (ValueError, OSError) as error:
        damage.append(one_line(error))
        return None
    found, encoding = _Found(), "cdr"
    try:
        for message in file.messages((CLOUD, ODOMETRY, *TRANSFORMS)):
            encoding = message.encoding
            _take(found, message, damage)
    except (ValueError, OSError) as error:
        damage.append(f"{one_line(error)}; {len(found.clouds)} clouds before that are kept")
    finally:
        types = file.types
        file.close()
    _tell_topics(types, found, damage)
    return _bag_of(scene, path, found, encoding, damage) if found.clouds else None


def _take(found: _Found, message: Message, damage: list[str]) -> None:
    try:
        if message.encoding not in ("cdr", "ros1"):
            raise ValueError(f"messages must be written as cdr or ros1, got {message.encoding!r}")
        if message.kind == CLOUD:
            t_ns, frame = _header(message)
            found.clouds.append(_Cloud(message.topic, t_ns, frame, message.where))
            return
        decoded = decoder(message.encoding)(message.raw, TF if message.kind in TRANSFORMS else message.kind)
        if message.kind == ODOMETRY:
            found.odometry.setdefault(message.topic, []).append(decoded)
        else:
            _take_transforms(found, decoded, message.topic.endswith("static"), damage)
    except Exception as error:  # the decoder of rosbags raises a dozen types on damaged messages
        damage.append(f"{message.topic}: a message is damaged and left out: {one_line(error)}")


def _header(message: Message) -> tuple[int, str]:
    """Return stamp (ns) and frame of a message that begins with a header; the time of recording where it has no stamp.

    The clouds are not decoded for that: a bag is listed as fast as it is read.
    """
    raw = message.raw
    little = message.encoding == "ros1" or raw[1:2] in (b"\x01", b"\x03")
    seconds, nanoseconds, length = struct.unpack_from("<III" if little else ">III", raw, 4)
    if length > len(raw) - 16:
        raise ValueError("its header is cut off")
    name = raw[16 : 16 + length].rstrip(b"\x00").decode("utf-8", "replace")
    return seconds * 1_000_000_000 + nanoseconds or message.t_ns, name.lstrip("/")


def _take_transforms(found: _Found, decoded: Any, static: bool, damage: list[str]) -> None:
    for transform in decoded.transforms:
        try:
            _add(found.transforms, transform.header, transform.child_frame_id, transform.transform.translation,
                 transform.transform.rotation, static=static)  # fmt: skip
        except ValueError as error:
            damage.append(f"tf: {one_line(error)}; left out")


def _add(buffer: TransformBuffer, header: Any, child: str, where: Any, turn: Any, *, static: bool = False) -> None:
    t_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    buffer.add(
        header.frame_id, child, t_ns, (where.x, where.y, where.z), (turn.w, turn.x, turn.y, turn.z), static=static
    )


def _tell_topics(types: dict[str, str], found: _Found, damage: list[str]) -> None:
    heard = {cloud.topic for cloud in found.clouds}
    for topic, kind in sorted(types.items()):
        if kind == CLOUD and topic not in heard:
            damage.append(f"topic {topic} has no cloud")
        elif kind in PACKETS:
            damage.append(f"topic {topic} has {kind}, which is not read; record PointCloud2")
    if not heard and CLOUD not in types.values():
        topics = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(types.items())) or "none"
        damage.append(f"no topic has {CLOUD}; topics that exist: {topics}")


def _take_odometry(found: _Found, damage: list[str]) -> None:
    """Add odometry as a transform, where tf does not already place its child frame."""
    placed: dict[str, str] = {}
    for topic, messages in sorted(found.odometry.items()):
        for odometry in messages:
            child = (odometry.child_frame_id or _ODOMETRY_CHILD).lstrip("/")
            if found.transforms.has_parent(child) and placed.get(child) != topic:
                continue
            placed[child] = topic
            pose = odometry.pose.pose
            try:
                _add(found.transforms, odometry.header, child, pose.position, pose.orientation)
                found.worlds.append(odometry.header.frame_id.lstrip("/"))
            except ValueError as error:
                damage.append(f"{topic}: {one_line(error)}; left out")
    found.worlds = list(dict.fromkeys(found.worlds))


def _bag_of(scene: str, path: Path, found: _Found, encoding: str, damage: list[str]) -> Bag:
    _take_odometry(found, damage)
    clouds = sorted(found.clouds, key=lambda cloud: (cloud.t_ns, cloud.topic))
    topics = dict.fromkeys(cloud.topic for cloud in clouds)
    refs = tuple(
        SweepRef(scene, index, str(path), cloud.t_ns, cloud.topic.strip("/") if len(topics) > 1 else "ego",
                 cloud.topic, key=cloud.where)
        for index, cloud in enumerate(clouds)
    )  # fmt: skip
    worlds = {frame: _world(found, frame, damage) for frame in dict.fromkeys(cloud.frame for cloud in clouds)}
    poses = tuple(_pose(found, worlds[cloud.frame], cloud) for cloud in clouds)
    for topic in topics:
        at = [poses[index] for index, cloud in enumerate(clouds) if cloud.topic == topic and worlds[cloud.frame]]
        if at.count(None):
            damage.append(f"{at.count(None)} of {len(at)} clouds of {topic} lie outside the times of the transforms "
                          f"and have no pose")  # fmt: skip
    return Bag(path, refs, poses, tuple(_height_m(found, cloud) for cloud in clouds), encoding)


def _world(found: _Found, frame: str, damage: list[str]) -> str | None:
    try:
        return found.transforms.world_of(frame, found.worlds)
    except ValueError as error:
        damage.append(f"clouds have no pose: {error}")
        return None


def _pose(found: _Found, world: str | None, cloud: _Cloud) -> Rigid | None:
    return None if world is None else found.transforms.lookup(world, cloud.frame, cloud.t_ns)


def _height_m(found: _Found, cloud: _Cloud) -> float | None:
    if FOOTPRINT not in found.transforms.frames():
        return None
    try:
        pose = found.transforms.lookup(FOOTPRINT, cloud.frame, cloud.t_ns)
    except ValueError:
        return None
    return None if pose is None or pose.translation[2] <= 0 else float(pose.translation[2])


def one_line(error: BaseException) -> str:
    """Return an error's message without line breaks."""
    return " ".join(str(error).split()) or type(error).__name__


LAYOUT = "a .bag or .mcap file, a folder with metadata.yaml, or a folder of these"


class BagRecording:
    """One bag or several, from :meth:`open`; each is a scene, each topic of PointCloud2 an agent.

    One pass over a bag lists its clouds and takes its transforms; the clouds themselves are read when asked for.

    Args:
        bags: name → bag.
        damage: what was found wrong.
    """

    def __init__(self, bags: dict[str, Bag], damage: tuple[str, ...] = ()) -> None:
        self._bags = bags
        self._damage = damage
        self._open: dict[str, BagFile] = {}
        self._process = os.getpid()

    def __getstate__(self) -> tuple[dict[str, Bag], tuple[str, ...]]:
        return self._bags, self._damage

    def __setstate__(self, state: tuple[dict[str, Bag], tuple[str, ...]]) -> None:
        self.__init__(*state)  # type: ignore[misc]

    @classmethod
    def open(cls, place: Path) -> BagRecording:
        """Return the bags at a place.

        Raises:
            ValueError: there is none, or none of them has a cloud; one line that says why.
            ImportError: the extra ``bags`` is not installed.
            OSError: it cannot be read.
        """
        decoder("cdr")
        damage: dict[str, None] = {}
        bags: dict[str, Bag] = {}
        for path in bags_in(place) or [place]:
            said: list[str] = []
            scene = path.stem if path.stem not in bags else path.name
            bag = scan_bag(scene, path, said)
            damage |= dict.fromkeys(f"{path}: {line}" for line in said)
            if bag is not None:
                bags[scene] = bag
        if not bags:
            raise ValueError("; ".join(damage))
        return cls(bags, tuple(damage))

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the bags, without their endings."""
        return tuple(self._bags)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the clouds of a bag in the order of their headers' times.

        Raises:
            ValueError: there is no such bag.
        """
        return self._bag(scene).refs

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep in the frame of its header, with its pose where transforms lead to it.

        Raises:
            ValueError: the message is damaged; one line that names the file and the topic.
            OSError: the bag cannot be read.
        """
        bag = self._bag(ref.scene)
        try:
            cloud = decoder(bag.encoding)(self._file(bag).message(ref.key), CLOUD)
            sweep = sweep_of_cloud(cloud)
        except OSError:
            raise
        except Exception as error:  # the decoder of rosbags raises a dozen types on damaged messages
            raise ValueError(f"{ref.file}: {ref.sensor} at {ref.t_ns} ns: {one_line(error)}") from error
        return sweep.replace(
            agent=ref.agent, t_ns=ref.t_ns, world_from_sensor=bag.poses[ref.index],
            sensor_height_m=bag.heights_m[ref.index],
        )  # fmt: skip

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return None: bags hold no annotations that are read."""
        self._bag(ref.scene)
        return None

    def damage(self) -> tuple[str, ...]:
        """Return what is wrong with the bags: damaged ones, empty topics, sweeps without a pose."""
        return self._damage

    def _bag(self, scene: str) -> Bag:
        if scene not in self._bags:
            raise ValueError(f"scene must be one of {', '.join(self._bags)}, got {scene!r}")
        return self._bags[scene]

    def _file(self, bag: Bag) -> BagFile:
        """Return the opened bag; only one is kept open, and none that another process opened."""
        if self._process != os.getpid():
            self._open, self._process = {}, os.getpid()
        name = str(bag.path)
        if name not in self._open:
            for file in self._open.values():
                file.close()
            self._open = {name: open_bag(bag.path)}
        return self._open[name]


def is_bag(place: Path) -> bool:
    """Return whether a place is a bag or a folder of bags, by names alone."""
    return bool(bags_in(place))
