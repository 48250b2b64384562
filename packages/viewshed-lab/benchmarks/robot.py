"""What a robot gets: rates of the ROS 2 node, replay to a bag, profiles: ``python -m benchmarks.robot [--seconds S]``.

Writes docs/results/robot.md and the picture of a costmap beside it. The node is measured where ``ros/python.sh`` finds
or makes its environment, in a process of its own, from publishing a cloud to receiving its grid. VIEWSHED_REAL_DATA
names a folder with real sweeps; without it simulated ones of the same sizes are taken.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import clouds
from benchmarks.drawn_network import draw_weights
from benchmarks.processes import VIEWSHED, alone
from benchmarks.soak import memory_mb
from viewshed.estimators import load_estimator
from viewshed.estimators.temporal import SweepBuffer
from viewshed.estimators.unet import PASSES
from viewshed.geometry import Rigid
from viewshed.monitor import StreamMonitor
from viewshed.networks.architecture import UNetShape
from viewshed.pipeline import Pipeline, prepare_process
from viewshed.pipeline.profiles import PROFILES, Profile
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab._page import facts, page, table
from viewshed_lab.sim import cast, junction

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "results" / "robot.md"
SEED = 20_261_123
REPLAY_S, HZ = 30.0, 10.0
MAX_DROPPED = 0.01
"""Maximum share of dropped clouds at a rate that a node keeps up with."""

WIDTHS, DEPTHS, CELLS = (8, 16, 32), (3, 4, 5, 6), (64, 128, 256)
"""Shapes of the networks that the node is measured with: those of the paper's trade study, up to here."""

STEP_NS = 100_000_000

Found = dict[str, Any]


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robot", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement of the node")
    parser.add_argument("--sweeps", type=int, default=200, help="of each profile")
    arguments = parser.parse_args()
    prepare_process()
    load_before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sweeps = _sweeps(np.random.default_rng(SEED))
        replayed = _replay(folder)
        _write(sweeps, folder)
        for width, depth, cells in product(WIDTHS, DEPTHS, CELLS):
            alone(draw_weights, folder / f"{_shape_name(width, depth, cells)}.onnx", UNetShape(width, depth), cells)
        node = _node(folder, arguments.seconds)
    costmap = _costmap(arguments.page.with_name("costmap.png"))
    topics = [[f"`{run['topic']}`", f"{run['processor_ms']:.2f}"] for run in node if run["case"] == "topic"]
    profiles = [_profile_cost(name, profile, sweeps, arguments.sweeps) for name, profile in PROFILES.items()]
    source = "nuScenes and KITTI" if clouds.real() else "simulated, HDL-32E and HDL-64E"
    content = page(
        "On the robot",
        facts(
            command="`python -m benchmarks.robot`",
            sweeps=f"{source}; VLP-16 and laser simulated", seed=str(SEED),
            load=f"{load_before:.1f} in the minute before, {os.getloadavg()[0]:.1f} at the end, on all cores",
            threads=f"OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'not set')}",
        ),
        _intro(node), "## Targets",
        table(["what", "target", "reached", ""], [*_targets(node, replayed), *_costmap_targets(costmap)]),
        "## The node", _NODE_TEXT, table(_NODE_HEADER, _node_rows(node)),
        "## Networks of every shape", _SHAPES_TEXT, table(_SHAPES_HEADER, _shape_rows(node)),
        "## Latencies with monitor, one cloud under way", *_histograms(node),
        "## Topics", _TOPICS_TEXT, table(["topic", "processor, ms a message"], topics),
        "## A costmap before and after", *_costmap_parts(costmap),
        "## Profiles", _PROFILES_TEXT, table(_PROFILES_HEADER, profiles),
    )  # fmt: skip
    arguments.page.write_text(content, encoding="utf-8")
    print(content)


