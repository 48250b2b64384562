"""Bad inputs as users make them: each is one clear line on standard error and exit code 2, and nothing is written.

How each format may be damaged is tested where it is read, in ``tests/io`` and ``tests/recordings``.
"""

import fnmatch
import json
import os
import shlex
import struct
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import run
from tests.networks.made import card, nearby
from tests.recordings.read.test_rosbag import ROS2, S, write_mcap, write_ros2

from viewshed import BevGrid, Sweep, read_sweep, write_sweep
from viewshed.io.samples import junction_path
from viewshed.networks.architecture import UNetShape
from viewshed_lab.training.onnx_export import export_onnx

CLOUD = np.random.default_rng(0).uniform((-20, -20, -2, 0), (20, 20, 2, 1), (500, 4)).astype(np.float32)
POSE = "1 0 0 0 0 1 0 0 0 0 1 1.8\n"
SHAPE = UNetShape(4, 2, 0.3)
GOOD = "good.pcd.bin.gz"
files: Any = import_module("sweep_files")

INPUTS: dict[str, bytes | str | Callable[[Path], object]] = {
    GOOD: junction_path().read_bytes(), "a.bin": CLOUD.tobytes(), "b.bin": CLOUD.tobytes(),
    "1700000000000000.bin": CLOUD.tobytes(), "sweep.npz": lambda p: write_sweep(read_sweep(junction_path()), p),
    "rings.npz": lambda p: write_sweep(Sweep(CLOUD[:, :3], ring=np.full(500, 90, np.int16)), p),
    "empty.bin": b"", "words.bin": "not points\n" * 9, "transposed.npy": files.npy(CLOUD[:, :3].T),
    "nothing": Path.mkdir,
    "text/a.txt": "x", "above/s/a.bin": CLOUD.tobytes(),
    "bag": lambda p: write_ros2(p, []),
    "two.mcap": lambda p: write_mcap(p, [("/front", 1, ROS2.cloud(S)), ("/rear", 2, ROS2.cloud(S))]),
    "one.txt": POSE, "nine.txt": "1 2 3 4 5 6 7 8 9\n", "zeros.txt": "0 " * 12, "early.txt": "5 0 0 0 0 0 0 1\n",
    "east.txt": "east\n", "file": "x", "json.toml": "{}", "named.toml": 'name = "x"', "speed.toml": "speed = 3\n",
    "empty.json": "[]", "words.json": "sweeps", "open.json": "{",
    "other.json": json.dumps([{"file": "other.bin", "sensor": "HDL-32E", "stats": {"points": 1}}]),
    "net.onnx": lambda p: export_onnx(p, card(SHAPE, BevGrid(64, 16.0), threshold=0.7), nearby(SHAPE)),
    "words.onnx": "x", "words.npz": "x",
    "torn.npz": bytes(46) + struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 1, 1, 46, 0, 0),
    # The first hour: what people have.
    "image.npy": files.npy(CLOUD[:, :3].repeat(40, axis=1)[:64]),
    "organized.npy": files.npy(np.zeros((8, 90, 3), np.float32)),
    "image.npz": lambda p: np.savez(p, image=np.zeros((64, 1024), np.float32)),
    "two.npz": lambda p: np.savez(p, cloud=CLOUD, labels=CLOUD[:, 0]),
    "mm.npy": files.npy(CLOUD[:, :3] * np.float32(1000)),
    "words.csv": "x,y,z,kind\n1,2,3,car\n", "two.csv": "x,y\n1,2\n", "no.csv": "time,speed,heading\n1,2,3\n",
    "ragged.csv": "x,y,z\n1,2,3\n1,2\n", "german.csv": "x;y;z\n1,5;2,5;3,5\n",
    "cut.las": files.las(CLOUD[:, :3], CLOUD[:, 3])[:900],
}  # fmt: skip
"""What a command line may name: the content of a file, or what makes it."""

