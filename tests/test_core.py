"""The native core as a whole: its stub, its threads, its version, and arrays that are not what they should be."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import viewshed
from viewshed import _core

STUB = Path(viewshed.__file__).with_name("_core.pyi")
OFFERED = {name: getattr(_core, name) for name in sorted(dir(_core)) if not name.startswith("_")}
FUNCTIONS = [name for name, offered in OFFERED.items() if callable(offered) and not isinstance(offered, type)]


def test_the_stub_names_what_the_core_has() -> None:
    stub = ast.parse(STUB.read_text(encoding="utf-8"))
    named = {node.name: node for node in stub.body if isinstance(node, ast.FunctionDef)}
    assert sorted(named) == FUNCTIONS
    for name, node in named.items():
        # The first line of a function's documentation is its signature, with the names of its arguments.
        signature = getattr(_core, name).__doc__.splitlines()[0]
        for argument in (*node.args.args, *node.args.kwonlyargs):
            assert f"{argument.arg}: " in signature, f"{name}: {argument.arg}"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_function_says_what_it_does(name: str) -> None:
    lines = getattr(_core, name).__doc__.splitlines()
    assert len(lines) > 1
    assert lines[-1].endswith(".")


def test_threads_are_set_within_bounds() -> None:
    before = _core.threads()
    try:
        for asked, got in ((1, 1), (2, 2), (0, 1), (1000, 4)):
            _core.set_threads(asked)
            assert _core.threads() == got
    finally:
        _core.set_threads(before)


def test_a_core_of_another_version_is_refused_by_name() -> None:
    code = "import viewshed._core as c, sys; c.__version__ = '0.0.1'; del sys.modules['viewshed']; import viewshed"
    run = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=False)
    assert run.returncode == 1
    said = f"ImportError: viewshed's native core must be of version {viewshed.__version__}, got 0.0.1;"
    assert run.stderr.splitlines()[-1] == f"{said} install viewshed anew (in a checkout: pip install .)"


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


@pytest.mark.parametrize(
    ("points", "ring"),
    [
        (np.zeros((5, 3)), np.zeros(5, np.int16)),  # float64
        (np.zeros((5, 4), np.float32), np.zeros(5, np.int16)),
        (np.zeros((3, 5), np.float32).T, np.zeros(5, np.int16)),  # not contiguous
        (np.zeros((5, 3), np.float32), np.zeros(5, np.int64)),
        (np.zeros((5, 3), np.float32), np.zeros((5, 1), np.int16)),
        (None, np.zeros(5, np.int16)),
    ],
)
def test_arrays_of_another_kind_are_a_type_error(points: object, ring: object) -> None:
    with pytest.raises(TypeError, match="range_image"):
        _core.range_image(points, ring, 16, 4, 0.5, 100.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("count", "ring", "columns", "rings", "message"),
    [
        (5, 0, 16, 4, "ring must have one row for each point"),
        (4, 4, 16, 4, r"ring must lie in \[-1, 3\], got 4"),
        (4, -2, 16, 4, r"ring must lie in \[-1, 3\], got -2"),
        (4, 0, 0, 4, "an image must have 1 to 65536 columns"),
        (4, 0, 16, 0, "an image must have 1 to 4096 rings"),
        (4, 0, 1 << 40, 4, "an image must have 1 to 65536 columns"),
    ],
)
def test_values_out_of_range_are_a_value_error(count: int, ring: int, columns: int, rings: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _core.range_image(np.ones((count, 3), np.float32), np.full(4, ring, np.int16), columns, rings, 0.5, 100.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 1e-40, 0.0])
def test_points_that_are_no_place_have_an_answer(value: float) -> None:
    points = np.full((40, 3), value, np.float32)
    column, counts, nearest_m2, *_ = _core.range_image(points, np.zeros(40, np.int16), 16, 4, 0.5, 100.0)
    assert ((column >= 0) & (column < 16)).all()
    assert counts.sum() == 40
    assert np.isinf(nearest_m2).all()
