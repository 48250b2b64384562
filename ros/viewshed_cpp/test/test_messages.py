"""The messages of the C++ node, compiled against those of ROS: grids as the Python node has them.

VIEWSHED_LIBRARY names the prefix that libviewshed is installed in (docs/cpp.md). The node itself needs rclcpp.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from viewshed import BevGrid, Rigid, Sweep, read_sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.geometry import quaternion_from_rotation
from viewshed.io.export.ros import visibility_layer
from viewshed.io.samples import junction_path
from viewshed.preprocess.leveling import level

HERE = Path(__file__).resolve().parent
GRID = BevGrid(256, 64.0)
TILT = np.array([0.9689124217106447, 0.0, 0.24740395925452294, 0.0])


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The test program, compiled."""
    prefix = os.environ.get("VIEWSHED_LIBRARY")
    if prefix is None:
        pytest.skip("VIEWSHED_LIBRARY names no installed libviewshed")
    headers = Path(os.environ.get("VIEWSHED_ROS_HEADERS", f"{sys.prefix}/include"))
    library = next(Path(prefix).glob("lib*/libviewshed.so"))
    path = tmp_path_factory.mktemp("program") / "grids_of_cloud"
    folders = [
        HERE.parent / "include",
        Path(prefix) / "include",
        *(each for each in headers.iterdir() if each.is_dir()),
    ]
    subprocess.run(
        ["c++", "-std=c++17", "-Wall", "-Wextra", "-Werror", str(HERE / "grids_of_cloud.cpp"),
         str(HERE.parent / "src" / "messages.cpp"), "-o", str(path), *(f"-isystem{folder}" for folder in folders),
         str(library), f"-Wl,-rpath,{library.parent}"],
        check=True,
    )  # fmt: skip
    return path


@pytest.mark.parametrize("tilted", [False, True])
def test_grids_are_those_of_python(program: Path, tilted: bool, tmp_path: Path) -> None:
    sweep = Sweep(read_sweep(junction_path()).points, attitude=TILT if tilted else None)
    sweep.points.tofile(tmp_path / "points.bin")
    command = [str(program), str(tmp_path / "points.bin"), "tilted" if tilted else "level"]
    written = subprocess.run(command, capture_output=True, check=True).stdout
    leveled = level(sweep, GRID)
    estimate = ShadowMap(GRID).estimate(leveled)
    sensor_from_grid = leveled.level_from_sensor.inverse() @ Rigid(np.eye(3), np.array([*GRID.origin_m, 0.0]))
    cells, size = 256 * 256, 256 * 256 + 7 * 8
    for k, layer in enumerate(("visibility", "state")):
        part = written[k * size : (k + 1) * size]
        values, pose = np.frombuffer(part[:cells], np.int8), np.frombuffer(part[cells:], np.float64)
        assert np.array_equal(values.reshape(256, 256).T, visibility_layer(estimate, layer)), layer
        assert pose[:3] == pytest.approx(sensor_from_grid.translation)
        assert np.abs(pose[3:] @ quaternion_from_rotation(sensor_from_grid.rotation)) == pytest.approx(1.0)
    assert len(written) == 2 * size
