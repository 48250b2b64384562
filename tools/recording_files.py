"""Build small valid recordings of every layout, for tests with links and damage, and for fuzzing."""

from __future__ import annotations

import io
import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from sweep_files import INTENSITY, POINTS, npy, pcd, rows, text

Files = dict[str, bytes]
"""Path below the recording's folder → content."""

KITTI = rows(POINTS, INTENSITY)
RIGID_LINE = "1 0 0 0 0 1 0 0 0 0 1 0"
OXTS = "49.0 8.4 110.0 0.01 0.02 0.5" + " 0" * 24 + "\n"
TRACKLETS = """<?xml version="1.0"?><boost_serialization><tracklets><count>1</count><item><objectType>Car</objectType>
<h>1.5</h><w>1.6</w><l>4.0</l><first_frame>0</first_frame><poses><count>1</count><item><tx>5</tx><ty>1</ty><tz>-1</tz>
<rz>0.3</rz></item></poses></item></tracklets></boost_serialization>"""
OPV2V = """lidar_pose: [10.0, 2.0, 1.9, 0.0, 90.0, 0.0]
true_ego_pos: [10.0, 2.0, 0.05, 0.0, 90.0, 0.0]
shared: &size [2.0, 1.0, 0.75]
vehicles:
  304:
    angle: [0, 90.0, 0]
    center: [0.5, 0, 0.7]
    extent: *size
    location: [8.0, 3.0, 0.1]
    obj_type: Car
"""
PROTOCOL = """world: {fixed_delta_seconds: 0.1}
vehicle_base:
  sensing: {perception: {lidar: {channels: 4, upper_fov: 2.0, lower_fov: -25.0, range: 120.0,
    points_per_second: 40000, rotation_frequency: 10}}}
"""


def nuscenes() -> Files:
    """Return a nuScenes scene of one keyframe and one sweep, with a box."""
    still = {"rotation": [1.0, 0.0, 0.0, 0.0], "translation": [0.9, 0.0, 1.84]}
    names = [f"samples/LIDAR_TOP/a__LIDAR_TOP__15315555555555{number:02d}.pcd.bin" for number in range(2)]
    box = {"translation": [5.0, 1.0, 0.8], "rotation": [0.0, 0.0, 0.0, 1.0], "size": [1.9, 4.6, 1.7]}
    tables: dict[str, list[dict[str, Any]]] = {
        "sensor": [{"token": "se", "channel": "LIDAR_TOP"}],
        "calibrated_sensor": [{"token": "ca", "sensor_token": "se", **still}],
        "scene": [{"token": "sc", "name": "scene-1"}],
        "sample": [{"token": "sa", "scene_token": "sc"}],
        "ego_pose": [{"token": "po", **still}],
        "sample_data": [
            {"token": f"sd{number}", "sample_token": "sa", "calibrated_sensor_token": "ca", "ego_pose_token": "po",
             "timestamp": 1531555555555500 + number, "is_key_frame": number == 0, "filename": name}
            for number, name in enumerate(names)
        ],
        "category": [{"token": "k", "name": "vehicle.car"}],
        "instance": [{"token": "i", "category_token": "k"}],
        "sample_annotation": [{"token": "an", "sample_token": "sa", "instance_token": "i", **box}],
    }  # fmt: skip
    files = {f"v1.0-mini/{name}.json": json.dumps(table, indent=0).encode() for name, table in tables.items()}
    return files | {name: rows(POINTS, INTENSITY, np.arange(6)) for name in names}


