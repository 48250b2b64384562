"""Fit the network that guesses how far beams without a return went.

    python tools/fit_no_return.py make learning road --scenes 0:1500 --out samples
    python tools/fit_no_return.py make training road --scenes 0:1000 --out samples
    python tools/fit_no_return.py make training indoor --scenes 0:500 --out samples
    python tools/fit_no_return.py fit samples --out packages/viewshed/src/core/no_return_network.inc

``make`` writes one file for 10 scenes and goes on where it was stopped. ``fit`` keeps the last scenes of each file for
validation, and writes the network as C++, which is compiled into the core. The sealed set is not opened.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from viewshed.arrays import Mask
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.data.wild import WildScene, wild_tables
from viewshed_lab.training.no_return import (
    Mixture,
    NoReturnNet,
    Samples,
    samples_of,
    source_of,
    within_windows,
)

Work = Callable[[argparse.Namespace], None]

GROUPS_OF_SWEEP, BATCH, RATE = 400, 2048, 3e-3
HELD_SHARE = 0.12
VARIANTS = ((False, False, False), (True, False, False), (True, True, False), (False, False, True), (False, True, True))
"""Variants of each sweep: with absorbing things, with lost returns, with a close cover of the sensor."""

CLEAN_SHARE = 0.7
"""Weight of the samples from unchanged sweeps in the training, against those from variants with lost returns."""


def make_file(path: Path, scenes: list[WildScene]) -> None:
    """Write the samples of scenes into one file."""
    rows: list[Samples] = []
    clean, numbers = [], []
    for scene in scenes:
        if scene.drawn_mounting().family.frame == "base":
            continue
        number = scene.number % scene.domain.sweeps
        seen, rng = scene.observe(number), scene.rng(100, number)
        given = seen.given(("rings", "rings", "nothing")[scene.number % 3])
        unchanged = level(given, seen.truth.grid)
        for absorbs, loses, covered in VARIANTS:
            keep, windows, sweep = np.ones(len(given), np.bool_), np.zeros((0, 4)), given
            cover_m: float | None = None
            if absorbs:
                keep &= without_absorbed(unchanged, rng)
            if loses:
                kept, windows = kept_returns(given, rng)
                keep &= kept
            if covered:
                sweep, kept, windows, cover_m = with_cover(given, rng)
                keep &= kept
            if keep.sum() < 100:
                continue
            is_clean = not (absorbs or loses or covered)
            leveled = unchanged if is_clean else level(sweep.select(keep), seen.truth.grid)
            samples = samples_of(seen, leveled, windows, cover_m)
            if samples is not None:
                picked = rng.permutation(len(samples.end))[:GROUPS_OF_SWEEP]
                rows.append(
                    Samples(samples.feature[picked], samples.stop[picked], samples.end[picked], samples.beams[picked])
                )
                clean.append(np.full(len(picked), is_clean))
                numbers.append(np.full(len(picked), scene.number))
    if not rows:
        return
    columns = (np.concatenate(column) for column in zip(*rows, strict=True))
    named = dict(zip(Samples._fields, columns, strict=True))
    write_part(path, clean=np.concatenate(clean), scene=np.concatenate(numbers), **named)


def write_part(path: Path, **columns: NDArray[Any]) -> None:
    """Write columns of equal length into a file, atomically."""
    part = path.with_suffix(".part.npz")
    np.savez(part, **columns)  # type: ignore[arg-type]
    part.replace(path)
    print(path.name, len(next(iter(columns.values()))), flush=True)


def parts_in(folder: Path) -> list[Path]:
    """Return the files of a folder, in order."""
    return [path for path in sorted(folder.glob("*-[0-9]*.npz")) if ".part" not in path.name]


def held_back(scene: NDArray[np.int64]) -> Mask:
    """Return the mask (K,) of the rows of the last scenes of a file, at least ``HELD_SHARE`` of its scenes."""
    scenes = np.unique(scene)
    return np.isin(scene, scenes[-math.ceil(HELD_SHARE * len(scenes)) :])


def without_absorbed(leveled: LeveledSweep, rng: np.random.Generator) -> Mask:
    """Return the mask (N,) of returns that remain if some things absorb light: black walls, glass, removal attacks."""
    keep = np.ones(len(leveled.sweep), np.bool_)
    high = np.flatnonzero(leveled.height_m > 0.2)
    for _ in range(int(rng.integers(1, 7)) if len(high) else 0):
        center = leveled.points[rng.choice(high), :2]
        near = np.hypot(*(leveled.points[high, :2] - center).T) < rng.uniform(0.5, 12.0)
        gone = near & (rng.random(len(high)) < rng.choice([0.8, 0.95, 1.0]))
        keep[leveled.rows[high[gone]]] = False
    return keep


def kept_returns(sweep: Sweep, rng: np.random.Generator) -> tuple[Mask, NDArray[np.float64]]:
    """Return the mask (N,) of returns of a degraded sensor, and the windows (W, 4) in which it is blind.

    It loses random returns, all in some angular windows (a cap on the lens, a removal attack), near ones of some rings
    (channels with a blind zone), and more with range. A window is azimuth, elevation, and half of its size in both.
    """
    x, y, z = sweep.points.T.astype(np.float64)
    range_m, azimuth = np.sqrt(x * x + y * y + z * z) + 1e-6, np.arctan2(y, x)
    keep = rng.random(len(sweep)) > rng.choice([0.0, 0.1, 0.3, 0.6, 0.85], p=[0.5, 0.2, 0.1, 0.1, 0.1])
    count = int(rng.integers(0, 8))
    windows = np.stack(
        [rng.uniform(-np.pi, np.pi, count), rng.normal(0.0, 0.25, count), rng.uniform(0.02, 0.5, count),
         rng.uniform(0.02, 0.4, count)], axis=1,
    )  # fmt: skip
    keep &= ~within_windows(azimuth, np.arcsin(z / range_m), windows)
    if rng.random() < 0.4:
        blind = rng.random(256) < rng.uniform(0.2, 1.0)
        near = range_m < np.quantile(range_m, rng.uniform(0.1, 0.8))
        keep &= ~near | (~blind[sweep.ring] if sweep.ring is not None else rng.random() < 0.3)
    if rng.random() < 0.3:
        keep &= rng.random(len(sweep)) < np.exp(-range_m / (np.quantile(range_m, 0.9) * rng.uniform(0.3, 3.0)))
    return keep, windows


def with_cover(sweep: Sweep, rng: np.random.Generator) -> tuple[Sweep, Mask, NDArray[np.float64], float]:
    """Return the sweep of a partly covered sensor, the mask (N,) of its returns, and the cover (window and range).

    The cover is an angular window (1, 4) at one range. Rings that are blind at that range get no return from it.
    """
    azimuth, elevation = np.arctan2(sweep.points[:, 1], sweep.points[:, 0]), np.zeros(len(sweep))
    windows = np.array([[rng.uniform(-np.pi, np.pi), 0.0, rng.uniform(0.3, 3.2), 2.0]])
    cover_m = float(rng.uniform(0.3, 1.5))
    behind = within_windows(azimuth.astype(np.float64), elevation, windows)
    scale = np.where(behind, cover_m / np.maximum(np.linalg.norm(sweep.points, axis=1), 1e-3), 1.0)
    blind = rng.random(256) < rng.uniform(0.2, 1.0)
    seen = ~blind[sweep.ring] if sweep.ring is not None else rng.random(len(sweep)) < 0.5
    points = sweep.points * np.minimum(scale, 1.0)[:, None].astype(np.float32)
    return sweep.replace(points=points), ~behind | seen, windows, cover_m


def make(arguments: argparse.Namespace) -> None:
    """Write the samples of a set."""
    make_files(arguments.out, scenes_of(arguments), make_file)


def scenes_of(given: argparse.Namespace) -> list[WildScene]:
    """Return the scenes that the command line names; numbers beyond those of the set are fresh scenes of it."""
    first, last = map(int, given.scenes.split(":"))
    domain = next(domain for domain in wild_tables().of_set(given.set) if domain.name == given.domain)
    if given.set == "own" and first < domain.scenes:
        raise SystemExit(f"--scenes must begin at {domain.scenes} or later for own: those before are judged")
    return [WildScene(domain, number) for number in range(first, last)]


def make_files(
    folder: Path, scenes: list[WildScene], make_one: Callable[[Path, list[WildScene]], None], per_file: int = 10
) -> None:
    """Write the files of scenes, ``per_file`` scenes each; skip those that exist."""
    folder.mkdir(parents=True, exist_ok=True)
    for at in range(0, len(scenes), per_file):
        some = scenes[at : at + per_file]
        path = folder / f"{some[0].name.rsplit('-', 1)[0]}-{len(some)}.npz"
        if not path.exists():
            make_one(path, some)


def descend(
    net: nn.Module, rate: float, decay: float, steps: int, loss_of: Callable[[], torch.Tensor]
) -> Iterator[tuple[int, torch.Tensor]]:
    """Fit a network with one cycle of the learning rate; yield number (from 1) and loss of each finished step."""
    optimizer = torch.optim.AdamW(net.parameters(), rate, weight_decay=decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, steps)
    for step in range(1, steps + 1):
        loss = loss_of()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        yield step, loss


def fit(arguments: argparse.Namespace) -> None:
    """Fit a network to all samples of a folder, and write it."""
    files = [np.load(path) for path in parts_in(arguments.folder)]
    columns = {name: np.concatenate([file[name] for file in files]) for name in Samples._fields}
    held = np.concatenate([held_back(file["scene"]) for file in files])
    tensors = {name: torch.tensor(column.astype(np.float32)) for name, column in columns.items()}
    clean = np.concatenate([file["clean"] for file in files])
    weight = torch.tensor(np.where(clean, CLEAN_SHARE / clean.mean(), (1 - CLEAN_SHARE) / (~clean).mean())[~held])
    own, other = torch.tensor(np.flatnonzero(~held)), torch.tensor(np.flatnonzero(held))
    torch.manual_seed(0)
    torch.set_num_threads(1)
    mean, std = tensors["feature"][own].mean(0), tensors["feature"][own].std(0)
    report_rows = torch.tensor(np.flatnonzero(held & clean))
    net = NoReturnNet(mean, 1.0 / std.clamp_min(1e-3), tensors["stop"].shape[1])

    def loss_of() -> torch.Tensor:
        return -_likelihood(net, tensors, own[torch.multinomial(weight, BATCH, replacement=True)]).mean()

    for step, loss in descend(net, RATE, 1e-4, arguments.steps, loss_of):
        if step % 500 == 0 or step == arguments.steps:
            with torch.no_grad():
                held_loss = -float(_likelihood(net, tensors, other).mean())
            print(f"step {step}: {float(loss):.3f}, held {held_loss:.3f}", flush=True)
    arguments.out.write_text(source_of(net.arrays()), encoding="ascii")
    report(net, tensors, report_rows)


def report(net: NoReturnNet, tensors: dict[str, torch.Tensor], rows: torch.Tensor) -> None:
    """Print the calibration of the survival probability at some ranges."""
    ranges = torch.tensor([2.0, 3.0, 4.0, 5.0, 6.0])
    with torch.no_grad():
        survival = Mixture.of(net, tensors["feature"][rows], tensors["stop"][rows]).survival(ranges).numpy()
    end = tensors["end"][rows].numpy()
    for k, log_m in enumerate(ranges.tolist()):
        true, prob = end > log_m, survival[:, k]
        bins = np.minimum((prob * 10).astype(int), 9)
        text = " ".join(
            f"{prob[bins == b].mean():.2f}/{true[bins == b].mean():.2f}" for b in range(10) if (bins == b).sum() > 50
        )
        print(f"{2**log_m:.0f} m: {true.mean():.3f} went on; said/true {text}")


def _likelihood(net: NoReturnNet, tensors: dict[str, torch.Tensor], rows: torch.Tensor) -> torch.Tensor:
    mixture = Mixture.of(net, tensors["feature"][rows], tensors["stop"][rows])
    return mixture.log_likelihood(tensors["end"][rows])


def main(words: Sequence[str] | None = None) -> None:
    """Run the step of the command line."""
    arguments = parser_of("fit_no_return.py", __doc__, ("learning", "training"), make, fit)[0].parse_args(words)
    arguments.work(arguments)


def parser_of(prog: str, about: str | None, sets: Sequence[str], make: Work, fit: Work) -> tuple[Any, Any]:
    """Return the parser of a tool with steps ``make`` and ``fit``, and the action that adds further steps."""
    parser = argparse.ArgumentParser(prog=prog, description=about, formatter_class=argparse.RawTextHelpFormatter)
    steps = parser.add_subparsers(required=True)
    step = steps.add_parser("make")
    step.set_defaults(work=make)
    step.add_argument("set", choices=sets)
    step.add_argument("domain", nargs="?", default="road")
    step.add_argument("--scenes", default="0:60", help="from : to")
    step.add_argument("--out", type=Path, required=True)
    step = steps.add_parser("fit")
    step.set_defaults(work=fit)
    step.add_argument("folder", type=Path)
    step.add_argument("--steps", type=int, default=6000)
    step.add_argument("--out", type=Path, required=True)
    return parser, steps


if __name__ == "__main__":
    main()
