"""All calls of the golden-file tests into viewshed, so that a moved name in the package is fixed only here."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import ESTIMATORS, GRIDS, BevGrid, FovEstimate, FovEstimator, Sweep
from viewshed.estimators import paper_estimators
from viewshed.estimators.unet import LEARNED as NETWORKS
from viewshed.fov.visibility import TARGETS
from viewshed.io import read_index, read_indexed, write_sweep
from viewshed_lab.data.archive.shard import Shard, write_shard
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import Preset, preset_named, preset_names
from viewshed_lab.data.sample import Sample
from viewshed_lab.data.simulated import ScenePlan, simulate_frame
from viewshed_lab.threats.attacks import ATTACKS, Knowledge

ATTACK_SEED = 20260
PASSES = 3
"""Passes of Monte Carlo dropout: enough for a nonzero standard deviation."""
_HALF_EXTENT_M = {"road": 64.0, "indoor": 16.0}
_TARGETS = {"road": "car", "indoor": "pedestrian"}
_PAPER_RANGE_M = {"road": 100.0, "indoor": 20.0}


@dataclass(frozen=True, slots=True)
class Arrays:
    """One estimate as uint8: state, round(255 p), and round(255 std), 255 if there is no std; each (256, 256)."""

    state: NDArray[np.uint8]
    prob: NDArray[np.uint8]
    std: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class SweepName:
    """One sweep of the golden files."""

    source: str  # ``real``, or the preset that it is simulated from
    place: str  # of a real sweep its path in index.json, else ``SCENE/FRAME`` of the preset's first split
    grid: str  # ``road`` or ``indoor``
    attack: str = ""  # of ``ATTACKS``, or empty

    def __str__(self) -> str:
        return f"{self.source}:{self.place}{self.attack and '+'}{self.attack}"


REAL = tuple(
    SweepName("real", place, grid)
    for grid, places in {
        "road": (
            "nuscenes/n008-2018-08-01-15-16-36-0400__LIDAR_TOP__1533151603547590.pcd.bin",
            "nuscenes/n015-2018-07-24-11-22-45+0800__LIDAR_TOP__1532402927647951.pcd.bin",
            "kitti/odometry00/000000.bin",
            "kitti/object/000100.bin",
            "kitti/front_fov_cropped/000005.bin",
            "kitti/raw_udacity/data_1_0000000021.pcd",
            "kitti/raw_drive0001_seq/0026.npz",
            "outdoor_vlp16_apollo/2.pcd",
            "outdoor_hdl32_gicp/251370668.pcd",
            "ouster/decoded/OS-0-128-U1_v2.3.0_1024x10.npz",
            "ouster/decoded/OS-1-128_v2.3.0_1024x10.npz",
            "ouster/decoded/OS-1-32-G_v2.1.1_1024x10.npz",
            "carla_multiagent/co_perception_31_30/ego1_1793.ply.gz",
            "argoverse2/7fab2350_315966265259836000.feather",
            "pandaset/000500.bin",
        ),
        "indoor": (
            "nebula/vlp16.pcd",
            "nebula/vlp32.pcd",
            "nebula/xt32.pcd",
            "nebula/pandar40p.pcd",
            "nebula/ot128.pcd",
        ),
    }.items()
    for place in places
)
"""20 real sweeps, at least one of each available sensor."""


_ATTACKS = (
    "uniform", "uniform_on_beams", "cluster", "cluster_on_beams", "wedge_cluster", "wedge_cluster_free", "frustum",
    "frustum_before", "frustum_free", "ghost_car", "ghost_wall", "far_wall", "removal", "high_frequency_removal",
    "jamming", "replay", "coherent_phantom", "relay", "pose_spoof", "removal_and_far_wall",
)  # fmt: skip


def _simulated() -> Iterator[SweepName]:
    """Yield 28 sweeps on roads and 22 indoors; every second one is attacked until each attack was used once."""
    attacks = iter(_ATTACKS)
    for preset, grid, count in (("roads", "road", 28), ("rooms", "indoor", 22)):
        for scene in range(count):
            # The last frames of a road scene are from the sensor on its mast.
            frame = 3 if preset == "roads" and scene % 7 == 6 else 2
            yield SweepName(preset, f"{scene}/{frame}", grid, next(attacks, "") if scene % 2 else "")


SIMULATED = tuple(_simulated())
SWEEPS = REAL + SIMULATED
SHORT = frozenset(map(str, (*REAL[::3], *SIMULATED[::6], *SIMULATED[1::10])))
"""The sweeps of the default suite."""
ROAD_ONLY = frozenset({"unet", "mc_dropout"})
CLASSICAL = (
    "continuous", "quantized", "concave_hull", "delaunay", "first_blocker", "first_blocker_median", "trimmed",
    "shadow_map", "majority_vote",
)  # fmt: skip
LEARNED = ("unet", "mc_dropout")
PAPER_METHODS = ("paper_label", "paper_quantized", "paper_continuous", "paper_concave_hull", "paper_delaunay")
METHODS = CLASSICAL + LEARNED + PAPER_METHODS
PAPER_SWEEPS = frozenset(map(str, (*REAL[::5], *SIMULATED[::10])))
"""The sweeps on which the estimators run with the paper's settings."""


