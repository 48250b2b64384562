"""Fit the network that says how often a cell is visible of which the beams say so much.

    python tools/fit_calibration.py make learning road --scenes 0:900 --out cells
    python tools/fit_calibration.py make training road --scenes 0:200 --out cells
    python tools/fit_calibration.py make training indoor --scenes 0:240 --out cells
    python tools/fit_calibration.py make own road --scenes 40:640 --out cells
    python tools/fit_calibration.py make own indoor --scenes 16:416 --out cells
    python tools/fit_calibration.py fit cells --out packages/viewshed/src/core/calibration_network.inc
    python tools/fit_calibration.py judge --page docs/results

``make`` writes one file for 10 scenes and goes on where it was stopped. ``fit`` keeps the last scenes of each file for
validation, and writes the network as C++, which is compiled into the core; each part of each set counts the same. The
scenes of ``own`` that the study of the wild judges (the first 40 and 16), the development and the sealed set are not
used. ``judge`` writes the page of the calibration, of the former two, after the core is compiled.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import nn
from torch.nn import functional

from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.visibility import TARGETS
from viewshed.grid import polar_of_cells
from viewshed.preprocess.evidence import beam_evidence, cell_features
from viewshed.preprocess.leveling import level
from viewshed_lab._page import facts, page, table
from viewshed_lab.data.wild import GIVEN, WildScene, wild_scenes, wild_tables
from viewshed_lab.studies.formatting import format_rates
from viewshed_lab.studies.wild.evaluate import reach_of, row_of
from viewshed_lab.studies.wild.figures import reliability_of
from viewshed_lab.studies.wild.pool import Pool
from viewshed_lab.training.no_return import MOST_DEVIATIONS, source_of

PARTS = {"road": "car", "indoor": "pedestrian"}
COUNTED, CALIBRATED = "counted", "calibrated"
WORDS = """What the default says of a cell, and how often it is so. *Counted*: the probability by counting beams alone.
*Calibrated*: that of the estimate, by a network of eight units that was fitted to other worlds
([evidence](../estimators.md#evidence)). *Development*: styles, sensors and mountings that share nothing with those it
was fitted to; *own*: those of the presets, other scenes. Given: the maker's table, height and attitude; rings; nothing
but points. The calibration error is over all cells whose truth is known, as far as the sensor sees a dark target; the
doubt is judged where beams aim. Both say the same of what is visible, so that they have one F1."""

SCENES_OF_FILE, CELLS_OF_SWEEP, BATCH, RATE, UNITS = 10, 400, 4096, 8e-3, 8
HELD_SHARE = 0.12
OTHER_SHARE = 0.3
"""Of the sweeps that are also shown with the target of the other grid."""


def make_file(folder: Path, scenes: list[WildScene]) -> None:
    """Write features (K, F) of cells drawn at random, and whether they are visible (K,), into one file of a folder."""
    path = folder / f"{scenes[0].name.rsplit('-', 1)[0]}-{len(scenes)}.npz"
    if path.exists():
        return
    features, visible = [], []
    for scene in scenes:
        for number in range(scene.domain.sweeps):
            seen, rng = scene.observe(number), scene.rng(101, number)
            grid = seen.truth.grid
            known = np.flatnonzero(seen.known & (polar_of_cells(grid)[0] <= reach_of(seen)))
            leveled = level(seen.given(GIVEN[(scene.number + number) % len(GIVEN)]), grid)
            for name, target in TARGETS.items():
                is_own = (name == "car") == (scene.domain.name == "road")
                if (is_own or rng.random() < OTHER_SHARE) and len(known):
                    some = rng.choice(known, min(CELLS_OF_SWEEP, len(known)), replace=False)
                    maps = cell_features(leveled, beam_evidence(leveled, grid, target))
                    features.append(maps.reshape(len(maps), -1)[:, some].T)
                    visible.append(seen.truth.visible(target).ravel()[some])
    part = path.with_suffix(".part.npz")
    np.savez(part, feature=np.concatenate(features), visible=np.concatenate(visible))
    part.replace(path)
    print(path.name, sum(map(len, visible)), flush=True)


class CalibrationNet(nn.Module):
    """Two layers on standardized features (B, F), cut off as the core cuts them; returns logits (B,)."""

    mean: torch.Tensor
    scale: torch.Tensor

    def __init__(self, mean: torch.Tensor, scale: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("scale", scale)
        self.first, self.second = nn.Linear(len(mean), UNITS), nn.Linear(UNITS, 1)

    def forward(self, feature: torch.Tensor) -> torch.Tensor:
        """Return logits (B,) for features (B, F)."""
        inputs = ((feature - self.mean) * self.scale).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        logit: torch.Tensor = self.second(torch.relu(self.first(inputs)))[:, 0]
        return logit

    def source(self) -> str:
        """Return the numbers of the network as C++."""
        first, second = self.first, self.second
        arrays = {
            "mean": self.mean, "scale": self.scale, "first": first.weight.T, "first_bias": first.bias,
            "second": second.weight.T, "second_bias": second.bias,
        }  # fmt: skip
        return source_of({name: np.ascontiguousarray(one.detach().numpy()) for name, one in arrays.items()})


def fit(given: argparse.Namespace) -> None:
    """Fit the network to all cells of a folder, write it, and print how well it is calibrated on scenes held back."""
    paths = [path for path in sorted(given.folder.glob("*-[0-9]*.npz")) if ".part" not in path.name]
    files = [np.load(path) for path in paths]
    feature = torch.tensor(np.concatenate([file["feature"] for file in files]))
    visible = torch.tensor(np.concatenate([file["visible"] for file in files]).astype(np.float32))
    sizes = [len(file["visible"]) for file in files]
    held = torch.tensor(np.concatenate([np.arange(size) >= (1 - HELD_SHARE) * size for size in sizes]))
    # Each part of each set counts the same.
    parts = ["-".join(path.name.split("-")[:2]) for path in paths]
    cells = {part: sum(size for size, of in zip(sizes, parts, strict=True) if of == part) for part in parts}
    shares = [sum(sizes) / len(cells) / cells[part] for part in parts]
    weight = torch.tensor(np.repeat(np.array(shares, np.float32), sizes))
    own = torch.nonzero(~held)[:, 0]
    torch.manual_seed(0)
    torch.set_num_threads(1)
    net = CalibrationNet(feature[own].mean(0), 1.0 / feature[own].std(0).clamp_min(1e-3))
    optimizer = torch.optim.AdamW(net.parameters(), RATE, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, given.steps)
    for _ in range(given.steps):
        rows = own[torch.randint(len(own), (BATCH,))]
        losses = functional.binary_cross_entropy_with_logits(net(feature[rows]), visible[rows], reduction="none")
        loss = (losses * weight[rows]).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    given.out.write_text(net.source(), encoding="ascii")
    with torch.no_grad():
        said, there = torch.sigmoid(net(feature[held])).numpy(), visible[held].numpy()
    bins = np.minimum((said * 10).astype(int), 9)
    text = " ".join(f"{said[bins == b].mean():.2f}/{there[bins == b].mean():.2f}" for b in np.unique(bins))
    print(f"{len(own)} cells fitted, {len(said)} held back; said/visible {text}")


def judge(given: argparse.Namespace) -> None:
    """Write the page: how well the probability is calibrated, beside that of counting alone."""
    rows = []
    for set_name, (domain, target) in product(("development", "own"), PARTS.items()):
        for scene in wild_scenes(set_name, domain):
            seen = scene.observe(0)
            for knowledge in GIVEN:
                sample = seen.sample(knowledge)
                leveled = level(sample.sweep, seen.truth.grid)
                calibrated = ShadowMap(seen.truth.grid, TARGETS[target]).estimate(leveled)
                counts = beam_evidence(leveled, seen.truth.grid, TARGETS[target]).visible_prob
                for method, estimate in ((CALIBRATED, calibrated), (COUNTED, replace(calibrated, visible_prob=counts))):
                    rows.append(row_of(seen, sample, estimate, leveled, method))
    every = Pool(pd.DataFrame(rows))
    lines = []
    for set_name, domain, knowledge in product(("development", "own"), PARTS, GIVEN):
        both = [
            every.of(set_name=set_name, domain=domain, told=knowledge, method=name) for name in (COUNTED, CALIBRATED)
        ]
        f1 = format_rates(both[1].counts.f1)
        eces = " → ".join(format_rates(pool.ece()) for pool in both)
        aurocs = " → ".join(format_rates(pool.mean("auroc")) for pool in both)
        lines.append((f"{domain}, {set_name}, {knowledge}", str(len(both[0].names("scene"))), f1, eces, aurocs))
    header = ("place", "scenes", "F1", "calibration error", "AUROC of the doubt")
    picture = "calibration_reliability.png"
    text = page(
        "Calibration of the default",
        facts(seeds="those of data/wild_sets.toml"),
        WORDS,
        "## Counted and calibrated\n\n" + table(header, lines),
        f"![Share of cells that are visible over the stated probability, development roads, rings given]({picture})",
    )
    roads = every.of(set_name="development", domain="road", told="rings")
    (given.page / picture).write_bytes(reliability_of(roads))
    (given.page / "calibration.md").write_text(text, encoding="utf-8")


def make(given: argparse.Namespace) -> None:
    """Write the cells of a set."""
    first, last = map(int, given.scenes.split(":"))
    domain = next(one for one in wild_tables().of_set(given.set) if one.name == given.domain)
    if given.set == "own" and first < domain.scenes:
        raise SystemExit(f"--scenes must begin at {domain.scenes} or later for own: those before are judged")
    scenes = [WildScene(domain, number) for number in range(first, last)]
    given.out.mkdir(parents=True, exist_ok=True)
    for at in range(0, len(scenes), SCENES_OF_FILE):
        make_file(given.out, scenes[at : at + SCENES_OF_FILE])


def main(words: Sequence[str] | None = None) -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(
        prog="fit_calibration.py", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    steps = parser.add_subparsers(required=True)
    step = steps.add_parser("make")
    step.set_defaults(work=make)
    step.add_argument("set", choices=("learning", "training", "own"))
    step.add_argument("domain", nargs="?", default="road")
    step.add_argument("--scenes", default="0:60", help="from : to")
    step.add_argument("--out", type=Path, required=True)
    step = steps.add_parser("fit")
    step.set_defaults(work=fit)
    step.add_argument("folder", type=Path)
    step.add_argument("--steps", type=int, default=6000)
    step.add_argument("--out", type=Path, required=True)
    step = steps.add_parser("judge")
    step.set_defaults(work=judge)
    step.add_argument("--page", type=Path, required=True)
    given = parser.parse_args(words)
    given.work(given)


if __name__ == "__main__":
    main()
