"""``viewshed evaluate``: figures against truth that no estimator made.

``viewshed evaluate truth``: estimators against the exact truth of a simulated data set.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli._options import TargetName, Weights, parse_target

if TYPE_CHECKING:
    import numpy as np

    from viewshed.datasets import Archive, Sample
    from viewshed.fov.estimate import FovEstimator
    from viewshed.fov.visibility import Target
    from viewshed.grid import BevGrid
    from viewshed.metrics import ConfusionCounts
    from viewshed.studies.against_truth import Contest, Scores
    from viewshed.studies.crossview.study import CrossViewRow
    from viewshed.sweep import Sweep


_ALL = "all"

_TRUTH_INTRODUCTION = """\
Cells pooled over the samples, where the truth is known. *Precision*: share of the claimed cells that are visible;
*recall*: share of the visible cells that are claimed. *Over* and *under*: area of a sample, on average, claimed and not
visible, visible and not claimed. *F1, clear*: without the cells next to the target's number of returns, where one beam
more or less decides."""

_FORMS = """\
*rings known*: the sweep as the sensor gives it. *unorganized*: without ring, firing azimuth and time. *no sensor*:
without the beam table as well. *bare points*: no mounting height, attitude or pose either."""

_DEFINITIONS = """\
What others call visible, from the same beams without noise, against ours (`probe`, exact)."""


def truth(
    archives: Annotated[
        list[str],
        typer.Argument(metavar="ARCHIVE…", help="Folders or URIs of simulated data sets.", show_default=False),
    ],
    methods: Annotated[
        str, typer.Option(help="Estimators, with commas; 'all' for every classical one, unet, mcd and viewnet by name.")
    ] = _ALL,
    weights: Weights = None,
    target: TargetName = "car",
    limit: Annotated[int, typer.Option(min=1, help="Samples at most, spread evenly over each data set.")] = 200,
    split: Annotated[str | None, typer.Option(help="Only this split: train, test, …")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the tables to this Markdown file and not to the screen.")
    ] = None,
) -> None:
    """Precision, recall and areas against exact truth, and how far other definitions of visible lie from ours.

    Example: viewshed evaluate truth nuscenes-small --split test --out truth.md
    """
    from viewshed._page import facts, page
    from viewshed.studies.against_truth import FORMS, Contest

    wanted = parse_target(target)
    contest = Contest(_makers(methods, wanted, weights), wanted, FORMS)
    opened = [_opened(place, split) for place in archives]
    parts = [_TRUTH_INTRODUCTION, _FORMS]
    for data in opened:
        parts += _sections(data, min(limit, len(data)), contest)
    text = page("Estimators against exact truth", facts(target=target, split=split or "all"), *parts)
    if out is None:
        typer.echo(text)
    else:
        out.write_text(text, encoding="utf-8")
        typer.echo(f"wrote {out}")


def _opened(place: str, split: str | None) -> Archive:
    from viewshed.datasets import Archive

    data = Archive.open(place)
    data = data if split is None else data.split(split)
    if not len(data):
        raise ValueError(f"{place} must hold samples, got none")
    return data


def _makers(methods: str, target: Target, weights: str | None) -> Mapping[str, Callable[[BevGrid], FovEstimator]]:
    from functools import partial

    from viewshed.estimators import CLASSICAL, LEARNED
    from viewshed.estimators.shadow_map import NO_RETURN_RULES, ShadowMap

    known: dict[str, Callable[[BevGrid], FovEstimator]] = {
        name: partial(make, target=target) for name, make in CLASSICAL.items()
    }
    for rule in NO_RETURN_RULES[1:]:
        known[f"shadow_map, no return {rule}"] = partial(ShadowMap, target=target, no_return=rule)
    names = [name for word in methods.split(",") for name in (known if word == _ALL else [word])]
    if weights is not None and not set(names) & set(LEARNED):
        raise ValueError(f"--weights goes with {', '.join(LEARNED)} among --methods, got {methods}")
    known |= {name: partial(make, target=target, weights=weights) for name, make in LEARNED.items()}
    for name in names:
        if name not in known:
            raise ValueError(f"methods must be among {', '.join(known)}, got {name!r}")
    return {name: known[name] for name in names}


def _sections(data: Archive, count: int, contest: Contest) -> Iterator[str]:
    from viewshed.studies.against_truth import compare_definitions, evaluate_truth

    recipe, names = data.manifest.recipe, list(contest.estimators)
    typer.echo(f"viewshed: {recipe.get('preset')}: {count} samples", err=True)
    scores = evaluate_truth(_spread(data, count), contest)
    others = compare_definitions(_spread(data, count), contest)
    yield f"## {recipe.get('preset')}"
    yield f"Seed {recipe.get('seed')}; {count} of {len(data)} samples, spread evenly over {len(data.scenes)} scenes."
    for form in contest.forms:
        yield f"### {form[0].upper()}{form[1:]}"
        yield _summary(scores, names, form)
    form = next(iter(contest.forms))
    yield f"### F1 by range, {form}"
    yield _by_range(scores, names, form)
    yield f"### F1 by sensor, {form}"
    yield _by_sensor(scores, names, form)
    yield "### Other definitions"
    yield _DEFINITIONS
    yield _summary(others, list(dict.fromkeys(key[0] for key in others)), "")
    yield _by_range(others, list(dict.fromkeys(key[0] for key in others)), "")


def _spread(data: Archive, count: int) -> Iterable[Sample]:
    """Yield ``count`` samples evenly over the data set."""
    return (data[k * len(data) // count] for k in range(count))


def _summary(scores: Scores, names: list[str], form: str) -> str:
    from viewshed._page import table
    from viewshed.studies.against_truth import ALL, CLEAR

    header = ["", "precision", "recall", "F1", "IoU", "over m²", "under m²", "F1, clear"]
    return table(
        header, [[name, *_truth_cells(scores[name, form, ALL]), _three(scores[name, form, CLEAR].f1)] for name in names]
    )


def _truth_cells(tally: ConfusionCounts) -> list[str]:
    rates = [_three(rate) for rate in (tally.precision, tally.recall, tally.f1, tally.iou)]
    return [*rates, f"{tally.over_m2:.0f}", f"{tally.under_m2:.0f}"]


def _three(rate: float) -> str:
    return "–" if isnan(rate) else f"{rate:.3f}"


def _by_range(scores: Scores, names: list[str], form: str) -> str:
    from viewshed.studies.against_truth import ALL, CLEAR, SENSOR

    parts = dict.fromkeys(key[2] for key in scores)
    bands = [part for part in parts if part not in {ALL, CLEAR} and not part.startswith(SENSOR)]
    return _f1_of_parts(scores, names, form, {band: band for band in bands})


def _by_sensor(scores: Scores, names: list[str], form: str) -> str:
    from viewshed.studies.against_truth import ALL, SENSOR

    parts = sorted({key[2] for key in scores if key[2].startswith(SENSOR)})
    counts = {part: scores[names[0], form, part].samples for part in parts if (names[0], form, part) in scores}
    heads = {part: f"{part.removeprefix(SENSOR)} ({count})" for part, count in counts.items()}
    return _f1_of_parts(scores, names, form, heads or {ALL: "all"})


def _f1_of_parts(scores: Scores, names: list[str], form: str, heads: Mapping[str, str]) -> str:
    """Return a table of F1 by part; ``heads`` are the columns' words by part."""
    from viewshed._page import table

    rows = [[name, *(_three(scores[name, form, part].f1) for part in heads)] for name in names]
    return table(["", *heads.values()], rows)


