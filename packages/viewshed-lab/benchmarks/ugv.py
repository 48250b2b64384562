"""The case of a small ground robot indoors: ``python -m benchmarks.ugv [--seconds 600] [--work FOLDER]``.

A robot with a VLP-16 and a 2-D laser drives through simulated rooms; both are recorded to bags, which are replayed
through ``viewshed.pipeline`` with its profile ``robot`` and its monitor, and held against the exact truth; then parts
of the drive once more under attack; then its beginning through the ROS 2 node, whose grids are compared with the
pipeline's (where ``ros/python.sh`` finds or makes its environment); and real bags beside it (VIEWSHED_REAL_RECORDINGS
and VIEWSHED_REAL_DATA name their folders). Writes docs/ugv.md and its picture. Minutes that are done are kept in the
work folder: a run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import InitVar, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.processes import VIEWSHED
from viewshed import open_recording
from viewshed.estimators import ESTIMATORS, load_estimator
from viewshed.estimators.base import Estimator
from viewshed.fov.visibility import TARGETS
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.io.export.ros import visibility_layer
from viewshed.io.messages.laserscan import sweep_of_scan
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.monitor import StreamMonitor
from viewshed.pipeline import Answer, Caution, Pipeline, prepare_process
from viewshed.pipeline.profiles import profile_named
from viewshed.recordings.read.bag_files import Message, open_bag
from viewshed.recordings.read.rosbag import decoder
from viewshed.recordings.write.bag_writers import McapWriter, Schema
from viewshed.recordings.write.moment import MAP, Transform
from viewshed.recordings.write.ros_topics import CLOUD, SCAN, TF, RosMessages
from viewshed.sensors import LidarModel
from viewshed.sweep import PlanarScan, Sweep
from viewshed_lab._page import commit_of, facts, page, table
from viewshed_lab.data.drive import drive_plan
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, observe_frame, world_of
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.observe import Setting, measure_sweep, observe
from viewshed_lab.threats.attacks import ATTACKS, Knowledge

ROOT = Path(__file__).resolve().parents[3]
PAGE, PICTURE = ROOT / "docs" / "ugv.md", ROOT / "docs" / "results" / "ugv.png"
SEED = 20_261_123
HZ, WORLD, TARGET = 10.0, "rooms", "pedestrian"
MINUTE = 600
"""Sweeps that are replayed as one stream, and kept as one result."""

TRUTH_EVERY = 20
"""Sweeps from one whose truth is computed to the next."""

PICTURE_AT = 300
"""Number of the sweep that is drawn."""

BASELINE = "concave_hull"
"""What the published case draws around the points."""

LASER = LidarModel("laser", np.zeros(1), 1440, min_range_m=0.05, max_range_m=30.0)
ATTACKED = ("ghost_wall", "ghost_car", "far_wall", "removal", "relay", "jamming", "replay")
CALM_SWEEPS, ATTACKED_SWEEPS = 50, 50
"""Numbers of sweeps of each attack: first some as they are, then attacked ones."""

REAL = (
    ("VLP-16, packets", "data", "vlp16_packets/einride_recording.bin"),
    ("packets in a ROS 2 bag", "recordings", "tier4__nebula"),
    ("Ouster packets in a ROS 1 bag", "recordings", "ouster-lidar__ouster-sdk/tests/bags/512x10_raw.bag"),
    ("`/scan` of a tilting laser in a ROS 1 bag", "recordings",
     "facontidavide__PlotJuggler/datasamples/tilt_laser.bag"),
)  # fmt: skip
REAL_SWEEPS = 100

Found = dict[str, Any]


def main() -> None:
    """Drive, replay, compare and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ugv", description=__doc__)
    parser.add_argument("--seconds", type=int, default=600, help="of the drive, whole minutes or less than one")
    parser.add_argument("--node-seconds", type=int, default=60, help="of the drive, through the node; 0 for none of it")
    parser.add_argument(
        "--work", type=Path, help="where bags and results of minutes are kept; a new folder if not given"
    )
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    chosen = parser.parse_args()
    prepare_process()
    work = chosen.work or Path(tempfile.mkdtemp())
    work.mkdir(parents=True, exist_ok=True)
    plan = drive_plan(preset_named("ugv"), seconds=chosen.seconds, hz=HZ, agents=1, world=WORLD, seed=SEED)
    done = _minutes(plan, chosen.seconds, work)
    node = _through_node(plan, chosen.seconds, chosen.node_seconds, work)
    content = _page(chosen.seconds, done, node, list(_real()))
    chosen.page.write_text(content, encoding="utf-8")
    if chosen.page == PAGE:
        PICTURE.write_bytes(_picture(_recorded(plan, chosen.seconds, work, PICTURE_AT + 1)[0]))
    print(content)