_NODE_TEXT = f"""From publishing a cloud to receiving `visibility`, in two processes, default QoS. *Under way* is how
many clouds are on their way at once; *dropped* are those that newer ones replaced before their turn, or that the
profile of sensor data lost. The node keeps up with the highest rate at which at most 1 % is dropped.
*Processor* is the time that the node's process uses for a sweep, all its threads together; it tells what a machine
that others use would reach without them. `unet` (one pass) and `mc_dropout` ({PASSES}) run the weights `road_int8`, all
other rows the method of the profile `infrastructure`."""
_NODE_HEADER = [
    "sweep", "monitor", "under way", "Hz", "median, ms", "99 %, ms", "worst, ms", "processor, ms", "memory, MB",
    "dropped",
]  # fmt: skip

_SHAPES_TEXT = """The node with `unet`, one pass in float32, weights drawn at random, on the 35k sweep, without a
monitor: clouds a second at the highest rate at which at most 1 % is dropped, and the median latency with one cloud
under way (nan above half a second). Width and depth are those of the U-Net, cells those of a side of the grid. The
paper asks for more than 50 Hz; [how accurate networks of other shapes are](paper.md)."""
_SHAPES_HEADER = ["width", "depth", "M parameters", *(f"{cells} cells: Hz (ms)" for cells in CELLS)]

_TOPICS_TEXT = """What making and serializing a message of each topic costs on the 35k sweep, the estimate not counted;
a topic that nobody subscribes to costs nothing."""

_PROFILES_TEXT = """Each profile's own method, grid, history and monitor through `viewshed.pipeline`, without ROS,
one sweep after the other; poses are known and the sensor moves by a meter from sweep to sweep. *Processor* is that
of the process for a sweep, all threads together."""
_PROFILES_HEADER = ["profile", "35k: median, ms", "processor, ms", "120k: median, ms", "processor, ms", "memory, MB"]


def _intro(node: Sequence[Found]) -> str:
    if node:
        return (
            "Measured by `python -m benchmarks.robot`; on a machine that others use as well, rates fall with the load."
        )
    return "The node was not measured: its environment could not be made (`ros/python.sh` says why)."


def _sweeps(rng: np.random.Generator) -> dict[str, Sweep]:
    sweeps = clouds.real() or {size: clouds.synthetic(size, rng) for size in clouds.SENSORS}
    vlp16 = cast(lidar_model("VLP-16"), junction(), 1.0, rng=rng)
    return {**sweeps, "VLP-16": vlp16.replace(azimuth=None, attitude=None, sensor_height_m=None)}


def _write(sweeps: Mapping[str, Sweep], folder: Path) -> None:
    """Write the inputs of the node: sweeps, and the ranges of a laser in a room of 16 by 10 meters."""
    for name, sweep in sweeps.items():
        columns: dict[str, Any] = {} if sweep.ring is None else {"ring": sweep.ring}
        intensity = np.zeros(len(sweep), np.float32) if sweep.intensity is None else sweep.intensity
        np.savez(folder / f"{name}.npz", points=sweep.points, intensity=intensity, **columns)
    field_of_view = np.deg2rad(270.0)
    angle = np.linspace(-field_of_view / 2, field_of_view / 2, 1080)
    with np.errstate(divide="ignore"):
        ranges_m = np.minimum(8.0 / np.abs(np.cos(angle)), 5.0 / np.abs(np.sin(angle)))
    ranges_m += np.random.default_rng(SEED).normal(0.0, 0.01, angle.size)
    ranges_m[::50] = np.inf
    np.savez(folder / "scan.npz", ranges_m=ranges_m.astype(np.float32), field_of_view=field_of_view, range_max_m=30.0)


def _node(folder: Path, seconds: float) -> list[Found]:
    """Measure the node and return its runs; an empty list without an environment for it."""
    command = [str(ROOT / "ros" / "python.sh"), str(ROOT / "ros" / "measure" / "rates.py"), str(folder)]
    done = subprocess.run([*command, "--seconds", str(seconds)], check=False, capture_output=True, text=True)
    if done.returncode == 3:
        return []
    if done.returncode:
        raise RuntimeError(f"the node could not be measured: {done.stderr.strip()[-500:]}")
    return list(json.loads(done.stdout.splitlines()[-1]))