def kitti_raw() -> Files:
    """Return a KITTI raw drive of two sweeps, with OXTS records and a tracklet."""
    drive = "2011_09_26/2011_09_26_drive_0001_sync"
    return {
        "2011_09_26/calib_imu_to_velo.txt": b"R: 1 0 0 0 1 0 0 0 1\nT: 0.8 -0.3 0.8\n",
        f"{drive}/velodyne_points/timestamps.txt": b"2011-09-26 13:02:25.96\n2011-09-26 13:02:26.06\n",
        f"{drive}/tracklet_labels.xml": TRACKLETS.encode(),
        **{f"{drive}/velodyne_points/data/{number:010d}.bin": KITTI for number in range(2)},
        **{f"{drive}/oxts/data/{number:010d}.txt": OXTS.encode() for number in range(2)},
    }


def kitti_odometry() -> Files:
    """Return a KITTI odometry sequence of one sweep, with its pose."""
    return {
        "sequences/00/velodyne/000000.bin": KITTI, "sequences/00/times.txt": b"0.5\n",
        "sequences/00/calib.txt": f"Tr: {RIGID_LINE}\n".encode(), "poses/00.txt": f"{RIGID_LINE}\n".encode(),
    }  # fmt: skip


def kitti_object() -> Files:
    """Return one sweep of the KITTI object set, with a label."""
    calibration = f"R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {RIGID_LINE}\n"
    label = "Car 0 0 0 0 0 50 50 1.5 1.6 4.0 1.0 1.6 8.0 0.3\n"
    return {
        "training/velodyne/000007.bin": KITTI, "training/calib/000007.txt": calibration.encode(),
        "training/label_2/000007.txt": label.encode(),
    }  # fmt: skip


def opv2v() -> Files:
    """Return one sweep of a car in OPV2V's layout, with a labeled vehicle and the protocol."""
    points = pcd(text(np.column_stack((POINTS, INTENSITY))), "ascii")
    return {
        "s/641/000068.pcd": points, "s/641/000068.yaml": OPV2V.encode(), "s/data_protocol.yaml": PROTOCOL.encode(),
    }  # fmt: skip


def carla() -> Files:
    """Return one sweep of a CARLA recording, with pose, sensor and actor."""
    actor = {
        "id": 3, "type": "vehicle", "x": 8, "y": 3, "z": 0.7, "roll": 0, "pitch": 0, "yaw": 30, "extent": [2, 1, 1],
    }  # fmt: skip
    beams = {"channels": 4, "upper_fov_deg": 10, "lower_fov_deg": -20, "range_m": 80, "points_per_second": 16000}
    sensor = {"sensor_height_m": 2.0, "lidar": beams | {"rotation_hz": 10}}
    return {
        "recording.json": json.dumps({"axes": "carla", "agents": {"car": sensor}}).encode(),
        "actors.jsonl": (json.dumps({"frame": 5, "t_ns": 7, "actors": [actor]}) + "\n").encode(),
        "car/poses.csv": b"frame,t_ns,x,y,z,roll,pitch,yaw\n5,7,10,2,1,0,0,90\n",
        "car/000005.npy": npy(POINTS),
    }


def feather(**columns: Any) -> bytes:
    """Return a feather file with these columns."""
    import pyarrow as pa
    from pyarrow import feather as arrow

    file = io.BytesIO()
    arrow.write_feather(pa.table(columns), file, compression="lz4")
    return file.getvalue()


def argoverse2() -> Files:
    """Return one sweep of an Argoverse 2 log with its pose and a box."""
    sweep = dict(zip("xyz", POINTS.astype(np.float16).T, strict=True)) | {
        "intensity": np.arange(6, dtype=np.uint8), "laser_number": np.arange(6, dtype=np.uint8),
        "offset_ns": np.arange(6, dtype=np.int32),
    }  # fmt: skip
    time = {"timestamp_ns": np.array([315966265259836000])}
    turned = {"qw": [0.8], "qx": [0.0], "qy": [0.0], "qz": [0.6]}
    box = {"length_m": [4.0], "width_m": [1.8], "height_m": [1.5], "tx_m": [8.0], "ty_m": [3.0], "tz_m": [0.7]}
    names = {"category": ["REGULAR_VEHICLE"], "track_uuid": ["a-1"]}
    return {
        "log/sensors/lidar/315966265259836000.feather": feather(**sweep),
        "log/city_SE3_egovehicle.feather": feather(**time, **turned, tx_m=[5224.0], ty_m=[2384.0], tz_m=[69.0]),
        "log/annotations.feather": feather(**time, **turned, **box, **names, num_interior_pts=[41]),
    }


