"""libviewshed: installed, found by CMake and pkg-config, and of one mind with the Python package.

The library is that of VIEWSHED_LIBRARY, a prefix that it is installed in; without it it is compiled here.
"""

from __future__ import annotations

import ctypes as c
import os
import shutil
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import viewshed
from viewshed import PEDESTRIAN, BevGrid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.polygons import polygon_of_mask
from viewshed.io import read_index, read_indexed
from viewshed.sensors import lidar_model, sensor_names
from viewshed_lab.sim import cast, junction

pytestmark = pytest.mark.slow

PACKAGE = Path(__file__).resolve().parents[2]
OK, ARGUMENT, STREAM, ROOM = range(4)
GRID = BevGrid(256, 64.0)


class Options(c.Structure):
    _fields_ = [
        ("cells", c.c_uint32), ("half_extent_m", c.c_double), ("offset_m", c.c_double * 2),
        ("target_width_m", c.c_double), ("target_height_m", c.c_double), ("min_returns", c.c_uint32),
        ("sensor", c.c_char_p),
    ]  # fmt: skip


class CSweep(c.Structure):
    _fields_ = [
        ("count", c.c_size_t), ("points", c.c_void_p), ("point_step", c.c_size_t), ("ring", c.c_void_p),
        ("ring_step", c.c_size_t), ("attitude", c.POINTER(c.c_double)), ("sensor_height_m", c.c_double),
        ("vehicle_yaw", c.c_double),
    ]  # fmt: skip


class CBasis(c.Structure):
    _fields_ = [
        ("sensor_height_m", c.c_double), ("height_source", c.c_int32), ("ground_support", c.c_double),
        ("unsure_ground_share", c.c_double), ("inferred_share", c.c_double), ("reach_m", c.c_double),
        ("level_from_sensor", c.c_double * 9), ("dropped_points", c.c_size_t), ("sensor", c.c_char * 32),
    ]  # fmt: skip


@pytest.fixture(scope="session")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the library is installed in."""
    told = os.environ.get("VIEWSHED_LIBRARY")
    if told:
        return Path(told)
    if shutil.which("cmake") is None or shutil.which("c++") is None:
        pytest.skip("no C++ compiler or no CMake: libviewshed is not built")
    # The build is kept in the checkout, which ignores it: the next run compiles what changed.
    build, where = PACKAGE.parents[1] / "build" / "library_of_tests", tmp_path_factory.mktemp("prefix")
    options = ("-DVIEWSHED_PYTHON=OFF", "-DVIEWSHED_LIBRARY=ON", f"-DCMAKE_INSTALL_PREFIX={where}")
    run("cmake", "-S", PACKAGE, "-B", build, *options)
    run("cmake", "--build", build, "--parallel", "2")
    run("cmake", "--install", build)
    return where


def run(*command: Any, **named: Any) -> str:
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, **named)
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


@pytest.fixture(scope="session")
def library(prefix: Path) -> c.CDLL:
    loaded = c.CDLL(str(next(prefix.glob("lib*/libviewshed.so"))))
    loaded.viewshed_error.restype = loaded.viewshed_version.restype = c.c_char_p
    loaded.viewshed_defaults.restype, loaded.viewshed_no_sweep.restype = Options, CSweep
    loaded.viewshed_estimate.argtypes = [
        c.c_uint64, c.POINTER(CSweep), c.c_void_p, c.c_void_p, c.c_size_t, c.POINTER(CBasis)
    ]  # fmt: skip
    loaded.viewshed_outline.argtypes = [
        c.c_uint64, c.c_void_p, c.c_size_t, c.c_void_p, c.c_void_p, c.c_size_t, c.c_void_p, c.c_void_p
    ]  # fmt: skip
    loaded.viewshed_close.argtypes = [c.c_uint64]
    loaded.viewshed_set_threads.argtypes = [c.c_size_t]
    return loaded


def opened(library: c.CDLL, **changes: Any) -> int:
    options, stream = library.viewshed_defaults(), c.c_uint64()
    for name, value in changes.items():
        setattr(options, name, value)
    assert library.viewshed_open(c.byref(options), c.byref(stream)) == OK, library.viewshed_error()
    return stream.value


def c_sweep(library: c.CDLL, sweep: Sweep) -> CSweep:
    """The sweep as C takes it; it points into the arrays of the other."""
    given: CSweep = library.viewshed_no_sweep()
    given.count, given.points = len(sweep), sweep.points.ctypes.data
    if sweep.ring is not None:
        given.ring = sweep.ring.ctypes.data
    if sweep.sensor_height_m is not None:
        given.sensor_height_m = sweep.sensor_height_m
    if sweep.vehicle_yaw is not None:
        given.vehicle_yaw = sweep.vehicle_yaw
    if (attitude := sweep.known_attitude) is not None:
        given.attitude = (c.c_double * 4)(*attitude)
    return given


def estimated(library: c.CDLL, stream: int, sweep: Sweep, grid: BevGrid = GRID) -> tuple[Any, Any, CBasis]:
    state, prob, basis = np.empty(grid.shape, np.uint8), np.empty(grid.shape, np.float32), CBasis()
    given = c_sweep(library, sweep)
    status = library.viewshed_estimate(
        stream, c.byref(given), state.ctypes.data, prob.ctypes.data, state.size, c.byref(basis)
    )
    assert status == OK, library.viewshed_error()
    return state, prob, basis


def assert_alike(library: c.CDLL, sweep: Sweep, **options: Any) -> None:
    """Hold the answer of C against that of Python: every byte."""
    estimate = ShadowMap(GRID).estimate(sweep)
    stream = opened(library, sensor=key_of(sweep), **options)
    state, prob, basis = estimated(library, stream, sweep)
    assert library.viewshed_close(stream) == OK
    assert np.array_equal(state, estimate.state), f"{(state != estimate.state).mean():.2e} of the states differ"
    assert prob.tobytes() == estimate.visible_prob.tobytes()
    assert estimate.basis is not None
    assert basis.sensor_height_m == estimate.basis.sensor_height_m
    assert ("given", "estimated", "assumed")[basis.height_source] == estimate.basis.height_source
    for name in ("ground_support", "unsure_ground_share", "inferred_share"):
        assert getattr(basis, name) == getattr(estimate.basis, name), name
    assert basis.reach_m == pytest.approx(estimate.basis.reach_m, rel=1e-15)  # two cube roots


def key_of(sweep: Sweep) -> bytes | None:
    """The name of a sweep's beam table, "none" where no sensor is to be inferred, None where one is."""
    if sweep.model is None:
        return None if sweep.infer_sensor else b"none"
    return next(name for name in sensor_names() if lidar_model(name) is sweep.model).encode()


