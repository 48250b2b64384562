"""Write the model card of the shipped weights, from their files: ``python tools/model_card.py [OUT.md]``."""

from __future__ import annotations

import argparse
import ast
import hashlib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from viewshed.networks.card import INT8, NetworkCard
from viewshed.networks.runtime import load_runner
from viewshed.networks.weights import WEIGHTS, manifest
from viewshed_lab._page import facts, page, table
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.studies.cases import TOUCHING
from viewshed_lab.training.config import PAPER, read_config
from viewshed_lab.training.no_return import arrays_of

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "results" / "model_card.md"
_ABOUT = """\
The networks that the package ships, read from their files. All are trained on simulated sweeps only, so their license
is that of viewshed. The output for a cell is the probability that a target of the named kind there would give enough
returns ([what visible means](../conventions.md#visible)).

## Files"""
_COMPILED = """\
## Networks of the default

`shadow_map` uses three networks, compiled into the core. They do not depend on a grid, and no attack was in their
training. They are fitted to scenes `from:to` of the [worlds in the wild](../simulate.md); the last 12 %
of each file are held out. The development set and the sealed set were not used."""
_COMMANDS = "These commands fit them again, in this order (`make priors`):"
_TRAINING = """\
## Training

*Shown*: number of training frames, sampled from the data; *attacked*: share of them under an attack. Validation F1 is
that of the best epoch, on frames of which the same share is attacked; do not compare estimators by it."""
_ATTACKS = """\
Training and the [attacks](../attacks.md) that change returns (`paper` is `uniform` and `cluster` as published):"""
_DATA = """\
## Data

Sweeps of the presets' `train` split; the other splits were never trained on. Weather and faults are sampled by weight;
positions, motion and traffic follow from the seed ([simulator](../simulate.md))."""
_WORTH = """\
## What they are worth

- [Networks of version 0.3.0](archive.md) beside the classical estimators, on scenes of other seeds: the networks and
  their parts, 8-bit weights, and the published shape on roads and indoors.
- [Cross-view truth](crossview.md): real sweeps of ten sensors.
- [Speed](network_speed.md).

## What they are not for

- **Other grids and targets**: they are refused with an error of one line.
- **Sensors on their side or upside down**, and mounts higher or lower than those of the data.
- **Proof.** A network states what is likely in worlds like those of its training. In the wedge of an attack that opens
  a view, one sweep does not distinguish a true far return from a false one; see the missed targets on the pages above.
- **Weather in the air.** Truth is geometric: a target in a visible cell in dense fog may still return nothing.
- **Decisions without a second check.** Compare with the classical estimators and the [monitor](../monitor.md)."""


def main(words: Sequence[str] | None = None) -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(prog="model_card.py", description=__doc__)
    parser.add_argument("out", type=Path, nargs="?", default=OUT)
    out = parser.parse_args(words).out
    out.write_text(card_page(), encoding="utf-8")
    print(f"written to {out}")


def card_page() -> str:
    """Return the page."""
    cards = {name: load_runner(name, 1).card for name in manifest()}
    own = {name: card for name, card in cards.items() if card.precision != INT8}
    data = dict.fromkeys(name for card in own.values() for name in card.trained["data"].split(", "))
    return page(
        "Model card of the shipped weights", facts(), _ABOUT,
        table(["name", "KB", "SHA-256", "grid", "target", "taken by", "parameters", "GFLOP", "numbers"],
              _files(cards)),
        _COMPILED,
        table(["name", "KB", "SHA-256", "layers", "says", "fitted to scenes"], map(_compiled, PRIORS)),
        _COMMANDS,
        "```sh\n" + "\n".join(command for prior in PRIORS for command in commands_of(prior.tool)) + "\n```",
        _TRAINING,
        table(["name", "data", "shown", "attacked", "seed", "best epoch", "validation F1", "trained with", "date"],
              map(_training, own.values())),
        _ATTACKS,
        table(["name", "attacks in training", "never shown"], _attacks(own.values())),
        _DATA,
        table(["data", "sweeps", "scenes", "seed", "worlds", "sensors", "weather and faults"],
              map(_preset_data, map(preset_named, data))),
        _WORTH,
    )  # fmt: skip