UNET = f"estimate {GOOD} --method unet --weights net.onnx"
REPLACED = "is an input and would be replaced; choose another place"
REFUSED = {
    # The first hour: what people have, or type.
    "estimate image.npy": "is it a range image?", "info organized.npy": "reshape it (points.reshape(-1, 3))",
    "export torn.npz": "torn.npz: ",
    "estimate image.npz": "is it a range image?", "estimate two.npz": "a single one, got cloud, labels",
    "estimate mm.npy": "is the file in millimeters", "export mm.npy": "is the file in millimeters",
    "view mm.npy --html a.html": "is the file in millimeters",
    "estimate words.csv": "got a word in the column 'kind': leave it out",
    "estimate two.csv": "three or more numbers per line",
    "estimate no.csv": "must have x, y and z among the names of its columns, got time, speed, heading",
    "estimate ragged.csv": "ragged.csv: ", "estimate german.csv": "for each of 3 names, got 6",
    "estimate cut.las": "points need … bytes, the file holds",
    f"estimate {GOOD} --out view.png": "--out must be a folder for the results, got the name of a file, view.png",
    f"estimate {GOOD} --json --quiet": "exclude each other",
    f"estimate {GOOD} --profile paper": "No such option: --profile",
    f"view {GOOD} --html a.html --every 2": "No such option: --every", f"view {GOOD} --html a.html --step 0": "--step",
    f"estimate {GOOD} --origin 1,2": "origin must be 3 numbers",
    f"estimate {GOOD} --vehicle-yaw north": "--vehicle-yaw",
    # Files that are not there, or not what they are named.
    "estimate no.bin": "no.bin: No such file", "replay no.mcap": "no.mcap: no such file",
    "estimate empty.bin": "empty.bin: the file is empty", "estimate words.bin": "words.bin",
    "info transposed.npy": "; transpose it (",
    "estimate s3://bucket/sweep.bin": "s3://bucket/sweep.bin must be a file or a folder, got a URL; copy",
    # Folders, patterns and bags.
    "estimate .": ". is a folder without sweeps and no recording (nuscenes, kitti_raw,",
    "estimate text": "sweeps end in .pcd.bin, .bin, .pcd", "estimate above": "s has some",
    "estimate no*.pcd": "no file matches", "estimate nothin?": "folder without sweeps",
    "estimate": "give at least one FILE, or an --index", "estimate bag": "no topic has",
    "estimate two.mcap --topic /up": "topic must be one with sweeps, /front (1 sweeps), /rear (1 sweeps), got '/up'",
    f"estimate {GOOD} --topic /up": "--topic is only for bags",
    f"replay {GOOD} --topic /up": "--topic is only for bags",
    f"export {GOOD} --number 3": "number must be below 1",
    f"monitor explain {GOOD} --number 4": "number must be below",
    "estimate two.mcap --file-frame carla": "does not go with a recording",
    # Poses and reference systems.
    **{f"{command} --history 2": "--history needs a pose and a time of each sweep … give --poses FILE"
       for command in (f"estimate {GOOD}", f"replay {GOOD} --as-fast")},
    f"estimate {GOOD} --poses no.txt": "no.txt: No such file",
    f"record {GOOD} --to run.mcap --poses no.txt": "no.txt: No such file",
    "estimate a.bin b.bin --poses one.txt": "must have one pose for each of 2 files, got 1 lines",
    f"estimate {GOOD} --poses nine.txt": "line 1 must have 12 numbers (KITTI) or 8 (TUM",
    f"estimate {GOOD} --poses zeros.txt": "line 1",
    "estimate 1700000000000000.bin --poses early.txt": "has no pose: early.txt reaches from 5.000 to 5.000 s",
    f"view {GOOD} --html v.html --poses east.txt": "line 1 must be numbers, got 'east'",
    f"estimate {GOOD} --poses nothing": "is a folder", f"fuse {GOOD}": "must have a time and a pose",
    f"estimate {GOOD} --crs EPSG:25832": "must have a pose in it",
    f"export {GOOD} --crs EPSG:77 --origin 0,0,0": "crs must be a known",
    f"export {GOOD} --crs EPSG:4326 --origin 0,0,0": "projected",
    f"export {GOOD} --to nav2_mask --crs EPSG:25832": "crs goes with",
    f"export {GOOD} --to cpm_uper": "a CPM must have a time, a pose and its crs, got no crs; give --poses and --crs",
    f"export {GOOD} --crs EPSG:25832 --origin 1e20,1e20,0": "lies outside of EPSG:25832",
    f"info {GOOD} --origin 1,2": "origin must be 3 numbers separated by commas, got 2 in '1,2'",
    # Where results go.
    f"estimate {GOOD} --out file": "must be a folder", f"compare {GOOD} --out file/c.png": "must lie in a folder that",
    f"export {GOOD} --out no/a.geojson": "must lie in a folder that exists",
    f"compare {GOOD} --out x.foo": "--out must be a folder or a file NAME.png, got x.foo",
    "demo --out one.png": "--out must be a folder for the results, got the name of a file, one.png; leave out .png",
    **{f"record {GOOD} --to no/{name}": "must lie in a folder that exists, got … no; create it first"
       for name in ("a.mcap", "a.bag", "a")},
    **dict.fromkeys((
        "estimate sweep.npz --out .", "export sweep.npz --to npz",
        f"export {GOOD} --out {GOOD}",
        "replay two.mcap --topic /front --as-fast --to two.mcap",
        f"view {GOOD} --html {GOOD}", f"view {GOOD} --rerun {GOOD}"
    ), REPLACED),
    f"view {GOOD} --html nothing": "path must name a file, got the folder",
    f"view {GOOD} --sweeps 1": "--html run.html", f"view {GOOD} --serve": "leave out FILES",
    "view --serve --monitor": "one after the other: leave out",
    "view --serve --objects": "one after the other: leave out",
    f"view {GOOD} --html a --rerun b": "give exactly one of --html run.html, --rerun run.rrd",
    f"estimate {GOOD} --results shp": "results must be some of png,geojson … osi,cpm, separated by commas, got 'shp'",
    f"estimate {GOOD} --results ''": "osi,cpm, separated by commas, got ''",
    f"fuse {GOOD} --results gif": "results must be some of jsonl,png",
    f"export {GOOD} --to las": "to must be one of geojson, geotiff",
    f"replay {GOOD} --as-fast --to run.db3": "a bag must be NAME.mcap, NAME.bag (ROS 1) or a folder",
    f"record {GOOD} --to a.png": "a.png", f"replay {GOOD} --schemas foxglove": "--schemas goes with --to",
    # Options that cannot be, or contradict the file.
    "info rings.npz --sensor vlp16": "ring must lie in [0, 16) of VLP-16",
    f"info {GOOD} --sensor velodyne": "sensor must be one of", f"info {GOOD} --sensor named.toml": "missing keys",
    f"info {GOOD} --sensor json.toml": "must be a TOML beam table", f"info {GOOD} --format ply": GOOD,
    f"estimate {GOOD} --format jpeg": "format must be auto or one of", f"estimate {GOOD} --file-frame upside": "upside",
    f"info {GOOD} --ring column": "ring must be one of file, none, got 'column'",
    "estimate --index empty.json": "must name a sweep, got none", "estimate --index words.json": "words.json",
    "estimate --index no.json": "no.json", f"estimate {GOOD} --index other.json": "is not in the index",
    f"estimate {GOOD} --method magic": "method must be one of … paper_delaunay, unet, mc_dropout, got 'magic'",
    f"compare {GOOD} --methods shadow_map,magic": "method must be one of",
    f"estimate {GOOD} --grid 0x64": "cells must lie in [1, 4096], got 0",
    f"estimate {GOOD} --grid street": "grid must be one of road",
    f"estimate {GOOD} --target tank": "target must be one of car, pedestrian",
    f"estimate {GOOD} --attitude 1,1,0,0": "norm 1",
    f"estimate {GOOD} --attitude 1,0,0": "attitude must be 4 numbers", f"info {GOOD} --height nan": "height",
    f"estimate {GOOD} --height 500": "sensor_height_m must lie in (0, 100), got 500; give it in meters",
    f"estimate {GOOD} --threshold 0": "threshold must lie in (0, 1]",
    f"estimate {GOOD} --threshold much": "--threshold",
    f"estimate {GOOD} --parameters loud": "parameters must be sound or paper",
    f"estimate {GOOD} --batch 1025": "Invalid value for '--batch'",
    f"estimate {GOOD} --batch 2 --history 3": "--history needs --batch 1: each sweep is added to the history before",
    f"estimate {GOOD} --require-confirmation": "--require-confirmation needs --history 1 or more",
    f"estimate {GOOD} --history 21": "less than or equal to 20",
    **{f"{command} --history 5 --method {method}": f"history is for shadow_map, got {method}"
       for command, method in ((f"estimate {GOOD}", "majority_vote"), (f"estimate {GOOD} --grid road", "unet"),
                               (f"view {GOOD} --html a.html", "majority_vote"), (f"replay {GOOD}", "majority_vote"))},
    f"export {GOOD} --to cpm --sectors 0": "sectors", f"replay {GOOD} --rate 0": "rate",
    f"monitor calibrate {GOOD} --rate 2 --out m.npz": "rate", "monitor check nothing": "is a folder without sweeps",
    f"monitor check {GOOD} --monitor-file words.npz": "words.npz",
    f"replay {GOOD} --as-fast --to a.mcap --monitor-file {GOOD}": f"{GOOD} must be a whole monitor",
    f"replay {GOOD} --as-fast --attacked vehicle_0": "--attacked goes with --attack",
    f"replay {GOOD} --as-fast --attack melt": "attack must be one of ",
    "record sim --to run.mcap --world moon": "world must be one of street, ",
    "record sim --to run.mcap --preset moon": "moon",
    "record sim --to run.mcap --seconds 0.01": "a drive must have seconds above 0",
    "record sim --to run.mcap --agents 0": "a drive must have seconds above 0",
    "record sim --to run.mcap --topic /up": "sim reads no file: leave out --topic",
    # Networks.
    f"{UNET} --grid 64x16 --abstain-below 0.9 --threshold 0.8":
        "--threshold must be at least --abstain-below 0.9, got 0.8; leave one of them out",
    f"{UNET} --grid 64x16 --target pedestrian": "target must be car for",
    f"{UNET} --grid 64x16 --passes 4": "passes must be 1 for unet",
    f"{UNET} --grid road": "grid must be 64x16 for the network made, got 256x64; ask for that",
    f"estimate {GOOD} --method majority_vote --abstain-below 0.9":
        "abstention must be used with an estimator of probabilities, got 0.9 for majority_vote",
    f"estimate {GOOD} --method unet --weights nowhere": "weights must be a file that viewshed train exported",
    f"estimate {GOOD} --method unet --weights sweep.npz": "must be a network that viewshed exported, got a file",
    f"estimate {GOOD} --weights yolo": "yolo",
    f"estimate {GOOD} --method shadow_map --weights road": "weights must be left out for shadow_map",
    f"estimate {GOOD} --method mc_dropout --grid 65x7":
        "method mc_dropout needs weights, and this version ships none for a car on",
    f"estimate {GOOD} --seed 3 --method majority_vote": "seed must be left out for majority_vote, which is no network",
    f"estimate {GOOD} --device cuda --method majority_vote":
        "device must be left out for majority_vote, which is no network",
    f"estimate {GOOD} --device tpu --method unet": "device must be one of cpu, cuda, got 'tpu'",
    # Commands of the laboratory.
    "evaluate": "Missing command", "evaluate crossview open.json": "open.json",
    "evaluate crossview no.json": "no.json",
    "evaluate crossview no.json --attacks cluster,magic": "attacks must be among uniform",
    f"corrupt {GOOD} --corruption lava --out o": "corruption must be",
    f"corrupt {GOOD} --corruption fog --severity 9 --out o": "severity must",
    "dataset verify no": "no", "train best --out o": "best", "train speed.toml --out o": "speed",
    "quantize road words.onnx --out o": "words.onnx",
    "study agents --only guess --out o": "--only must be some of scenes, runs, page",
    # Words that are no command or option.
    "info": "Missing argument", "info x.bin --wat": "No such option: --wat", "estimat": "No such command",
}  # fmt: skip
"""Command line → what its line must say, parts of it between "…"."""


