"""Fuzz the native core with damaged arguments: each call must return or raise an allowed error, and never crash.

    python tools/fuzz_core.py [--seconds S] [--only NAME] [--seed N] [--sanitize] [--tests FILE …]

The original arguments are recorded from real calls (estimates, files and streams are run once) and taken from the valid
ones of ``test_core_arrays.py``. Then each function is called for S seconds with some arguments damaged: other types and
shapes, dropped or repeated rows, values that are not finite, huge, denormal, out of range or all equal, and far too
large numbers. During half of that time another thread alternately writes such values and the original ones into an
array of the running call. Allowed errors are ValueError, TypeError, OverflowError and MemoryError. --sanitize first
compiles the core with address and undefined-behavior sanitizers (into build/sanitize) and calls that one; --tests runs
these tests against it at the same time.

The exit code is 1 if a call raises anything else or a function of the core was never called. A crash ends the process;
the last printed line names function, seed and round.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = (ValueError, TypeError, OverflowError, MemoryError)
_ODD_FLOATS = (np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40, 0.0, -0.0, -1.0, 3e9)
_ODD_INTS = (0, 1, -1, 127, 255, -32768, 32767, 2**31 - 1, -(2**31), 2**40, 2**63 - 1)
_TYPES = (np.float64, np.float32, np.int64, np.int32, np.int16, np.uint8, np.bool_)

Calls = dict[str, list[tuple[tuple[Any, ...], dict[str, Any]]]]


def build_sanitized() -> Path:
    """Compile the core with sanitizers; return its folder."""
    folder = ROOT / "build" / "sanitize"
    options = ("-DVIEWSHED_SANITIZE=ON", f"-DPython_EXECUTABLE={sys.executable}", f"-DVIEWSHED_OUTPUT={folder}")
    subprocess.run(
        ("cmake", "-S", str(ROOT / "packages" / "viewshed"), "-B", str(folder), *options),
        check=True,
        capture_output=True,
    )
    subprocess.run(("cmake", "--build", str(folder), "--parallel", "2"), check=True, capture_output=True)
    return folder


def run_sanitized(tests: list[str]) -> int:
    """Run this tool, and some tests at the same time, with the sanitized core; return the exit code."""
    folder = build_sanitized()
    runtime = [
        subprocess.run(("gcc", f"-print-file-name={name}"), check=True, capture_output=True, text=True).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    environment = os.environ | {
        "LD_PRELOAD": ":".join(runtime),
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1:alloc_dealloc_mismatch=0",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "VIEWSHED_CORE": str(folder),
    }
    command = (sys.executable, "-m", "pytest", "-n0", "-q", "-p", "fuzz_core", *tests)
    test_environment = environment | {"PYTHONPATH": str(Path(__file__).parent)}
    test_process = subprocess.Popen(command, cwd=ROOT, env=test_environment) if tests else None
    given = [word for word in sys.argv[1:] if word != "--sanitize" and word not in ("--tests", *tests)]
    code = subprocess.run((sys.executable, __file__, *given), env=environment, check=False).returncode
    return code or (0 if test_process is None else test_process.wait())


def use_core_of(folder: str) -> None:
    """Import the core in a folder as ``viewshed._core``."""
    from importlib.machinery import ExtensionFileLoader
    from importlib.util import module_from_spec, spec_from_loader

    path = next(Path(folder).glob("_core.*.so"))
    spec = spec_from_loader("viewshed._core", ExtensionFileLoader("viewshed._core", str(path)))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules["viewshed._core"] = module
    spec.loader.exec_module(module)


def record_calls() -> Calls:
    """Return arguments of each function of the core: of up to four real calls, and the valid ones of its tests."""
    sys.path[:0] = [str(ROOT / "packages" / name) for name in ("viewshed", "viewshed-lab")]
    from tests.test_core_arrays import GOOD, OF_WINDOWS

    from viewshed import _core

    members = {name: getattr(_core, name) for name in dir(_core) if not name.startswith("_")}
    calls: Calls = {name: [] for name, value in members.items() if callable(value) and not isinstance(value, type)}
    originals = {name: getattr(_core, name) for name in calls}

    def recorder(name: str) -> Callable[..., Any]:
        def call(*args: Any, **named: Any) -> Any:
            if len(calls[name]) < 4:
                calls[name].append((tuple(map(_copied, args)), {key: _copied(value) for key, value in named.items()}))
            return originals[name](*args, **named)

        return call

    for name in calls:
        setattr(_core, name, recorder(name))
    try:
        use_everything()
    finally:
        for name, original in originals.items():
            setattr(_core, name, original)
    for name, recorded in calls.items():
        if name in GOOD and name not in OF_WINDOWS:  # their windows are added by the test; real calls have them
            recorded.append(((), GOOD[name]))
    return calls


def use_everything() -> None:
    """Call, through files, estimators and streams, the functions of the core that the tests' table leaves out."""
    import tempfile

    import viewshed
    from viewshed import _core
    from viewshed.estimators import ESTIMATORS
    from viewshed.fov.polygons import inner_polygon_of_mask, sectors_of_mask
    from viewshed.guarantees.certificate import certify
    from viewshed.guarantees.envelope import Threat
    from viewshed.io import read_sweep, write_sweep
    from viewshed.monitor.evidence import EVIDENCE, MonitoredSweep
    from viewshed.objects.detector import Detector
    from viewshed.preprocess.evidence import beam_evidence, cell_features
    from viewshed.preprocess.leveling import level
    from viewshed.preprocess.no_return import no_return_beams, no_return_groups
    from viewshed_lab.sim import Box, Scene, cast

    # 1. Functions that nothing below calls, or not always.
    counts = np.ones((16, 360), np.uint8)
    _core.set_threads(_core.threads())
    _core.silent_columns(counts)
    _core.pixels_without(np.zeros(4, np.int16), np.ones(4, np.bool_), np.arange(4, dtype=np.int32), counts)
    _core.unpack_lzf(np.array([0, 65, 224, 1, 0], np.uint8), np.empty(11, np.uint8))  # "A", then ten bytes from it
    # 2. Sweeps of a VLP-16: read from files, noisy, without rings, shuffled.
    scene = Scene((Box(14, 6, 1, 20, 8), Box(-20, -3, 1, 60, 9), Box(6, -9, 4.2, 1.8, 1.5)))
    sweep = cast(viewshed.lidar_model("vlp16"), scene, 1.8)
    with tempfile.TemporaryDirectory() as folder:
        for ending in (".bin", ".pcd.bin", ".pcd", ".ply", ".npz"):
            write_sweep(sweep, Path(folder) / f"sweep{ending}")
            read_sweep(Path(folder) / f"sweep{ending}", file_frame="carla")
    rng, grid = np.random.default_rng(0), viewshed.BevGrid()
    noisy = sweep.replace(points=sweep.points * rng.uniform(0.5, 2.0, (len(sweep), 1)).astype(np.float32))
    bare, shuffled = (viewshed.Sweep(sweep.points[rows]) for rows in (slice(None), rng.permutation(len(sweep))))
    # 3. Every result of a sweep: estimates, evidence, objects, certificates, polygons.
    for variant in (sweep, noisy, bare, shuffled):
        leveled = level(variant, grid)
        for method in ESTIMATORS:
            estimate = viewshed.load_estimator(method).estimate(leveled)
        for evidence in EVIDENCE.values():
            evidence.measure(MonitoredSweep(leveled))
        Detector().detect(leveled)
        _core.free_plane(variant.points)
    leveled = level(sweep.replace(attitude=np.eye(4)[0], sensor_height_m=1.8), grid)
    for words in ("replaced:5", "wedge:10", "dropped:5"):
        certify(leveled, estimate, Threat.parse(words))
    no_return_groups(leveled, 1.5)
    cell_features(leveled, beam_evidence(leveled, grid, viewshed.CAR))
    no_return_beams(leveled, fill=True)
    inner_polygon_of_mask(estimate.visible(), grid, 12)
    sectors_of_mask(estimate.visible(), grid, 4)
    # 4. A stream, in which earlier sweeps end beams and confirm cells.
    poses = [viewshed.Rigid(np.eye(3), np.array([0.5 * k, 0.0, 1.8])) for k in range(4)]
    drive = [sweep.replace(world_from_sensor=pose, t_ns=k * 100_000_000) for k, pose in enumerate(poses)]
    for _ in viewshed.load_estimator().stream(drive, history=3, require_confirmation=True):
        pass


