"""``viewshed reproduce``: the published study made again.

``viewshed report``: studies that run, go on where they were stopped, and write their pages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from viewshed.studies.paper.jobs import Scope
    from viewshed.studies.paper.plan import StudyPlan
    from viewshed.studies.paper.store import JobStore
    from viewshed.studies.robustness.plan import Study
    from viewshed.studies.robustness.store import ResultStore


report_app = typer.Typer(help="Studies and their reports.")


@report_app.callback()
def report() -> None:
    """Studies and their reports."""


@report_app.command()
def vulnerability(
    out: Annotated[Path, typer.Option(help="Folder of the results, the report and its figures.")] = Path(
        "vulnerability"
    ),
    preset: Annotated[str, typer.Option(help="What is run: tiny, small, full.")] = "small",
    workers: Annotated[int | None, typer.Option(help="Jobs under way at a time; one a core if not given.")] = None,
    engine: Annotated[str, typer.Option(help="local, or ray for a cluster.")] = "local",
    run: Annotated[bool, typer.Option(help="Run what is not there yet; --no-run only writes the report.")] = True,
    page: Annotated[
        Path | None, typer.Option(help="Where the Markdown page goes; figures and NAME_tables.md beside it.")
    ] = None,
) -> None:
    """Estimators under attacks, corruptions and defenses. Stopped runs go on; the same figures for any --workers.

    Example: viewshed report vulnerability --preset small --out study
    """
    from viewshed.studies.robustness.plan import study_named
    from viewshed.studies.robustness.store import FILE, ResultStore

    study = study_named(preset)
    if not run and not (out / FILE).exists():
        raise ValueError(f"{out} must hold results, got none; run without --no-run")
    store = ResultStore.open(out, study)
    failed = _run(study, store, engine, workers) if run else []
    for line in failed:
        typer.echo(f"viewshed: {line}", err=True)
    _write_report(store, failed, out, page or out / "vulnerability.md")
    if failed:
        raise ValueError(f"{len(failed)} jobs failed; what is finished is kept, the same command tries them again")


def _run(study: Study, store: ResultStore, engine: str, workers: int | None) -> list[str]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from viewshed._jobs import engine_named
    from viewshed.studies.robustness.jobs import run_study

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("jobs"),
               TimeElapsedColumn(), TimeRemainingColumn())  # fmt: skip
    runner = engine_named(engine, workers)
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(study.name, total=len(study.jobs()))
        return run_study(study, store, runner, lambda _: bar.advance(task))


def _write_report(store: ResultStore, failed: list[str], out: Path, page: Path) -> None:
    """Write the report twice: one HTML file, and a Markdown page with its figures beside it."""
    from viewshed._files import write_atomic
    from viewshed._page import facts, to_html, to_markdown
    from viewshed.studies.robustness.page import LONG_TITLE, TITLE, blocks_of, details_of, pictures_of, told
    from viewshed.studies.robustness.results import Results

    results = Results.read(store)
    if not results.scores:
        raise ValueError(f"{store.path} must hold results, got none; run without --no-run")
    blocks, details, about = list(blocks_of(results, failed)), list(details_of(results)), facts(**told(results))
    write_atomic(out / "index.html", to_html(TITLE, about, [*blocks, *details]).encode())
    for picture in pictures_of(blocks):
        write_atomic(page.parent / picture.name, picture.png)
    write_atomic(page, to_markdown(TITLE, about, blocks).encode())
    write_atomic(page.with_name(f"{page.stem}_tables.md"), to_markdown(LONG_TITLE, about, details).encode())
    typer.echo(f"Look at {(out / 'index.html').resolve()}; Markdown in {page}")


_BOTH = "both"


def reproduce(
    study: Annotated[
        str, typer.Argument(help="paper, the published study, or successor, what the parts of our network are worth.")
    ] = "paper",
    preset: Annotated[str, typer.Option(help="What is run: tiny, small, paper; of successor tiny, small.")] = "small",
    out: Annotated[Path, typer.Option(help="Folder of data, models and results.")] = Path("reproduce"),
    only: Annotated[
        str | None,
        typer.Option(
            metavar="STEPS",
            help="With commas: data, models, pairs, strict, trade, monitor, pages; "
            "of successor models, validation, test, chosen, page.",
        ),
    ] = None,
    protocol: Annotated[str, typer.Option(help="paper, strict or both.")] = _BOTH,
    device: Annotated[str, typer.Option(help="cpu or cuda, for trainings and networks.")] = "cpu",
    workers: Annotated[int | None, typer.Option(help="Jobs under way at a time; one a core if not given.")] = None,
    page: Annotated[Path | None, typer.Option(help="Folder of the pages and figures; --out if not given.")] = None,
) -> None:
    """Train the study's models, score them, write its pages. Stopped runs go on: the same command again.

    Example: viewshed reproduce --preset tiny --out study
    """
    if study not in ("paper", "successor"):
        raise ValueError(f"STUDY must be paper or successor, got {study!r}")
    problems = (_paper if study == "paper" else _successor)(_Asked(preset, out, only, protocol, device, workers, page))
    if problems:
        raise ValueError(f"{problems} jobs are not done; what is finished is kept, the same command goes on")


@dataclass(frozen=True, slots=True)
class _Asked:
    """The options."""

    preset: str
    out: Path
    only: str | None
    protocol: str
    device: str
    workers: int | None
    page: Path | None


def _paper(asked: _Asked) -> int:
    """Return how many jobs of the published study are not done."""
    from viewshed.studies.paper.jobs import Scope, folder_of, named_steps, run_steps
    from viewshed.studies.paper.plan import plan_named
    from viewshed.studies.paper.protocols import PROTOCOLS
    from viewshed.studies.paper.store import JobStore

    protocols = PROTOCOLS if asked.protocol == _BOTH else (asked.protocol,)
    scope = Scope(named_steps(asked.only), protocols, asked.device, asked.workers)
    store = JobStore.open(folder_of(asked.out), plan_named(asked.preset))
    problems = _told(lambda told: run_steps(store, scope, told))
    if "pages" in scope.steps:
        _write_pages(store, scope, asked.page or asked.out)
    return problems


def _successor(asked: _Asked) -> int:
    """Return how many jobs of the ablation are not done."""
    from viewshed._files import write_atomic
    from viewshed.studies.ablation.jobs import STEPS, run_steps
    from viewshed.studies.ablation.page import page_of
    from viewshed.studies.ablation.plan import ablation_named
    from viewshed.studies.paper.jobs import folder_of
    from viewshed.studies.paper.store import JobStore

    if asked.protocol != _BOTH or asked.device != "cpu":
        raise ValueError("--protocol and --device go with the published study, not with successor")
    steps = STEPS if asked.only is None else tuple(asked.only.split(","))
    store = JobStore.open(folder_of(asked.out), ablation_named(asked.preset))
    problems = _told(lambda told: run_steps(store, steps, asked.workers, told))
    if "page" in steps:
        folder = asked.page or asked.out
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / "successor.md", page_of(store).encode())
        typer.echo(f"Look at {folder / 'successor.md'}")
    return problems


def _told(run: Callable[[Callable[[str, int, int], None]], Iterator[str]]) -> int:
    """Return how many jobs are not done; why is told as it happens."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
               TimeRemainingColumn())  # fmt: skip
    tasks: dict[str, TaskID] = {}
    bars = Progress(*columns, console=Console(stderr=True))

    def told(step: str, done: int, total: int) -> None:
        if not tasks:
            bars.start()
        if step not in tasks:
            tasks[step] = bars.add_task(step, total=total)
        bars.update(tasks[step], completed=done)

    problems = 0
    try:
        for line in run(told):
            problems += 1
            bars.console.print(f"viewshed: {line}", markup=False, highlight=False, soft_wrap=True)
        return problems
    finally:
        if tasks:
            bars.stop()


def _write_pages(store: JobStore[StudyPlan], scope: Scope, folder: Path) -> None:
    """Write the pages of the protocols and their figures."""
    from viewshed._files import write_atomic
    from viewshed.studies.paper.page import files_of
    from viewshed.studies.paper.results import Results

    results = Results.read(store)
    folder.mkdir(parents=True, exist_ok=True)
    for protocol in scope.protocols:
        files = files_of(results, protocol)
        for name, content in files.items():
            write_atomic(folder / name, content)
        typer.echo(f"Look at {folder / next(reversed(files))}")
