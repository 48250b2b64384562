"""Put a study's networks into the laboratory and write their page: ``python tools/ship_study.py STUDY``.

The networks are those of the paper's protocol. Each is quantized as ``viewshed quantize`` does it and written with its
checksum into ``viewshed_lab/networks``; one that would lose more than .002 F1 stays in float32. The page says of each
what it is, how it was trained, and what it scored in the study.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from ship_weights import ship

from viewshed.networks.weights import ShippedWeights
from viewshed_lab._page import facts, table
from viewshed_lab._results import write_page
from viewshed_lab.networks import WEIGHTS
from viewshed_lab.studies.formatting import format_rate
from viewshed_lab.studies.pages import fill_template
from viewshed_lab.studies.paper.data import preset_of
from viewshed_lab.studies.paper.models import config_of, weights_of
from viewshed_lab.studies.paper.page import provenance
from viewshed_lab.studies.paper.plan import Model, PaperPlan
from viewshed_lab.studies.paper.published import OTHERS, SUB_TABLES, PaperResults
from viewshed_lab.studies.records import PAPER
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.training.calibrate_int8 import FRAMES, QuantizationCost, quantize

OUT = Path(__file__).resolve().parents[1] / "docs" / "results" / "models.md"


def main(words: Sequence[str] | None = None) -> None:
    """Quantize, copy and list the networks, and write the page."""
    parser = argparse.ArgumentParser(prog="ship_study.py", description=__doc__)
    parser.add_argument("study", type=Path, help="folder of a finished study paper")
    parser.add_argument("--preset", default="medium", help="its plan")
    parser.add_argument(
        "--frames", type=int, default=FRAMES, help="number of sweeps to calibrate on; as many others are for the check"
    )
    parser.add_argument("--folder", type=Path, default=WEIGHTS)
    parser.add_argument("--page", type=Path, default=OUT)
    arguments = parser.parse_args(words)
    store = ResultStore.open(arguments.study, PaperPlan.load(arguments.preset))
    ship_study(store, arguments.frames, arguments.folder, arguments.page)


def ship_study(store: ResultStore[PaperPlan], frames: int, folder: Path, page: Path) -> None:
    """Ship the networks of the paper's protocol, quantized if that costs little, and write their page."""
    results, files, models = PaperResults.read(store), list[list[str]](), store.plan.models([PAPER])
    missing = [model.name for model in models if model.key[1:] not in results.models]
    if missing:
        raise ValueError(f"{store.folder} must hold all networks of the paper's protocol, got no {', '.join(missing)}")
    for model in models:
        config = config_of(store.plan, store.folder, model)
        with tempfile.TemporaryDirectory() as place:
            file, costs = Path(place) / "network.onnx", list[QuantizationCost]()
            try:
                costs = quantize(config, weights_of(store.folder, model), file, frames)
            except ValueError as error:
                print(f"{config.name} stays in float32: {error}", file=sys.stderr)
                file = weights_of(store.folder, model)
            files.append(_file_row(ship(file, config.name, (), folder), file.stat().st_size, costs))
    values = {
        "plan": store.plan, "files": table(["name", "KB", "SHA-256", "grid", "F1 lost to int8, by passes"], files),
        "trainings": table(
            ["name", "trained on", "attacked", "dropout", "learning rate", "epochs", "best", "validation F1"],
            [_training_row(results, model) for model in models],
        ),
        "scores": table(
            ["name", "tested on", "precision", "recall", "accuracy", "F1", "F1 elsewhere"],
            [_score_row(results, model) for model in models],
        ),
    }  # fmt: skip
    filled = fill_template("paper/models.md", **values)
    write_page(page, filled.markdown(facts(**provenance(results, PAPER))))


def _file_row(line: ShippedWeights, size: int, costs: Sequence[QuantizationCost]) -> list[str]:
    lost = ", ".join(f"{cost.passes}: {cost.f1 - cost.f1_int8:.4f}" for cost in costs) or "in float32"
    grid = f"{line.cells} × {line.cells}, ±{line.half_extent_m:g} m"
    return [f"`{line.name}`", f"{size / 1000:.0f}", f"`{line.sha256[:12]}…`", grid, lost]


def _training_row(results: PaperResults, model: Model) -> list[str]:
    config, training = config_of(results.plan, results.store.folder, model), results.models[model.key[1:]]
    preset = preset_of(results.plan, model.domain, "train")
    best = training["history"][training["best"] - 1]
    return [
        f"`{config.name}`", f"{model.domain}: {preset.sweeps:,} sweeps of {preset.scenes[0]:,} scenes",
        f"{config.attack_share:.0%}", f"{config.shape.dropout:g}", f"{config.learning_rate:g}",
        str(len(training["history"])), str(training["best"]), format_rate(best["f1"]),
    ]  # fmt: skip


def _score_row(results: PaperResults, model: Model) -> list[str]:
    """Return precision, recall, accuracy and F1 in the own domain, and F1 in the others, for the training mixture."""
    kind = (model.variant, model.mixture, model.mixture)
    [of] = [one for one in (*SUB_TABLES, *OTHERS) if (one.variant, one.trained, one.tested) == kind]
    counts = {test: results.pairs.counts(of.key(PAPER, test, model.domain)) for test in results.domains}
    own = counts.pop(model.domain)
    elsewhere = ", ".join(f"{test} {format_rate(one.f1)}" for test, one in counts.items())
    rates = map(format_rate, (own.precision, own.recall, own.accuracy, own.f1))
    return [f"`{PAPER}-{model.name}`", f"{model.domain}, {model.mixture}", *rates, elsewhere or "–"]


if __name__ == "__main__":
    main()
