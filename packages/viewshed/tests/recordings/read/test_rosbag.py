"""Bags that the tests write: ROS 1, ROS 2 in SQLite, MCAP; real and made-up clouds, transforms, and damage."""

import pickle
import re
import struct
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree
from tests.io.test_hostile_files import mcap_chunk, ros1_chunk, ros1_fields, ros1_indexes

from viewshed.io import read_sweep
from viewshed.recordings.read import open_source
from viewshed.recordings.read.bag_files import bags_in, open_bag
from viewshed.recordings.read.source import each_sweep
from viewshed.recordings.recording import open_recording
from viewshed.sweep import Sweep

pytest.importorskip("rosbags", reason="rosbags is not installed: bags are not tested")
pytest.importorskip("mcap", reason="mcap is not installed: its files are not compared")
recording_files: Any = import_module("recording_files")
sweep_files: Any = import_module("sweep_files")
CLOUD, TF, ODOMETRY = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
S = 1_000_000_000
POINTS = np.array([[5.0, 3.0, -1.5], [8.0, -2.0, 0.5], [-4.0, 1.0, 0.25]], np.float32)
TURN = 0.5**0.5  # cosine and sine of 45 degrees: a turn of 90
UNTURNED, LEFT, NOTHING_STATED = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, TURN, TURN), np.zeros((6, 6))
Entry = tuple[str, int, Any]
Write = Callable[[Path, Iterable[Entry]], Path]


@dataclass
class Ros:
    """Messages of one ROS version."""

    one: bool

    @cached_property
    def store(self) -> Any:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC if self.one else Stores.ROS2_FOXY)
        if TF not in store.types:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        return store

    def make(self, kind: str, *values: Any) -> Any:
        """Return a message of a kind, PACKAGE/NAME."""
        return self.store.types[kind.replace("/", "/msg/")](*values)

    def header(self, t_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/Time", t_ns // S, t_ns % S)
        return self.make("std_msgs/Header", *((0,) if self.one else ()), stamp, frame)

    def cloud(self, t_ns: int, table: NDArray[Any] | None = None, frame: str = "lidar") -> Any:
        table = _table(POINTS) if table is None else table
        codes, named = {"f4": 7, "f8": 8, "i2": 3, "u2": 4, "u4": 6}, dict(table.dtype.fields or {})
        fields = [
            self.make("sensor_msgs/PointField", name, kind[1], codes[kind[0].str[1:]], 1)
            for name, kind in named.items()
        ]
        data, step = np.frombuffer(table.tobytes(), np.uint8), table.dtype.itemsize
        head = self.header(t_ns, frame)
        return self.make("sensor_msgs/PointCloud2", head, 1, len(table), fields, False, step, data.size, data, True)

    def tf(
        self, t_ns: int, parent: str, child: str, where: Iterable[float], turn_xyzw: Iterable[float] = UNTURNED
    ) -> Any:
        vector, turn = self.make("geometry_msgs/Vector3", *where), self.make("geometry_msgs/Quaternion", *turn_xyzw)
        moved = self.make("geometry_msgs/Transform", vector, turn)
        stamped = self.make("geometry_msgs/TransformStamped", self.header(t_ns, parent), child, moved)
        return self.make("tf2_msgs/TFMessage", [stamped])

    def odometry(
        self, t_ns: int, parent: str, child: str, where: Iterable[float], turn_xyzw: Iterable[float] = UNTURNED,
        covariance: NDArray[np.float64] = NOTHING_STATED,
    ) -> Any:  # fmt: skip
        point, turn = self.make("geometry_msgs/Point", *where), self.make("geometry_msgs/Quaternion", *turn_xyzw)
        pose = self.make(
            "geometry_msgs/PoseWithCovariance", self.make("geometry_msgs/Pose", point, turn), covariance.ravel()
        )
        twist = self.make("geometry_msgs/Twist", *[self.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)] * 2)
        twist = self.make("geometry_msgs/TwistWithCovariance", twist, np.zeros(36))
        return self.make("nav_msgs/Odometry", self.header(t_ns, parent), child, pose, twist)


ROS1, ROS2 = Ros(True), Ros(False)