def _replay(folder: Path) -> Found:
    """Return speed and CPU time of a command line replay of a simulated drive (30 s, 10 Hz, monitor) to MCAP."""
    source, to = folder / "drive.mcap", [folder / "seen.mcap", folder / "again.mcap"]
    drive = ["sim", "--preset", "nuscenes", "--agents", "1", "--seconds", str(REPLAY_S), "--hz", str(HZ)]
    subprocess.run([VIEWSHED, "record", *drive, "--to", str(source)], check=True, capture_output=True)
    command = [VIEWSHED, "replay", str(source), "--as-fast", "--monitor", "--to"]
    taken_s, used_s = [], []
    for place in to:
        begin_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([*command, str(place)], check=False, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"the replay failed: {done.stderr.strip()[-500:]}")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        taken_s.append(time.perf_counter() - begin_s)
        used_s.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return {
        "speed": REPLAY_S / min(taken_s), "processor_s": min(used_s),
        "is_equal": to[0].read_bytes() == to[1].read_bytes(),
    }  # fmt: skip


def _profile_cost(name: str, profile: Profile, sweeps: Mapping[str, Sweep], count: int) -> list[str]:
    """Return a row: times of a profile for both sizes, and the memory of a process with it."""
    cells = [f"`{name}`"]
    for size in ("35k", "120k"):
        cost = alone(profile_cost, profile, sweeps[size], count)  # a new process, to measure its own memory
        cells += [f"{cost['median_ms']:.1f}", f"{cost['processor_ms']:.1f}"]
    return [*cells, f"{cost['memory_mb']:.0f}"]


def profile_cost(profile: Profile, sweep: Sweep, count: int) -> Found:
    """Return latency, CPU time and memory of a pipeline with a profile's settings over ``count`` sweeps."""
    prepare_process()
    estimator = load_estimator(profile.method, grid=profile.grid)
    monitor = StreamMonitor() if profile.monitor else None
    history = SweepBuffer(profile.history) if profile.history else None
    latencies: list[float] = []
    pipeline = Pipeline(
        estimator, lambda answer: latencies.append(answer.latency_s), history=history, monitor=monitor,
        rules=profile.rules,
    )  # fmt: skip
    used_s = 0.0
    warm = 10
    for number in range(warm + count):
        if number == warm:
            latencies.clear()
            used_s = time.process_time()
        pose = Rigid.from_yaw(0.0, (float(number), 0.0, 1.8))
        pipeline.put(sweep.replace(t_ns=(1 + number) * STEP_NS, world_from_sensor=pose))
        while pipeline.statistics().answered + sum(pipeline.statistics().refused.values()) <= number:
            time.sleep(0.0005)
    used_s = time.process_time() - used_s
    pipeline.close()
    return {
        "median_ms": 1e3 * float(np.median(latencies)), "processor_ms": 1e3 * used_s / count,
        "memory_mb": memory_mb(os.getpid()),
    }  # fmt: skip


def _shape_name(width: int, depth: int, cells: int) -> str:
    return f"shape_{width}_{depth}_{cells}"


def _shape_rows(node: Sequence[Found]) -> Iterator[list[str]]:
    """Yield rate and latency of the node by the shape of its network."""
    for width, depth in product(WIDTHS, DEPTHS) if node else ():
        row = [str(width), str(depth), f"{UNetShape(width, depth).parameters / 1e6:.2f}"]
        for cells in CELLS:
            name = _shape_name(width, depth, cells)
            one = next(run for run in node if run["case"] == name and run["under_way"] == 1)
            row.append(f"{_kept_up(node, name, 'never'):.0f} ({one['p50_ms']:.1f})")
        yield row