def test_the_library_answers_as_python_does_on_every_real_sweep(library: c.CDLL, real_data: Path) -> None:
    shipped, compared = [lidar_model(name) for name in sensor_names()], 0
    for entry in read_index(real_data / "index.json"):
        if entry.points is None:
            continue
        sweep = read_indexed(entry)
        # Ouster's files have tables of their own, which C does not take.
        if sweep.model is None or any(sweep.model is model for model in shipped):
            assert_alike(library, sweep)
            compared += 1
    assert compared > 40


@pytest.mark.parametrize(
    "given", [{}, {"ring": None}, {"sensor_height_m": None}, {"model": None}, {"model": None, "infer_sensor": False}]
)
def test_the_library_answers_as_python_does_on_simulated_sweeps(library: c.CDLL, given: dict[str, Any]) -> None:
    sweep = cast(lidar_model("vlp16"), junction(), 1.8).replace(**given)
    assert_alike(library, sweep)
    tilt = np.array([np.cos(0.1), 0.0, np.sin(0.1), 0.0])
    assert_alike(library, sweep.replace(attitude=tilt))
    assert_alike(library, sweep.select(np.repeat(np.arange(len(sweep)), 2)))
    assert_alike(library, sweep.select(sweep.points[:, 2] > 0.0))  # sees no ground
    assert_alike(library, sweep.select(np.arange(3)))
    assert_alike(library, sweep.select(np.arange(0)))


def test_tables_target_grid_and_bytes_between_points_are_taken(library: c.CDLL) -> None:
    sweep = cast(lidar_model("hdl32e"), junction(), 1.8)
    grid = BevGrid(64, 20.0, (3.0, -2.0))
    estimate = ShadowMap(grid, PEDESTRIAN).estimate(sweep)
    stream = opened(
        library,
        cells=64,
        half_extent_m=20.0,
        offset_m=(3.0, -2.0),
        sensor=b"HDL-32E",
        min_returns=PEDESTRIAN.min_returns,
        target_width_m=PEDESTRIAN.width_m,
        target_height_m=PEDESTRIAN.height_m,
    )
    assert np.array_equal(estimated(library, stream, sweep, grid)[0], estimate.state)
    # The same points with bytes between them, and a row that is no point.
    rows = np.full((len(sweep) + 1, 7), np.nan, np.float32)
    rows[1:, 2:5] = sweep.points
    given, state, basis = library.viewshed_no_sweep(), np.empty(grid.shape, np.uint8), CBasis()
    given.count, given.points, given.point_step = len(rows), rows.ctypes.data + 8, 28
    given.sensor_height_m = 1.8
    ring = np.zeros((len(rows), 3), np.uint16)
    assert sweep.ring is not None
    ring[1:, 0] = sweep.ring
    given.ring, given.ring_step = ring.ctypes.data, 6
    assert library.viewshed_estimate(stream, c.byref(given), state.ctypes.data, None, state.size, c.byref(basis)) == OK
    assert basis.dropped_points == 1
    assert basis.sensor == b"hdl32e"
    assert np.array_equal(state, estimate.state)