def unrecorded() -> list[str]:
    """Return the estimators and attacks of the package's tables that have no golden array.

    An ``_aimed`` or ``_clean`` attack is covered by its base attack, which differs only in wedge or noise.
    """
    attacks = {name.attack for name in SIMULATED}
    missing = [name for name in ATTACKS if name.removesuffix("_aimed").removesuffix("_clean") not in attacks]
    return [*(name for name in ESTIMATORS if name not in METHODS), *missing]


def methods_of(name: SweepName) -> tuple[str, ...]:
    """Return the methods that have a golden array of a sweep."""
    return tuple(
        method
        for method in METHODS
        if not (method in ROAD_ONLY and name.grid != "road")
        and not (method in PAPER_METHODS and str(name) not in PAPER_SWEEPS)
    )


@lru_cache(maxsize=1)
def _entries(folder: Path) -> dict[Path, Callable[[], Sweep]]:
    return {entry.file: partial(read_indexed, entry) for entry in read_index(folder / "index.json")}


def sweep_of(name: SweepName, real_data: Path | None) -> Sweep:
    """Return the named sweep: read from the folder of real data, or simulated and, if so named, attacked."""
    if name.source == "real":
        if real_data is None:
            raise ValueError(f"{name} needs the folder of real sweeps; set VIEWSHED_REAL_DATA")
        return _entries(real_data)[(real_data / name.place).resolve()]()
    scene, frame = map(int, name.place.split("/"))
    sweep = _simulated_sweep(name.source, scene, frame)
    if not name.attack:
        return sweep
    agents = preset_named(name.source).agents
    knowledge = Knowledge((_simulated_sweep(name.source, scene, frame - agents),), None, _HALF_EXTENT_M[name.grid])
    rng = np.random.Generator(np.random.PCG64(ATTACK_SEED))
    return ATTACKS[name.attack](None, knowledge).apply(sweep, rng).sweep


def _simulated_sweep(preset: str, scene: int, frame: int) -> Sweep:
    # The truth is not used here: a coarse grid saves time.
    coarse = replace(preset_named(preset), grid_cells=8)
    return simulate_frame(ScenePlan(coarse, 0, scene), frame).sweep


@cache
def _estimator(method: str, grid_name: str) -> FovEstimator:
    grid: BevGrid = GRIDS[grid_name]
    if method in CLASSICAL:
        return ESTIMATORS[method](grid)
    if method in PAPER_METHODS:
        return paper_estimators(_PAPER_RANGE_M[grid_name])[method](grid)
    return NETWORKS[method](grid, TARGETS[_TARGETS[grid_name]], passes=PASSES if method == "mc_dropout" else None)