def _table(points: NDArray[np.float32]) -> NDArray[Any]:
    table = np.zeros(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    return table


def write_ros1(path: Path, entries: Iterable[Entry]) -> Path:
    from rosbags.rosbag1 import Writer

    place = path.with_suffix(".bag")
    _write(Writer(place), ROS1.store, "serialize_ros1", entries)
    return place


def write_ros2(path: Path, entries: Iterable[Entry]) -> Path:
    from rosbags.rosbag2 import Writer

    _write(Writer(path, version=8), ROS2.store, "serialize_cdr", entries)
    return path


def _write(writer: Any, store: Any, serialize: str, entries: Iterable[Entry]) -> None:
    connections: dict[str, Any] = {}
    with writer:
        for topic, t_ns, message in entries:
            kind = message if isinstance(message, str) else message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            if not isinstance(message, str):
                writer.write(connections[topic], t_ns, bytes(getattr(store, serialize)(message, kind)))


MAGIC = b"\x89MCAP0\r\n"


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def write_mcap(path: Path, entries: Iterable[Entry], packing: str = "zstd") -> Path:
    """A file of the ``mcap`` package, a chunk for each message and no index."""
    from mcap.writer import CompressionType, IndexType, Writer

    place, kept = path.with_suffix(".mcap"), list(entries)
    kinds = {topic: each if isinstance(each, str) else each.__msgtype__ for topic, _, each in kept}
    with place.open("wb") as file:
        bare = dict.fromkeys(("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"), False)
        packed = CompressionType[packing.upper() or "NONE"]
        writer = Writer(file, chunk_size=1, compression=packed, index_types=IndexType.NONE, **bare)
        writer.start("ros2", "test")
        channels = {
            topic: writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))
            for topic, kind in kinds.items()
        }
        for topic, t_ns, message in kept:
            if not isinstance(message, str):
                raw = bytes(ROS2.store.serialize_cdr(message, kinds[topic]))
                writer.add_message(channels[topic], t_ns, raw, t_ns)
        writer.finish()
    return place


KINDS = pytest.mark.parametrize(
    ("ros", "write"), [(ROS1, write_ros1), (ROS2, write_ros2), (ROS2, write_mcap)], ids=["ros1", "ros2", "mcap"]
)


def _world(source: Any, ref: Any) -> NDArray[np.float64]:
    sweep = source.read(ref)
    return np.asarray(sweep.world_from_sensor @ sweep.points)