def _files(cards: dict[str, NetworkCard]) -> Iterator[list[str]]:
    for name, line in manifest().items():
        card, size = cards[name], (WEIGHTS / line.file).stat().st_size
        grid = f"{line.cells} × {line.cells}, ±{line.half_extent_m:g} m"
        yield [
            f"`{name}`", f"{size / 1000:.0f}", f"`{line.sha256[:12]}…`", grid, line.target,
            ", ".join(f"`{method}`" for method in line.methods) or "name alone",
            f"{card.shape.parameters:,}", f"{card.shape.flops(line.cells) / 1e9:.2f}", card.precision,
        ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Prior:
    """A network that is compiled into the core."""

    file: str  # its weights, in the folder of the core
    tool: str  # the tool that fits it
    says: str  # its output with unit


PRIORS = (
    Prior("ground_network.inc", "fit_ground.py", "height of the ground in polar bins: three quantiles"),
    Prior("no_return_network.inc", "fit_no_return.py",
          "where beams without a return ended: weights of seven places, of an unseen one (log2 m) and of none"),
    Prior("calibration_network.inc", "fit_calibration.py", "logit of the probability that a cell is visible"),
)  # fmt: skip


def commands_of(tool: str) -> list[str]:
    """Return the ``make`` and ``fit`` commands in the docstring of a tool."""
    text = ast.get_docstring(ast.parse((ROOT / "tools" / tool).read_text(encoding="utf-8"))) or ""
    return re.findall(rf"^ +(python tools/{tool} (?:make|fit) .*)$", text, re.MULTILINE)


def _compiled(prior: Prior) -> list[str]:
    path = ROOT / "packages" / "viewshed" / "src" / "core" / prior.file
    source = path.read_bytes()
    text = source.decode("ascii")
    if sizes := re.findall(r"\{(\d+), (\d+), (\d+), WEIGHT", text):
        outputs = [int(of) for _, _, of in sizes]
        weights = sum(int(size) ** 2 * int(inputs) * int(of) for size, inputs, of in sizes)
        layers = f"U-Net: {len(sizes)} convolutions, up to {max(outputs)} channels, {weights:,} weights in bytes"
    else:
        arrays = arrays_of(text)
        counts = [len(arrays["mean"]), *(len(array) for name, array in arrays.items() if name.endswith("_bias"))]
        layers = " → ".join(map(str, counts))
    made = re.findall(r"make (\w+) (\w+) --scenes (\S+)", "\n".join(commands_of(prior.tool)))
    return [
        f"`{prior.file}`", f"{len(source) / 1000:.0f}", f"`{hashlib.sha256(source).hexdigest()[:12]}…`",
        layers, prior.says, ", ".join(f"{name} {domain} {part}" for name, domain, part in made),
    ]  # fmt: skip


def _training(card: NetworkCard) -> list[str]:
    facts_of, config = card.trained, read_config(card.name)
    shown = int(facts_of["epochs"]) * config.frames_per_epoch
    return [
        f"`{card.name}`", facts_of["data"], f"{shown:,}" if config.frames_per_epoch else f"{facts_of['epochs']} epochs",
        f"{float(facts_of['attack_share']):.0%}", facts_of["seed"], facts_of["best_epoch"],
        facts_of["validation_f1"], facts_of["version"], facts_of["date"],
    ]  # fmt: skip


def _attacks(cards: Iterable[NetworkCard]) -> list[list[str]]:
    """Return one row per list of attacks, with the networks that were trained on it."""
    names: dict[tuple[str, str], list[str]] = {}
    for card in cards:
        shown = card.trained["attacks"].split(", ")
        known = {*shown, *(("uniform", "cluster") if PAPER in shown else ())}
        never = [name for name in TOUCHING if name not in known]
        names.setdefault((", ".join(shown), ", ".join(never) or "–"), []).append(f"`{card.name}`")
    return [[", ".join(of), *lists] for lists, of in names.items()]


def _preset_data(preset: Preset) -> list[str]:
    weather = (f"{name} {weight:g}" for name, weight in zip(preset.conditions, preset.condition_weights, strict=True))
    sensors = [*preset.sensors, *([f"{preset.roadside_sensor} (on masts)"] if preset.roadside else [])]
    place = preset.splits.index("train")
    return [
        f"`{preset.name}`", f"{preset.frames[place]:,}", f"{preset.scenes[place]:,}", str(preset.seed),
        ", ".join(preset.worlds), ", ".join(sensors), ", ".join(weather),
    ]  # fmt: skip


if __name__ == "__main__":
    main()