# The drive


def _recorded(plan: ScenePlan, seconds: int, work: Path, sweeps: int) -> tuple[Path, Path]:
    """Return bags of the VLP-16 and of the laser with at least ``sweeps`` sweeps, recorded where they are missing."""
    for kept in sorted(work.glob(f"lidar-{seconds}-*.mcap")):
        laser = kept.with_name(kept.name.replace("lidar", "laser"))
        if int(kept.stem.rpartition("-")[2]) >= sweeps and laser.exists():
            return kept, laser
    lidar, laser = work / f"lidar-{seconds}-{sweeps:06d}.mcap", work / f"laser-{seconds}-{sweeps:06d}.mcap"
    if not lidar.exists():
        words = [
            "--preset",
            "ugv",
            "--world",
            WORLD,
            "--seconds",
            str(seconds),
            "--seed",
            str(SEED),
            "--grid",
            "indoor",
        ]
        words += ["--sweeps", str(sweeps), "--to", str(lidar)]
        subprocess.run([VIEWSHED, "record", "sim", *words], check=True, capture_output=True)
    _record_laser(plan, laser, sweeps)
    return lidar, laser


def _record_laser(plan: ScenePlan, place: Path, sweeps: int) -> None:
    """Write a bag of the laser's scans, at the VLP-16's place and times, with their poses."""
    ros, part = RosMessages(ros1=False), place.with_suffix(".part")
    writer = McapWriter(part, "ros2")
    schemas = {kind: Schema(kind, "ros2msg", "cdr", ros.definition(kind).encode()) for kind in (SCAN, TF)}
    for frame in range(sweeps):
        sweep, t_ns = _laser_sweep(plan, frame), _time_ns(plan, frame)
        if sweep.world_from_sensor is not None:
            pose = ros.transforms([Transform(MAP, "ego/laser", sweep.world_from_sensor)], t_ns)
            writer.write("/tf", schemas[TF], t_ns, ros.encode(pose))
        writer.write("/ego/laser/data", schemas[SCAN], t_ns, ros.encode(ros.returns(sweep, t_ns, "ego/laser")))
    writer.close()
    part.rename(place)


def _time_ns(plan: ScenePlan, frame: int) -> int:
    return round((frame + 0.5) * plan.preset.interval_s * 1e9)


def _laser_sweep(plan: ScenePlan, frame: int) -> Sweep:
    """Return what the laser measures in one frame: returns of one ring, and the beams that met nothing."""
    world = world_of(plan)
    seeds = np.random.SeedSequence([SEED, frame]).spawn(2)
    setting = Setting(plan.preset.grid, CONDITIONS["clear"], 0.0)
    _, stored = measure_sweep(world, world.agents[0], (frame + 0.5) / HZ, setting, seeds[0], seeds[1], LASER)
    sweep = stored.sweep()
    azimuth = np.arctan2(sweep.points[:, 1], sweep.points[:, 0])
    step = 2 * np.pi / LASER.azimuth_columns
    fired = (np.arange(LASER.azimuth_columns) + 0.5) * step - np.pi
    met = np.zeros(LASER.azimuth_columns, bool)
    met[((azimuth + np.pi) / step).astype(int) % LASER.azimuth_columns] = True
    points = sweep.points * np.array([1.0, 1.0, 0.0], np.float32)
    return Sweep(
        points, sweep.intensity, azimuth=azimuth, t_ns=sweep.t_ns, world_from_sensor=sweep.world_from_sensor,
        sensor_height_m=sweep.sensor_height_m, infer_sensor=False, agent="ego",
        planar=PlanarScan(fired[~met].astype(np.float32), LASER.max_range_m),
    )  # fmt: skip