def _copied(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value


def damaged(value: Any, rng: np.random.Generator) -> Any:
    """Return a copy of an argument with one kind of damage."""
    if isinstance(value, np.ndarray):
        return _damaged_array(value, rng)
    if isinstance(value, bool) or value is None:
        return rng.choice(np.array([True, False, None, 3], object))
    if isinstance(value, int):
        return int(rng.choice(np.array(_ODD_INTS, object)))
    if isinstance(value, float | np.floating):
        return float(rng.choice(np.array(_ODD_FLOATS)))
    if isinstance(value, list | tuple) and value:
        at = int(rng.integers(len(value)))
        return type(value)([damaged(each, rng) if k == at else each for k, each in enumerate(value)])
    return value


def _damaged_array(value: np.ndarray[Any, Any], rng: np.random.Generator) -> Any:
    match int(rng.integers(11)):
        case 0:
            return value.astype(rng.choice(np.array(_TYPES, object)))
        case 1:
            return value[: int(rng.integers(len(value) + 1))].copy() if value.ndim else value
        case 2:
            return value[:0].copy() if value.ndim else value
        case 3:
            return value[:1].copy() if value.ndim else value
        case 4:
            return np.repeat(value, 2, axis=0)
        case 5:
            return rng.choice(np.array([value.reshape(-1), value[None], value.T, value[::2], None, 1.0], dtype=object))
        case 6:
            return np.full_like(value, value.flat[0] if value.size else 0)
        case 7:
            return rng.permutation(value) if value.ndim else value
        case 8:
            return np.zeros_like(value)
        case _:
            return _with_odd_values(value, rng)


def _with_odd_values(value: np.ndarray[Any, Any], rng: np.random.Generator) -> np.ndarray[Any, Any]:
    copy = value.copy()
    if copy.size:
        at = rng.integers(copy.size, size=int(rng.integers(1, 1 + copy.size)) if rng.random() < 0.5 else 1)
        odd = _ODD_FLOATS if copy.dtype.kind == "f" else _ODD_INTS
        with np.errstate(all="ignore"):
            copy.flat[at] = np.array(rng.choice(np.array(odd, np.float64), at.size)).astype(copy.dtype)
    return copy


def fuzz(name: str, calls: list[tuple[tuple[Any, ...], dict[str, Any]]], seconds: float, seed: int) -> tuple[int, int]:
    """Call a function with damaged arguments for some seconds; return the numbers of calls that returned and raised."""
    from viewshed import _core

    function = getattr(_core, name)
    end, returned, raised = time.monotonic() + seconds, 0, 0
    while time.monotonic() < end:
        rng = np.random.default_rng([seed, returned + raised])
        args, named = calls[int(rng.integers(len(calls)))]
        values = [_copied(value) for value in (*args, *named.values())]
        for _ in range(int(rng.integers(1, 4))):
            if values:
                at = int(rng.integers(len(values)))
                values[at] = damaged(values[at], rng)
        sys.stdout.write(f"\r{name} seed {seed} round {returned + raised} ")
        sys.stdout.flush()
        try:
            function(*values[: len(args)], **dict(zip(named, values[len(args) :], strict=True)))
            returned += 1
        except ALLOWED:
            raised += 1
    return returned, raised


def fuzz_written(
    name: str, calls: list[tuple[tuple[Any, ...], dict[str, Any]]], seconds: float, seed: int
) -> tuple[int, int]:
    """Call a function for some seconds while another thread writes to one of its arrays; return counts as ``fuzz``."""
    from viewshed import _core

    function = getattr(_core, name)
    end, rounds, counts = time.monotonic() + seconds, 0, [0, 0]
    while time.monotonic() < end:
        rng = np.random.default_rng([seed, 1, rounds])
        args, named = calls[int(rng.integers(len(calls)))]
        positional = [_deep_copied(value) for value in args]
        keywords = {key: _deep_copied(value) for key, value in named.items()}
        arrays = [array for array in _arrays_in([*positional, *keywords.values()]) if array.size]
        if not arrays:
            break
        chosen = arrays[int(rng.integers(len(arrays)))]
        original, odd, done = chosen.copy(), _with_odd_values(chosen, rng), threading.Event()

        def write(to: Any = chosen, both: Any = (odd, original), until: threading.Event = done) -> None:
            while not until.is_set():
                for content in both:
                    to[...] = content

        sys.stdout.write(f"\r{name} seed {seed} written, round {rounds} ")
        sys.stdout.flush()
        writer = threading.Thread(target=write)
        writer.start()
        stop = min(time.monotonic() + 0.1, end)
        while time.monotonic() < stop:
            try:
                function(*positional, **keywords)
                counts[0] += 1
            except ALLOWED:
                counts[1] += 1
        done.set()
        writer.join()
        rounds += 1
    return counts[0], counts[1]


def _deep_copied(value: Any) -> Any:
    return type(value)(map(_deep_copied, value)) if isinstance(value, list | tuple) else _copied(value)


def _arrays_in(values: Iterable[Any]) -> Iterator[np.ndarray[Any, Any]]:
    for value in values:
        if isinstance(value, np.ndarray):
            yield value
        elif isinstance(value, list | tuple):
            yield from _arrays_in(value)


def main() -> int:
    """Fuzz the functions of the core, and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="time for each function")
    parser.add_argument("--only", default="", help="only functions whose name holds this")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sanitize", action="store_true", help="check addresses and undefined behavior")
    parser.add_argument("--tests", nargs="*", default=[], help="with --sanitize: tests to run beside")
    given = parser.parse_args()
    if given.sanitize:
        return run_sanitized(given.tests)
    calls = record_calls()
    unused = [name for name, recorded in calls.items() if not recorded]
    for name, recorded in calls.items():
        if recorded and given.only in name and name != "set_threads":
            counts = [run(name, recorded, given.seconds / 2, given.seed) for run in (fuzz, fuzz_written)]
            returned, raised = map(sum, zip(*counts, strict=True))
            print(f"\r{name}: {returned} calls answered, {raised} refused")
    if unused:
        print(f"never called: {', '.join(unused)}; add good arguments to test_core_arrays.py", file=sys.stderr)
    return int(bool(unused))


if "VIEWSHED_CORE" in os.environ:  # also where pytest loads this as a plugin
    use_core_of(os.environ["VIEWSHED_CORE"])

if __name__ == "__main__":
    sys.exit(main())
