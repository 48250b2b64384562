"""Fit the network that predicts the ground without returns.

    python tools/fit_ground.py make learning road --scenes 0:3200 --out ground
    python tools/fit_ground.py make learning road --scenes 5000:6800 --out ground
    python tools/fit_ground.py make own road --scenes 40:1240 --out ground
    python tools/fit_ground.py make training road --scenes 0:1000 --out ground
    python tools/fit_ground.py make training indoor --scenes 0:500 --sweeps 1 --out ground
    python tools/fit_ground.py make own indoor --scenes 16:516 --sweeps 1 --out ground
    python tools/fit_ground.py fit ground --minutes 23 --out packages/viewshed/src/core/ground_network.inc

``make`` writes one file for 50 scenes and resumes where it was stopped; run two at once on two cores. ``fit`` trains
for the given time, keeps a checkpoint beside the samples and resumes from it, keeps whole scenes of each file for
validation, and writes the network as C++, which is compiled into the core. The scenes of ``own`` that the study of the
wild judges (the first 40 and 16), the development set and the sealed set are not used.
"""

from __future__ import annotations

import argparse
import copy
import time
from collections.abc import Sequence
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import torch
from fit_no_return import held_back, make_files, parser_of, parts_in, scenes_of, write_part

from viewshed.preprocess.leveling import level
from viewshed_lab.data.wild import WildScene
from viewshed_lab.training.unseen_ground import (
    GroundNet,
    Samples,
    augmented,
    exact_ground,
    inputs_of,
    loss_of,
    maps_of,
    source_of_network,
)

SCENES_OF_FILE, BATCH, RATE, DECAY, STEPS_OF_CHECKPOINT = 50, 16, 2.5e-3, 2e-2, 500
AVERAGED = 0.003
"""Share of each step in the averaged weights, which are the ones that are written."""

SHARES = {
    "learning-road": 0.45, "own-road": 0.22, "training-road": 0.18, "own-indoor": 0.07, "training-indoor": 0.08,
}  # fmt: skip
"""Of the samples of a batch, by set and grid."""


def make_file(sweeps: int, path: Path, scenes: list[WildScene]) -> None:
    """Write the samples of scenes into one file, of some sweeps each."""
    maps, ground, heights, numbers = [], [], [], []
    for scene in scenes:
        if scene.drawn_mounting().family.frame == "base":
            continue
        for number in range(sweeps):
            seen = scene.observe(number)
            given = seen.given(("rings", "rings", "nothing")[(scene.number + number) % 3])
            leveled = level(given, seen.truth.grid)
            maps.append(maps_of(leveled))
            ground.append(exact_ground(leveled, seen.scan.world_from_sensor, seen.world.ground_of(seen.agent)))
            heights.append(leveled.sensor_height_m)
            numbers.append(scene.number)
    write_part(
        path, maps=np.stack(maps).astype(np.float16), ground_m=np.stack(ground).astype(np.float16),
        height_m=np.array(heights, np.float32), scene=np.array(numbers),
    )  # fmt: skip


def make(given: argparse.Namespace) -> None:
    """Write the samples of a set."""
    make_files(given.out, scenes_of(given), partial(make_file, given.sweeps), SCENES_OF_FILE)


