"""The native core as a whole: its threads, its version, and arrays that are not what they should be."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import viewshed
from viewshed import _core


def test_threads_are_set_within_bounds() -> None:
    before = _core.threads()
    try:
        for asked, got in ((1, 1), (2, 2), (0, 1), (1000, 4)):
            _core.set_threads(asked)
            assert _core.threads() == got
    finally:
        _core.set_threads(before)


def test_a_core_of_another_version_is_refused_by_name() -> None:
    code = "import viewshed._core as c, sys; c.VERSION = '0.0.1'; del sys.modules['viewshed']; import viewshed"
    run = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=False)
    assert run.returncode == 1
    said = f"ImportError: viewshed's native core must be of version {viewshed.__version__}, got 0.0.1;"
    assert run.stderr.splitlines()[-1] == f"{said} reinstall viewshed (in a checkout: pip install packages/viewshed)"


def test_forked_processes_and_threads_use_the_core() -> None:
    code = """
import os, threading
import numpy as np
from viewshed import _core
points = np.random.default_rng(0).normal(size=(200_000, 3)).astype(np.float32) * 20
ring = np.random.default_rng(1).integers(0, 32, 200_000).astype(np.int16)
call = lambda: _core.range_image(points, ring, 1024, 32, 0.5, 250.0)
_core.set_threads(2)
expected = call()
child = os.fork()
same = lambda: all(np.array_equal(a, b) for a, b in zip(call()[:6], expected))
if child == 0:
    os._exit(0 if same() else 1)
assert os.waitpid(child, 0)[1] == 0
found = []
workers = [threading.Thread(target=lambda: found.append(same())) for _ in range(4)]
for each in workers: each.start()
for each in workers: each.join()
assert found == [True] * 4
_core.set_threads(1)
assert same()
"""
    subprocess.run((sys.executable, "-W", "ignore", "-c", code), check=True, timeout=60)


def test_a_memory_may_be_asked_while_another_thread_adds_to_it() -> None:
    code = """
import threading, time
import numpy as np
from viewshed import _core
rng, flat, here = np.random.default_rng(0), np.zeros(16, np.float32), np.eye(3, 4, dtype=np.float32)
def view():
    azimuth, range_m = (rng.uniform(low, high, 20_000).astype(np.float32) for low, high in ((-3.1, 3.1), (3, 44)))
    points = np.column_stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), azimuth * 0 + 1])
    image = np.full((16, 1024), 900, np.float32), flat, np.linspace(-0.3, 0.1, 16, dtype=np.float32), flat
    return _core.SweepView(*image, points, points[:, 2].copy(), range_m, azimuth, range_m < 0, here)
views, memory, end = [view() for _ in range(3)], _core.CellMemory(), time.monotonic() + 1.5
def ask():
    while time.monotonic() < end:
        memory.check(views[0], here, 1.0, views[1:2], here[None].copy(), np.ones(1, np.float32), 36)
threads = [threading.Thread(target=ask) for _ in range(2)]
for each in threads: each.start()
t_s = 0.0
while time.monotonic() < end:
    there, back, t_s = here.copy(), here.copy(), t_s + 1.0
    there[0, 3] = rng.uniform(0, 300)
    back[0, 3] = -there[0, 3]
    memory.add(views[2], there, back, t_s)
for each in threads: each.join()
"""
    run = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=False, timeout=60)
    assert run.returncode == 0, run.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.skipif("VIEWSHED_CORE" in os.environ, reason="the sanitizer's own heap is locked in forked processes")
def test_processes_forked_while_threads_allocate_use_the_core() -> None:
    # Memory that is used again stands behind a lock, which no thread may hold while the process forks.
    code = """
import os, threading
import numpy as np
from viewshed import _core
points = np.random.default_rng(0).normal(size=(64, 3)).astype(np.float32) * 20
ring = np.random.default_rng(1).integers(0, 16, 64).astype(np.int16)
call = lambda: _core.range_image(points, ring, 128, 16, 0.5, 250.0)
done = threading.Event()
def work():
    while not done.is_set(): call()
workers = [threading.Thread(target=work, daemon=True) for _ in range(3)]
for each in workers: each.start()
for _ in range(40):
    child = os.fork()
    if child == 0:
        for _ in range(20): call()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