evaluate_app = typer.Typer(help="Figures against truth that no estimator made.")

evaluate_app.command()(truth)

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

_POINTS = 150

_ATTACKED = f"""\
What estimators are shown of A is attacked, with {_POINTS} points each time; what B sees is not. *over* / *under*, and
how much the worse of the two grows at most under any of the attacks. A sweep that does not allow an attack stays as
it is."""

_FLOOR = """\
In a simulated junction (ten views, HDL-64E, range noise 1.5 cm) the mask is known exactly. What the metric charges
the exact mask with is the metric's own error."""


@evaluate_app.callback()
def evaluate() -> None:
    """Figures against truth that no estimator made."""


@evaluate_app.command()
def crossview(
    index: Annotated[
        Path, typer.Argument(metavar="INDEX", help="Index (JSON) of posed sweeps; each folder of it is one scene.")
    ],
    methods: Annotated[
        str, typer.Option(help="Estimators, with commas; 'all' for every classical one, unet, mcd and viewnet by name.")
    ] = _ALL,
    seed: Annotated[int, typer.Option(help="Seed of the bootstrap.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Write the tables to this Markdown file and not to the screen.")
    ] = None,
    attacks: Annotated[
        str, typer.Option(help=f"Attacks with {_POINTS} points that the sweeps are shown under as well, with commas.")
    ] = "",
    floor: Annotated[bool, typer.Option(help="Measure the metric's own error in a simulation as well.")] = True,
) -> None:
    """Over- and under-claim against what other sweeps of the same scene saw.

    Example: viewshed evaluate crossview data/index.json --out crossview.md
    """
    from viewshed._page import facts, page
    from viewshed.studies.crossview.study import FIRST_RULES, CrossViewRules

    estimators, names = _estimators(methods), _attacks(attacks)
    scenes = _scenes(index)
    parts = [_INTRODUCTION]
    for heading, text, rules in (
        ("Whole targets", _WHOLE, CrossViewRules()),
        ("As first defined", _FIRST, FIRST_RULES),
    ):
        tables = [_real(sensor, sweeps, estimators, rules, seed) for sensor, sweeps in scenes.items()]
        parts += [f"## {heading}", text, *tables]
    if names:
        tables = [_under_attack(sensor, sweeps, estimators, names, seed) for sensor, sweeps in scenes.items()]
        parts += ["## Attacked", _ATTACKED, *tables]
    if floor:
        parts += ["## The floor of the metric", _FLOOR, _floor(estimators, seed)]
    text = page("Cross-view truth", facts(seed=str(seed), grid="road (256 cells of 0.5 m)", target="car"), *parts)
    if out is None:
        typer.echo(text)
    else:
        out.write_text(text, encoding="utf-8")
        typer.echo(f"wrote {out}")