def _laser_truth(plan: ScenePlan, frame: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the cells (cells, cells) in which the laser's plane meets the target, and where that is known."""
    world, setting = world_of(plan), Setting(plan.preset.grid, CONDITIONS["clear"], 0.0)
    seed = np.random.SeedSequence([SEED, frame])
    seen = observe(world, world.agents[0], (frame + 0.5) / HZ, setting, seed, LASER)
    return seen.truth.visible(TARGETS[TARGET]), seen.known


# A minute of it


@dataclass(slots=True)
class Stream:
    """The sweeps of a bag, read once."""

    sweeps: InitVar[Iterable[Sweep]]  # all of them
    position: int = 0  # number of the next one
    _rest: Iterator[Sweep] = field(init=False)

    def __post_init__(self, sweeps: Iterable[Sweep]) -> None:
        self._rest = iter(sweeps)

    def take(self, begin: int, end: int) -> list[Sweep]:
        """Return the sweeps from ``begin`` to before ``end``; those before them are skipped."""
        taken = list(islice(self._rest, begin - self.position, end - self.position))
        self.position = end
        return taken


def _minutes(plan: ScenePlan, seconds: int, work: Path) -> list[Found]:
    """Return what came of each minute, kept from earlier runs where it was done then."""
    places = {begin: work / f"minute-{plan.frames}-{begin:06d}.json" for begin in range(0, plan.frames, MINUTE)}
    if not all(place.exists() for place in places.values()):
        streams = [Stream(open_recording(bag)) for bag in _recorded(plan, seconds, work, plan.frames)]
        for begin, place in places.items():
            if not place.exists():
                place.write_text(json.dumps(_minute(plan, begin, streams)), encoding="utf-8")
                print(f"from {begin / HZ:.0f} s of {plan.frames / HZ:.0f} s", file=sys.stderr)
    return [json.loads(place.read_text(encoding="utf-8")) for place in places.values()]


def _minute(plan: ScenePlan, begin: int, streams: Sequence[Stream]) -> Found:
    """Return what came of the sweeps from ``begin`` on, and of which version."""
    end = min(begin + MINUTE, plan.frames)
    sweeps = [stream.take(begin, end) for stream in streams]
    return {
        "made": f"commit {commit_of(ROOT)}, {datetime.datetime.now(datetime.UTC):%Y-%m-%d}",
        "lidar": _clean(plan, begin, sweeps[0], is_planar=False),
        "laser": _clean(plan, begin, sweeps[1], is_planar=True),
        "attacks": {name: _attacked(plan, begin, name, sweeps[0]) for name in ATTACKED},
    }


def _estimator() -> Estimator:
    profile = profile_named("robot")
    return load_estimator(profile.method, grid=profile.grid, target=TARGET)


def _replayed(sweeps: Sequence[Sweep]) -> tuple[list[Answer], Found]:
    """Return the answers of a pipeline with the profile ``robot``, and what it took."""
    answers: list[Answer] = []
    monitor = StreamMonitor()
    pipeline = Pipeline(
        _estimator(), answers.append, monitor=monitor, rules=profile_named("robot").rules, lossless=True
    )
    begin_s, used_s = time.perf_counter(), time.process_time()
    for sweep in sweeps:
        pipeline.put(sweep)
    statistics = pipeline.close()
    took = {
        "seconds": time.perf_counter() - begin_s, "processor_s": time.process_time() - used_s, "sweeps": len(sweeps),
        "refused": statistics.refused,
    }  # fmt: skip
    return answers, took


def _clean(plan: ScenePlan, begin: int, sweeps: Sequence[Sweep], *, is_planar: bool) -> Found:
    """Return scores, rates and false alarms of sweeps as they are."""
    answers, took = _replayed(sweeps)
    baseline, estimator = ESTIMATORS[BASELINE](_estimator().grid, TARGETS[TARGET]), _estimator()
    counts = {name: Counter[str]() for name in ("with reactions", "shadow_map", BASELINE)}
    for number in range(0, len(sweeps), TRUTH_EVERY):
        estimate = answers[number].estimate
        if estimate is None:
            continue
        grid = estimate.grid
        if is_planar:
            visible, known = _laser_truth(plan, begin + number)
        else:
            seen = observe_frame(plan, begin + number)
            visible, known = seen.truth.visible(TARGETS[TARGET]), seen.known
        claims = {"with reactions": estimate.visible(), "shadow_map": estimator.estimate(sweeps[number]).visible()}
        if not is_planar:
            claims[BASELINE] = baseline.estimate(sweeps[number]).visible()
        for name, claimed in claims.items():
            counts[name].update(_counts(claimed, visible, known))
            if is_planar:
                counts[name]["no echo"] += int((claimed & ~visible & known & _behind_lost(sweeps[number], grid)).sum())
    return {**took, **_alarms(answers), "counts": {name: dict(count) for name, count in counts.items()}}


def _behind_lost(sweep: Sweep, grid: BevGrid) -> NDArray[np.bool_]:
    """Return the cells (cells, cells) in the directions of a laser's beams that met nothing."""
    if sweep.planar is None:
        raise ValueError("sweep must be planar, got one in space")
    step = 2 * np.pi / LASER.azimuth_columns
    is_open = np.zeros(LASER.azimuth_columns, np.bool_)
    is_open[((sweep.planar.open_azimuth + np.pi) / step).astype(int) % LASER.azimuth_columns] = True
    behind: NDArray[np.bool_] = is_open[((polar_of_cells(grid)[1] + np.pi) / step).astype(int) % LASER.azimuth_columns]
    return behind


def _counts(claimed: NDArray[np.bool_], visible: NDArray[np.bool_], known: NDArray[np.bool_]) -> dict[str, int]:
    return {
        "true": int((claimed & visible & known).sum()), "false": int((claimed & ~visible & known).sum()),
        "missed": int((~claimed & visible & known).sum()),
    }  # fmt: skip


def _alarms(answers: Sequence[Answer]) -> Found:
    """Return how many sweeps were inconsistent or degraded, how many alarms of the stream there were, and caution."""
    reports = [answer.report for answer in answers if answer.report is not None]
    return {
        "inconsistent": sum(report.now.inconsistent for report in reports),
        "degraded": sum(report.now.degraded for report in reports),
        "stream_alarms": sum(report.alarm for report in reports),
        "cautious": sum(answer.reaction.caution >= Caution.WIDEN for answer in answers),
    }


def _attacked(plan: ScenePlan, begin: int, name: str, sweeps: Sequence[Sweep]) -> Found:
    """Return what is found of an attack that begins after some calm sweeps."""
    rng = np.random.default_rng([SEED, begin, ATTACKED.index(name)])
    first = ATTACKED.index(name) * max(len(sweeps) - CALM_SWEEPS - ATTACKED_SWEEPS, 0) // len(ATTACKED)
    calm = list(sweeps[first : first + CALM_SWEEPS])
    after = sweeps[first + CALM_SWEEPS : first + CALM_SWEEPS + ATTACKED_SWEEPS]
    known = Knowledge(earlier=tuple(calm[-20:]), half_extent_m=_estimator().grid.half_extent_m)
    attack = ATTACKS[name](None, known)
    touched = [attack.apply(sweep, rng) for sweep in after]
    answers, _ = _replayed([*calm, *(each.sweep for each in touched)])
    # Where the truth is known: how much is claimed wrongly, with the reactions and without.
    counts = {"with reactions": Counter[str](), "without": Counter[str]()}
    for number in range(5, len(after), TRUTH_EVERY):
        estimate = answers[CALM_SWEEPS + number].estimate
        if estimate is None:
            continue
        seen = observe_frame(plan, begin + first + CALM_SWEEPS + number)
        visible = seen.truth.visible(TARGETS[TARGET])
        plain = _estimator().estimate(touched[number].sweep)
        for kind, claimed in (("with reactions", estimate.visible()), ("without", plain.visible())):
            counts[kind].update(_counts(claimed, visible, seen.known))
    attacked = answers[CALM_SWEEPS:]
    is_found = [
        answer.report is not None and (answer.report.now.inconsistent or answer.report.alarm) for answer in attacked
    ]
    return {
        "sweeps": len(attacked), "found": sum(is_found), "delay": is_found.index(True) if any(is_found) else None,
        "returns": int(np.mean([each.added.sum() + each.removed.sum() for each in touched])),
        "counts": {kind: dict(count) for kind, count in counts.items()},
    }  # fmt: skip


# Through the node


def _through_node(plan: ScenePlan, seconds: int, node_seconds: int, work: Path) -> dict[str, Found] | None:
    """Return by sensor how many grids of the node are those of the pipeline; None where there is no environment for it.

    The beginning of the drive is played from its bags, each message as it was recorded and after the grids of the one
    before. The pipeline takes the same messages without what else the bag tells, as the node does.
    """
    found, count = {}, min(round(node_seconds * HZ), plan.frames)
    if not count:
        return None
    for sensor, bag in zip(_NAMES, _recorded(plan, seconds, work, count), strict=True):
        kind = CLOUD if sensor == "lidar" else SCAN
        raws = [message.raw for message in islice(_messages(bag, kind), count)]
        expected = _digests(raws, kind)
        played = _play(raws, "scan" if kind == SCAN else "cloud", work)
        if played is None:
            return None
        grids = {int(t_ns): digests for t_ns, digests in played["found"].items()}
        found[sensor] = {
            "sent": len(raws), "answered": len(grids), "seconds": played["seconds"],
            **{
                layer: sum(grids.get(t_ns, {}).get(layer) == digests[layer] for t_ns, digests in expected.items())
                for layer in ("state", "visibility")
            },
        }  # fmt: skip
    return found


def _messages(bag: Path, kind: str) -> Iterator[Message]:
    file = open_bag(bag.parent, bag)
    try:
        yield from file.messages((kind,))
    finally:
        file.close()


def _digests(raws: Sequence[bytes], kind: str) -> dict[int, dict[str, str]]:
    """Return the digests of the grids that the pipeline answers messages with, by their times."""
    sweeps = []
    for raw in raws:
        message = decoder("cdr")(raw, kind)
        sweep = sweep_of_scan(message) if kind == SCAN else sweep_of_cloud(message)
        stamp = message.header.stamp
        sweeps.append(sweep.replace(t_ns=stamp.sec * 1_000_000_000 + stamp.nanosec, agent="lidar"))
    answers, _ = _replayed(sweeps)
    return {
        estimate.t_ns or 0: {
            layer: hashlib.sha256(visibility_layer(estimate, layer).T.tobytes()).hexdigest()
            for layer in ("state", "visibility")
        }
        for estimate in (answer.estimate for answer in answers)
        if estimate is not None
    }


def _play(raws: Sequence[bytes], kind: str, work: Path) -> Found | None:
    """Return what the node made of messages; None where there is no environment for it."""
    place = work / "messages.npz"
    np.savez(place, raw=np.frombuffer(b"".join(raws), np.uint8), ends=np.cumsum([len(raw) for raw in raws]))
    command = [str(ROOT / "ros" / "python.sh"), str(ROOT / "ros" / "measure" / "play.py"), str(place), kind, TARGET]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    place.unlink()
    if done.returncode == 3:
        return None
    if done.returncode:
        raise RuntimeError(f"the node could not be played to: {done.stderr.strip()[-500:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


# Real bags


def _real() -> Iterator[list[str]]:
    """Yield a row for each real recording that is there."""
    folders = {
        "data": os.environ.get("VIEWSHED_REAL_DATA"), "recordings": os.environ.get("VIEWSHED_REAL_RECORDINGS"),
    }  # fmt: skip
    for what, folder, name in REAL:
        root = folders[folder]
        if root is None or not (Path(root) / name).exists():
            yield [what, "not there", *["–"] * 6]
            continue
        for place in _places(Path(root) / name):
            yield _real_row(what, place)


def _places(path: Path) -> list[Path]:
    """Return a recording itself, or the bags of raw packets below a folder."""
    if path.is_file():
        return [path]
    return sorted(each.parent for each in path.rglob("metadata.yaml"))


def _real_row(what: str, place: Path) -> list[str]:
    try:
        sweeps = list(islice(open_recording(place), REAL_SWEEPS))
        answers, took = _replayed(sweeps)
    except (ValueError, OSError, ImportError) as error:
        return [f"{what}: {place.name}", f"refused: {_without_folders(error, place)[:90]}", *["–"] * 6]
    answered = [answer.estimate for answer in answers if answer.estimate is not None]
    alarms = _alarms(answers)
    returns = f"{np.median([len(sweep) for sweep in sweeps]):,.0f}" if sweeps else "–"
    area = f"{np.median([estimate.area_m2() for estimate in answered]):.0f}" if answered else "–"
    return [
        f"{what}: {place.name}", f"{len(answered)} of {len(sweeps)}", returns, area,
        f"{1e3 * took['processor_s'] / max(len(sweeps), 1):.1f}", str(alarms["inconsistent"]),
        str(alarms["stream_alarms"]), str(alarms["degraded"]),
    ]  # fmt: skip


def _without_folders(error: Exception, place: Path) -> str:
    return " ".join(str(error).replace(str(place), place.name).split()).replace("|", "/")


# The page


def _page(
    seconds: int, done: Sequence[Found], node: dict[str, Found] | None, real: Sequence[Sequence[str]]
) -> str:  # fmt: skip
    provenance = facts(
        command=f"`python -m benchmarks.ugv --seconds {seconds}`",
        drive=f"{seconds} s at {HZ:g} Hz in a simulated world of {WORLD}, seed {SEED}; target {TARGET}",
        minutes="; ".join(f"{count} made by {made}" for made, count in Counter(each["made"] for each in done).items()),
        load=f"{os.getloadavg()[0]:.1f} in the minute before the end, on all cores",
    )
    minutes = sum(each["lidar"]["sweeps"] for each in done) / HZ / 60
    return page(
        "A ground robot indoors", provenance,
        _INTRO.format(minutes=minutes, every=TRUTH_EVERY), "![What the VLP-16 sees](results/ugv.png)",
        "## Against the exact truth", _TRUTH_TEXT,
        table(["sensor", "method", "precision", "recall", "sweeps with truth"], _score_rows(done)),
        _lost_line(done), "## Through the ROS 2 node", *_node_parts(node), "## Rates", _RATES_TEXT,
        table(_RATES_HEADER, _rate_rows(done)),
        "## False alarms", _FALSE_TEXT,
        table(_FALSE_HEADER, _false_rows(done)),
        "## Attacks", _ATTACK_TEXT,
        table(_ATTACK_HEADER, _attack_rows(done)),
        _shortfall(done),
        "## Real bags", _REAL_TEXT,
        table(_REAL_HEADER, real),
    )  # fmt: skip


_INTRO = """The published study shows a robot with a VLP-16 in rooms, without truth. Here a simulated robot drives
{minutes:.1f} minutes with a VLP-16 and a 2-D laser of 1,440 beams. Both are recorded to bags and replayed through
`viewshed.pipeline` with the profile `robot`: shadow map on cells of 0.125 m, the shipped monitor, reactions.
The exact truth is computed for every {every}th sweep."""

_TRUTH_TEXT = """Precision: share of the cells claimed visible that are visible; recall: share of the visible cells that
are claimed. A cell is visible where enough beams would have met a pedestrian there. *With reactions* is the output of
the pipeline, without the claims that an alarm withdraws. `concave_hull` is what the study's code publishes on its
robot."""

_NODE_TEXT = """The bags of the beginning of the drive are played message by message to the node with the profile
`robot`; each message waits for the grids of the one before. A grid is *equal* if all its cells match the answer of
`viewshed.pipeline` to the same message, reactions included."""

_NODE_HEADER = ["sensor", "messages", "answered", "equal `state`", "equal `visibility`", "times real time"]

_RATES_TEXT = """As fast as the machine goes, all threads of one process, decoding of the bag not counted. The
target is 15 % of a core for a VLP-16 at 10 Hz."""

_FALSE_TEXT = """Nobody attacks here: each alarm is a false one. The shipped monitor was not calibrated for the
laser, so that no rate is promised for it."""

_ATTACK_TEXT = f"""{CALM_SWEEPS} clean sweeps, then {ATTACKED_SWEEPS} attacked ones; each attack is at another
place of each minute, with its usual budget. *Found* sweeps are inconsistent by themselves, or the stream alarms at
them."""

_REAL_TEXT = f"""The first {REAL_SWEEPS} sweeps at most of each real recording, through the same pipeline. There is no
truth for them: an inconsistent sweep is a false alarm or a fault of the recording. No recording is from the robot's
kind of place."""


_RATES_HEADER = [
    "sensor", "sweeps", "refused", "Hz, as fast as it goes", "processor, ms a sweep", "share of one core at 10 Hz",
]  # fmt: skip
_FALSE_HEADER = ["sensor", "sweeps", "inconsistent", "degraded", "stream alarms", "sweeps with claims withdrawn"]
_ATTACK_HEADER = [
    "attack", "returns touched", "attacked sweeps found", "first found after", "precision without",
    "precision with reactions", "recall without", "recall with reactions",
]  # fmt: skip
_REAL_HEADER = [
    "recording", "answered", "returns", "visible, m²", "processor, ms", "inconsistent", "stream alarms", "degraded",
]  # fmt: skip


def _sum(counts: Iterable[dict[str, int]]) -> tuple[float, float]:
    """Return precision and recall of counts, summed."""
    total: Counter[str] = Counter()
    for count in counts:
        total.update(count)
    true = total["true"]
    return true / max(true + total["false"], 1), true / max(true + total["missed"], 1)


def _score_rows(done: Sequence[Found]) -> Iterator[list[str]]:
    for sensor in ("lidar", "laser"):
        for method in done[0][sensor]["counts"]:
            counts = [each[sensor]["counts"][method] for each in done]
            if any(counts):
                precision, recall = _sum(counts)
                with_truth = sum(-(-each[sensor]["sweeps"] // TRUTH_EVERY) for each in done)
                yield [_NAMES[sensor], method, f"{precision:.3f}", f"{recall:.3f}", str(with_truth)]


def _node_parts(node: dict[str, Found] | None) -> list[str]:
    """Return the part of the page about the node."""
    if node is None:
        return ["Not done: its environment could not be made (`ros/python.sh` says why)."]
    rows = [
        [
            name, str(found["sent"]), str(found["answered"]), str(found["state"]), str(found["visibility"]),
            f"{found['sent'] / HZ / found['seconds']:.1f} ×",
        ]
        for sensor, name in _NAMES.items() for found in (node[sensor],)
    ]  # fmt: skip
    return [_NODE_TEXT, table(_NODE_HEADER, rows)]


def _lost_line(done: Sequence[Found]) -> str:
    counts = [each["laser"]["counts"]["shadow_map"] for each in done]
    lost, false = (sum(count.get(key, 0) for count in counts) for key in ("no echo", "false"))
    return (
        f"Of the laser's false cells {lost / max(false, 1):.0%} lie in the directions of beams without an echo, which a"
        " driver reports as +inf though a dark surface may have swallowed them. Where that matters, let it report NaN."
    )


_NAMES = {"lidar": "VLP-16", "laser": "2-D laser"}


def _rate_rows(done: Sequence[Found]) -> Iterator[list[str]]:
    for sensor, name in _NAMES.items():
        sweeps, seconds, used = (
            sum(each[sensor][key] for each in done) for key in ("sweeps", "seconds", "processor_s")
        )
        refused = sum(sum(each[sensor]["refused"].values()) for each in done)
        per_sweep = used / sweeps
        yield [
            name,
            str(sweeps),
            str(refused),
            f"{sweeps / seconds:.0f}",
            f"{1e3 * per_sweep:.1f}",
            f"{1e3 * per_sweep:.0f} %",
        ]


def _false_rows(done: Sequence[Found]) -> Iterator[list[str]]:
    for sensor, name in _NAMES.items():
        keys = ("sweeps", "inconsistent", "degraded", "stream_alarms", "cautious")
        yield [name, *(str(sum(each[sensor][key] for each in done)) for key in keys)]


def _attack_rows(done: Sequence[Found]) -> Iterator[list[str]]:
    for name in ATTACKED:
        found = [each["attacks"][name] for each in done]
        delays = [each["delay"] for each in found if each["delay"] is not None]
        share = sum(each["found"] for each in found) / max(sum(each["sweeps"] for each in found), 1)
        (before, before_recall), (after, after_recall) = (
            _sum(each["counts"][kind] for each in found) for kind in ("without", "with reactions")
        )
        first = f"{np.median(delays):.0f} sweeps" if delays else "never"
        never = f" ({len(found) - len(delays)} of {len(found)} never)" if delays and len(delays) < len(found) else ""
        yield [
            f"`{name}`", f"{np.mean([each['returns'] for each in found]):.0f}", f"{share:.0%}", first + never,
            f"{before:.3f}", f"{after:.3f}", f"{before_recall:.3f}", f"{after_recall:.3f}",
        ]  # fmt: skip


def _shortfall(done: Sequence[Found]) -> str:
    """Return which attacks are seldom found, and what the reactions cost, in sentences."""
    shares, lost = {}, {}
    for name in ATTACKED:
        found = [each["attacks"][name] for each in done]
        shares[name] = sum(each["found"] for each in found) / max(sum(each["sweeps"] for each in found), 1)
        recalls = [_sum(each["counts"][kind] for each in found)[1] for kind in ("without", "with reactions")]
        lost[name] = recalls[0] - recalls[1]
    seldom = ", ".join(f"`{name}` ({share:.0%})" for name, share in shares.items() if share < 0.5) or "none"
    costly = ", ".join(f"`{name}` ({loss:.2f})" for name, loss in lost.items() if loss > 0.25) or "none"
    return (
        f"Found in fewer than half of the attacked sweeps: {seldom}. The caution `CONFIRMED` withdraws what no earlier"
        " sweep confirms, and the profile `robot` keeps no earlier sweeps: more than a quarter of the recall is lost"
        f" under {costly}. The profile `contested` keeps five earlier sweeps for this."
    )


def _picture(bag: Path) -> bytes:
    """Return a PNG of an estimate in the first minute of the drive."""
    from viewshed.preprocess.leveling import level

    estimator = _estimator()
    sweep = next(islice(open_recording(bag), PICTURE_AT, None))
    leveled = level(sweep, estimator.grid)
    return estimator.estimate(leveled).plot(leveled, "VLP-16 in rooms, pedestrian")


if __name__ == "__main__":
    main()