def test_every_table_of_python_is_in_the_library(library: c.CDLL) -> None:
    for name in sensor_names():
        library.viewshed_close(opened(library, cells=4, sensor=name.encode()))


def test_the_outline_is_the_polygon_of_python(library: c.CDLL) -> None:
    sweep, stream = cast(lidar_model("vlp16"), junction(), 1.8), opened(library)
    counts = (c.c_size_t * 2)()
    outline: Callable[..., int] = library.viewshed_outline
    where = c.addressof(counts), c.addressof(counts) + c.sizeof(c.c_size_t)
    assert outline(stream, None, 0, None, None, 0, *where) == ARGUMENT
    assert b"must follow an estimate" in library.viewshed_error()
    _, prob, _ = estimated(library, stream, sweep)
    assert outline(stream, None, 0, None, None, 0, *where) == ROOM
    corners, begin = np.empty((counts[0], 2)), np.empty(counts[1] + 1, np.int64)
    region = np.empty(counts[1], np.int32)
    arrays = corners.ctypes.data, len(corners), begin.ctypes.data, region.ctypes.data, len(region)
    assert outline(stream, *arrays, *where) == OK
    # The area by the shoelace formula, holes turn the other way.
    area = 0.0
    for k in range(len(region)):
        x, y = corners[begin[k] : begin[k + 1]].T
        ring = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
        area += ring if region[k] > 0 else -ring
    assert area == pytest.approx(polygon_of_mask(prob >= 0.5, GRID).area, rel=1e-12)


def test_wrong_calls_get_an_error_and_a_line(library: c.CDLL) -> None:
    stream = opened(library, cells=4)
    state, points = np.zeros(16, np.uint8), np.zeros((3, 3), np.float32)
    given = library.viewshed_no_sweep()

    def answer(handle: int = stream, cells: int = 16, to: Any = state.ctypes.data, **changes: Any) -> tuple[int, bytes]:
        sweep = CSweep.from_buffer_copy(given)
        sweep.count, sweep.points = 3, points.ctypes.data
        for name, value in changes.items():
            setattr(sweep, name, value)
        return library.viewshed_estimate(handle, c.byref(sweep), to, None, cells, None), library.viewshed_error()

    assert answer() == (OK, b"")
    assert library.viewshed_estimate(stream, None, state.ctypes.data, None, 16, None) == ARGUMENT
    for changes, words in (
        ({"points": None}, b"points must not be null"),
        ({"to": None}, b"state must not be null"),
        ({"count": 2**63}, b"at most 20 million"),
        ({"point_step": 11}, b"point_step"),
        ({"point_step": 2**63}, b"point_step"),
        ({"cells": 15}, b"cells must be"),
        ({"cells": 2**63}, b"cells must be"),
        ({"sensor_height_m": -1.0}, b"(0, 100)"),
        ({"attitude": (c.c_double * 4)(2.0, 0, 0, 0)}, b"norm 1, got 2"),
        ({"vehicle_yaw": np.inf}, b"vehicle_yaw"),
        ({"ring": np.full(3, 5000, np.uint16).ctypes.data}, b"ring"),
        ({"ring": points.ctypes.data, "ring_step": 1}, b"ring_step"),
    ):
        status, line = answer(**changes)
        assert (status, words in line) == (ARGUMENT, True), (changes, line)
    wrong: list[dict[str, Any]] = [
        {"cells": 0}, {"cells": 2**31}, {"half_extent_m": np.nan}, {"sensor": b"nothing"}, {"min_returns": 0},
        {"target_width_m": -1.0}, {"offset_m": (np.inf, 0.0)},
    ]  # fmt: skip
    for changes in wrong:
        options, other = library.viewshed_defaults(), c.c_uint64(7)
        for name, value in changes.items():
            setattr(options, name, value)
        assert library.viewshed_open(c.byref(options), c.byref(other)) == ARGUMENT
        assert other.value == 0
    assert library.viewshed_open(None, c.byref(c.c_uint64())) == ARGUMENT
    assert library.viewshed_open(c.byref(library.viewshed_defaults()), None) == ARGUMENT
    # A stream that is closed, twice, and one that never was.
    assert library.viewshed_close(stream) == OK
    assert library.viewshed_close(stream) == STREAM
    assert answer()[0] == STREAM
    assert answer(handle=2**64 - 1)[0] == STREAM


