"""Make files that were built to kill, stall or swell a reader, and measure what they cost.

    python tools/hostile_files.py [--before CHECKOUT] [--only WORD,WORD] [--out docs/results/hostile_files.md]

Each file is read in a child process, which measures the processor's time and the growth of its memory. ``--before``
names a checkout of an earlier version (``git worktree add CHECKOUT d5ad149``) that is measured the same way.
"""

from __future__ import annotations

import argparse
import datetime
import gzip
import json
import platform
import struct
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from with_checkout import environment_of

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S, LIMIT_BYTES, RATIO = 2.0, 64_000_000, 10
GIVE_UP_S = 10
MEMORY_BYTES = 4_000_000_000


@dataclass(frozen=True, slots=True)
class Hostile:
    """One file: what it does, and what writes it into a folder and returns what is opened."""

    what: str
    write: Callable[[Path], Path]


@dataclass(frozen=True, slots=True)
class Cost:
    """What reading took: seconds of the processor, growth of memory in bytes, and how it ended."""

    seconds: float
    peak_bytes: int
    outcome: str

    def within(self, size: int) -> bool:
        """Return whether that is within the limits for a file of so many bytes."""
        clear = self.outcome in {"read", "one line"}
        return clear and self.seconds <= LIMIT_S and self.peak_bytes <= max(LIMIT_BYTES, RATIO * size)


def _file(name: str, content: Callable[[], bytes]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content())
        return folder / name

    return write


def _recording(kind: str, **spoiled: Callable[[], bytes]) -> Callable[[Path], Path]:
    """Return what writes a small recording of which some files, by the end of their names, are replaced."""

    def write(folder: Path) -> Path:
        made: Any = import_module("recording_files")
        files = made.recordings()[kind]
        for ending, content in spoiled.items():
            name = next(name for name in files if name.replace("/", "_").replace(".", "_").endswith(ending))
            files[name] = content()
        made.write(folder / "recording", files)
        return folder / "recording"

    return write


def _yaml(text: str | bytes) -> Callable[[Path], Path]:
    content = text if isinstance(text, bytes) else text.encode()
    return _recording("opv2v", **{"000068_yaml": lambda: content})


def _bomb(levels: int, item: str) -> str:
    lines = ["a0: &a0 [1,1,1,1,1,1,1,1,1]"]
    lines += [f"a{k}: &a{k} {item.format(k - 1)}" for k in range(1, levels)]
    box = f"{{angle: [0, 0, 0], location: [1, 2, 3], extent: [1, 1, 1], obj_type: *a{levels - 1}}}"
    return "\n".join(lines) + f"\nlidar_pose: [1, 2, 3, 0, 0, 0]\nvehicles: {{1: {box}}}\n"


def _merges(levels: int = 25) -> str:
    lines = ["a0: &a0 {x: 1}"]
    lines += [f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}" for k in range(1, levels)]
    return "\n".join(lines) + "\n"


def _mcap(body: bytes) -> bytes:
    return b"\x89MCAP0\r\n" + body


def _mcap_chunk(size: int, content: bytes | None = None, times: int = 1) -> bytes:
    """Return an MCAP file of one chunk, some times over."""
    import pyarrow as pa

    raw = bytes(size) if content is None else content
    packed = pa.compress(raw, codec="zstd", asbytes=True)
    record = struct.pack("<QQQI", 0, 0, len(raw), 0) + struct.pack("<I", 4) + b"zstd"
    record += struct.pack("<Q", len(packed)) + packed
    return _mcap((struct.pack("<BQ", 6, len(record)) + record) * times)


def _mcap_message(size: int) -> bytes:
    """Return a channel of MCAP and a message of so many zeros in it."""
    channel = struct.pack("<HHI", 1, 0, 0) + struct.pack("<I", 3) + b"cdr" + struct.pack("<I", 0)
    message = struct.pack("<HIQQ", 1, 0, 0, 0) + bytes(size)
    return struct.pack("<BQ", 4, len(channel)) + channel + struct.pack("<BQ", 5, len(message)) + message


def _fields(**fields: bytes) -> bytes:
    parts = (name.encode() + b"=" + value for name, value in fields.items())
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header


