"""Fit the network that calibrates the probability of visible from the beam evidence of a cell and of its sweep.

    python tools/fit_calibration.py make learning road --scenes 0:900 --out cells
    python tools/fit_calibration.py make training road --scenes 0:200 --out cells
    python tools/fit_calibration.py make training indoor --scenes 0:240 --out cells
    python tools/fit_calibration.py make own road --scenes 40:640 --out cells
    python tools/fit_calibration.py make own indoor --scenes 16:416 --out cells
    python tools/fit_calibration.py fit cells --out packages/viewshed/src/core/calibration_network.inc
    python tools/fit_calibration.py judge --page docs/results

``make`` writes one file for every 10 scenes and resumes where it was stopped. ``fit`` holds back the last scenes of
each file for validation, weights each domain of each set equally, and writes the network as C++, which is compiled into
the core. The scenes of ``own`` that the study of the wild judges (the first 40 and 16), the development set and the
sealed set are not used. ``judge``, run after the core is compiled, writes the page of the calibration and of what is
guessed, on the development set and on the judged scenes of ``own``.
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
from fit_no_return import descend, held_back, make_files, parser_of, parts_in, scenes_of, write_part
from torch import nn
from torch.nn import functional

from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import THRESHOLD, FovEstimate
from viewshed.fov.visibility import TARGETS, probability_of_visible
from viewshed.grid import polar_of_cells
from viewshed.preprocess.evidence import BeamEvidence, beam_evidence, cell_features
from viewshed.preprocess.leveling import level
from viewshed_lab._page import facts, page, table
from viewshed_lab.data.wild import GIVEN, WildObservation, WildScene, wild_scenes
from viewshed_lab.studies.formatting import format_number, format_rate, format_rates
from viewshed_lab.studies.judges import ground_errors
from viewshed_lab.studies.wild.evaluate import ground_error_m, reach_of, row_of
from viewshed_lab.studies.wild.figures import reliability_of
from viewshed_lab.studies.wild.pool import Pool
from viewshed_lab.training.no_return import MAX_DEVIATIONS, source_of

PARTS = {"road": "car", "indoor": "pedestrian"}
CASES = tuple(product(("development", "own"), PARTS))
SURE_GROUND_M = 0.1
COUNTED, CALIBRATED = "counted", "calibrated"
WORDS = """How well the probability of `shadow_map`, the default, is calibrated: the stated probability that a cell is
visible against the share of visible cells, in simulated scenes. *Counted* is the probability from counting beams alone.
*Calibrated* is that of the estimate: a network of sixteen units that also sees averages over the whole sweep
([evidence](../estimators.md#evidence)) corrects the count. It is fitted to other worlds. The *development* set shares
no styles, sensors or mountings with these; the *own* set has the styles of the presets, in scenes that were not
fitted. The last word of a row is what the estimator is given: the maker's beam table, height and attitude (*table*),
*rings*, or *nothing* but points.

A cell shows counted → calibrated. Cells are those with known truth within the range at which the sensor detects a dark
target. A cell is claimed from a probability of one half on. The doubt, min(p, 1 - p), should predict wrong cells; its
AUROC is over the cells at which beams aim."""

PRIORS = """Results where the default guesses what was not measured, rings given. *Claims by inferred beams alone*:
claimed cells that measured beams would not support; *false* if they are not visible. *Unresolved*: missed cells that
would be claimed if the beams without a return had ended late. *Unseen ground*: the estimated height of ground without
returns, against the standard deviation that the estimate states."""

STYLES = "Results by style of world, pooled over all scenes of a style, rings given."

FAR_M = 64.0
"""Range beyond which only the corners of the road grid lie."""

CELLS_OF_SWEEP, BATCH, RATE, DECAY, UNITS = 400, 4096, 8e-3, 0.05, 16
MAX_SWEEP_DEVIATIONS = 2.0
"""Limit at which standardized features of the sweep are clipped, as in the core."""

OTHER_SHARE = 0.3
"""Share of the sweeps that are also sampled with the target of the other grid."""


def make_file(path: Path, scenes: list[WildScene]) -> None:
    """Write features (K, F) and visibility (K,) of randomly sampled cells of some scenes into one file."""
    features, visible, numbers = [], [], []
    for scene in scenes:
        for number in range(scene.domain.sweeps):
            seen, rng = scene.observe(number), scene.rng(101, number)
            grid = seen.truth.grid
            known = np.flatnonzero(seen.known & (polar_of_cells(grid)[0] <= reach_of(seen)))
            leveled = level(seen.given(GIVEN[(scene.number + number) % len(GIVEN)]), grid)
            for name, target in TARGETS.items():
                is_own = (name == "car") == (scene.domain.name == "road")
                if (is_own or rng.random() < OTHER_SHARE) and len(known):
                    sampled = rng.choice(known, min(CELLS_OF_SWEEP, len(known)), replace=False)
                    maps = cell_features(leveled, beam_evidence(leveled, grid, target))
                    features.append(maps.reshape(len(maps), -1)[:, sampled].T)
                    visible.append(seen.truth.visible(target).ravel()[sampled])
                    numbers.append(np.full(len(sampled), scene.number))
    columns = (np.concatenate(column) for column in (features, visible, numbers))
    write_part(path, **dict(zip(("feature", "visible", "scene"), columns, strict=True)))


class CalibrationNet(nn.Module):
    """Map features (B, F) to logits (B,): standardize, clip as the core does, two layers.

    The first half of the features belongs to a cell, the second half to its sweep.
    """

    mean: torch.Tensor
    scale: torch.Tensor
    limit: torch.Tensor

    def __init__(self, mean: torch.Tensor, scale: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("scale", scale)
        is_of_cell = torch.arange(len(mean)) < len(mean) // 2
        self.register_buffer("limit", torch.where(is_of_cell, MAX_DEVIATIONS, MAX_SWEEP_DEVIATIONS))
        self.first, self.second = nn.Linear(len(mean), UNITS), nn.Linear(UNITS, 1)

    def forward(self, feature: torch.Tensor) -> torch.Tensor:
        """Return logits (B,) for features (B, F)."""
        inputs = ((feature - self.mean) * self.scale).clamp(-self.limit, self.limit)
        logit: torch.Tensor = self.second(torch.relu(self.first(inputs)))[:, 0]
        return logit

    def source(self) -> str:
        """Return the network's weights as C++ source."""
        first, second = self.first, self.second
        arrays = {
            "mean": self.mean, "scale": self.scale, "first": first.weight.T, "first_bias": first.bias,
            "second": second.weight.T, "second_bias": second.bias,
        }  # fmt: skip
        return source_of({name: np.ascontiguousarray(array.detach().numpy()) for name, array in arrays.items()})


def fit(given: argparse.Namespace) -> None:
    """Fit the network to the cells of a folder, write it, and print its calibration on the scenes held back."""
    paths = parts_in(given.folder)
    files = [np.load(path) for path in paths]
    feature = torch.tensor(np.concatenate([file["feature"] for file in files]))
    visible = torch.tensor(np.concatenate([file["visible"] for file in files]).astype(np.float32))
    sizes = [len(file["visible"]) for file in files]
    held = torch.tensor(np.concatenate([held_back(file["scene"]) for file in files]))
    # Weight each domain of each set equally.
    parts = ["-".join(path.name.split("-")[:2]) for path in paths]
    cells = {part: sum(size for size, of in zip(sizes, parts, strict=True) if of == part) for part in parts}
    shares = [sum(sizes) / len(cells) / cells[part] for part in parts]
    weight = torch.tensor(np.repeat(np.array(shares, np.float32), sizes))
    own = torch.nonzero(~held)[:, 0]
    torch.manual_seed(0)
    torch.set_num_threads(1)
    net = CalibrationNet(feature[own].mean(0), 1.0 / feature[own].std(0).clamp_min(1e-3))

    def loss() -> torch.Tensor:
        rows = own[torch.randint(len(own), (BATCH,))]
        losses = functional.binary_cross_entropy_with_logits(net(feature[rows]), visible[rows], reduction="none")
        return (losses * weight[rows]).mean()

    for _ in descend(net, RATE, DECAY, given.steps, loss):
        pass
    given.out.write_text(net.source(), encoding="ascii")
    with torch.no_grad():
        predicted, actual = torch.sigmoid(net(feature[held])).numpy(), visible[held].numpy()
    bins = np.minimum((predicted * 10).astype(int), 9)
    text = " ".join(f"{predicted[bins == b].mean():.2f}/{actual[bins == b].mean():.2f}" for b in np.unique(bins))
    print(f"{len(own)} cells fitted, {len(predicted)} held back; said/visible {text}")


def prior_figures(seen: WildObservation, evidence: BeamEvidence, estimate: FovEstimate) -> dict[str, int]:
    """Count cells claimed, claimed by inferred beams alone, missed, and beyond ``FAR_M``, with their subsets."""
    grid, target = estimate.grid, estimate.target
    range_m = polar_of_cells(grid)[0]
    known, true, claimed = seen.known & (range_m <= reach_of(seen)), seen.truth.visible(target), estimate.visible()
    alone, late = (
        probability_of_visible(returns, target.min_returns) >= THRESHOLD
        for returns in (evidence.measured, evidence.measured + evidence.late)
    )
    inferred, missed, far = known & claimed & ~alone, known & true & ~claimed, known & (range_m > FAR_M)
    masks = {
        "claimed": known & claimed, "inferred": inferred, "inferred_false": inferred & ~true, "missed": missed,
        "unresolved": missed & late, "far_true": far & true, "far_claimed": far & claimed,
        "far_both": far & true & claimed,
    }  # fmt: skip
    return {name: int(mask.sum()) for name, mask in masks.items()}


def table_of_priors(every: Pool, unseen: dict[str, pd.DataFrame]) -> str:
    """Return the table of figures on what is guessed, with their targets, by domain and set."""
    pools = [every.of(set_name=name, domain=domain) for name, domain in CASES]
    sure = [ground[ground["std_m"] <= SURE_GROUND_M]["off_m"] for ground in unseen.values()]

    def shares(part: str, whole: str) -> list[str]:
        return [format_rate(pool.share(part, whole)) for pool in pools]

    lines = [
        ("claims by inferred beams alone", "", *shares("inferred", "claimed")),
        ("of these false", "≤ .04", *shares("inferred_false", "inferred")),
        ("missed cells, unresolved", "≤ .15", *shares("unresolved", "missed")),
        (f"precision beyond {FAR_M:g} m", "", *shares("far_both", "far_claimed")),
        (f"recall beyond {FAR_M:g} m", "≥ .65", *shares("far_both", "far_true")),
        ("unseen ground within one deviation", ".63 to .73",
         *(format_rate(float((ground["off_m"] <= ground["std_m"]).mean())) for ground in unseen.values())),
        (f"90 % of its errors where it states ≤ {SURE_GROUND_M:g} m, m", "≤ 0.20",
         *(format_number(float(off_m.quantile(0.9)), 2) for off_m in sure)),
    ]  # fmt: skip
    return table(("what", "target", *unseen), lines)


def table_of_styles(every: Pool) -> str:
    """Return the table of precision, recall and F1 by style of world."""
    lines = []
    for set_name, domain in CASES:
        part = every.of(set_name=set_name, domain=domain)
        for style in sorted(part.names("style")):
            pool = part.of(style=style)
            counts = pool.counts
            rates = map(format_rate, (counts.precision, counts.recall, counts.f1))
            lines.append((f"{domain}, {set_name}", style, str(len(pool.names("scene"))), *rates))
    return table(("place", "style", "scenes", "precision", "recall", "F1"), lines)


def judge(given: argparse.Namespace) -> None:
    """Write the page: calibration of the probability, compared with counting alone, and what is guessed."""
    rows, ground = [], {f"{domain}, {name}": list[pd.DataFrame]() for name, domain in CASES}
    for set_name, domain in CASES:
        target = PARTS[domain]
        for scene in wild_scenes(set_name, domain):
            seen = scene.observe(0)
            for knowledge in GIVEN:
                sample = seen.sample(knowledge)
                leveled = level(sample.sweep, seen.truth.grid)
                calibrated = ShadowMap(seen.truth.grid, TARGETS[target]).estimate(leveled)
                evidence = beam_evidence(leveled, seen.truth.grid, TARGETS[target])
                counted = replace(calibrated, visible_prob=evidence.counted_prob)
                priors = prior_figures(seen, evidence, calibrated)
                for method, estimate in ((CALIBRATED, calibrated), (COUNTED, counted)):
                    rows.append({**row_of(seen, sample, estimate, leveled, method), **priors})
                if knowledge == "rings":
                    known, error_m = seen.known, ground_error_m(leveled, sample)
                    errors = ground_errors(leveled, seen.truth.grid.centers[known], error_m[known])
                    ground[f"{domain}, {set_name}"].append(errors[~errors["seen"]])
    every = Pool(pd.DataFrame(rows))
    lines = []
    for (set_name, domain), knowledge in product(CASES, GIVEN):
        both = [
            every.of(set_name=set_name, domain=domain, told=knowledge, method=name) for name in (COUNTED, CALIBRATED)
        ]
        f1s = " → ".join(format_rates(pool.counts.f1) for pool in both)
        eces = " → ".join(format_rates(pool.ece()) for pool in both)
        aurocs = " → ".join(format_rates(pool.mean("auroc")) for pool in both)
        lines.append((f"{domain}, {set_name}, {knowledge}", str(len(both[0].names("scene"))), f1s, eces, aurocs))
    header = ("place", "scenes", "F1", "calibration error", "AUROC of the doubt")
    rings = every.of(told="rings", method=CALIBRATED)
    unseen = {part: pd.concat(errors) for part, errors in ground.items()}
    picture = "calibration_reliability.png"
    text = page(
        "Calibration of the default",
        facts(seeds="those of data/wild_sets.toml"),
        WORDS,
        "## Counted and calibrated\n\n" + table(header, lines),
        f"![Share of cells that are visible over the stated probability, development roads, rings given]({picture})",
        f"## What is guessed\n\n{PRIORS}\n\n{table_of_priors(rings, unseen)}",
        f"## By style\n\n{STYLES}\n\n{table_of_styles(rings)}",
    )
    roads = every.of(set_name="development", domain="road", told="rings")
    (given.page / picture).write_bytes(reliability_of(roads))
    (given.page / "calibration.md").write_text(text, encoding="utf-8")


def make(given: argparse.Namespace) -> None:
    """Write sampled cells of the scenes of a set."""
    make_files(given.out, scenes_of(given), make_file)


def main(words: Sequence[str] | None = None) -> None:
    """Run the step that the command line names."""
    parser, steps = parser_of("fit_calibration.py", __doc__, ("learning", "training", "own"), make, fit)
    step = steps.add_parser("judge")
    step.set_defaults(work=judge)
    step.add_argument("--page", type=Path, required=True)
    given = parser.parse_args(words)
    given.work(given)


if __name__ == "__main__":
    main()