def _estimators(methods: str) -> dict[str, FovEstimator]:
    from viewshed.estimators import CLASSICAL, LEARNED, PAPER_ESTIMATORS
    from viewshed.estimators.shadow_map import NO_RETURN_RULES, ShadowMap
    from viewshed.fov.visibility import CAR
    from viewshed.grid import GRIDS

    road, published = GRIDS["road"], GRIDS["paper"]
    known: dict[str, Callable[[], FovEstimator]] = {name: partial(make, road) for name, make in CLASSICAL.items()}
    for rule in NO_RETURN_RULES[1:]:
        known[f"shadow_map, no return {rule}"] = partial(ShadowMap, road, CAR, rule)
    for name, make in PAPER_ESTIMATORS.items():
        known[f"paper: {name.removeprefix('paper_')}"] = partial(make, published)
    names = [name for word in methods.split(",") for name in (known if word == _ALL else [word])]
    known |= {name: partial(make, road) for name, make in LEARNED.items()}
    for name in names:
        if name not in known:
            raise ValueError(f"methods must be among {', '.join(known)}, got {name!r}")
    return {name: known[name]() for name in names}


def _scenes(index: Path) -> dict[str, list[list[Sweep]]]:
    """Sweeps of each sensor, scene by scene: folders of the index with three posed sweeps or more over 0.7 s."""
    from viewshed.io import read_index, read_indexed

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
    from viewshed.sensors import lidar_model

    with contextlib.suppress(ValueError):
        return sweep if sweep.model is not None else sweep.replace(model=lidar_model(name.removeprefix("Velodyne ")))
    return sweep