@KINDS
def test_poses_from_a_chain_of_transforms_by_hand(tmp_path: Path, ros: Ros, write: Write) -> None:
    # map -> odom is 100 m east; odom -> base moves from x = 0 to x = 4 while it turns left by 90 degrees, in 1 s; the
    # lidar is 1 m ahead of the base and 2 m above it, turned left by 90 degrees. Half way: base at (102, 0), heading 45
    # degrees; the lidar's x axis points to 135 degrees and the lidar is at (102 + c, c, 2), c = cos 45 degrees.
    entries: list[Entry] = [
        ("/tf_static", 0, ros.tf(0, "base_link", "lidar", (1.0, 0.0, 2.0), LEFT)),
        ("/tf", 0, ros.tf(0, "map", "odom", (100.0, 0.0, 0.0))),
        ("/tf", 1, ros.tf(0, "odom", "base_link", (0.0, 0.0, 0.0))),
        ("/points", 2, ros.cloud(S // 2)),
        ("/tf", 3, ros.tf(S, "map", "odom", (100.0, 0.0, 0.0))),
        ("/tf", 4, ros.tf(S, "odom", "base_link", (4.0, 0.0, 0.0), LEFT)),
        ("/points", 5, ros.cloud(S)),
        ("/points", 6, ros.cloud(S + 1)),
    ]
    source = open_source(write(tmp_path / "a", entries))
    refs = source.refs("a")
    x, y, z = POINTS.T.astype(np.float64)
    c = TURN
    half = np.column_stack([102 + c - c * x - c * y, c + c * x - c * y, z + 2])
    np.testing.assert_allclose(_world(source, refs[0]), half, atol=1e-5)
    np.testing.assert_allclose(_world(source, refs[1]), np.column_stack([104 - x, 1 - y, z + 2]), atol=1e-5)
    assert source.read(refs[2]).world_from_sensor is None
    assert any("1 of 3 clouds of /points lie outside the times" in line for line in source.notes())


@KINDS
def test_poses_are_not_made_up_in_a_gap_but_an_equal_transform_holds(tmp_path: Path, ros: Ros, write: Write) -> None:
    entries: list[Entry] = [
        *(("/tf", t_s, ros.tf(t_s * S, "odom", "lidar", (x, 0.0, 0.0))) for t_s, x in ((0, 0.0), (2, 2.0), (9, 4.0))),
        *(("/tf", t_s, ros.tf(t_s * S, "map", "odom", (1.0, 0.0, 0.0))) for t_s in (0, 9)),
        *(("/points", t_s, ros.cloud(t_s * S)) for t_s in (1, 5, 9)),
    ]
    source = open_source(write(tmp_path / "a", entries))
    poses = [sweep.world_from_sensor for _, sweep in each_sweep(source)]
    assert [None if pose is None else pose.translation[0] for pose in poses] == [2.0, None, 5.0]
    assert any("1 of 3 clouds of /points lie outside the times" in line for line in source.notes())


@KINDS
def test_odometry_is_a_pose_where_tf_has_none(tmp_path: Path, ros: Ros, write: Write) -> None:
    entries: list[Entry] = [
        ("/odom", 0, ros.odometry(S, "start", "base_link", (10.0, 5.0, 0.0), LEFT)),
        ("/tf_static", 0, ros.tf(0, "base_link", "lidar", (0.0, 0.0, 1.5))),
        ("/tf_static", 1, ros.tf(0, "base_footprint", "unrelated", (0.0, 0.0, 9.5))),
        ("/points", 1, ros.cloud(S)),
    ]
    source = open_source(write(tmp_path / "a", entries))
    x, y, z = POINTS.T.astype(np.float64)
    [ref] = source.refs("a")
    np.testing.assert_allclose(_world(source, ref), np.column_stack([10 - y, 5 + x, z + 1.5]), atol=1e-5)
    assert source.read(ref).sensor_height_m is None
    assert source.damage() == ()


@KINDS
def test_odometry_states_how_certain_the_pose_of_a_sensor_is(tmp_path: Path, ros: Ros, write: Write) -> None:
    # The lidar stands 2 m ahead and 1 m left of the base, which faces left: a turn by .1 radians carries it by .2 m
    # along x and by .1 m along y.
    stated = np.diag([0.04, 0.09, 0.01, 0.0, 0.0, 0.01])
    place = (10.0, 5.0, 0.0)
    source = open_source(write(tmp_path / "a", [
        ("/odom", 0, ros.odometry(S, "odom", "base_link", place, LEFT, stated)),
        ("/odom", 1, ros.odometry(2 * S, "odom", "base_link", place, LEFT)),
        ("/odom", 2, ros.odometry(3 * S, "odom", "base_link", place, LEFT, -stated)),
        ("/tf_static", 0, ros.tf(0, "base_link", "lidar", (2.0, 1.0, 1.5))),
        *(("/points", n, ros.cloud(n * S)) for n in (1, 2, 3)),
    ]))  # fmt: skip
    found = [source.read(ref).pose_covariance for ref in source.refs("a")]
    place_m2 = [[0.08, 0.02, 0.0], [0.02, 0.1, 0.0], [0.0, 0.0, 0.01]]
    np.testing.assert_allclose(found[0][:3, :3], place_m2, atol=1e-9)
    np.testing.assert_allclose(found[0][[0, 1, 5], [5, 5, 5]], [-0.02, -0.01, 0.01], atol=1e-9)
    # What odometry leaves out in between is that of the message before: only one states a covariance here.
    np.testing.assert_allclose(found[1:], [found[0]] * 2, atol=1e-9)
    bare = write(
        tmp_path / "b", [("/odom", 0, ros.odometry(S, "odom", "lidar", place, LEFT)), ("/points", 1, ros.cloud(S))]
    )
    assert [open_source(bare).read(ref).pose_covariance for ref in open_source(bare).refs("b")] == [None]


@KINDS
def test_transforms_that_lead_in_a_circle_end_there(tmp_path: Path, ros: Ros, write: Write) -> None:
    here = (0.0, 0.0, 0.0)
    circle = [("base_link", "lidar"), ("arm", "base_link"), ("lidar", "arm")]
    entries: list[Entry] = [
        *(("/tf", at, ros.tf(S, parent, child, here)) for at, (parent, child) in enumerate(circle)),
        ("/tf", 3, ros.tf(S, "map", "map", here)),
        ("/points", 4, ros.cloud(S)),
    ]
    source = open_source(write(tmp_path / "a", entries))
    [(_, sweep)] = each_sweep(source)
    assert sweep.world_from_sensor is None
    assert any("frame 'lidar' is not connected to any of map" in line for line in source.notes())
    assert any("frame 'map' must have one parent" in line for line in source.damage())


@KINDS
def test_topics_are_agents_and_come_in_the_order_of_their_stamps(tmp_path: Path, ros: Ros, write: Write) -> None:
    def cloud(t_ns: int, shift: float) -> Any:
        return ros.cloud(t_ns, _table(POINTS + np.float32(shift)))

    entries: list[Entry] = [
        ("/front/points", 10, cloud(3 * S, 1.0)), ("/rear/points", 10, cloud(2 * S, 2.0)),
        ("/front/points", 10, cloud(1 * S, 3.0)), ("/rear/points", 11, cloud(0, 4.0)),
    ]  # fmt: skip
    source = pickle.loads(pickle.dumps(open_source(write(tmp_path / "a", entries))))  # noqa: S301
    read = [(ref.agent, ref.t_ns, float(sweep.points[0, 0])) for ref, sweep in each_sweep(source)]
    assert read == [
        ("rear/points", 11, 9.0), ("front/points", S, 8.0), ("rear/points", 2 * S, 7.0), ("front/points", 3 * S, 6.0),
    ]  # fmt: skip


@KINDS
def test_what_follows_a_restart_of_the_clock_is_left_out(tmp_path: Path, ros: Ros, write: Write) -> None:
    tenths = [*range(100, 106), 300, 107, 104, 108, 109]  # a wrong stamp, and a late sweep
    runs = [(100.0, [t * S // 10 for t in tenths]), (7.0, [t * S // 10 for t in range(101, 106)])]
    entries: list[Entry] = []
    for y, times_ns in runs:
        for t_ns in times_ns:
            entries.append(("/tf", len(entries), ros.tf(t_ns, "map", "lidar", (0.0, y, 0.0))))
            entries.append(("/points", len(entries), ros.cloud(t_ns)))
    source = open_source(write(tmp_path / "a", entries))
    read = list(each_sweep(source))
    assert [ref.t_ns for ref, _ in read] == sorted(runs[0][1])
    assert {sweep.world_from_sensor.translation[1] for _, sweep in read if sweep.world_from_sensor} == {100.0}
    words = r"the clock of /points restarts at 10\.100 s: 5 of 16 sweeps, from there on, are left out"
    assert len([line for line in source.damage() if re.search(words, line)]) == len(source.damage()) == 1


def test_files_of_a_split_bag_are_read_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in range(12):
        entries = [("/points", 1, ROS2.cloud((2 * number + k + 1) * S)) for k in range(2)]
        write_mcap(tmp_path / f"bag_{number}", entries)
    (tmp_path / "metadata.yaml").touch()
    source = open_source(tmp_path)
    assert ([ref.t_ns // S for ref, _ in each_sweep(source)], source.damage()) == ([*range(1, 25)], ())


def test_an_mcap_chunk_that_claims_too_much_is_refused(tmp_path: Path) -> None:
    # 300 bytes of zstd that unpack to 3 MB of zeros: more than 200 times as many, and more than 1 MB
    for size, words in ((3_000_000, "bytes; refused"), (900_000, "is damaged")):
        (tmp_path / "a.mcap").write_bytes(mcap_chunk(bytes(size)) + _record(0x0F, bytes(4)))
        with pytest.raises(ValueError, match=words):
            open_source(tmp_path / "a.mcap")


def test_many_chunks_that_add_up_to_too_much_are_refused(tmp_path: Path) -> None:
    # Each chunk of 900 kB is small enough by itself; forty of them unpack to 36 MB, from a file of 5 kB.
    empty = (struct.pack("<HIQQ", 1, number, number, number) + bytes(900_000) for number in range(40))
    texts = b"".join(struct.pack("<I", len(text)) + text for text in (b"/other", b"cdr"))
    content = MAGIC + _record(0x04, struct.pack("<HH", 1, 0) + texts + struct.pack("<I", 0))
    content += b"".join(mcap_chunk(_record(0x05, each))[len(MAGIC) :] for each in empty) + _record(0x0F, bytes(4))
    (tmp_path / "a.mcap").write_bytes(content)
    limit = max(200 * len(content), 1_000_000)
    assert limit < 40 * 900_000
    with pytest.raises(
        ValueError, match=rf"a\.mcap: is damaged: it unpacks to more than {limit} bytes in all; refused"
    ):
        open_source(tmp_path / "a.mcap")


@pytest.mark.parametrize("ending", [".zstd", ".zst", ".ZSTD"])
def test_a_packed_bag_is_a_recording(tmp_path: Path, ending: str) -> None:
    place = tmp_path / f"a.mcap{ending}"
    place.write_bytes(bytes(pa.compress(recording_files.mcap(), codec="zstd", asbytes=True)))
    assert [len(sweep) for sweep in open_recording(place)] == [6, 6]
    assert [len(sweep) for sweep in open_recording(tmp_path)] == [6, 6]


def test_records_that_only_keep_a_reader_busy_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(MAGIC + _record(0x85, b"") * 100_001)
    with pytest.raises(ValueError, match="100001 records before byte 900008 hold no message"):
        open_source(tmp_path / "a.mcap")


@pytest.mark.parametrize("packing", ["", "bz2", "lz4"])
def test_ros1_chunks_of_every_packing(tmp_path: Path, packing: str) -> None:
    content = recording_files.ros1_bag(packing)
    (tmp_path / "a.bag").write_bytes(content)
    source = open_source(tmp_path / "a.bag")
    assert [len(sweep) for _, sweep in each_sweep(source)] == [6, 6]
    assert source.damage() == ()


@pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap"])
def test_an_empty_file_is_one_line(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    with pytest.raises(ValueError, match=rf"{name}: the file is empty$"):
        open_source(tmp_path / name)


def test_a_ros1_bag_that_only_keeps_a_reader_busy_is_refused(tmp_path: Path) -> None:
    place = tmp_path / "a.bag"
    message = ros1_fields(op=b"\x02", conn=bytes(4), time=bytes(8))
    message += struct.pack("<I", 300_000) + bytes(300_000)
    for content, problem in (
        (ros1_indexes(1000, 50), "its index names more than the file has"),
        (ros1_chunk(3 << 20), "unpacks to 1000001 bytes, not 1000000"),
        (ros1_indexes(10_000, 1, b"none", message), "unpacks to more than .* bytes in all; refused"),
    ):
        place.write_bytes(content)
        try:
            lines: Iterable[str] = open_source(place).damage()
        except ValueError as error:
            lines = [str(error)]
        assert any(re.search(rf"a\.bag: is damaged.*{problem}", line) for line in lines), lines


def test_a_folder_of_several_files_keeps_what_can_be_read(tmp_path: Path) -> None:
    recording_files.write(tmp_path / "bag", {
        "metadata.yaml": b"", "a_0.db3": recording_files.db3(), "a_1.db3": recording_files.db3()[:5000],
        "a_2.mcap": recording_files.mcap(), "a_0.db3-wal": b"of a recorder that was killed",
        "a_3.db3": recording_files.db3(),  # a player left it beside the packed one
        "a_3.db3.zstd": bytes(pa.compress(recording_files.db3(), codec="zstd", asbytes=True)),
        "a_4.db3.zstd": bytes(pa.compress(recording_files.db3(), codec="zstd", asbytes=True)),
    })  # fmt: skip
    with pytest.warns(UserWarning, match="a_0.db3 was not closed: what lies in a_0.db3-wal is .*a_1.db3 is damaged"):
        assert [len(sweep) for sweep in open_recording(tmp_path / "bag")] == [6] * 8


def test_packed_messages_are_unpacked_and_bounded(tmp_path: Path) -> None:
    _, raw = recording_files.cloud(ros1=False)
    (tmp_path / "a.db3").write_bytes(recording_files.db3(raw=bytes(pa.compress(raw, codec="zstd", asbytes=True))))
    assert [len(sweep) for _, sweep in each_sweep(open_source(tmp_path / "a.db3"))] == [6, 6]
    bomb = bytes(pa.compress(bytes(3_000_000), codec="zstd", asbytes=True))
    (tmp_path / "b.db3").write_bytes(recording_files.db3(raw=bomb))
    with pytest.raises(ValueError, match=r"b\.db3: is damaged|unpacks to more than 1000000 bytes"):
        open_source(tmp_path / "b.db3")


@pytest.mark.parametrize(
    ("statements", "problem"),
    [
        (("DROP TABLE topics", "CREATE VIEW topics AS SELECT 1 AS id"), "must have tables named topics and messages"),
        (("DROP TABLE messages", "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, "
          "data AS (zeroblob(1000)))"), "without computed columns"),
        (("UPDATE messages SET data = 'text'",), "message 1 is no bytes"),
        (("UPDATE messages SET timestamp = 'late'",), "message 1 has no time"),
    ],
)  # fmt: skip
def test_sqlite_files_that_are_no_bag_are_one_line(statements: tuple[str, ...], problem: str, tmp_path: Path) -> None:
    (tmp_path / "a.db3").write_bytes(recording_files.db3(statements))
    with pytest.raises(ValueError, match=rf"a\.db3: .*{problem}") as caught:
        open_source(tmp_path / "a.db3")
    assert "\n" not in str(caught.value)


def test_an_mcap_file_that_was_cut_off_keeps_what_lies_before(tmp_path: Path) -> None:
    place = write_mcap(tmp_path / "a", [("/points", k, ROS2.cloud(k * S)) for k in range(1, 5)])
    content = place.read_bytes()
    place.write_bytes(content[: len(content) * 7 // 10])
    source = open_source(place)
    assert 2 <= len(source.refs("a")) < 4
    [line] = [line for line in source.damage() if "cut off" in line]
    assert f"{len(source.refs('a'))} clouds before that are kept" in line
    np.testing.assert_array_equal(source.read(source.refs("a")[1]).points, POINTS)


def test_every_cut_of_an_mcap_file_is_one_line(tmp_path: Path) -> None:
    place = write_mcap(tmp_path / "a", [("/points", 1, ROS2.cloud(S))])
    content = place.read_bytes()
    for end in range(0, len(content) - 50, 7):
        place.write_bytes(content[:end])
        try:
            lines: Iterable[str] = open_source(place).damage()
        except ValueError as error:
            lines = [str(error)]
        assert all(line.startswith(str(place)) and "\n" not in line for line in lines)
        assert any("cut off" in line or "does not begin" in line or "is empty" in line for line in lines), (end, lines)


@pytest.mark.parametrize("write", [write_ros1, write_ros2], ids=["ros1", "ros2"])
def test_a_truncated_bag_is_one_line_and_its_neighbors_are_read(tmp_path: Path, write: Write) -> None:
    ros = ROS1 if write is write_ros1 else ROS2
    (tmp_path / "all").mkdir()
    good = write(tmp_path / "all" / "good", [("/points", 1, ros.cloud(S))])
    bad = write(tmp_path / "all" / "bad", [("/points", 1, ros.cloud(S))])
    file = bad if bad.is_file() else next(bad.glob("*.db3"))
    file.write_bytes(file.read_bytes()[:300])
    source = open_source(tmp_path / "all")
    assert source.scenes() == ("good",)
    assert len(source.refs("good")) == 1
    [line] = [line for line in source.damage() if line.startswith(str(bad))]
    assert "is damaged" in line
    with pytest.raises(ValueError, match="is damaged"):
        open_source(bad)
    assert good.exists()


def test_ros2_bags_need_no_metadata(tmp_path: Path) -> None:
    for number, metadata in enumerate((None, "rosbag2_bagfile_information: [", "version: 99\n")):
        folder = write_ros2(tmp_path / f"b{number}", [("/points", 1, ROS2.cloud(S))])
        (folder / "metadata.yaml").unlink()
        if metadata is not None:
            (folder / "metadata.yaml").write_text(metadata)
        [(ref, sweep)] = each_sweep(open_source(folder))
        assert (ref.t_ns, len(sweep)) == (S, 3)
        [(_, again)] = each_sweep(open_source(next(folder.glob("*.db3"))))
        np.testing.assert_array_equal(again.points, sweep.points)
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "metadata.yaml").write_text("x: 1\n")
    with pytest.raises(ValueError, match=r"empty: is damaged: it holds no \.db3 and no \.mcap file"):
        open_source(tmp_path / "empty", "bag")


@KINDS
def test_empty_topics_and_bags_without_clouds(tmp_path: Path, ros: Ros, write: Write) -> None:
    pose = ros.odometry(0, "odom", "base_link", (0.0, 0.0, 0.0))
    place = write(
        tmp_path / "a", [("/points", 1, ros.cloud(0, frame="base_link")), ("/none", 1, CLOUD), ("/o", 1, pose)]
    )
    source = open_source(place)
    assert len(source.refs("a")) == 1
    assert any("topic /none has no cloud" in line for line in source.notes())
    with pytest.raises(
        ValueError, match=r"no topic has .*PointCloud2 or .*, packets of .*; topics that exist: /o \(nav_msgs/msg/Odom"
    ):
        open_source(write(tmp_path / "b", [("/o", 1, pose)]))


def test_unknown_types_are_left_alone_and_packets_are_named(tmp_path: Path) -> None:
    strangers = [("/packets", 2, "nebula_msgs/msg/NebulaPackets"), ("/own", 3, "my_msgs/msg/Own")]
    content = write_mcap(tmp_path / "a", [("/points", 1, ROS2.cloud(S)), *strangers])
    source = open_source(content)
    assert len(source.refs("a")) == 1
    [line] = [line for line in source.notes() if "topic" in line]
    assert "/packets has packets of many makers (nebula_msgs/msg/NebulaPackets), which are not read" in line


def test_one_damaged_cloud_does_not_stop_the_others(tmp_path: Path) -> None:
    short = ROS2.cloud(2 * S)
    object.__setattr__(short, "width", 9)
    entries: list[Entry] = [("/points", 1, ROS2.cloud(S)), ("/points", 2, short), ("/points", 3, ROS2.cloud(3 * S))]
    told: list[str] = []
    source = open_source(write_ros2(tmp_path / "a", entries))
    assert [ref.t_ns for ref, _ in each_sweep(source, on_damage=lambda _, line: told.append(line))] == [S, 3 * S]
    assert sum("/points at 2000000000 ns: a cloud is cut off" in line for line in told) == 1


def test_a_bag_may_be_closed_by_another_thread(tmp_path: Path) -> None:
    entries: list[Entry] = [("/points", 0, ROS2.cloud(0))]
    bag = open_bag(tmp_path, write_ros2(tmp_path / "a", entries))
    assert len(list(bag.messages(("sensor_msgs/msg/PointCloud2",)))) == 1
    with ThreadPoolExecutor(1) as thread:
        thread.submit(bag.close).result()


def test_reading_leaves_no_file_behind(tmp_path: Path) -> None:
    place = write_ros2(tmp_path / "a", [("/points", 1, ROS2.cloud(S))])
    before = sorted(path.name for path in place.iterdir())
    [(_, sweep)] = each_sweep(open_source(place))
    assert isinstance(sweep, Sweep)
    assert sorted(path.name for path in place.iterdir()) == before


VELODYNE, SCAN, STRING = "velodyne_msgs/msg/VelodyneScan", "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
LIVOX = ("livox_ros_driver", "livox_ros_driver2")
LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
LIVOX_MESSAGE = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n{}/CustomPoint[] points"
)
OUSTER = ("ouster_ros/msg/PacketMsg", "ouster_sensor_msgs/msg/PacketMsg")


def _register(ros: Ros) -> dict[str, Any]:
    """Return the types of a ROS version, with those of packets."""
    from rosbags.typesys import get_types_from_msg

    if VELODYNE not in ros.store.types:
        for kind, definition in (
            ("velodyne_msgs/msg/VelodynePacket", "builtin_interfaces/Time stamp\nuint8[1206] data"),
            (VELODYNE, "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets"),
            *((kind, "uint8[] buf") for kind in OUSTER),
            *((f"{name}/msg/CustomPoint", LIVOX_POINT) for name in LIVOX),
            *((f"{name}/msg/CustomMsg", LIVOX_MESSAGE.format(name)) for name in LIVOX),
        ):
            ros.store.register(get_types_from_msg(definition, kind))
    types: dict[str, Any] = ros.store.types
    return types


def _velodyne(ros: Ros, t_ns: int) -> Any:
    make, header = _register(ros)["velodyne_msgs/msg/VelodynePacket"], ros.header(t_ns, "lidar")
    packets = [make(header.stamp, np.frombuffer(each, np.uint8)) for each in sweep_files.vlp16_turns(turns=1.0)]
    return _register(ros)[VELODYNE](header, packets)


def _scan(ros: Ros, t_ns: int, ranges: list[float]) -> Any:
    kind = _register(ros)[SCAN]
    step, none = 0.1, np.zeros(0, np.float32)
    last = step * (len(ranges) - 1)
    return kind(ros.header(t_ns, "laser"), 0.0, last, step, 0.0, 0.1, 0.1, 30.0, np.array(ranges, np.float32), none)


def _ouster(ros: Ros, frames: int, kind: str) -> list[Any]:
    make = _register(ros)[kind]
    return [make(np.frombuffer(each, np.uint8)) for each in sweep_files.ouster_payloads(frames)]


@KINDS
def test_velodyne_scans_are_sweeps(tmp_path: Path, ros: Ros, write: Write) -> None:
    at = ros.tf(0, "map", "lidar", (1.0, 2.0, 3.0))
    place = write(tmp_path / "a", [("/tf_static", 0, at), ("/packets", 1, _velodyne(ros, 5 * S))])
    [(ref, sweep)] = each_sweep(open_source(place))
    assert (ref.sensor, sweep.t_ns) == ("/packets", 5 * S)
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), 5.0, atol=0.03)
    assert sweep.world_from_sensor.translation.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(("ros", "write", "name"), [(ROS1, write_ros1, LIVOX[0]), (ROS2, write_mcap, LIVOX[1])])
def test_livox_points_are_sweeps(tmp_path: Path, ros: Ros, write: Write, name: str) -> None:
    types = _register(ros)
    rows = [(0, 1.0, 2.0, -0.5, 10), (50_000_000, 0.0, 0.0, 0.0, 0), (99_000_000, 4.0, -3.0, 1.0, 255)]
    points = [types[f"{name}/msg/CustomPoint"](*row, 16, line) for line, row in enumerate(rows)]
    message = types[f"{name}/msg/CustomMsg"](ros.header(7 * S, "livox"), 7 * S, 3, 1, np.zeros(3, np.uint8), points)
    [(ref, sweep)] = each_sweep(open_source(write(tmp_path / "a", [("/livox/lidar", 1, message)])))
    assert (ref.sensor, sweep.t_ns) == ("/livox/lidar", 7 * S)
    assert sweep.points.tolist() == [[1.0, 2.0, -0.5], [4.0, -3.0, 1.0]]  # without the beam that met nothing
    assert sweep.intensity.tolist() == [10.0, 255.0]
    np.testing.assert_allclose(sweep.time_s, [0.0, 0.099])
    assert (sweep.ring, sweep.infer_sensor) == (None, False)


@KINDS
def test_laser_scans_are_sweeps_in_a_plane(tmp_path: Path, ros: Ros, write: Write) -> None:
    footprint = ros.tf(0, "base_footprint", "laser", (0.2, 0.0, 0.18))
    scan = _scan(ros, 3 * S, [2.0, np.inf, np.nan, 4.0])
    source = open_source(write(tmp_path / "a", [("/tf_static", 0, footprint), ("/scan", 1, scan)]))
    [(_, sweep)] = each_sweep(source)
    assert sweep.sensor_height_m == pytest.approx(0.18)
    assert sweep.planar.max_range_m == 30.0
    np.testing.assert_allclose(sweep.planar.open_azimuth, [0.1], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), [2.0, 4.0], rtol=1e-6)


@pytest.mark.parametrize(("ros", "write", "kind"), [(ROS1, write_ros1, OUSTER[0]), (ROS2, write_ros2, OUSTER[1])])
def test_ouster_packets_are_sweeps(tmp_path: Path, ros: Ros, write: Write, kind: str) -> None:
    packets = _ouster(ros, 3, kind)[2:]  # the first revolution is cut off
    entries: list[Entry] = [("/os/lidar_packets", k * S, packet) for k, packet in enumerate(packets)]
    entries.insert(7, ("/os/lidar_packets", 6 * S + 1, packets[5]))  # late: the next revolution has begun
    imu = _register(ros)[kind](np.zeros(48, np.uint8))
    about = _register(ros)[STRING](sweep_files.ouster_metadata().decode())
    place = write(tmp_path / "a", [*entries, ("/os/imu_packets", 0, imu), ("/os/metadata", 1, about)])
    source = pickle.loads(pickle.dumps(open_source(place)))  # noqa: S301
    found = list(each_sweep(source))
    assert [(ref.sensor, ref.t_ns) for ref, _ in found] == [("/os/lidar_packets", 2 * S), ("/os/lidar_packets", 6 * S)]
    for (_, sweep), distance_m in zip(found, (6.0, 7.0), strict=True):
        assert len(sweep) == 32 * 64
        np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), distance_m, atol=0.05)


def test_metadata_of_ouster_packets_may_lie_beside_the_bag(tmp_path: Path) -> None:
    entries: list[Entry] = [("/lidar_packets", k, packet) for k, packet in enumerate(_ouster(ROS2, 1, OUSTER[1]))]
    place = write_mcap(tmp_path / "a", entries)
    with pytest.raises(ValueError, match=r"cannot be read: its metadata must be in the bag or beside it as a\.json"):
        open_source(place)
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(ValueError, match="cannot be read: beam_altitude_angles must be a list"):
        open_source(place)
    (tmp_path / "a.json").write_bytes(sweep_files.ouster_metadata())
    [(_, sweep)] = each_sweep(open_source(place))
    assert len(sweep) == 32 * 64


def test_what_a_sensor_tells_twice_is_read_once(tmp_path: Path) -> None:
    place = write_mcap(
        tmp_path / "a",
        [("/points", 1, ROS2.cloud(S)), ("/packets", 2, _velodyne(ROS2, S)), ("/scan", 3, _scan(ROS2, S, [2.0]))],
    )
    source = open_source(place)
    assert [ref.sensor for ref in source.refs("a")] == ["/points"]
    for topic in ("/packets", "/scan"):
        assert any(f"topic {topic} (" in line and "is not read beside /points" in line for line in source.notes())


def test_real_bags_of_packets_and_scans(real_data: Path) -> None:
    recordings = real_data.parent / "recordings"
    if not recordings.is_dir():
        pytest.skip("no recordings")
    bags = {
        "tier4__nebula/velodyne/vlp32/1713492677464078412": (5, 25_000, 32),
        "tier4__nebula/velodyne/vls128/1614315746471294674": (4, 130_000, 127),
        "tier4__nebula/hesai/qt64/1673401195788312575": (4, 38_000, 64),
        "ouster-lidar__ouster-sdk/tests/bags/512x10_raw.bag": (1, 4_000, 32),
    }
    for name, (count, fewest, rings) in bags.items():
        sweeps = [sweep for _, sweep in each_sweep(open_source(recordings / name))]
        assert len(sweeps) == count, name
        for sweep in sweeps:
            assert len(sweep) > fewest, name
            assert len(np.unique(sweep.ring)) >= rings, name
    scans = [
        sweep
        for _, sweep in each_sweep(open_source(recordings / "facontidavide__PlotJuggler/datasamples/tilt_laser.bag"))
    ]
    assert len(scans) == 178
    assert all(sweep.planar is not None and len(sweep) > 300 for sweep in scans)


def test_packets_decoded_by_others_lie_at_the_same_points(real_data: Path) -> None:
    """A VLP-16 that stands still, decoded by Autoware's driver: one of its turns beside ours."""
    theirs = read_sweep(real_data / "nebula" / "vlp16.pcd")
    sweeps = [sweep for _, sweep in each_sweep(open_source(real_data / "nebula" / "vlp16_packets_0.db3"))]
    assert len(sweeps) == 4
    near_m = [np.quantile(KDTree(sweep.points).query(theirs.points)[0], 0.9) for sweep in sweeps]
    assert min(near_m) < 0.02


def test_bags_of_a_folder_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        (tmp_path / f"run_{number}.mcap").touch()
    assert [path.name for path in bags_in(tmp_path)] == ["run_1.mcap", "run_2.mcap", "run_10.mcap"]
