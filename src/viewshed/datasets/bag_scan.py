"""One pass over a bag: which clouds it has, and where the sensor was at each."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viewshed.datasets.bag_files import TF, decoder, open_bag
from viewshed.datasets.mcap import Message
from viewshed.datasets.source import SweepRef
from viewshed.datasets.transforms import WORLDS, TransformBuffer
from viewshed.geometry import Rigid

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