def _real(
    sensor: str, scenes: Sequence[Sequence[Sweep]], estimators: Mapping[str, FovEstimator], rules: object, seed: int
) -> str:
    import numpy as np

    from viewshed.studies.crossview.study import CrossViewRules, evaluate_crossview

    if not isinstance(rules, CrossViewRules):
        raise TypeError(f"rules must be CrossViewRules, got {type(rules).__name__}")
    rows = evaluate_crossview(scenes, estimators, rng=np.random.default_rng(seed), rules=rules, progress=_progress)
    sweeps = sum(len(scene) for scene in scenes)
    return f"### {sensor}, {len(scenes)} scene(s), {sweeps} sweeps\n\n{_table(rows)}"


def _attacks(names: str) -> list[str]:
    from viewshed.threats.attacks import ATTACKS

    found = [name for name in names.split(",") if name]
    for name in found:
        if name not in ATTACKS:
            raise ValueError(f"attacks must be among {', '.join(ATTACKS)}, got {name!r}")
    return found


def _under_attack(
    sensor: str,
    scenes: Sequence[Sequence[Sweep]],
    estimators: Mapping[str, FovEstimator],
    names: Sequence[str],
    seed: int,
) -> str:
    """Return the table of over- and under-claim without and with each attack, estimator by estimator."""
    import numpy as np

    from viewshed._page import table
    from viewshed.studies.crossview.study import crossview_truth, rows_of

    truth = crossview_truth(scenes, progress=_progress)
    found: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for name in ("", *names):
        rng = np.random.default_rng(seed)
        shown = partial(_attacked, name, rng)
        for row in rows_of(truth, estimators, rng=rng, progress=_progress, shown=shown):
            found[row.method].append((row.over.value, row.under.value))
    rows = []
    for method, rates in found.items():
        growth = np.nanmax(np.array(rates) - np.array(rates[0]))
        cells = [" / ".join("–" if np.isnan(rate) else f"{rate:.3f}" for rate in pair) for pair in rates]
        rows.append([method, *cells, f"{growth:+.3f}"])
    return f"### Attacked, {sensor}\n\n{table(['estimator', 'untouched', *names, 'grows by'], rows)}"


def _attacked(name: str, rng: np.random.Generator, sweep: Sweep) -> Sweep:
    from viewshed.threats.attacks import ATTACKS, Knowledge

    if not name:
        return sweep
    with contextlib.suppress(ValueError):
        return ATTACKS[name](_POINTS, Knowledge(half_extent_m=64.0)).apply(sweep, rng).sweep
    return sweep


def _floor(estimators: Mapping[str, FovEstimator], seed: int) -> str:
    import numpy as np

    from viewshed.studies.crossview.study import FIRST_RULES, CrossViewRules, evaluate_floor

    few = {
        name: estimator
        for name, estimator in estimators.items()
        if name in ("shadow_map", "majority_vote", "first_blocker")
    }
    tables = []
    steps = {"As first defined": FIRST_RULES, "and as wide as the target": CrossViewRules(foot_m=None),
             "and standing on the ground": CrossViewRules()}  # fmt: skip
    for name, rules in steps.items():
        _progress(f"floor: {name}")
        rows = evaluate_floor(few, rng=np.random.default_rng(seed), rules=rules)
        tables.append(f"**{name}**\n\n{_table(rows)}")
    return "\n\n".join(tables)


def _progress(step: str) -> None:
    typer.echo(f"viewshed: {step}", err=True)


def _table(rows: Sequence[CrossViewRow]) -> str:
    from viewshed._page import table

    header = ["estimator", "over", "under", "over, nothing dropped", "dropped"]
    return table(header, [_cells(row) for row in rows])


def _cells(row: CrossViewRow) -> list[str]:
    rates = [
        f"{rate.value:.3f} [{rate.low:.3f}, {rate.high:.3f}] of {rate.columns}" if rate.columns else "no columns"
        for rate in (row.over, row.under, row.over_unfiltered)
    ]
    return [row.method, *rates, f"{row.dropped_share:.2f}"]