done.set()
for each in workers: each.join()
"""
    subprocess.run((sys.executable, "-W", "ignore", "-c", code), check=True, timeout=60)


# Calls with an array that another thread writes meanwhile: right values, then one that is far out of range.
WRITTEN = {
    "beam_slopes": ("_core.beam_slopes(points, range_m, 1.7, isolated, rows)", "rows", 2**30),
    "interpolate": ("_core.interpolate(ground_m, node, part, part)", "node", 2**30),
    "claims": (
        "_core.claims(state, many, cell_node, ground_m, table=table)",
        "cell_node",
        2**30,
    ),
    "range_image": ("_core.range_image(points, ring, 1024, 32, 0.5, 250.0)", "ring", 32767),
    "pixels_without": ("_core.pixels_without(ring, isolated, column, counts)", "column", 2**30),
    "beams_by_evidence": (
        "_core.beams_by_evidence(ring, column, counts, isolated, None, phase, origin_m, origin_m, np.eye(3), points, "
        "range_m, range_m, rows, 1.7, ground_m, 50.0, 2.0, 0.3)",
        "rows",
        2**30,
    ),
    "encode_view": ("_core.encode_view(state, state, state, 128, 128)", "state", 255),
    "cells_inside": ("_core.cells_inside(corners, begin, 64)", "begin", 2**40),
    "BeamsByAzimuth": ("_core.BeamsByAzimuth(azimuth, range_m, range_m)", "azimuth", 3.0),
    "object_candidates": ("_core.object_candidates(points, range_m, range_m, 1.7)", "points", np.nan),
}


def test_arrays_that_another_thread_writes_meanwhile_do_no_harm() -> None:
    # Drivers use a buffer again: what was checked may be another number when it is used.
    code = f"""
import sys, threading, time
import numpy as np
from viewshed import _core
sys.setswitchinterval(1e-4)
_core.set_threads(2)
rng = np.random.default_rng(0)
count = 40_000
points = (rng.normal(size=(count, 3)) * [20.0, 20.0, 1.0]).astype(np.float32)
range_m, azimuth = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
isolated = rng.random(count) < 0.1
ring, column = rng.integers(0, 32, count).astype(np.int16), rng.integers(0, 1024, count).astype(np.int32)
rows, counts = np.arange(count, dtype=np.int32), np.ones((32, 1024), np.uint8)
phase, origin_m = np.full(32, 0.5, np.float32), np.linspace(-0.3, 0.1, 32)
ground_m, part = np.zeros((64, 64), np.float32), np.full(count, 0.5)
node = rng.integers(0, 64 * 62, count).astype(np.int32)
state, many = np.ones((256, 256), np.uint8), np.full((256, 256), 5.0, np.float32)
cell_node, table = np.zeros((256, 256), np.int32), np.linspace(0.0, 1.0, 99, dtype=np.float32)
corners, begin = np.tile([[1.0, 1.0], [9.0, 1.0], [9.0, 9.0], [1.0, 1.0]], (2000, 1)), np.arange(0, 8001, 4)
nan = np.nan
for name, (call, written, wrong) in {WRITTEN}.items():
    print(name, flush=True)
    call, written, done = compile(call, name, "eval"), globals()[written], threading.Event()
    right = written.copy()
    def write():
        while not done.is_set():
            written[...] = wrong
            written[...] = right
    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        try:
            eval(call)
        except ValueError:
            pass
    done.set()
    writer.join()
    written[...] = right
    eval(call)
"""
    run = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=False, timeout=60)
    assert run.returncode == 0, run.stdout + run.stderr


def _no_return_beams(rows: NDArray[np.int32]) -> object:
    count, rings, columns = len(rows), 16, 1024
    ring, column = (np.arange(count) % rings).astype(np.int16), (np.arange(count) // rings % columns).astype(np.int32)
    range_m = np.full(count, 10.0, np.float32)
    zeros = np.zeros(rings)
    return _core.no_return_beams(
        ring,
        column,
        np.ones((rings, columns), np.uint8),
        None,
        zeros.astype(np.float32),
        zeros,
        zeros,
        np.eye(3),
        range_m,
        range_m,
        rows,
        True,
    )


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = _core.threads()
    _core.set_threads(2)
    yield
    _core.set_threads(before)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("wrong", [0, 39_999])
def test_an_error_in_a_part_of_the_work_reaches_the_caller_whoever_does_it(wrong: int) -> None:
    # 40,000 rows are four parts and more: the thread that asks begins with the first, another one takes the last.
    rows = np.arange(40_000, dtype=np.int32)
    damaged = rows.copy()
    damaged[wrong] = 40_000
    for _ in range(20):
        with pytest.raises(ValueError, match="rows must lie in the sweep"):
            _no_return_beams(damaged)
        _no_return_beams(rows)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="this system does not tell the threads of a process")
def test_threads_that_are_no_longer_wanted_end() -> None:
    code = """
import os
import numpy as np
from viewshed import _core
threads = lambda: len(os.listdir("/proc/self/task"))
points, ring = np.full((600_000, 3), 9.0, np.float32), np.zeros(600_000, np.int16)
work = lambda: _core.range_image(points, ring, 1024, 32, 0.5, 250.0)
_core.set_threads(1)
before = threads()
for time in range(21):
    _core.set_threads(2 + time % 3)
    work()
    assert threads() == before + 1 + time % 3, (time, threads())
_core.set_threads(1)
assert threads() == before
"""
    run = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=False, timeout=60)
    assert run.returncode == 0, run.stderr
