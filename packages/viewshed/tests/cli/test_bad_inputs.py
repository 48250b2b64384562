"""Bad inputs as users make them: each is one clear line on standard error and exit code 2, and nothing is written."""

import gzip
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from tests.cli.commands import run
from tests.io.test_bad_input import BAD
from tests.recordings.read.test_rosbag import ROS2, S, write_mcap, write_ros2

from viewshed import Sweep, write_sweep
from viewshed.io.samples import junction_path

LOW, HIGH = (-20.0, -20.0, -2.0, 0.0), (20.0, 20.0, 2.0, 1.0)
CLOUD = np.random.default_rng(0).uniform(LOW, HIGH, (500, 4)).astype(np.float32)
POSE = "1 0 0 0 0 1 0 0 0 0 1 1.8\n"
PCD = (
    "VERSION .7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\n"
    "WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {data}\n"
)


class Case(NamedTuple):
    """One bad input.

    Attributes:
        name: what is wrong.
        make: writes it into a folder and returns the command.
        said: what the line must say.
    """

    name: str
    make: Callable[[Path], tuple[object, ...]]
    said: str


def put(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def bin4(path: Path, rows: np.ndarray = CLOUD) -> Path:
    return put(path, np.ascontiguousarray(rows, np.float32).tobytes())


def npy(path: Path, array: np.ndarray) -> Path:
    np.save(path, array)
    return path.with_suffix(".npy")


def npz(path: Path) -> Path:
    np.savez(path, values=np.zeros(3))
    return path


def good(place: Path) -> list[Path]:
    """A sweep that can be read."""
    return [put(place / "000000.pcd.bin.gz", junction_path().read_bytes())]


def pcd(path: Path, fields: str = "x y z", data: str = "binary", n: int = 500, body: bytes | None = None) -> Path:
    width = len(fields.split())
    one = " ".join(["{}"] * width)
    head = PCD.format(
        fields=fields, sizes=one.format(*"4" * width), types=one.format(*"F" * width),
        counts=one.format(*"1" * width), n=n, data=data,
    )  # fmt: skip
    return put(path, head.encode() + (np.zeros((n, width), np.float32).tobytes() if body is None else body))


def ply(path: Path, properties: str, count: int, body: bytes) -> Path:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n"
    return put(path, head.encode() + body)


def bag(folder: Path) -> Path:
    """A bag with two topics of clouds, without poses."""
    return write_mcap(folder / "drive", [("/front", 1, ROS2.cloud(S)), ("/rear", 2, ROS2.cloud(S))])


def folder(place: Path, name: str) -> Path:
    (place / name).mkdir()
    return place / name


def with_rings(place: Path, ring: int) -> Path:
    write_sweep(Sweep(CLOUD[:, :3], ring=np.full(500, ring, np.int16)), place / "a.npz")
    return place / "a.npz"


def loop(path: Path) -> Path:
    path.symlink_to(path)
    return path


def unreadable(path: Path) -> Path:
    path.chmod(0)
    return path


def index(folder: Path, entry: object) -> Path:
    return put(folder / "index.json", json.dumps(entry))


def toml(folder: Path, text: str) -> Path:
    return put(folder / "mine.toml", text)


XYZ = "property float x\nproperty float y\nproperty float z\n"

NAMED = [
    Case("missing file", lambda f: ("estimate", f / "no.bin"), "no.bin: No such file"),
    Case("missing disk", lambda f: ("estimate", "/media/usb/sweep.bin"), "/media/usb/sweep.bin: No such file"),
    Case("empty file", lambda f: ("estimate", put(f / "a.bin", b"")), "a.bin: the file is empty"),
    Case("empty pcd", lambda f: ("info", put(f / "a.pcd", b"")), "a.pcd: the file is empty"),
    Case("text as bin", lambda f: ("estimate", put(f / "a.bin", "not points\n" * 9)), "a.bin"),
    Case("text as pcd", lambda f: ("estimate", put(f / "a.pcd", "hello")), "is named like pcd but does not begin like"),
    Case("a picture as ply", lambda f: ("info", put(f / "a.ply", b"\x89PNG\r\n\x1a\n" + bytes(99))), "named like ply"),
    Case("a zip as npz", lambda f: ("info", put(f / "a.npz", b"PK\x03\x04" + bytes(60))), "a.npz"),
    Case("html as bin", lambda f: ("info", put(f / "a.bin", "<!DOCTYPE html><html>" * 20)), "a.bin"),
    Case("unknown ending", lambda f: ("estimate", put(f / "a.xyz", "1 2 3\n")),
         "format is not known by name or content"),
    Case("las", lambda f: ("estimate", put(f / "a.las", b"LASF" + bytes(300))),
         "a.las: is a LAS file; convert it to PLY or PCD"),
    Case("pcapng", lambda f: ("info", put(f / "a.pcap", b"\n\r\r\n" + bytes(60))),
         "is a pcapng capture; convert it with"),
    Case("gzip twice", lambda f: ("info", put(f / "a.bin.gz", gzip.compress(gzip.compress(b"x" * 99)))),
         "gzipped twice"),
    Case("gzip cut off", lambda f: ("info", put(f / "a.bin.gz", gzip.compress(CLOUD.tobytes())[:-20])), "cut off"),
    Case("gzip of nothing", lambda f: ("info", put(f / "a.bin.gz", gzip.compress(b""))), "gzip content is empty"),
    Case("a device", lambda f: ("info", "/dev/null"), "/dev/null: is not a regular file"),
    Case("a loop of links", lambda f: ("info", loop(f / "b.bin")), "b.bin"),
]  # fmt: skip
CUT_OFF = [
    Case("bin cut off", lambda f: ("info", put(f / "a.bin", CLOUD.tobytes()[:-3])), "a.bin"),
    Case("bin of one byte", lambda f: ("info", put(f / "a.bin", b"\0")), "a.bin"),
    Case("pcd cut off", lambda f: ("info", pcd(f / "a.pcd", body=bytes(100))), "a.pcd"),
    Case("pcd without z", lambda f: ("info", pcd(f / "a.pcd", "x y i")), "must have columns x, y and z, z not found"),
    Case("pcd of another kind", lambda f: ("info", pcd(f / "a.pcd", data="zipped")), "a.pcd"),
    Case("pcd of -1 points", lambda f: ("info", pcd(f / "a.pcd", n=-1, body=b"")), "a.pcd"),
    Case("pcd with words", lambda f: ("info", pcd(f / "a.pcd", data="ascii", n=2, body=b"1 2 3\na b c\n")), "a.pcd"),
    Case("ply of faces", lambda f: ("info", put(f / "a.ply", "ply\nformat ascii 1.0\nelement face 1\nend_header\n1\n")),
         "a.ply"),
    Case("ply without z", lambda f: ("info", ply(f / "a.ply", "property float x\nproperty float y\n", 1, bytes(8))),
         "z not found"),
    Case("ply cut off", lambda f: ("info", ply(f / "a.ply", XYZ, 100, bytes(50))), "a.ply"),
    Case("npy of text", lambda f: ("info", npy(f / "a.npy", np.array([["a", "b", "c"]]))), "a.npy"),
    Case("npy transposed", lambda f: ("info", npy(f / "a.npy", np.zeros((3, 500)))), "transpose it"),
    Case("npy of two columns", lambda f: ("info", npy(f / "a.npy", np.zeros((500, 2)))), "a.npy"),
    Case("npy of a picture", lambda f: ("info", npy(f / "a.npy", np.zeros((4, 64, 3)))), "a.npy"),
    Case("npy of objects", lambda f: ("info", npy(f / "a.npy", np.array([{}], object))), "a.npy"),
    Case("npy of complex", lambda f: ("info", npy(f / "a.npy", np.zeros((9, 3), complex))), "a.npy"),
    Case("npy of more points than there are", lambda f: ("info", put(
        f / "a.npy", b"\x93NUMPY\x01\0v\0"
        + b"{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999, 3), }".ljust(118))), "a.npy"),
    Case("npz without points", lambda f: ("info", npz(f / "a.npz")), "a.npz"),
]  # fmt: skip
FOLDERS = [
    Case("empty folder", lambda f: ("estimate", f), "is a folder without sweeps and no recording"),
    Case("folder of text", lambda f: (put(f / "a.txt", "x"), "estimate", f)[1:], "sweeps end in .pcd.bin, .bin, .pcd"),
    Case("folder above", lambda f: (bin4(folder(f, "s") / "a.bin"), "estimate", f)[1:], "s has some"),
    Case("pattern without a match", lambda f: ("estimate", f / "*.pcd"), "no file fits"),
    Case("pattern of folders", lambda f: (folder(f, "a"), "estimate", f / "?")[1:], "folder without sweeps"),
    Case("metadata without a bag", lambda f: (put(f / "metadata.yaml", "x: 1"), "estimate", f)[1:],
         "no .db3 and no .mcap"),
    Case("no file at all", lambda f: ("estimate",), "name at least one FILE, or an --index"),
]  # fmt: skip
BAGS = [
    Case("bag without clouds", lambda f: ("estimate", write_ros2(f / "a", [])), "no topic has"),
    Case("empty bag", lambda f: ("estimate", put(f / "a.bag", b"")), "a.bag: the file is empty"),
    Case("db3 that is none", lambda f: ("estimate", put(f / "a.db3", b"x" * 99)), "it is no SQLite database"),
    Case("mcap that is none", lambda f: ("estimate", put(f / "a.mcap", b"x" * 99)), "does not begin like an MCAP file"),
    Case("topic that does not exist", lambda f: ("estimate", bag(f), "--topic", "/up"),
         "topic must be one with sweeps, /front (1 sweeps), /rear (1 sweeps), got '/up'"),
    Case("topic of a file", lambda f: ("estimate", *good(f), "--topic", "/up"), "--topic goes with a bag"),
    Case("sweep beyond the last", lambda f: ("export", *good(f), "--number", 3), "number must be below 1"),
    Case("axes of a recording", lambda f: ("estimate", bag(f), "--file-frame", "carla"),
         "does not go with a recording"),
]  # fmt: skip
POSES = [
    Case("history without poses", lambda f: ("estimate", *good(f), "--history", 2),
         "--history needs a pose and a time"),
    Case("missing poses", lambda f: ("estimate", *good(f), "--poses", f / "p.txt"), "p.txt: No such file"),
    Case("poses of wrong length", lambda f: ("estimate", bin4(f / "a.bin"), bin4(f / "b.bin"), "--poses",
         put(f / "p.txt", POSE)), "must have one pose for each of 2 files, got 1 lines"),
    Case("poses of nine numbers", lambda f: ("estimate", *good(f), "--poses", put(f / "p.txt", "1 2 3 4 5 6 7 8 9\n")),
         "line 1 must have 12 numbers (KITTI) or 8 (TUM"),
    Case("poses that turn nothing", lambda f: ("estimate", *good(f), "--poses", put(f / "p.txt", "0 " * 12)), "line 1"),
    Case("poses of another day", lambda f: ("estimate", bin4(f / "1700000000000000.bin"), "--poses",
         put(f / "p.txt", "5 0 0 0 0 0 0 1\n")), "has no pose: p.txt reaches from 5.000 to 5.000 s"),
    Case("poses in words", lambda f: ("view", *good(f), "--html", f / "v.html", "--poses", put(f / "p.txt", "east\n")),
         "line 1 must be numbers, got 'east'"),
    Case("poses as a folder", lambda f: ("estimate", *good(f), "--poses", f), "is a folder"),
    Case("crs without a pose", lambda f: ("estimate", *good(f), "--crs", "EPSG:25832"), "must have a pose in it"),
    Case("unknown crs", lambda f: ("export", *good(f), "--crs", "EPSG:77", "--origin", "0,0,0"), "crs must be a known"),
    Case("crs in degrees", lambda f: ("export", *good(f), "--crs", "EPSG:4326", "--origin", "0,0,0"), "projected"),
    Case("crs of a mask", lambda f: ("export", *good(f), "--to", "nav2_mask", "--crs", "EPSG:25832"), "crs goes with"),
    Case("origin outside of the world", lambda f: ("export", *good(f), "--crs", "EPSG:25832", "--origin",
         "1e20,1e20,0"),
         "lies outside of EPSG:25832"),
    Case("origin of two numbers", lambda f: ("info", *good(f), "--origin", "1,2"),
         "origin must be 3 numbers with commas"),
    Case("origin that is none", lambda f: ("info", *good(f), "--origin", "nan,0,0"), "origin_m must be three finite"),
]  # fmt: skip
OUTPUTS = [
    Case("output folder that is a file", lambda f: ("estimate", *good(f), "--out", put(f / "o", "x")),
         "must be a folder"),
    Case("output file in no folder", lambda f: ("export", *good(f), "--out", f / "no" / "a.geojson"),
         "must lie in a folder that exists"),
    Case("result over its input", lambda f: ("export", *good(f), "--out", f / "000000.pcd.bin.gz"),
         "is an input and would be"),
    Case("picture below a file", lambda f: ("compare", *good(f), "--out", put(f / "o", "x") / "c.png"),
         "must lie in a folder that exists"),
    Case("page as a folder", lambda f: ("view", *good(f), "--html", f), "path must name a file, got the folder"),
    Case("unknown result", lambda f: ("estimate", *good(f), "--results", "shp"), "results must be some of png,geojson"),
    Case("unknown export", lambda f: ("export", *good(f), "--to", "las"), "to must be one of geojson, geotiff"),
]  # fmt: skip
OPTIONS = [
    Case("sensor of other rings", lambda f: ("info", with_rings(f, 90), "--sensor", "vlp16"),
         "ring must lie in [0, 16) of VLP-16"),
    Case("sensor of another spelling", lambda f: ("info", *good(f), "--sensor", "velodyne"), "sensor must be one of"),
    Case("sensor file without beams", lambda f: ("info", *good(f), "--sensor", toml(f, 'name = "x"')), "missing keys"),
    Case("sensor file of JSON", lambda f: ("info", *good(f), "--sensor", toml(f, "{}")), "must be a TOML beam table"),
    Case("format of another", lambda f: ("info", *good(f), "--format", "ply"), "000000.pcd.bin.gz"),
    Case("ring of nothing", lambda f: ("info", *good(f), "--ring", "column"), "ring must be one of file, none"),
    Case("index that names nothing", lambda f: ("estimate", "--index", index(f, [])), "must name a sweep, got none"),
    Case("index of words", lambda f: ("estimate", "--index", put(f / "index.json", "sweeps")), "index.json"),
    Case("file beside the index", lambda f: ("estimate", *good(f), "--index", index(f, [
        {"file": "other.bin", "sensor": "HDL-32E", "stats": {"points": 1}}])), "is not in the index"),
    Case("weights of nobody", lambda f: ("estimate", *good(f), "--weights", "yolo"), "yolo"),
    Case("weights for a shadow map", lambda f: ("estimate", *good(f), "--method", "shadow_map", "--weights", "road"),
         "weights must be left out for shadow_map"),
    Case("monitor that is none", lambda f: ("monitor", "check", *good(f), "--monitor-file", put(f / "m.npz", "x")),
         "m.npz"),
    Case("check of an empty folder", lambda f: ("monitor", "check", f), "is a folder without sweeps"),
    Case("explain beyond the last", lambda f: ("monitor", "explain", *good(f), "--number", 4), "number must be below"),
    Case("two pages at once", lambda f: ("view", *good(f), "--html", f / "a", "--rerun", f / "b"), "name one of"),
    Case("bag to a picture", lambda f: ("record", *good(f), "--to", f / "a.png"), "a.png"),
]  # fmt: skip
COMMANDS = [
    Case("replay of nothing", lambda f: ("replay", f / "no.mcap"), "no.mcap: no such file"),
    Case("replay to a picture", lambda f: ("replay", bag(f), "--as-fast", "--to", f / "a.png"), "a.png"),
    Case("pace of nothing", lambda f: ("replay", *good(f), "--rate", 0), "rate"),
    Case("fusing without poses", lambda f: ("fuse", *good(f)), "must have a time and a pose"),
    Case("attack of nobody", lambda f: ("attack", *good(f), "--attack", "laser", "--out", f / "o"), "attack must be"),
    Case("attack of an empty folder", lambda f: ("attack", folder(f, "s"), "--attack", "relay", "--out", f / "o"),
         "folder"),
    Case("budget in words", lambda f: ("attack", *good(f), "--attack", "relay", "--budget", "much", "--out", f / "o"),
         "budget must be"),
    Case("corruption of nobody", lambda f: ("corrupt", *good(f), "--corruption", "lava", "--out", f / "o"),
         "corruption must be"),
    Case("severity of 9", lambda f: ("corrupt", *good(f), "--corruption", "fog", "--severity", 9, "--out", f / "o"),
         "severity must"),
    Case("preset of nobody", lambda f: ("simulate", "mars", "--out", f / "o"), "preset must be one of"),
    Case("no sweeps at all", lambda f: ("simulate", "nuscenes-small", "--sweeps", 0, "--out", f / "o"), "sweeps must"),
    Case("a folder that is no data set", lambda f: ("dataset", "info", f), "must be a data set"),
    Case("a data set that is nowhere", lambda f: ("dataset", "verify", f / "no"), "no"),
    Case("labels of nothing", lambda f: ("label", f / "no", "--out", f / "o"), "no"),
    Case("a config of nobody", lambda f: ("train", "best", "--out", f / "o"), "best"),
    Case("a config of another key", lambda f: ("train", toml(f, "speed = 3\n"), "--out", f / "o"), "speed"),
    Case("a network that is none", lambda f: ("quantize", "viewnet_road", put(f / "n.onnx", "x"), "--out", f / "o"),
         "n.onnx"),
    Case("methods of nobody", lambda f: ("compare", *good(f), "--methods", "lidar"), "method"),
    Case("grid of words", lambda f: ("info", *good(f), "--grid", "large"), "grid must be one of road"),
    Case("grid of no cells", lambda f: ("info", *good(f), "--grid", "0x64"), "cells must"),
    Case("target of nobody", lambda f: ("estimate", *good(f), "--target", "bus"), "target must be one of car"),
    Case("height in the sky", lambda f: ("info", *good(f), "--height", "nan"), "height"),
    Case("tilt that is no rotation", lambda f: ("info", *good(f), "--attitude", "0,0,0,0"), "must have norm 1"),
    Case("probability of 3", lambda f: ("estimate", *good(f), "--threshold", 3), "threshold must lie in (0, 1]"),
    Case("rate of 2", lambda f: ("monitor", "calibrate", *good(f), "--rate", 2, "--out", f / "m.npz"), "rate"),
    Case("index for crossview that is none", lambda f: ("evaluate", "crossview", put(f / "i.json", "{")), "i.json"),
    Case(
        "a study's step of nobody",
        lambda f: ("study", "agents", "--only", "guess", "--out", f / "o"),
        "--only must be some of scenes, runs, page",
    ),
    Case("a study's size of nobody", lambda f: ("study", "robustness", "--preset", "huge", "--out", f / "o"), "preset"),
]  # fmt: skip
BOMBS = {"bomb.npz", "bomb.bin.gz"}
"""Larger than a test's limit, not than a user's."""
DAMAGED = [
    Case(name, lambda f, name=name: ("estimate", put(f / name, BAD[name][0])), name)  # type: ignore[misc]
    for name in sorted(BAD.keys() - BOMBS)
]
GROUPS = {
    "files that are not what they are named": NAMED,
    "files that are cut off or hold something else": CUT_OFF,
    "folders and patterns": FOLDERS,
    "bags": BAGS,
    "poses and reference systems": POSES,
    "where results go": OUTPUTS,
    "options that contradict the file": OPTIONS,
    "other commands": COMMANDS,
    "damaged files of each format": DAMAGED,
}
CASES = [case for cases in GROUPS.values() for case in cases]


def test_no_two_cases_are_the_same() -> None:
    assert len({case.name for case in CASES}) == len(CASES) >= 148


def fault_of(case: Case, place: Path) -> str:
    """Return what is wrong with the answer to a bad input, empty where nothing is.

    Args:
        place: an empty folder.
    """
    inputs = place / "in"
    inputs.mkdir()
    words = case.make(inputs)
    before = {path: path.stat().st_mtime_ns for path in inputs.rglob("*") if not path.is_symlink()}
    done = run(*words, cwd=place)
    if done.returncode != 2:
        return f"exit code {done.returncode}: {done.stdout}{done.stderr}"
    lines = [line for line in done.stderr.splitlines() if not line.startswith("viewshed: note: ")]
    if len(lines) != 1 or not lines[0].startswith("viewshed: ") or len(lines[0]) >= 900:
        return f"not one line: {done.stderr}"
    if case.said not in lines[0]:
        return f"it does not say {case.said!r}: {lines[0]}"
    if {path: path.stat().st_mtime_ns for path in before} != before:
        return "an input has changed"
    written = {path for path in place.rglob("*") if path.is_file() and not path.is_symlink()} - before.keys()
    return f"written: {sorted(written)}" if written else ""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_input_is_one_line_and_exit_code_2(case: Case, tmp_path: Path) -> None:
    assert fault_of(case, tmp_path) == ""


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission_is_one_line(tmp_path: Path) -> None:
    done = run("estimate", unreadable(bin4(tmp_path / "a.bin")), cwd=tmp_path)
    assert (done.returncode, done.stderr.splitlines()) == (2, [f"viewshed: {tmp_path}/a.bin: Permission denied"])


def test_good_sweeps_beside_bad_ones_are_estimated(tmp_path: Path) -> None:
    sweep = junction_path().read_bytes()
    put(tmp_path / "1.pcd.bin.gz", sweep)
    put(tmp_path / "2.pcd.bin.gz", sweep[:1000])
    put(tmp_path / "3.pcd.bin.gz", sweep)
    done = run("estimate", tmp_path, "--results", "npz", "--grid", "64x32", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == ["1", "3"]
    [line] = done.stderr.splitlines()
    assert "2.pcd.bin.gz" in line