def cloud(ros1: bool) -> tuple[Any, bytes]:
    """Return a type store, and a PointCloud2 of :data:`POINTS` serialized with it."""
    from rosbags.typesys import Stores, get_typestore

    store: Any = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_FOXY)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](5, 0)
    header = types["std_msgs/msg/Header"](*((0, stamp, "lidar") if ros1 else (stamp, "lidar")))
    fields = [types["sensor_msgs/msg/PointField"](name, 4 * axis, 7, 1) for axis, name in enumerate("xyz")]
    data = np.frombuffer(POINTS.tobytes(), np.uint8)
    message = types["sensor_msgs/msg/PointCloud2"](header, 1, 6, fields, False, 12, 72, data, True)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    return store, bytes(serialize(message, "sensor_msgs/msg/PointCloud2"))


def ros1_bag(packing: str = "") -> bytes:
    """Return a ROS 1 bag of two clouds; ``packing`` is "", bz2 or lz4."""
    from rosbags.rosbag1 import Writer

    store, raw = cloud(ros1=True)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.bag"
        writer: Any = Writer(path)
        if packing:
            writer.set_compression(Writer.CompressionFormat[packing.upper()])
        with writer:
            connection = writer.add_connection("/points", "sensor_msgs/msg/PointCloud2", typestore=store)
            for number in range(2):
                writer.write(connection, 10 + number, raw)
        return path.read_bytes()


def db3(statements: tuple[str, ...] = (), raw: bytes | None = None) -> bytes:
    """Return a ROS 2 bag (SQLite) of two clouds; further statements may damage it."""
    raw = cloud(ros1=False)[1] if raw is None else raw
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        base = sqlite3.connect(path)
        base.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format, qos)")
        base.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        base.execute("INSERT INTO topics VALUES (1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr', '')")
        base.executemany("INSERT INTO messages VALUES (?, 1, ?, ?)", [(number, number, raw) for number in (1, 2)])
        for statement in statements:
            base.execute(statement)
        base.commit()
        base.close()
        return path.read_bytes()


def mcap(packing: str = "ZSTD") -> bytes:
    """Return an MCAP file of two clouds, written by the ``mcap`` package."""
    from mcap.writer import CompressionType, Writer

    raw = cloud(ros1=False)[1]
    file = io.BytesIO()
    writer: Any = Writer(file, compression=CompressionType[packing], chunk_size=100)
    writer.start("ros2")
    schema = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"")
    channel = writer.register_channel("/points", "cdr", schema)
    for number in range(2):
        writer.add_message(channel, 10 + number, raw, 10 + number)
    writer.finish()
    return file.getvalue()


def recordings() -> dict[str, Files]:
    """Return the files of a small recording of every kind, by a unique name."""
    return {
        "nuscenes": nuscenes(), "kitti_raw": kitti_raw(), "kitti_odometry": kitti_odometry(),
        "kitti_object": kitti_object(), "opv2v": opv2v(), "carla": carla(), "argoverse2": argoverse2(),
        "ros1 bag": {"a.bag": ros1_bag()}, "db3": {"a.db3": db3()}, "mcap": {"a.mcap": mcap()},
        "ros2 folder": {"a/a_0.db3": db3(), "a/metadata.yaml": b""},
    }  # fmt: skip


def write(folder: Path, files: Files) -> Path:
    """Write the files of a recording and return its folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


@contextmanager
def written(files: Files) -> Iterator[Path]:
    """Yield the folder of a recording, and remove it at the end."""
    with TemporaryDirectory() as folder:
        yield write(Path(folder), files)