class Sets:
    """The samples of a folder by set and grid, in memory; the last scenes of each file are for validation."""

    def __init__(self, folder: Path) -> None:
        self.shown: dict[str, list[Samples]] = {name: [] for name in SHARES}
        self.held: dict[str, list[Samples]] = {name: [] for name in SHARES}
        for path in parts_in(folder):
            with np.load(path) as file:
                columns = [file[name] for name in Samples._fields]
                held = held_back(file["scene"])
            name = "-".join(path.name.split("-")[:2])
            for mask, where in ((~held, self.shown), (held, self.held)):
                where[name].append(Samples(*(torch.tensor(column[mask]) for column in columns)))
        self.names = [name for name in SHARES if self.shown[name]]

    def draw(self, rng: np.random.Generator) -> Samples:
        """Return a batch of augmented samples."""
        shares = np.array([SHARES[name] for name in self.names])
        rows = []
        for k in rng.choice(len(self.names), BATCH, p=shares / shares.sum()):
            files = self.shown[self.names[k]]
            file = files[rng.integers(len(files))]
            row = int(rng.integers(len(file.height_m)))
            rows.append([column[row].float() for column in file])
        return augmented(Samples(*(torch.stack(column) for column in zip(*rows, strict=True))), rng)

    @torch.no_grad()
    def validated(self, net: GroundNet) -> dict[str, float]:
        """Return the mean loss of the samples that are held back, by set and grid; of at most four files each."""
        losses = {}
        for name in self.names:
            some = [Samples(*(column[:32].float() for column in file)) for file in self.held[name][:4]]
            losses[name] = float(np.mean([float(_loss(net, samples)) for samples in some]))
        return losses


def _loss(net: GroundNet, samples: Samples) -> torch.Tensor:
    inputs, base = inputs_of(samples)
    return loss_of(net(inputs.contiguous(memory_format=torch.channels_last)), samples, base)


@torch.no_grad()
def average(averaged: GroundNet, net: GroundNet) -> None:
    """Move averaged weights a step towards those of a network."""
    for mean, value in zip(averaged.state_dict().values(), net.state_dict().values(), strict=True):
        if mean.is_floating_point():
            mean.lerp_(value, AVERAGED)


def fit(given: argparse.Namespace) -> None:
    """Fit a network to the samples of a folder, and write it."""
    torch.set_num_threads(given.threads)
    torch.manual_seed(0)
    checkpoint = given.folder / "checkpoint.pt"
    sets, net = Sets(given.folder), GroundNet()
    optimizer = torch.optim.AdamW(net.parameters(), RATE, weight_decay=DECAY)
    averaged = copy.deepcopy(net).eval()
    first, spent_s = 0, 0.0
    if checkpoint.exists():
        saved = torch.load(checkpoint)
        net.load_state_dict(saved["net"])
        averaged.load_state_dict(saved["averaged"])
        optimizer.load_state_dict(saved["optimizer"])
        first, spent_s = saved["step"], saved["spent_s"]
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    rng, start_s = np.random.default_rng(first), time.monotonic() - spent_s
    for step in count(first + 1):
        # The rate rises for a twentieth of the time, then falls along a cosine.
        done = min((time.monotonic() - start_s) / (60.0 * given.minutes), 1.0)
        for group in optimizer.param_groups:
            group["lr"] = RATE * float(min(20 * done + 0.05, 0.5 + 0.5 * np.cos(np.pi * done)))
        loss = _loss(net, sets.draw(rng))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        average(averaged, net)
        if step % STEPS_OF_CHECKPOINT == 0 or done == 1.0:
            losses = ", ".join(f"{name} {loss:.3f}" for name, loss in sets.validated(averaged).items())
            print(f"step {step}, {60 * given.minutes * done:.0f} s: {loss.item():.3f}; held back: {losses}", flush=True)
            state = {"net": net.state_dict(), "averaged": averaged.state_dict(), "optimizer": optimizer.state_dict()}
            torch.save(state | {"step": step, "spent_s": time.monotonic() - start_s}, checkpoint)
            given.out.write_text(source_of_network(averaged.convolutions()), encoding="ascii")
        if done == 1.0:
            return


def main(words: Sequence[str] | None = None) -> None:
    """Run the step that the command line names."""
    parser, steps = parser_of("fit_ground.py", __doc__, ("learning", "training", "own"), make, fit)
    steps.choices["make"].add_argument("--sweeps", type=int, default=2, help="of each scene")
    steps.choices["fit"].add_argument("--minutes", type=float, default=75.0, help="of training")
    steps.choices["fit"].add_argument("--threads", type=int, default=2)
    given = parser.parse_args(words)
    given.work(given)


if __name__ == "__main__":
    main()
