"""Fit and judge the network that guesses ground which no beam met.

    python tools/fit_ground.py make learning road --scenes 0:5000 --sweeps 2 --out samples
    python tools/fit_ground.py make training road --scenes 0:1000 --sweeps 2 --out samples
    python tools/fit_ground.py fit samples --steps 20000 --out ground.pt
    python tools/fit_ground.py judge ground.pt development --scenes 0:60

``make`` writes one file for 50 scenes and goes on where it was stopped, ``fit`` keeps a checkpoint for every 500 steps
and goes on from it, ``judge`` holds the shadow map on the network's ground against that on the ground of the rules and
on the exact ground. The sealed set is not opened.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from viewshed.arrays import F32
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.visibility import CAR
from viewshed.grid import polar_of_cells
from viewshed.metrics import ConfusionCounts
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.wild import WildScene, wild_scenes
from viewshed_lab.sim.lidar.optics import optics_of
from viewshed_lab.studies.wild.evaluate import ground_error_m
from viewshed_lab.training.ground_prior import (
    GroundNet,
    Modes,
    exact_ground,
    inputs_of,
    lattice_features,
    loss_of,
    on_ground,
)

SCENES_OF_FILE, BATCH, SAVED_EVERY, RATE = 50, 12, 500, 2e-3
LEARNING_SHARE = 0.6
"""Of the samples that are shown: those of the set without styles; the others are of the set ``training``."""


def samples(scene: WildScene, sweeps: int) -> Iterator[tuple[F32, F32, float]]:
    """Yield features (5, n, n), exact ground (n, n), NaN where unknown, and sensor height of a scene's sweeps."""
    for number in range(sweeps):
        seen = scene.observe(number)
        given = seen.told(("rings", "nothing")[(scene.number + number) % 2])
        leveled = level(given, seen.truth.grid)
        ground_m, known = exact_ground(leveled, seen.scan.world_from_sensor, seen.world.ground_of(seen.agent))
        ground_m[~known | (np.abs(ground_m) > 30.0)] = np.nan
        yield lattice_features(leveled), ground_m, leveled.sensor_height_m


def make_file(folder: Path, sweeps: int, scenes: list[WildScene]) -> str:
    """Write the samples of scenes into one file of a folder, and return its name; one that is there is kept."""
    path = folder / f"{scenes[0].name.rsplit('-', 1)[0]}-{len(scenes)}.npz"
    if not path.exists():
        rows = [row for scene in scenes for row in samples(scene, sweeps)]
        features, ground, height = (np.stack(column).astype(np.float16) for column in zip(*rows, strict=True))
        part = path.with_suffix(".part.npz")
        np.savez(part, features=features, ground_m=ground, height_m=height)
        part.replace(path)
    return path.name


def make(given: argparse.Namespace) -> None:
    """Write the samples of a set."""
    scenes = scenes_of(given)
    given.out.mkdir(parents=True, exist_ok=True)
    groups = [scenes[at : at + SCENES_OF_FILE] for at in range(0, len(scenes), SCENES_OF_FILE)]
    for done in LocalEngine(given.workers).run(partial(make_file, given.out, given.sweeps), groups):
        print(done.error or done.result, flush=True)


def fit(given: argparse.Namespace) -> None:
    """Fit a network to all samples of a folder; the last scenes of each file are for validation."""
    files = [(path.name, np.load(path)) for path in sorted(given.folder.glob("*-[0-9]*.npz"))]
    columns = {key: np.concatenate([file[key] for _, file in files]) for key in ("features", "ground_m", "height_m")}
    is_land = np.concatenate([np.full(len(file["height_m"]), name.startswith("learning")) for name, file in files])
    is_held = np.concatenate(
        [np.arange(len(file["height_m"])) >= int(0.96 * len(file["height_m"])) for _, file in files]
    )
    shown = (
        np.where(is_land, LEARNING_SHARE / is_land.sum(), (1 - LEARNING_SHARE) / max((~is_land).sum(), 1)) * ~is_held
    )
    held = np.flatnonzero(is_held)
    rng = np.random.default_rng(0)

    def batch(rows: Any, turn: int = 0, *, flip: bool = False) -> tuple[torch.Tensor, torch.Tensor]:
        features, ground, height = (torch.tensor(column[rows].astype(np.float32)) for column in columns.values())
        features, ground = torch.rot90(features, turn, (2, 3)), torch.rot90(ground, turn, (1, 2))
        if flip:
            features, ground = features.flip(3), ground.flip(2)
        return inputs_of(features, height, given.half_extent), ground

    torch.manual_seed(0)
    net, first = GroundNet(), 0
    optimizer = torch.optim.AdamW(net.parameters(), RATE, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, given.steps)
    if given.out.exists():
        saved = torch.load(given.out)
        net.load_state_dict(saved["net"])
        optimizer.load_state_dict(saved["optimizer"])
        schedule.load_state_dict(saved["schedule"])
        first = saved["step"]
        rng = np.random.default_rng(first)
    for step in range(first + 1, given.steps + 1):
        rows = rng.choice(len(shown), BATCH, replace=False, p=shown / shown.sum())
        inputs, ground = batch(rows, int(rng.integers(4)), flip=bool(rng.integers(2)))
        loss = loss_of(net(inputs), ground, given.half_extent)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        if step % SAVED_EVERY == 0 or step == given.steps:
            net.eval()
            with torch.no_grad():
                blocks = [batch(held[at : at + 24]) for at in range(0, len(held), 24)]
                losses = [float(loss_of(net(x), y, given.half_extent)) for x, y in blocks]
            net.train()
            print(f"step {step}: negative log-likelihood {np.mean(losses):.3f} of {len(held)} sweeps", flush=True)
            state = {"net": net.state_dict(), "optimizer": optimizer.state_dict(), "schedule": schedule.state_dict()}
            torch.save(state | {"step": step, "shape": net.shape}, given.out)


