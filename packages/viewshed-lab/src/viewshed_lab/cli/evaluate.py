"""``viewshed evaluate``: evaluate estimators against independent truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli._options import DEFAULT_READING, Index, TargetName, Weights, parse_target

if TYPE_CHECKING:
    from viewshed.fov.estimate import FovEstimator
    from viewshed.fov.visibility import Target
    from viewshed.grid import BevGrid
    from viewshed_lab.data import Archive

_ALL = "all"

Methods = Annotated[str, typer.Option(help="Methods, separated by commas; 'all' for all except networks.")]

Out = Annotated[Path | None, typer.Option(help="Write the tables to this Markdown file instead of the screen.")]

evaluate_app = typer.Typer(help="Measure estimators against exact truth, or by other sweeps.")


@evaluate_app.callback()
def evaluate() -> None:
    """Measure estimators against exact truth, or by other sweeps."""


@evaluate_app.command()
def truth(
    archives: Annotated[
        list[str],
        typer.Argument(metavar="ARCHIVE…", help="Folders or URIs of simulated data sets.", show_default=False),
    ],
    methods: Methods = _ALL,
    weights: Weights = None,
    target: TargetName = "car",
    limit: Annotated[
        int, typer.Option(min=1, help="Maximum number of samples, spread evenly over each data set.")
    ] = 200,
    split: Annotated[str | None, typer.Option(help="Only this split: train, test, …")] = None,
    out: Out = None,
) -> None:
    """Measure precision, recall and areas against exact truth.

    Also compares other definitions of visible with ours.

    Example: viewshed evaluate truth nuscenes-small --split test --out truth.md
    """
    from viewshed_lab.studies.against_truth import FORMS, TruthEvaluation, page_of
    from viewshed_lab.studies.fixed_views import FIXED_VIEWS

    parsed = parse_target(target)
    evaluation = TruthEvaluation(_makers(methods, parsed, weights, FIXED_VIEWS), parsed, FORMS)
    _write_page(page_of([_opened(path, split) for path in archives], evaluation, limit, split or "all", _on_step), out)


def _opened(path: str, split: str | None) -> Archive:
    from viewshed_lab.data import Archive

    data = Archive.open(path)
    data = data if split is None else data.split(split)
    if not len(data):
        raise ValueError(f"{path} must hold samples, got none")
    return data


def _makers(
    methods: str, target: Target, weights: str | None, more: Mapping[str, Callable[[BevGrid], FovEstimator]]
) -> dict[str, Callable[[BevGrid], FovEstimator]]:
    """Return the factories of the estimators in ``methods``, by name; ``more`` are known besides ours."""
    from viewshed.estimators import CLASSICAL, LEARNED
    from viewshed.estimators.shadow_map import NO_RETURN_RULES, ShadowMap

    classical: dict[str, Callable[[BevGrid], FovEstimator]] = {
        name: partial(make, target=target) for name, make in CLASSICAL.items()
    }
    for rule in NO_RETURN_RULES[1:]:
        classical[f"shadow_map, no return {rule}"] = partial(ShadowMap, target=target, no_return=rule)
    classical |= more
    names = [name for word in methods.split(",") for name in (classical if word == _ALL else [word])]
    if weights is not None and not set(names) & set(LEARNED):
        raise ValueError(f"--weights goes with {', '.join(LEARNED)} among --methods, got {methods}")
    known = classical | {name: partial(make, target=target, weights=weights) for name, make in LEARNED.items()}
    for name in names:
        if name not in known:
            raise ValueError(f"methods must be among {', '.join(known)}, got {name!r}")
    return {name: known[name] for name in names}


@evaluate_app.command()
def crossview(
    index: Annotated[
        Path, typer.Argument(metavar="INDEX", help="Index (JSON) of posed sweeps; each of its folders is one scene.")
    ],
    methods: Methods = _ALL,
    seed: Annotated[int, typer.Option(help="Seed of the bootstrap.")] = 0,
    out: Out = None,
    attacks: Annotated[
        str, typer.Option(help="Attacks, separated by commas: also measure under each, with 150 moved points.")
    ] = "",
    floor: Annotated[bool, typer.Option(help="Also measure the metric's own error in simulation.")] = True,
) -> None:
    """Measure false claims and denials by other sweeps of the scene.

    A false claim is a hidden cell called visible; a false denial is a seen cell called hidden.

    Example: viewshed evaluate crossview data/index.json --out crossview.md
    """
    from viewshed_lab.studies.crossview.page import page_of

    estimators, names = _estimators(methods), [name for name in attacks.split(",") if name]
    _write_page(page_of(index, estimators, names, seed, _on_step, floor=floor), out)


_JUDGED = "shadow_map,majority_vote,first_blocker,continuous,concave_hull"


@evaluate_app.command()
def survey(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="Folder of an Argoverse 2 log with its map.", show_default=False)
    ],
    methods: Methods = _JUDGED,
    out: Out = None,
) -> None:
    """Measure claims against the surveyed ground of a city.

    Example: viewshed evaluate survey val/7fab2350-7eaf-3b7e-a39d-6937a4c1bede --out survey.md
    """
    from viewshed.fov.visibility import CAR
    from viewshed.recordings.read import open_source
    from viewshed_lab.studies.judges import survey_page

    _write_page(survey_page(log, open_source(log, "argoverse2"), _estimators(methods), CAR), out)


@evaluate_app.command()
def boxes(
    recording: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="nuScenes, KITTI or Argoverse 2, annotated.", show_default=False)
    ],
    methods: Methods = _JUDGED,
    limit: Annotated[
        int, typer.Option(min=1, help="Maximum number of sweeps, spread evenly over the recording.")
    ] = 200,
    out: Out = None,
) -> None:
    """Measure claims and ground against annotated boxes.

    Example: viewshed evaluate boxes nuscenes --limit 100 --out boxes.md
    """
    from viewshed.cli._outputs import Failures
    from viewshed.fov.visibility import CAR
    from viewshed.recordings.read import open_source
    from viewshed_lab.studies.judges import boxes_page

    failures = Failures()
    _write_page(boxes_page(recording, open_source(recording), _estimators(methods), CAR, limit, failures.report), out)
    if failures.count:
        raise typer.Exit(2)


@evaluate_app.command()
def beyond(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE…", help="Sweeps in any known format, folders of them, or recordings."),
    ] = None,
    index: Index = None,
    out: Out = None,
) -> None:
    """Measure the share of claimed area that lies beyond every return.

    Indoors, such a claim can be right only through a door or window.

    Example: viewshed evaluate beyond office.pcd room.pcap --out beyond.md
    """
    from viewshed.cli._outputs import Failures, output_names
    from viewshed.cli._places import chosen_files
    from viewshed.cli._stream import named_sweeps
    from viewshed_lab.studies.beyond import beyond_page

    jobs, failures = list(chosen_files(files or [], index)), Failures()
    sweeps = named_sweeps(DEFAULT_READING, jobs, output_names([file for file, _ in jobs]), failures)
    _write_page(beyond_page((named.name, named.sweep) for named in sweeps), out)
    if failures.count:
        raise typer.Exit(2)


def _estimators(methods: str) -> dict[str, FovEstimator]:
    """Return estimators for cars by name, on the road grid; the paper's estimators on the paper's grid."""
    from viewshed.estimators import PAPER_ESTIMATORS
    from viewshed.fov.visibility import CAR
    from viewshed.grid import GRIDS

    papers = {f"paper: {name.removeprefix('paper_')}": make for name, make in PAPER_ESTIMATORS.items()}
    chosen = _makers(methods, CAR, None, papers)
    return {name: make(GRIDS["paper" if name in papers else "road"]) for name, make in chosen.items()}


def _on_step(step: str) -> None:
    typer.echo(f"viewshed: {step}", err=True)


def _write_page(text: str, out: Path | None) -> None:
    """Write a page to a file, or print it."""
    if out is None:
        typer.echo(text)
    else:
        from viewshed_lab._results import write_page

        typer.echo(f"wrote {write_page(out, text)}")