def _ros1_indexes(entries: int = 1_000_000, infos: int = 500) -> bytes:
    """Return a bag of one chunk whose index is named over and over."""
    start = b"#ROSBAG V2.0\n"
    chunk = _fields(op=b"\x05", compression=b"none", size=bytes(4)) + bytes(4)
    index = _fields(op=b"\x04", ver=struct.pack("<I", 1), conn=bytes(4), count=struct.pack("<I", entries))
    index += struct.pack("<I", 12 * entries) + bytes(12 * entries)
    info = _fields(op=b"\x06", ver=struct.pack("<I", 1), chunk_pos=struct.pack("<Q", 4096), start_time=bytes(8),
                   end_time=bytes(8), count=struct.pack("<I", 1)) + struct.pack("<III", 8, 0, 1)  # fmt: skip
    connection = _fields(op=b"\x07", conn=bytes(4), topic=b"/a")
    inner = _fields(topic=b"/a", type=b"sensor_msgs/PointCloud2", md5sum=b"x", message_definition=b"x")
    connection += struct.pack("<I", len(inner) - 4) + inner[4:]
    position = 4096 + len(chunk) + len(index)
    head = _fields(op=b"\x03", index_pos=struct.pack("<Q", position), conn_count=struct.pack("<I", 1),
                   chunk_count=struct.pack("<I", infos))  # fmt: skip
    padding = 4096 - len(start) - len(head) - 4
    return start + head + struct.pack("<I", padding) + b" " * padding + chunk + index + connection + info * infos


def _ros1_chunk(size: int = 1_000_000_000) -> bytes:
    import bz2

    packer = bz2.BZ2Compressor(9)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packer.flush()
    unpacked = struct.pack("<I", size >> 20 << 20)
    head = _fields(op=b"\x03", index_pos=struct.pack("<Q", 1), conn_count=bytes(4), chunk_count=bytes(4))
    chunk = _fields(op=b"\x05", compression=b"bz2", size=unpacked)
    return b"#ROSBAG V2.0\n" + head + bytes(4) + chunk + struct.pack("<I", len(packed)) + packed


def _db3(*statements: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        made: Any = import_module("recording_files")
        topic = "{name: /points, type: sensor_msgs/msg/PointCloud2, serialization_format: cdr}"
        metadata = f"""rosbag2_bagfile_information: {{version: 4, storage_identifier: sqlite3, message_count: 2,
 relative_file_paths: [a_0.db3], duration: {{nanoseconds: 1}}, starting_time: {{nanoseconds_since_epoch: 1}},
 topics_with_message_count: [{{topic_metadata: {topic}, message_count: 2}}]}}"""
        files = {"a/a_0.db3": made.db3(statements), "a/metadata.yaml": metadata.encode()}
        return Path(made.write(folder, files)) / "a"

    return write


def _metadata(text: str) -> Callable[[Path], Path]:
    return _recording("ros2 folder", metadata_yaml=text.encode)


def _pcap(frames: int, more: bool) -> bytes:
    """Return a capture of one datagram's fragments: all but the second are there, over and over."""
    files: Any = import_module("sweep_files")
    parts = [files.ip_packet(bytes(8), offset=8 * k, more=more) for k in range(510) if k != 1]
    parts[1] = files.ip_packet(bytes(8), offset=8 * 511, more=False)
    record = [struct.pack("<IIII", 1000, 0, len(part), len(part)) + part for part in parts]
    capture = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1)
    velodyne: bytes = files.pcap([files.ip_packet(files.udp_packet(files.vlp16_payload(0, 0.4, 5)))])[24:]
    return capture + velodyne + b"".join(record[k % len(record)] for k in range(frames))