def grounds(net: GroundNet, leveled: LeveledSweep) -> dict[str, LeveledSweep]:
    """Return a sweep on the ground of the rules, on the network's median, and on that where no return shows ground."""
    features = torch.tensor(lattice_features(leveled))[None]
    height, half_m = torch.tensor([leveled.sensor_height_m], dtype=torch.float32), leveled.ground.half_extent_m
    with torch.no_grad():
        modes = Modes.of(net(inputs_of(features, height, half_m)))
    median, std = modes.quantile(0.5)[0].numpy(), 0.5 * modes.std()[0].numpy()
    old, times = leveled.ground, len(median) // len(leveled.ground.heights_m)
    rules, rules_std, seen = (np.kron(each, np.ones((times, times))) for each in (old.heights_m, old.std_m, old.seen))
    pinned = on_ground(leveled, np.where(seen > 0, rules, median), np.where(seen > 0, np.minimum(rules_std, std), std))
    return {"rules": leveled, "network": on_ground(leveled, median, std), "network, seen ground pinned": pinned}


def judge(given: argparse.Namespace) -> None:
    """Print precision, recall and F1 of the shadow map on each ground, rings given, car, within the sensor's reach."""
    saved = torch.load(given.net)
    net = GroundNet(**saved["shape"])
    net.load_state_dict(saved["net"])
    net.eval()
    found: dict[str, ConfusionCounts] = {}
    for scene in scenes_of(given):
        seen = scene.observe(0)
        if seen.mounting.family.frame == "base":
            continue
        sample, grid = seen.sample("rings"), seen.truth.grid
        leveled = level(sample.sweep, grid)
        reach_m = min(optics_of(seen.sensor.model).reach_m, seen.sensor.model.max_range_m)
        known = seen.known & (polar_of_cells(grid)[0] <= reach_m)
        leveled_on = grounds(net, leveled)
        # The exact ground where no return shows it, as far as the cells reach.
        exact = (leveled.ground.at(grid.centers) - ground_error_m(leveled, sample)).astype(np.float32)
        nodes = len(leveled_on["network"].ground.heights_m)
        side = grid.cells // nodes
        means = exact.reshape(nodes, side, nodes, side).mean(axis=(1, 3))
        pinned = leveled_on["network, seen ground pinned"].ground
        leveled_on["exact where unseen"] = on_ground(leveled, np.where(pinned.seen, pinned.heights_m, means), 0 * means)
        for name, each in leveled_on.items():
            claimed = ShadowMap(grid, CAR).estimate(each).visible()
            counts = ConfusionCounts.of(claimed, seen.truth.visible(CAR), known, grid.cell_area_m2)
            found[name] = found[name] + counts if name in found else counts
    for name, counts in found.items():
        print(f"{name:28} precision {counts.precision:.3f}  recall {counts.recall:.3f}  F1 {counts.f1:.3f}")


def scenes_of(given: argparse.Namespace) -> list[WildScene]:
    """Return the scenes that the command line names."""
    first, last = map(int, given.scenes.split(":"))
    return wild_scenes(given.set, given.domain)[first:last]


def main(words: Sequence[str] | None = None) -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(
        prog="fit_ground.py", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    steps = parser.add_subparsers(required=True)
    for work in (make, fit, judge):
        step = steps.add_parser(work.__name__, help=(work.__doc__ or "").split(";")[0])
        step.set_defaults(work=work)
        if work is judge:
            step.add_argument("net", type=Path)
        if work is fit:
            step.add_argument("folder", type=Path)
            step.add_argument("--steps", type=int, default=20000)
            step.add_argument("--half-extent", type=float, default=64.0, help="of the lattice of the samples, meters")
        else:
            step.add_argument("set")
            step.add_argument("domain", nargs="?", default="road")
            step.add_argument("--scenes", default="0:60", help="from : to")
        if work is make:
            step.add_argument("--sweeps", type=int, default=2, help="of each scene")
            step.add_argument("--workers", type=int, default=2)
        if work is not judge:
            step.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(words)
    given.work(given)


if __name__ == "__main__":
    main()