def test_threads_share_a_stream_and_close_it_while_others_work(library: c.CDLL) -> None:
    sweep, stream = cast(lidar_model("vlp16"), junction(), 1.8), opened(library)
    wanted, statuses = estimated(library, stream, sweep)[0], set()

    def work() -> None:
        state, given = np.empty(GRID.shape, np.uint8), c_sweep(library, sweep)
        for _ in range(8):
            status = library.viewshed_estimate(stream, c.byref(given), state.ctypes.data, None, state.size, None)
            statuses.add(status if status != OK or np.array_equal(state, wanted) else "other bytes")

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    assert library.viewshed_close(stream) == OK
    for thread in threads:
        thread.join()
    assert statuses <= {OK, STREAM}


def test_programs_find_it_by_cmake_and_by_pkg_config(prefix: Path, tmp_path: Path) -> None:
    sweep = cast(lidar_model("vlp16"), junction(), 1.8)
    rows = np.column_stack([sweep.points, np.zeros(len(sweep), np.float32)]).astype(np.float32)
    rows.tofile(tmp_path / "sweep.bin")
    state = ShadowMap(GRID).estimate(Sweep(sweep.points)).state
    cells = np.bincount(state.ravel(), minlength=4).tolist()
    line = "unknown {}, free {}, surface {}, hidden {} cells\n".format(*cells)
    source = PACKAGE / "examples" / "what_is_seen.c"
    assert len(source.read_text(encoding="utf-8").splitlines()) <= 40
    # 1. CMake.
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.20)\nproject(seen LANGUAGES C CXX)\nfind_package(viewshed REQUIRED)\n"
        f"add_executable(seen {source})\ntarget_link_libraries(seen viewshed::viewshed)\n"
        "add_executable(cpp cpp.cpp)\ntarget_link_libraries(cpp viewshed::viewshed)\n",
        encoding="utf-8",
    )
    (tmp_path / "cpp.cpp").write_text(
        "#include <viewshed.hpp>\nint main() {\n"
        "  viewshed::Stream stream;\n  stream = viewshed::Stream();\n  viewshed_sweep sweep = viewshed_no_sweep();\n"
        "  const viewshed::Estimate estimate = stream.estimate(sweep);\n"
        "  if (estimate.state.size() != 256 * 256 || !stream.outline().region.empty()) return 1;\n"
        "  sweep.count = 1;\n"
        "  try { stream.estimate(sweep); } catch (const viewshed::Error& error) {\n"
        "    return error.status == VIEWSHED_ERROR_ARGUMENT ? 0 : 2; }\n  return 3;\n}\n",
        encoding="utf-8",
    )
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", tmp_path / "build")
    assert run(tmp_path / "build" / "seen", tmp_path / "sweep.bin").endswith(line)
    run(tmp_path / "build" / "cpp")
    # 2. pkg-config.
    if shutil.which("pkg-config") is None:
        pytest.skip("no pkg-config")
    where = next(prefix.glob("lib*/pkgconfig"))
    flags = run(
        "pkg-config", "--cflags", "--libs", "viewshed", env=os.environ | {"PKG_CONFIG_PATH": str(where)}
    ).split()
    strict = ("-Wall", "-Wextra", "-Werror", "-std=c11")
    run("cc", *strict, source, "-o", tmp_path / "plain", *flags, f"-Wl,-rpath,{where.parent}")
    assert run(tmp_path / "plain", tmp_path / "sweep.bin").endswith(line)
    assert subprocess.run([tmp_path / "plain", tmp_path], capture_output=True, check=False).returncode == 2  # a folder


def test_nothing_of_python_is_in_it_and_only_the_interface_is_exported(prefix: Path) -> None:
    library = next(prefix.glob("lib*/libviewshed.so"))
    every = run("nm", "-D", library)
    assert "Py" not in every
    assert "nanobind" not in every
    exported = {line.split()[-1] for line in run("nm", "-D", "--defined-only", library).splitlines()}
    assert {name.partition("@")[0] for name in exported} == {
        f"viewshed_{name}"
        for name in ("version", "error", "set_threads", "defaults", "no_sweep", "open", "estimate", "outline", "close")
    }


def test_its_version_is_that_of_the_package(library: c.CDLL) -> None:
    assert library.viewshed_version().decode() == viewshed.__version__