def estimate(method: str, name: SweepName, sweep: Sweep) -> Arrays:
    """Return the estimate of a method for a sweep; networks run with shipped weights and a fixed seed."""
    fov: FovEstimate = _estimator(method, name.grid).estimate(sweep)
    std = np.full(fov.state.shape, np.nan, np.float32) if fov.std is None else fov.std
    return Arrays(fov.state, _bytes(fov.visible_prob), _bytes(np.where(np.isnan(std), np.float32(1.0), std)))


def _bytes(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    rounded: NDArray[np.uint8] = np.rint(values * np.float32(255)).astype(np.uint8)
    return rounded


PRESETS = preset_names()


def shard_digests(preset: str, folder: Path) -> dict[str, dict[str, str]]:
    """Write a short shard of a preset as an archive does, read it again, and return hashes by frame and column.

    Its frames are the first of the first agent, the first of the last agent, and the second of the first agent.
    """
    plan: Preset = preset_named(preset)
    scene, store = ScenePlan(plan, 0, 1), Storage.of(folder)
    numbers = sorted({0, plan.agents - 1, plan.agents})
    frames = (simulate_frame(scene, number) for number in numbers)
    write_shard(store, f"{preset}.parquet", frames)
    shard = Shard(store, f"{preset}.parquet")
    try:
        return {str(number): _digests(shard.sample(row)) for row, number in enumerate(numbers)}
    finally:
        shard.close()


def _digests(frame: Sample) -> dict[str, str]:
    """Hash integers and masks unchanged, and floats rounded to a step that numerical noise seldom crosses."""
    image, sweep, truth = frame.measured, frame.sweep, frame.truth
    if isinstance(image, Sweep):
        raise TypeError("a simulated frame must hold its range image, got a sweep")
    columns: dict[str, NDArray[Any]] = {"steps": image.steps, "intensity": image.intensity, "known": frame.known}
    columns |= {f"expected_returns {name}": values for name, values in truth.expected_returns.items()}
    columns |= {f"state {name}": values for name, values in truth.state.items()}
    columns |= {f"definition {name}": mask for name, mask in truth.definitions.items()}
    columns["ring"] = np.array([] if sweep.ring is None else sweep.ring, np.int16)
    motion = (*image.motion.velocity_mps, image.motion.yaw_rate, image.motion.period_s)
    floats = {"pose": image.world_from_sensor.as_matrix(), "height": image.sensor_height_m, "motion": motion,
              "middle of the points": sweep.points.mean(axis=0, dtype=np.float64)}  # fmt: skip
    columns |= {name: _rounded(values) for name, values in floats.items()}
    facts = f"{image.model.name}, {image.agent}, {image.t_ns} ns, {image.step_m:.6f} m a step, {len(sweep)} returns"
    return {"facts": facts} | {name: _digest(values) for name, values in columns.items()}


def _rounded(values: Any) -> NDArray[np.int64]:
    """Round to whole multiples of 1e-4 (0.1 mm)."""
    return np.rint(np.asarray(values, np.float64) * 1e4).astype(np.int64)


def _digest(values: NDArray[Any]) -> str:
    array = np.ascontiguousarray(values)
    return hashlib.sha256(f"{array.dtype.str} {array.shape} ".encode() + array.tobytes()).hexdigest()[:16]


def config() -> dict[str, Any]:
    """Return the settings of the golden arrays as plain values."""
    return {
        "attack_seed": ATTACK_SEED,
        "dropout": {"passes": PASSES, "seed": 0},
        "targets": {"classical": "car", "learned": _TARGETS},
        "grids": {name: [GRIDS[name].cells, GRIDS[name].half_extent_m] for name in _TARGETS},
        "paper_max_range_m": _PAPER_RANGE_M,
        "preset_seeds": {name: preset_named(name).seed for name in ("roads", "rooms")},
        "networks": {
            f"{method} {grid}": NETWORKS[method](GRIDS[grid], TARGETS[_TARGETS[grid]]).card.name
            for method in LEARNED
            for grid in _TARGETS
        },
    }


TINY_PAGES = {
    "robustness": "robustness/robustness.md",
    "paper": "paper/paper.md",
    "paper_strict": "paper/paper_strict.md",
    "wild": "wild/wild.md",
    "agents": "agents/agents.md",
    "tracks": "tracks/tracks.md",
    "alarms": "alarms/monitor.md",
    "truth": "truth.md",
    "crossview": "crossview.md",
}
"""Where the studies write their pages in :func:`tiny_pages`, by name."""
_CLI = "from viewshed.cli import main; main()"


def tiny_pages(folder: Path) -> dict[str, str]:
    """Run every study on its tiny plan in an empty ``folder``; return the Markdown of its pages by name."""
    run = partial(_run, folder)
    run("study", "robustness", "--preset", "tiny", "--out", "robustness")
    run("study", "paper", "--preset", "tiny", "--out", "paper")
    run("study", "wild", "--preset", "tiny", "--out", "wild")
    run("study", "agents", "--preset", "tiny", "--out", "agents")
    run("study", "tracks", "--preset", "tiny", "--out", "tracks")
    run("study", "monitor", "--preset", "tiny", "--out", "alarms")
    run("simulate", "nuscenes-small", "--sweeps", "24", "--out", "sweeps")
    run("evaluate", "truth", "sweeps", "--limit", "6", "--out", "truth.md")
    _write_index(folder / "posed")
    run("evaluate", "crossview", "posed/index.json", "--attacks", "cluster_on_beams", "--out", "crossview.md")
    run("attack", "sweeps", "--attack", "ghost_wall", "--out", "attacked")
    run("monitor", "fit", "sweeps", "--passes", "3", "--false-alarm-rate", "0.1", "--out", "monitor.npz")
    verdicts = run("monitor", "check", "sweeps", "attacked", "--monitor-file", "monitor.npz")
    pages = {name: _whole_page(folder / path) for name, path in TINY_PAGES.items()}
    lines = "".join(f"| {line} |\n" for line in verdicts.splitlines())
    return pages | {"monitor": f"# Monitor\n\n| what the monitor said |\n|---|\n{lines}"}


def _whole_page(path: Path) -> str:
    """Return a page with all its tables: NAME_full.md if the page omits some, else the page itself."""
    full = path.with_name(f"{path.stem}_full.md")
    return (full if full.exists() else path).read_text(encoding="utf-8")


def _run(folder: Path, *words: str) -> str:
    """Run a viewshed command and return its standard output."""
    done = subprocess.run(
        [sys.executable, "-c", _CLI, *words], cwd=folder, check=False, capture_output=True, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"},
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"viewshed {' '.join(words)} failed: {done.stderr.strip()[-500:]}")
    return done.stdout


def _write_index(folder: Path) -> None:
    """Write an index of five posed sweeps of one simulated scene, 1.5 s apart."""
    scene, entries = ScenePlan(preset_named("nuscenes-small"), 0, 1), []
    folder.mkdir()
    for number in range(0, 15, 3):
        sweep = simulate_frame(scene, number).sweep
        if sweep.world_from_sensor is None or sweep.t_ns is None:
            raise ValueError("a simulated sweep must have pose and time")
        write_sweep(sweep, folder / f"{number}.npz")
        entries.append(
            {"file": f"{number}.npz", "sensor": "HDL-32E", "sensor_height_m": sweep.sensor_height_m,
             "world_from_sensor": sweep.world_from_sensor.as_matrix().tolist(), "t": sweep.t_ns / 1e9,
             "stats": {"points": len(sweep)}}
        )  # fmt: skip
    (folder / "index.json").write_text(json.dumps(entries), encoding="utf-8")
