"""Files built to kill, stall or swell a reader: each is read, or refused in one line, in bounded time and memory.

A child process reads them, so that a crash, a hang and the growth of memory are seen from outside.
"""

import bz2
import gzip
import json
import struct
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

LIMIT_S, GIVE_UP_S, RATIO, FLOOR_BYTES = 4.0, 10, 10, 64_000_000
"""Seconds of the processor that a file may take and after which it is given up; memory that it may take."""

Make = Callable[[Path], Path]


def one(name: str, content: Callable[[], bytes]) -> Make:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content())
        return folder / name

    return write


def recording(kind: str, ending: str, content: Callable[[], bytes]) -> Make:
    """Return what writes a small recording whose file of this ending is another."""

    def write(folder: Path) -> Path:
        made: Any = import_module("recording_files")
        files = made.recordings()[kind]
        files[next(name for name in files if name.endswith(ending))] = content()
        made.write(folder / "recording", files)
        return folder / "recording"

    return write


def opv2v(text: str) -> Make:
    return recording("opv2v", "000068.yaml", text.encode)


def merges(levels: int = 25) -> str:
    lines = [f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}" for k in range(1, levels)]
    return "\n".join(["a0: &a0 {x: 1}", *lines]) + "\n"


def aliases(levels: int = 9) -> str:
    lines = [f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 7)}]" for k in range(1, levels)]
    box = f"{{angle: [0, 0, 0], location: [1, 2, 3], extent: [1, 1, 1], obj_type: *a{levels - 1}}}"
    return "\n".join(["a0: &a0 [1,1,1,1]", *lines, "lidar_pose: [1, 2, 3, 0, 0, 0]", f"vehicles: {{1: {box}}}\n"])


def many_channels() -> bytes:
    protocol: str = import_module("recording_files").PROTOCOL
    return protocol.replace("channels: 4", "channels: 1000000000").encode()


def mcap_chunk(raw: bytes) -> bytes:
    import pyarrow as pa

    packed: bytes = pa.compress(raw, codec="zstd", asbytes=True)
    record = struct.pack("<QQQI", 0, 0, len(raw), 0) + struct.pack("<I", 4) + b"zstd"
    record += struct.pack("<Q", len(packed)) + packed
    return b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(record)) + record


def ros1_fields(**fields: bytes) -> bytes:
    """Return a header of ROS 1 and its length."""
    parts = (name.encode() + b"=" + value for name, value in fields.items())
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header


def ros1_indexes(entries: int = 1_000_000, infos: int = 500, packing: bytes = b"none", packed: bytes = b"") -> bytes:
    """Return a bag of one chunk whose index is named over and over."""
    start = b"#ROSBAG V2.0\n"
    chunk = ros1_fields(op=b"\x05", compression=packing, size=bytes(4)) + struct.pack("<I", len(packed)) + packed
    index = ros1_fields(op=b"\x04", ver=struct.pack("<I", 1), conn=bytes(4), count=struct.pack("<I", entries))
    index += struct.pack("<I", 12 * entries) + bytes(12 * entries)
    info = ros1_fields(op=b"\x06", ver=struct.pack("<I", 1), chunk_pos=struct.pack("<Q", 4096), start_time=bytes(8),
                   end_time=bytes(8), count=struct.pack("<I", 1)) + struct.pack("<III", 8, 0, 1)  # fmt: skip
    connection = ros1_fields(op=b"\x07", conn=bytes(4), topic=b"/a")
    inner = ros1_fields(topic=b"/a", type=b"sensor_msgs/PointCloud2", md5sum=b"x", message_definition=b"x")
    connection += struct.pack("<I", len(inner) - 4) + inner[4:]
    position = 4096 + len(chunk) + len(index)
    head = ros1_fields(op=b"\x03", index_pos=struct.pack("<Q", position), conn_count=struct.pack("<I", 1),
                   chunk_count=struct.pack("<I", infos))  # fmt: skip
    padding = 4096 - len(start) - len(head) - 4
    return start + head + struct.pack("<I", padding) + b" " * padding + chunk + index + connection + info * infos


def ros1_chunk(size: int = 256 << 20) -> bytes:
    """Return a bag of one message in a chunk of this many zeros."""
    packer = bz2.BZ2Compressor(9)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packer.flush()
    return ros1_indexes(1, 1, b"bz2", packed)


def db3(*statements: str) -> Make:
    def write(folder: Path) -> Path:
        made: Any = import_module("recording_files")
        topic = "{name: /points, type: sensor_msgs/msg/PointCloud2, serialization_format: cdr}"
        metadata = f"""rosbag2_bagfile_information: {{version: 4, storage_identifier: sqlite3, message_count: 2,
 relative_file_paths: [a_0.db3], duration: {{nanoseconds: 1}}, starting_time: {{nanoseconds_since_epoch: 1}},
 topics_with_message_count: [{{topic_metadata: {topic}, message_count: 2}}]}}"""
        made.write(folder, {"a/a_0.db3": made.db3(statements), "a/metadata.yaml": metadata.encode()})
        return folder / "a"

    return write