@pytest.mark.parametrize("words", REFUSED)
def test_a_bad_input_is_one_line_and_exit_code_2(words: str, tmp_path: Path) -> None:
    arguments = shlex.split(words)
    for name, made in INPUTS.items():
        if any(fnmatch.fnmatch(name.partition("/")[0], word.partition("/")[0]) for word in arguments):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            if callable(made):
                made(tmp_path / name)
            else:
                (tmp_path / name).write_bytes(made.encode() if isinstance(made, str) else made)
    before = {path: path.lstat().st_mtime_ns for path in tmp_path.rglob("*")}
    done = run(*arguments, cwd=tmp_path)
    assert (done.returncode, done.stdout if arguments[:2] != ["monitor", "check"] else "") == (2, "")
    [line] = [line for line in done.stderr.splitlines() if not line.startswith("viewshed: note: ")]
    assert line.startswith("viewshed: ")
    assert len(line) < 900
    assert [part for part in REFUSED[words].split(" … ") if part not in line] == []
    after = {path: path.lstat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file() or path in before}
    assert after == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(CLOUD.tobytes())
    (tmp_path / "a.bin").chmod(0)
    done = run("estimate", tmp_path / "a.bin", cwd=tmp_path)
    assert (done.returncode, done.stderr.splitlines()) == (2, [f"viewshed: {tmp_path}/a.bin: Permission denied"])
