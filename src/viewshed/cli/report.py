"""``viewshed report``: studies that run, go on where they were stopped, and write their pages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from viewshed.vulnerability import ResultStore, Study

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
    from viewshed.vulnerability import ResultStore, study_named
    from viewshed.vulnerability.store import FILE

    study = study_named(preset)
    if not run and not (out / FILE).exists():
        raise ValueError(f"{out} must hold results, got none; run without --no-run")
    store = ResultStore.open(out, study)
    failed = _run(study, store, engine, workers) if run else []
    for line in failed:
        typer.echo(f"viewshed: {line}", err=True)
    _write(store, failed, out, page or out / "vulnerability.md")
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

    from viewshed.engines import engine_named
    from viewshed.vulnerability import run_study

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("jobs"),
               TimeElapsedColumn(), TimeRemainingColumn())  # fmt: skip
    runner = engine_named(engine, workers)
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(study.name, total=len(study.jobs()))
        return run_study(study, store, runner, lambda _: bar.advance(task))


def _write(store: ResultStore, failed: list[str], out: Path, page: Path) -> None:
    """Write the report twice: one HTML file, and a Markdown page with its figures beside it."""
    from viewshed.atomic import write_bytes
    from viewshed.report import facts
    from viewshed.vulnerability.page import to_html, to_markdown
    from viewshed.vulnerability.report import LONG_TITLE, TITLE, blocks_of, details_of, pictures_of, told
    from viewshed.vulnerability.results import Results

    results = Results.read(store)
    if not results.scores:
        raise ValueError(f"{store.path} must hold results, got none; run without --no-run")
    blocks, details, about = list(blocks_of(results, failed)), list(details_of(results)), facts(**told(results))
    write_bytes(out / "index.html", to_html(TITLE, about, [*blocks, *details]).encode())
    for picture in pictures_of(blocks):
        write_bytes(page.parent / picture.name, picture.png)
    write_bytes(page, to_markdown(TITLE, about, blocks).encode())
    write_bytes(page.with_name(f"{page.stem}_tables.md"), to_markdown(LONG_TITLE, about, details).encode())
    typer.echo(f"Look at {(out / 'index.html').resolve()}; Markdown in {page}")