def fragments(frames: int = 300_000) -> bytes:
    """Return a capture of one datagram's fragments: all but the second are there, over and over."""
    files: Any = import_module("sweep_files")
    parts = [files.ip_packet(bytes(8), offset=8 * k, more=True) for k in range(510) if k != 1]
    parts[1] = files.ip_packet(bytes(8), offset=8 * 511, more=False)
    record = [struct.pack("<IIII", 1000, 0, len(part), len(part)) + part for part in parts]
    capture = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1)
    velodyne: bytes = files.pcap([files.ip_packet(files.udp_packet(files.vlp16_payload(0, 0.4, 5)))])[24:]
    return capture + velodyne + b"".join(record[k % len(record)] for k in range(frames))


def npy_header(blanks: int) -> bytes:
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (" + (b"1" + b" " * (blanks // 4)) * 4 + b"!"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def pcd_text(rows: int = 1_500_000) -> bytes:
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    return f"{header}WIDTH {rows}\nHEIGHT 1\nPOINTS {rows}\nDATA ascii\n".encode() + b"1 2 3\n" * rows


def tracklets(body: str, count: int) -> Make:
    text = "<boost_serialization><tracklets><item>" + body * count
    return recording("kitti_raw", "tracklet_labels.xml", text.encode)


def ouster_pixels(folder: Path) -> Path:
    files: Any = import_module("sweep_files")
    sample = files.samples()["ouster pcap"]
    about = json.loads(sample.beside["o.json"])
    about["data_format"] |= {"columns_per_frame": 8192, "pixels_per_column": 512, "pixel_shift_by_row": [0] * 512}
    about["data_format"]["column_window"] = [0, 8191]
    about |= {name: list(np.linspace(20, -20, 512)) for name in ("beam_altitude_angles", "beam_azimuth_angles")}
    (folder / "o.json").write_text(json.dumps(about))
    (folder / "o.pcap").write_bytes(sample.content)
    return folder / "o.pcap"


def link_to_itself(folder: Path) -> Path:
    (folder / "loop.bin").symlink_to(folder / "loop.bin")
    return folder / "loop.bin"


ENDLESS_VIEW = (
    "DROP TABLE topics", "CREATE VIEW topics AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL SELECT id FROM r) "
    "SELECT id, '/a' AS name, 'sensor_msgs/msg/PointCloud2' AS type, 'cdr' AS serialization_format FROM r",
    'CREATE TABLE "TOPICS " (x)',
)  # fmt: skip
COMPUTED = (
    "DROP TABLE messages", "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
    "data AS (zeroblob(900000000)))", "INSERT INTO messages (topic_id, timestamp) VALUES (1, 1)",
)  # fmt: skip
RECORD = struct.pack("<BQ", 0x85, 0)
NESTED = b"[" + b",".join([b'{"a": {"b": [' + b"{}," * 8_000 + b"{}]}}"] * 600)
POSE = "lidar_pose: [1, 2, 3, 0, 0, 0]\n"

HOSTILE: dict[str, Make] = {
    "OPV2V's YAML, 50,000 open brackets": opv2v("x: " + "[" * 50_000),
    "YAML of merges into merges": opv2v(merges()),
    "YAML of aliases of aliases": opv2v(aliases()),
    "YAML, a base-60 integer of 400 kB": opv2v("x: " + "1:" * 200_000 + "1\n"),
    "YAML, 100,000 directives": opv2v("".join(f"%TAG !{k}! x\n" for k in range(100_000))),
    "YAML, 4 MB of short nodes": opv2v("x: [" + "1," * 1_990_000 + "]\n"),
    "YAML, infinite pose": opv2v("lidar_pose: [.inf, 0, 0, 0, 0, 0]\n"),
    "YAML, lists for numbers": opv2v(f"{POSE}true_ego_pos: [[1], [2], [3]]\n"),
    "YAML, an integer of 1,000 digits": opv2v(f"lidar_pose: [1, 2, {'9' * 1000}, 0, 0, 0]\n"),
    "data_protocol.yaml with 1,000,000,000 channels": recording("opv2v", "data_protocol.yaml", many_channels),
    "metadata.yaml, 50,000 open brackets": recording("ros2 folder", "metadata.yaml", ("x: " + "[" * 50_000).encode),
    "NPY header of blanks, 306 bytes": one("a.npy", lambda: npy_header(241)),
    "NPY header of blanks, 10 kB": one("a.npy", lambda: npy_header(9_900)),
    "a million empty gzip members": one("a.bin.gz", lambda: gzip.compress(b"", mtime=0) * 1_000_000),
    "ascii PCD, numbers of one digit": one("a.pcd", pcd_text),
    "capture of fragments that never fit": one("a.pcap", fragments),
    "Ouster metadata of 512 × 8192 pixels": ouster_pixels,
    "index of seven million empty entries": one("index.json", lambda: b"[" + b"{}," * 7_000_000),
    "MCAP, a chunk of 300 MB of zeros": recording("mcap", ".mcap", lambda: mcap_chunk(bytes(300_000_000))),
    "MCAP, five million empty records": recording("mcap", ".mcap", lambda: b"\x89MCAP0\r\n" + RECORD * 5_000_000),
    "MCAP, a chunk of empty records": recording("mcap", ".mcap", lambda: mcap_chunk(RECORD * 3_000_000)),
    "ROS 1 bag, a chunk of 256 MB of zeros": recording("ros1 bag", ".bag", ros1_chunk),
    "ROS 2 bag whose topics are an endless view": db3(*ENDLESS_VIEW),
    "ROS 2 bag whose messages are computed": db3(*COMPUTED),
    "nuScenes table of 60 MB without a closing brace": recording(
        "nuscenes", "ego_pose.json", lambda: b'[{"token": "' + b"x" * 60_000_000
    ),
    "nuScenes table, objects in objects": recording("nuscenes", "ego_pose.json", lambda: NESTED),
    "KITTI tracklets, elements without end": tracklets("<a/>", 2_000_000),
    "KITTI tracklets, 2 million deep": tracklets("<a>", 2_000_000),
    "CARLA's poses.csv of damaged rows": recording(
        "carla", "poses.csv", lambda: b"frame,t_ns,x,y,z,roll,pitch,yaw\n" + b"a,\n" * 3_000_000
    ),
    "a link to itself": link_to_itself,
}


class Reader:
    """A child process that reads files and says what each cost; a new one where the last has died."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None

    def cost(self, path: Path) -> tuple[float, int, str]:
        """Return seconds of the processor, growth of memory in bytes, and how reading a file ended."""
        if self.process is None or self.process.poll() is not None:
            command = [sys.executable, __file__]
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        print(path, file=self.process.stdin, flush=True)
        line = self.process.stdout.readline()
        if not line:
            return 0.0, 0, f"the process ended with {self.process.wait()}"
        seconds, grown, outcome = json.loads(line)
        return seconds, grown, outcome

    def close(self) -> None:
        if self.process is not None:
            self.process.communicate()


@pytest.mark.slow
def test_hostile_files_are_read_or_refused_in_bounded_time_and_memory(tmp_path: Path) -> None:
    reader = Reader()
    made: Any = import_module("recording_files")
    files: Any = import_module("sweep_files")
    warm = [made.write(tmp_path / kind, content) for kind, content in made.recordings().items()]
    for name, sample in files.samples().items():
        for other, content in {**sample.beside, sample.name: sample.content}.items():
            (tmp_path / f"of {name}").mkdir(exist_ok=True)
            (tmp_path / f"of {name}" / other).write_bytes(content)
        warm.append(tmp_path / f"of {name}" / sample.name)
    for path in warm:  # libraries and compiled code are loaded before anything is measured
        reader.cost(path)
    faults = []
    for number, (what, make) in enumerate(HOSTILE.items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = make(folder)
        size = sum(file.lstat().st_size for file in [path, *path.rglob("*")] if not file.is_dir())
        seconds, grown, outcome = reader.cost(path)
        if outcome or seconds > LIMIT_S or grown > max(FLOOR_BYTES, RATIO * size):
            faults.append(f"{what}: {seconds:.2f} s, {grown / 1e6:.0f} MB, {outcome or 'one line'}")
        for file in folder.rglob("*"):
            if not file.is_dir():
                file.unlink()
    reader.close()
    assert faults == []
    assert len(HOSTILE) >= 30


def measure(path: Path) -> tuple[float, int, str]:
    """Read whatever lies at a path in this process."""
    import resource

    used = int(time.process_time())
    resource.setrlimit(resource.RLIMIT_CPU, (used + GIVE_UP_S, resource.RLIM_INFINITY))
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before, start, outcome = status("VmRSS"), time.process_time(), ""
    try:
        read(path)
    except (ValueError, OSError, ImportError) as error:
        outcome = "" if "\n" not in str(error) and str(path.parent) in str(error) else f"unclear: {error}"
    except BaseException as error:
        outcome = type(error).__name__
    return time.process_time() - start, max(0, status("VmHWM") - before), outcome


def status(key: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return 1024 * int(line.split()[1])


def read(path: Path) -> None:
    from viewshed.io import read_index, read_sweeps
    from viewshed.recordings.read import open_source
    from viewshed.recordings.read.source import each_sweep

    if path.name == "index.json":
        read_index(path)
    elif path.is_dir():
        lines: list[str] = []
        source = open_source(path)
        for ref in [ref for ref, _ in each_sweep(source, on_damage=lambda _, line: lines.append(line))]:
            source.boxes(ref)
        assert not any("\n" in line for line in lines)
    else:
        for sweep in read_sweeps(path):
            assert np.isfinite(sweep.points).all()


if __name__ == "__main__":
    warnings.simplefilter("ignore", UserWarning)
    for asked in sys.stdin:
        print(json.dumps(measure(Path(asked.rstrip("\n")))), flush=True)
