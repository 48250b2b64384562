"""Random samples, made without the simulator; and object stores on this machine."""

import contextlib
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from pyarrow import fs

from viewshed.fov.truth import OTHER_DEFINITIONS, Truth
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.io import write_sweep
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sweep import PlanarScan, Sweep
from viewshed_lab.data import Sample
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.raycast.scan import Motion

MakeSample = Callable[..., Sample]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two sequences of three sweeps; one sweep of the first is damaged."""
    rng = np.random.default_rng(4)
    for sequence in ("07", "08"):
        folder = tmp_path / "kitti" / "sequences" / sequence / "velodyne"
        folder.mkdir(parents=True)
        (folder.parent / "times.txt").write_text("0.0\n0.1\n0.2\n")
        for number in range(3):
            points = rng.normal(0, 15, (40 + number, 3)).astype(np.float32)
            write_sweep(Sweep(points), folder / f"{number:06d}.bin")
    (tmp_path / "kitti" / "sequences" / "07" / "velodyne" / "000001.bin").write_bytes(b"12345")
    return tmp_path / "kitti"


@pytest.fixture
def custom_model() -> LidarModel:
    """A sensor that is in no table."""
    elevation = np.deg2rad([-17.3, -3.1, 0.7])
    offset, origin = np.deg2rad([0.1, 0.0, -0.2]), np.array([0.01, 0.0, -0.03])
    return LidarModel("own", elevation, 40, offset, origin, 0.4, 77.7, "é", 33.0, "own")


@pytest.fixture
def make_truth() -> Callable[..., tuple[Truth, np.ndarray]]:
    def make(seed: int = 0, cells: int = 33) -> tuple[Truth, np.ndarray]:
        rng = np.random.default_rng(seed)
        grid = BevGrid(cells, 20.5, (1.5, -0.25))

        def some(high: int) -> np.ndarray:
            return rng.integers(0, high, grid.shape).astype(np.uint8)

        returns, states = ({name: some(high) for name in ("pedestrian", "car")} for high in (256, 4))
        return Truth(grid, returns, states, {name: some(2) == 1 for name in OTHER_DEFINITIONS}), some(2) == 1

    return make


@pytest.fixture
def make_sample(make_truth: Callable[..., tuple[Truth, np.ndarray]], custom_model: LidarModel) -> MakeSample:
    """Return a function that makes a sample with a range image (``image=True``) or with points only."""

    def make(seed: int = 0, *, image: bool = True, scene: str = "s0", split: str = "train", cells: int = 33) -> Sample:
        rng = np.random.default_rng(seed)
        truth, known = make_truth(seed, cells)
        pose = Rigid.from_yaw(rng.uniform(-3, 3), rng.normal(0, 100, 3))
        if not image:
            return Sample(_points(rng, pose), truth, known, scene, split)
        model = custom_model if seed % 2 else lidar_model("vlp16")
        shape = (model.azimuth_columns, model.rings)
        steps = (rng.integers(0, 65536, shape) * (rng.random(shape) < 0.8)).astype(np.uint16)
        level = np.where(steps > 0, rng.integers(0, 256, shape), 0).astype(np.uint8)
        motion = Motion((8.1, -0.3, 0.07), 0.21, 0.1) if seed % 3 else Motion()
        stored = StoredSweep(
            model, steps, level, 0.002, pose, motion, 1.73, 123_456_789_012_345_678 + seed, f"agent {seed}"
        )
        return Sample(stored, truth, known, scene, split)

    return make


def _points(rng: np.random.Generator, pose: Rigid) -> Sweep:
    count = int(rng.integers(0, 300))
    return Sweep(
        points=rng.normal(0, 30, (count, 3)).astype(np.float32),
        intensity=rng.random(count).astype(np.float32),
        ring=rng.integers(0, 64, count).astype(np.int16),
        azimuth=None if rng.random() < 0.5 else rng.random(count).astype(np.float32),
        time_s=rng.random(count).astype(np.float32),
        t_ns=None if rng.random() < 0.5 else 7,
        attitude=np.array([1.0, 0.0, 0.0, 0.0]) if rng.random() < 0.5 else None,
        sensor_height_m=None,
        world_from_sensor=pose if rng.random() < 0.5 else None,
        agent="ägent",
        dropped_points=3,
        infer_sensor=bool(rng.random() < 0.5),
        vehicle_yaw=0.25 if rng.random() < 0.5 else None,
        planar=PlanarScan(np.array([0.5, -1.0]), np.inf) if rng.random() < 0.5 else None,
        pose_covariance=np.eye(6) if rng.random() < 0.5 else None,
    )


@pytest.fixture(scope="session")
def s3() -> Iterator[str]:
    """Start an S3 server with a bucket ``data``; yield the URI options of ``s3://data/FOLDER?OPTIONS``."""
    pytest.importorskip("moto", reason="moto is not installed: S3 is not tested")
    keys = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_EC2_METADATA_DISABLED": "true"}
    port = _free_port()
    with pytest.MonkeyPatch.context() as environment, _server("moto.server", "-H", "127.0.0.1", "-p", port):
        for name, value in keys.items():
            environment.setenv(name, value)
        options = f"endpoint_override=127.0.0.1:{port}&scheme=http&region=us-east-1"
        bucket_store, _ = fs.FileSystem.from_uri(f"s3://data?{options}&allow_bucket_creation=true")
        bucket_store.create_dir("data")
        yield options


def _free_port() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return str(free.getsockname()[1])


@contextlib.contextmanager
def _server(module: str, *words: str) -> Iterator[None]:
    port = int(words[words.index("-p") + 1])
    server = subprocess.Popen(
        [sys.executable, "-m", module, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        _wait_for(port)
        yield
    finally:
        server.kill()
        server.wait()


def _wait_for(port: int) -> None:
    for _ in range(400):
        try:
            socket.create_connection(("127.0.0.1", port)).close()
        except OSError:
            time.sleep(0.05)
        else:
            return
    pytest.fail("the server did not start")
