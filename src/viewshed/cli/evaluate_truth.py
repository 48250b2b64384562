"""``viewshed evaluate truth``: estimators against the exact truth of a simulated data set."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli.learned import Weights
from viewshed.cli.options import TargetName, parse_target

if TYPE_CHECKING:
    from viewshed.bev import BevGrid
    from viewshed.datasets import Archive, Sample
    from viewshed.estimate import FovEstimator
    from viewshed.evaluation import Contest, Scores, Tally
    from viewshed.visible import Target

_ALL = "all"
_INTRODUCTION = """\
Cells pooled over the samples, where the truth is known. *Precision*: share of the claimed cells that are visible;
*recall*: share of the visible cells that are claimed. *Over* and *under*: area of a sample, on average, claimed and not
visible, visible and not claimed. *F1, clear*: without the cells next to the target's number of returns, where one beam
more or less decides."""
_FORMS = """\
*rings known*: the sweep as the sensor gives it. *unorganised*: without ring, firing azimuth and time. *no sensor*:
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
    from viewshed.evaluation import FORMS, Contest
    from viewshed.report import facts, page

    wanted = parse_target(target)
    contest = Contest(_makers(methods, wanted, weights), wanted, FORMS)
    opened = [_opened(place, split) for place in archives]
    parts = [_INTRODUCTION, _FORMS]
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

    from viewshed.cli.options import make_estimator
    from viewshed.estimators import ESTIMATORS
    from viewshed.estimators.learned import LEARNED, learned
    from viewshed.estimators.shadow_map import NO_RETURN_RULES, ShadowMap

    known: dict[str, Callable[[BevGrid], FovEstimator]] = {
        name: partial(make_estimator, name, target=target.name) for name in ESTIMATORS
    }
    for rule in NO_RETURN_RULES[1:]:
        known[f"shadow_map, no return {rule}"] = partial(ShadowMap, target=target, no_return=rule)
    names = [name for word in methods.split(",") for name in (known if word == _ALL else [word])]
    if weights is not None and not set(names) & set(LEARNED):
        raise ValueError(f"--weights goes with unet, mcd or viewnet among --methods, got {methods}")
    known |= {name: partial(learned, name, target=target.name, weights=weights) for name in LEARNED}
    for name in names:
        if name not in known:
            raise ValueError(f"methods must be among {', '.join(known)}, got {name!r}")
    return {name: known[name] for name in names}


def _sections(data: Archive, count: int, contest: Contest) -> Iterator[str]:
    from viewshed.evaluation import compare_definitions, evaluate_truth

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
    from viewshed.evaluation import ALL, CLEAR
    from viewshed.report import table

    header = ["", "precision", "recall", "F1", "IoU", "over m²", "under m²", "F1, clear"]
    return table(
        header, [[name, *_cells(scores[name, form, ALL]), _three(scores[name, form, CLEAR].f1)] for name in names]
    )


def _cells(tally: Tally) -> list[str]:
    rates = [_three(rate) for rate in (tally.precision, tally.recall, tally.f1, tally.iou)]
    return [*rates, f"{tally.over_m2:.0f}", f"{tally.under_m2:.0f}"]


def _three(rate: float) -> str:
    return "–" if isnan(rate) else f"{rate:.3f}"


def _by_range(scores: Scores, names: list[str], form: str) -> str:
    from viewshed.evaluation import ALL, CLEAR, SENSOR

    parts = dict.fromkeys(key[2] for key in scores)
    bands = [part for part in parts if part not in {ALL, CLEAR} and not part.startswith(SENSOR)]
    return _f1_of_parts(scores, names, form, {band: band for band in bands})


def _by_sensor(scores: Scores, names: list[str], form: str) -> str:
    from viewshed.evaluation import ALL, SENSOR

    parts = sorted({key[2] for key in scores if key[2].startswith(SENSOR)})
    counts = {part: scores[names[0], form, part].samples for part in parts if (names[0], form, part) in scores}
    heads = {part: f"{part.removeprefix(SENSOR)} ({count})" for part, count in counts.items()}
    return _f1_of_parts(scores, names, form, heads or {ALL: "all"})


def _f1_of_parts(scores: Scores, names: list[str], form: str, heads: Mapping[str, str]) -> str:
    """Return a table of F1 by part; ``heads`` are the columns' words by part."""
    from viewshed.report import table

    rows = [[name, *(_three(scores[name, form, part].f1) for part in heads)] for name in names]
    return table(["", *heads.values()], rows)