def _node_rows(node: Sequence[Found]) -> Iterator[list[str]]:
    for found in node:
        if found["case"].startswith("shape_"):
            continue
        if "under_way" in found:
            yield [
                found["case"], found["monitor"], str(found["under_way"]), f"{found['hz']:.0f}",
                f"{found['p50_ms']:.1f}",
                f"{found['p99_ms']:.1f}", f"{found['worst_ms']:.1f}", f"{found['processor_ms']:.1f}",
                f"{found['memory_mb']:.0f}", f"{_share(found):.1%}",
            ]  # fmt: skip
        elif "cores" in found:
            hz = f"{found['hz']:.1f} to {found['hz_most']:.1f}"
            yield [
                f"{found['case']}, 10 Hz each" if "agents" in found["case"] else f"{found['case']}, 10 Hz",
                "always", "–", hz, f"{found['p50_ms']:.1f}", f"{found['p99_ms']:.1f}", f"{found['worst_ms']:.1f}",
                f"{100 * found['cores']:.0f} % of a core", f"{found['memory_mb']:.0f}", "–",
            ]  # fmt: skip


def _share(found: Found) -> float:
    """Return the share of dropped clouds."""
    return float(found["dropped"] / max(found["dropped"] + len(found["taken_ms"]), 1))


def _kept_up(node: Sequence[Found], case: str, monitor: str) -> float:
    """Return the highest rate of a case with at most one percent of dropped clouds; 0 without any."""
    runs = [run for run in node if (run["case"], run.get("monitor")) == (case, monitor)]
    return max((float(run["hz"]) for run in runs if _share(run) <= MAX_DROPPED), default=0.0)


def _histograms(node: Sequence[Found]) -> Iterator[str]:
    """Yield a text histogram of the latencies of each size, with monitor and one cloud in flight."""
    for found in node:
        if found.get("under_way") == 1 and found["monitor"] == "always" and found["case"] != "LaserScan":
            taken_ms = np.asarray(found["taken_ms"])
            # Bins with edges in ratios of 1.1, from the minimum to the maximum.
            edges = taken_ms.min() * 1.1 ** np.arange(
                np.ceil(np.log(taken_ms.max() / taken_ms.min()) / np.log(1.1)) + 2
            )
            counts, _ = np.histogram(taken_ms, edges)
            lines = [
                f"{low:6.1f} to {high:6.1f} ms {count:6d} {'█' * round(40 * count / counts.max())}".rstrip()
                for low, high, count in zip(edges, edges[1:], counts, strict=False)
            ]
            yield "\n".join([f"{found['case']}, {len(taken_ms)} clouds:", "", "```text", *lines, "```"])


