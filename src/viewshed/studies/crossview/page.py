"""The page of cross-view truth: over- and under-claim by sensor, attacked as well, and the floor of the metric."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from viewshed._page import facts, page, table
from viewshed.fov.estimate import FovEstimator
from viewshed.io import read_index, read_indexed
from viewshed.sensors import lidar_model
from viewshed.studies.crossview.rates import (
    FIRST_RULES,
    CrossViewRow,
    CrossViewRules,
    OnStep,
    crossview_truth,
    evaluate_crossview,
    evaluate_floor,
    rows_of,
)
from viewshed.sweep import Sweep
from viewshed.threats.attacks import ATTACKS, Knowledge

_INTRODUCTION = """\
Two posed sweeps A and B of a static scene: what B sees tells what A must have seen or missed. *over* is the share of
columns that A does not see and the estimate claims visible; *under* the share that A sees and the estimate does not
claim. In brackets the 95 % interval (the wider of a bootstrap over sweeps and the exact binomial one), and how many
columns the rate rests on. Differences under about .05 mean nothing."""

_WHOLE = """\
A column counts as not seen only if it hides a whole target: as wide (0.9 m to both sides across A's line of sight)
and standing on the ground. The last table shows why. These two rules were added after the first figures on real data
were known; the evidence for them is the simulation, and few columns are left, so the intervals are wide."""

_FIRST = """\
The metric as first defined takes any column for a target. It is kept for comparison: a car-wide target that looks
out beside a post, or beams that pass below a bus, count as over-claim although they are none."""

POINTS = 150

_ATTACKED = f"""\
What estimators are shown of A is attacked, with {POINTS} points each time; what B sees is not. *over* / *under*, and
how much the worse of the two grows at most under any of the attacks. A sweep that does not allow an attack stays as
it is."""

_FLOOR = """\
In a simulated junction (ten views, HDL-64E, range noise 1.5 cm) the mask is known exactly. What the metric charges
the exact mask with is the metric's own error."""


def page_of(
    index: Path,
    estimators: Mapping[str, FovEstimator],
    attacks: Sequence[str],
    seed: int,
    on_step: OnStep,
    *,
    floor: bool = True,
) -> str:
    """Return the page as Markdown.

    Args:
        index: JSON of posed sweeps; each folder of it is one scene.
        estimators: by name.
        attacks: of ``ATTACKS``, under which sweeps are shown as well.
        seed: of the bootstrap.
        on_step: is called with what is done next.
        floor: whether the metric's own error is measured in a simulation as well.

    Raises:
        ValueError: an attack is not known, or the index has no scene.
        OSError: a file cannot be read.
    """
    for name in attacks:
        if name not in ATTACKS:
            raise ValueError(f"attacks must be among {', '.join(ATTACKS)}, got {name!r}")
    scenes = _scenes(index)
    parts = [_INTRODUCTION]
    kinds = ("Whole targets", _WHOLE, CrossViewRules()), ("As first defined", _FIRST, FIRST_RULES)
    for heading, text, rules in kinds:
        parts += [f"## {heading}", text]
        for sensor, sweeps in scenes.items():
            rng = np.random.default_rng(seed)
            rows = evaluate_crossview(sweeps, estimators, rng=rng, rules=rules, on_step=on_step)
            count = sum(len(scene) for scene in sweeps)
            parts.append(f"### {sensor}, {len(sweeps)} scene(s), {count} sweeps\n\n{_table(rows)}")
    if attacks:
        parts += ["## Attacked", _ATTACKED]
        parts += [_under_attack(name, sweeps, estimators, attacks, seed, on_step) for name, sweeps in scenes.items()]
    if floor:
        parts += ["## The floor of the metric", _FLOOR, *_floor(estimators, seed, on_step)]
    return page("Cross-view truth", facts(seed=str(seed), grid="road (256 cells of 0.5 m)", target="car"), *parts)


def _scenes(index: Path) -> dict[str, list[list[Sweep]]]:
    """Return the sweeps by sensor and scene: folders of the index with three posed sweeps or more over 0.7 s."""
    folders = defaultdict(list)
    for entry in read_index(index):
        if entry.world_from_sensor is not None and entry.t is not None:
            folders[entry.file.parent].append(entry)
    scenes: dict[str, list[list[Sweep]]] = defaultdict(list)
    for entries in folders.values():
        times = [entry.t or 0.0 for entry in entries]
        if len(entries) >= 3 and max(times) - min(times) >= 0.7:
            scenes[entries[0].sensor].append([_with_beams(read_indexed(entry), entry.sensor) for entry in entries])
    if not scenes:
        raise ValueError(f"{index} must have a folder of at least three posed sweeps over 0.7 s, got none")
    return dict(scenes)


def _with_beams(sweep: Sweep, name: str) -> Sweep:
    """Return the sweep with the beam table that the index names, where its file does not bring one."""
    with contextlib.suppress(ValueError):
        return sweep if sweep.model is not None else sweep.replace(model=lidar_model(name.removeprefix("Velodyne ")))
    return sweep


def _under_attack(
    sensor: str,
    scenes: Sequence[Sequence[Sweep]],
    estimators: Mapping[str, FovEstimator],
    attacks: Sequence[str],
    seed: int,
    on_step: OnStep,
) -> str:
    """Return the table of over- and under-claim without and with each attack, estimator by estimator."""
    truth = crossview_truth(scenes, on_step=on_step)
    found: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for name in ("", *attacks):
        rng = np.random.default_rng(seed)
        for row in rows_of(truth, estimators, rng=rng, on_step=on_step, shown=partial(_attacked, name, rng)):
            found[row.method].append((row.over.value, row.under.value))
    rows = []
    for method, rates in found.items():
        growth = np.nanmax(np.array(rates) - np.array(rates[0]))
        cells = [" / ".join("–" if np.isnan(rate) else f"{rate:.3f}" for rate in pair) for pair in rates]
        rows.append([method, *cells, f"{growth:+.3f}"])
    return f"### Attacked, {sensor}\n\n{table(['estimator', 'untouched', *attacks, 'grows by'], rows)}"


def _attacked(name: str, rng: np.random.Generator, sweep: Sweep) -> Sweep:
    """Return a sweep under an attack; one that does not allow it stays as it is."""
    if name:
        with contextlib.suppress(ValueError):
            return ATTACKS[name](POINTS, Knowledge(half_extent_m=64.0)).apply(sweep, rng).sweep
    return sweep


def _floor(estimators: Mapping[str, FovEstimator], seed: int, on_step: OnStep) -> Iterator[str]:
    few = {name: estimators[name] for name in estimators if name in ("shadow_map", "majority_vote", "first_blocker")}
    steps = {"As first defined": FIRST_RULES, "and as wide as the target": CrossViewRules(foot_m=None),
             "and standing on the ground": CrossViewRules()}  # fmt: skip
    for name, rules in steps.items():
        on_step(f"floor: {name}")
        yield f"**{name}**\n\n{_table(evaluate_floor(few, rng=np.random.default_rng(seed), rules=rules))}"


def _table(rows: Sequence[CrossViewRow]) -> str:
    header = ["estimator", "over", "under", "over, nothing dropped", "dropped"]
    return table(header, [_cells(row) for row in rows])


def _cells(row: CrossViewRow) -> list[str]:
    rates = [
        f"{rate.value:.3f} [{rate.low:.3f}, {rate.high:.3f}] of {rate.columns}" if rate.columns else "no columns"
        for rate in (row.over, row.under, row.over_unfiltered)
    ]
    return [row.method, *rates, f"{row.dropped_share:.2f}"]