def _npy_header(blanks: int) -> bytes:
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (" + (b"1" + b" " * (blanks // 4)) * 4 + b"!"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def _text_ring() -> bytes:
    files: Any = import_module("sweep_files")
    arrays = {"viewshed_sweep": np.array(1), "points": files.POINTS, "agent": np.array("ego"),
              "dropped_points": np.array(0), "ring": np.array(["a"] * 6)}  # fmt: skip
    return bytes(files.npz(**arrays))


def _zip_entries(count: int) -> bytes:
    entry = b"PK\x01\x02" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"a"
    end = b"PK\x05\x06" + bytes(4) + struct.pack("<HHII", 0xFFFE, 0xFFFE, len(entry) * count, 0) + bytes(2)
    return entry * count + end


def _pcd(numbers: str, rows: int, newline: str = "\n") -> bytes:
    width = len(numbers.split())
    header = f"VERSION 0.7\nFIELDS {' '.join(('x', 'y', 'z', *'abcdefgh')[:width])}\nSIZE {'4 ' * width}\n"
    header += f"TYPE {'F ' * width}\nCOUNT {'1 ' * width}\nWIDTH {rows}\nHEIGHT 1\nPOINTS {rows}\nDATA ascii\n"
    return header.encode() + (numbers + newline).encode() * rows


def _tracklets(body: str, count: int) -> Callable[[Path], Path]:
    text = "<boost_serialization><tracklets><item>" + body * count
    return _recording("kitti_raw", tracklet_labels_xml=text.encode)


def _ouster(folder: Path) -> Path:
    files: Any = import_module("sweep_files")
    sample = files.samples()["ouster pcap"]
    about = json.loads(sample.beside["o.json"])
    about["data_format"] |= {"columns_per_frame": 8192, "pixels_per_column": 512, "pixel_shift_by_row": [0] * 512}
    about["data_format"]["column_window"] = [0, 8191]
    about |= {name: list(np.linspace(20, -20, 512)) for name in ("beam_altitude_angles", "beam_azimuth_angles")}
    (folder / "o.json").write_text(json.dumps(about))
    (folder / "o.pcap").write_bytes(sample.content)
    return folder / "o.pcap"


def _loop(folder: Path) -> Path:
    (folder / "loop.bin").symlink_to(folder / "loop.bin")
    return folder / "loop.bin"


HOSTILE: dict[str, Hostile] = {
    "yaml depth": Hostile("OPV2V's YAML, 50,000 open brackets", _yaml("x: " + "[" * 50_000)),
    "yaml merges": Hostile("YAML of merges into merges", _yaml(_merges())),
    "yaml aliases": Hostile("YAML of aliases of aliases", _yaml(_bomb(9, f"[{','.join(['*a{0}'] * 7)}]"))),
    "yaml base 60": Hostile("YAML, a base-60 integer of 400 kB", _yaml("x: " + "1:" * 200_000 + "1\n")),
    "yaml directives": Hostile("YAML, 100,000 directives", _yaml("".join(f"%TAG !{k}! x\n" for k in range(100_000)))),
    "yaml nodes": Hostile("YAML, 4 MB of short nodes", _yaml("x: [" + "1," * 1_990_000 + "]\n")),
    "yaml numbers": Hostile("YAML, infinite pose", _yaml("lidar_pose: [.inf, 0, 0, 0, 0, 0]\n")),
    "yaml nested height": Hostile("YAML, lists for numbers", _yaml(
        "lidar_pose: [1, 2, 3, 0, 0, 0]\ntrue_ego_pos: [[1], [2], [3]]\n")),
    "yaml huge integer": Hostile("YAML, an integer of 1,000 digits", _yaml(
        f"lidar_pose: [1, 2, {'9' * 1000}, 0, 0, 0]\n")),
    "yaml channels": Hostile("data_protocol.yaml with 1,000,000,000 channels", _recording(
        "opv2v", data_protocol_yaml=lambda: import_module("recording_files").PROTOCOL.replace(
            "channels: 4", "channels: 1000000000").encode())),
    "npy header": Hostile("NPY header of blanks, 306 bytes", _file("a.npy", lambda: _npy_header(241))),
    "npy long header": Hostile("the same, 10 kB", _file("a.npy", lambda: _npy_header(9_900))),
    "npz text": Hostile("NPZ with text as ring", _file("a.npz", _text_ring)),
    "npz entries": Hostile("NPZ, 400,000 entries", _file("a.npz", lambda: _zip_entries(400_000))),
    "gzip members": Hostile("a million empty gzip members", _file(
        "a.bin.gz", lambda: gzip.compress(b"", mtime=0) * 1_000_000)),
    "pcd text": Hostile("ascii PCD, numbers of one digit", _file("a.pcd", lambda: _pcd("1 2 3", 3_000_000))),
    "pcd wide text": Hostile("ascii PCD, eleven columns", _file(
        "a.pcd", lambda: _pcd("1 2 3 4 5 6 7 8 9 1 1", 900_000))),
    "pcd line": Hostile("ascii PCD of one line", _file("a.pcd", lambda: _pcd("1 2 3", 3_000_000, " "))),
    "pcap fragments": Hostile("capture of fragments that never fit", _file("a.pcap", lambda: _pcap(300_000, True))),
    "index rows": Hostile("index of seven million empty entries", _file(
        "index.json", lambda: b"[" + b"{}," * 7_000_000)),
    "ouster pixels": Hostile("Ouster metadata of 512 × 8192 pixels", _ouster),
    "mcap chunk": Hostile("MCAP, a chunk of 1 GB of zeros", _recording("mcap", mcap=lambda: _mcap_chunk(10**9))),
    "mcap many chunks": Hostile("MCAP, 30,000 chunks of 900 kB", _recording("mcap", mcap=lambda: _mcap_chunk(
        0, _mcap_message(900_000), 30_000))),
    "mcap records": Hostile("MCAP, five million empty records", _recording(
        "mcap", mcap=lambda: _mcap(struct.pack("<BQ", 0x85, 0) * 5_000_000))),
    "mcap records in a chunk": Hostile("MCAP, a chunk of empty records", _recording(
        "mcap", mcap=lambda: _mcap_chunk(0, struct.pack("<BQ", 0x85, 0) * 3_000_000))),
    "ros1 index": Hostile("ROS 1 bag, one index named 500 times", _recording("ros1 bag", bag=_ros1_indexes)),
    "ros1 chunk": Hostile("ROS 1 bag, a chunk of 1 GB of zeros", _recording("ros1 bag", bag=_ros1_chunk)),
    "db3 endless view": Hostile("ROS 2 bag whose topics are an endless view", _db3(
        "DROP TABLE topics", "CREATE VIEW topics AS WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL SELECT id FROM r) "
        "SELECT id, '/a' AS name, 'sensor_msgs/msg/PointCloud2' AS type, 'cdr' AS serialization_format FROM r",
        "CREATE TABLE \"TOPICS \" (x)")),
    "db3 computed": Hostile("ROS 2 bag whose messages are computed", _db3(
        "DROP TABLE messages", "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data AS (zeroblob(900000000)))", "INSERT INTO messages (topic_id, timestamp) VALUES (1, 1)")),
    "metadata depth": Hostile("metadata.yaml, 50,000 open brackets", _metadata("x: " + "[" * 50_000)),
    "metadata merges": Hostile("metadata.yaml of merges into merges", _metadata(_merges())),
    "nuscenes brace": Hostile("nuScenes table of 60 MB without a closing brace", _recording(
        "nuscenes", ego_pose_json=lambda: b'[{"token": "' + b"x" * 60_000_000)),
    "nuscenes nested": Hostile("nuScenes table of 30 MB, objects in objects", _recording(
        "nuscenes", ego_pose_json=lambda: b"[" + b",".join([b'{"a": {"b": [' + b"{}," * 8_000 + b"{}]}}"] * 1_200))),
    "tracklets elements": Hostile("KITTI tracklets, elements without end", _tracklets("<a/>", 5_000_000)),
    "tracklets depth": Hostile("KITTI tracklets, 5 million deep", _tracklets("<a>", 5_000_000)),
    "carla poses": Hostile("CARLA's poses.csv of 20 MB of damaged rows", _recording(
        "carla", poses_csv=lambda: b"frame,t_ns,x,y,z,roll,pitch,yaw\n" + b"a,\n" * 7_000_000)),
    "carla actors": Hostile("CARLA's actors.jsonl of 20 MB of short lines", _recording(
        "carla", actors_jsonl=lambda: b"{}\n" * 7_000_000)),
    "link circle": Hostile("a link to itself", _loop),
}  # fmt: skip


def measure(path: Path) -> Cost:
    """Read whatever lies at a path in this process."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before, start = _status("VmRSS"), time.process_time()
    outcome = "read"
    warnings.simplefilter("ignore", UserWarning)
    try:
        _read(path)
    except (ValueError, OSError, ImportError) as error:
        outcome = "one line" if "\n" not in str(error) and str(path.parent) in str(error) else "unclear message"
    except BaseException as error:
        outcome = type(error).__name__
    return Cost(time.process_time() - start, max(0, _status("VmHWM") - before), outcome)


def _status(key: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return 1024 * int(line.split()[1])


def _read(path: Path) -> None:
    from viewshed.io import read_index, read_sweeps

    if path.name == "index.json":
        read_index(path)
    elif path.is_dir():
        source = _recordings()[0](path)
        lines: list[str] = []
        refs = [ref for ref, _ in _recordings()[1](source, on_damage=lambda _, line: lines.append(line))]
        for ref in refs:
            source.boxes(ref)
        if any("\n" in line for line in lines):
            raise RuntimeError("a line of damage is two")
        if lines or source.damage():
            raise ValueError(f"{path.parent}: {len(lines)} lines of damage")
    else:
        for sweep in read_sweeps(path):
            assert np.isfinite(sweep.points).all()


def _recordings() -> tuple[Any, Any]:
    """Return what opens a recording and what gives its sweeps; earlier versions had them elsewhere."""
    try:
        return (import_module("viewshed.datasets.recordings").open_source,
                import_module("viewshed.datasets.recordings.source").each_sweep)  # fmt: skip
    except ModuleNotFoundError:
        return import_module("viewshed.datasets.sources").open_source, import_module(
            "viewshed.datasets.source"
        ).each_sweep


def _warm(folder: Path, path: Path) -> None:
    """Load the libraries and the compiled code that a file needs before it is measured."""
    import pyarrow  # noqa: F401

    files: Any = import_module("sweep_files")
    made: Any = import_module("recording_files")
    if path.is_dir():
        for kind in ("opv2v", "kitti_raw", "mcap"):
            measure(made.write(folder / kind, made.recordings()[kind]))
        return
    for sample in files.samples().values():
        if Path(sample.name).suffix == path.suffix:
            for name, content in {**sample.beside, sample.name: sample.content}.items():
                (folder / name).write_bytes(content)
            measure(folder / sample.name)


def _run_one(path: Path, checkout: Path) -> Cost:
    """Return what reading a file costs a child process with the viewshed of a checkout."""
    command = [sys.executable, __file__, "--measure", str(path)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=GIVE_UP_S + 90, check=False, env=environment_of(checkout)
        )
    except subprocess.TimeoutExpired:
        return Cost(GIVE_UP_S, 0, "does not end")
    if done.returncode != 0:
        how = {-11: "SIGSEGV", -9: "killed", -24: "does not end"}.get(done.returncode, f"exit {done.returncode}")
        return Cost(GIVE_UP_S if how == "does not end" else 0.0, 0, how)
    return Cost(**json.loads(done.stdout.splitlines()[-1]))


def _child(path: Path) -> None:
    import resource
    from dataclasses import asdict

    with TemporaryDirectory() as folder:
        _warm(Path(folder), path)
    used = int(time.process_time())
    resource.setrlimit(resource.RLIMIT_CPU, (used + GIVE_UP_S, used + GIVE_UP_S + 5))
    size = _status("VmSize") + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    print(json.dumps(asdict(measure(path))))


def total_bytes(path: Path) -> int:
    """Return the bytes of a file, or of those in a folder."""
    return (
        sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
        if path.is_dir()
        else path.lstat().st_size
    )


def report(rows: list[str], with_before: bool) -> str:
    """Return the page."""
    from viewshed._results import with_numbers  # here: this file also runs with versions that do not have it

    head = "| file | bytes |" + (" before: s | MB | outcome |" if with_before else "") + " now: s | MB | outcome |"
    rule = "|---|---|" + ("---|---|---|" if with_before else "") + "---|---|---|"
    made = (
        "- command: `python tools/hostile_files.py --before CHECKOUT`\n"
        f"- date: {datetime.datetime.now(datetime.UTC):%Y-%m-%d}\n"
        f"- version: {platform.machine()}, Linux, Python {platform.python_version()}, numpy {np.__version__}\n"
        "- before: commit d5ad149, the last with the former layout"
    )
    return with_numbers("Hostile files", made, "\n".join([
        "Files that were built to kill, stall or swell a reader. Each is read in a process of its own after everything "
        f"is loaded: seconds of the processor (given up after {GIVE_UP_S}), growth of the process's memory (at most "
        f"{MEMORY_BYTES // 10**9} GB), and how it ended: *read*, *one line* that names a file, or the exception that "
        f"would end a whole run. The aim is at most {LIMIT_S:g} s, and the larger of {RATIO} × the file and "
        f"{LIMIT_BYTES // 10**6} MB; what misses it is bold. The rows were measured in several runs (`--only`).", "",
        head, rule, *rows,
    ]))  # fmt: skip


def _cells(cost: Cost, size: int) -> str:
    mark = "" if cost.within(size) else "**"
    outcome = f"{mark}{cost.outcome}{mark}"
    return f" {cost.seconds:.2f} | {cost.peak_bytes / 1e6:.0f} | {outcome} |"


def main() -> None:
    """Make the files, measure, write the page; exit 1 where this version misses the aim."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        _child(given.measure)
        return
    rows, missed = [], 0
    for name, hostile in HOSTILE.items():
        if not any(word in name for word in given.only.split(",")):
            continue
        with TemporaryDirectory() as folder:
            path = hostile.write(Path(folder))
            size = total_bytes(path)
            costs = [_run_one(path, checkout) for checkout in (given.before, ROOT) if checkout]
        missed += not costs[-1].within(size)
        rows.append(f"| {hostile.what} | {size} |" + "".join(_cells(cost, size) for cost in costs))
        print(name, rows[-1], flush=True)
    if given.out:
        given.out.write_text(report(rows, bool(given.before)), encoding="utf-8")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