def _costmap(picture: Path) -> Found | None:
    """Return the numbers of costmap cells that are cleared with and without the view; draw the picture."""
    command = [str(ROOT / "ros" / "python.sh"), str(ROOT / "ros" / "measure" / "costmap_picture.py"), str(picture)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode == 3:
        return None
    if done.returncode:
        raise RuntimeError(f"the costmap could not be made: {done.stderr.strip()[-500:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def _costmap_targets(found: Found | None) -> Iterator[list[str]]:
    if found is None:
        return
    fewer = 1.0 - found["wrong_with"] / found["wrong_without"]
    yield _target("obstacles wrongly cleared in a costmap", "≥ 95 % fewer", f"{fewer:.1%} fewer", fewer >= 0.95)
    lost = 1.0 - found["right_with"] / found["right_without"]
    yield _target("cells rightly cleared that are lost", "≤ 5 %", f"{lost:.1%}", lost <= 0.05)


def _costmap_parts(found: Found | None) -> list[str]:
    if found is None:
        return ["Not made: the environment of ROS could not be had."]
    rows = [
        ["hidden by a wall or the body", *(f"{found[key]:,}" for key in ("hidden", "wrong_without", "wrong_with"))],
        ["seen by the laser", *(f"{found[key]:,}" for key in ("seen", "right_without", "right_with"))],
    ]
    return [
        f"![The same room twice: cleared within range, and by what is visible](costmap.png)\n\n{_COSTMAP_TEXT}",
        table(["cells", "there are", "cleared by range", "cleared by the view"], rows),
    ]


_COSTMAP_TEXT = """A laser in a room (`ros/viewshed_ros/test/test_costmap.py`), its robot hides 90° behind it; all cells
were marked before. Left: all that lies within range is cleared. Right: what lies before the ends of `NAME/clearing`.
Green is rightly cleared, red wrongly, gray still marked, black a wall."""


def _targets(node: Sequence[Found], replayed: Found) -> Iterator[list[str]]:
    """Yield one row per target: description, target, reached figure, met or missed."""
    by_case = {(found["case"], found.get("monitor"), found.get("under_way")): found for found in node}
    if node:
        for monitor, targets_hz in (("always", {"35k": 100, "120k": 60}), ("never", {"35k": 200, "120k": 100})):
            words = "with monitor" if monitor == "always" else "without monitor"
            for size, hz in targets_hz.items():
                reached = _kept_up(node, size, monitor)
                yield _target(f"node, {size}, {words}", f"≥ {hz} Hz", f"{reached:.0f} Hz", reached >= hz)
        reached = _kept_up(node, "35k, unet", "never")
        yield _target("node, 35k, `unet` in bytes (paper: over 50 Hz)", "≥ 50 Hz", f"{reached:.0f} Hz", reached >= 50)
        for size in ("35k", "120k"):
            found = by_case[size, "always", 1]
            ratio = found["p99_ms"] / found["p50_ms"]
            yield _target(f"node, {size}: 99 % of the latencies", "≤ 2 × median", f"{ratio:.1f} ×", ratio <= 2.0)
        for monitor, words in (("never", "without monitor"), ("always", "with monitor")):
            reached = _kept_up(node, "LaserScan", monitor)
            yield _target(f"LaserScan of 1,080 beams, {words}", "≥ 500 Hz", f"{reached:.0f} Hz", reached >= 500)
        vlp16, agents = by_case["VLP-16", None, None], by_case["10 agents", None, None]
        share, memory = 100.0 * vlp16["cores"], vlp16["memory_mb"]
        yield _target("VLP-16 at 10 Hz: share of one core", "≤ 15 %", f"{share:.0f} %", share <= 15.0)
        yield _target("VLP-16 at 10 Hz: resident memory", "≤ 400 MB", f"{memory:.0f} MB", memory <= 400.0)
        # The input rate is 10 Hz; a cloud in flight at the end is not counted.
        yield _target("ten agents: the slowest", "≥ 10 Hz", f"{agents['hz']:.1f} Hz", agents["hz"] >= 9.95)
        ratio = agents["hz_most"] / max(agents["hz"], 1e-9)
        yield _target("ten agents: fastest / slowest", "≤ 1.2", f"{ratio:.2f}", ratio <= 1.2)
        for found in node:
            if found["case"] == "start":
                first_s = found["first_s"]
                what = f"start of the process to the first field of view, caches {found['caches']}"
                yield _target(what, "≤ 2 s", f"{first_s:.1f} s", first_s <= 2.0)
    speed = replayed["speed"]
    words = f"{speed:.1f} × ({replayed['processor_s']:.1f} s of the processor for {REPLAY_S:g} s)"
    yield _target(
        "replay of 30 s at 10 Hz with monitor to MCAP, start included", "≥ 10 × real time", words, speed >= 10.0
    )
    is_equal = replayed["is_equal"]
    yield _target("its bytes on repeat", "equal", "equal" if is_equal else "different", is_equal)


def _target(what: str, target: str, reached: str, is_met: bool) -> list[str]:
    return [what, target, reached, "met" if is_met else "**missed**"]


if __name__ == "__main__":
    main()
