"""``viewshed reproduce``: the published study made again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from viewshed.reproduce.run import Scope
    from viewshed.reproduce.store import JobStore

_BOTH = "both"


def reproduce(
    preset: Annotated[str, typer.Option(help="What is run: tiny, small, paper.")] = "small",
    out: Annotated[Path, typer.Option(help="Folder of data, models and results.")] = Path("reproduce"),
    only: Annotated[
        str | None,
        typer.Option(metavar="STEPS", help="With commas: data, models, pairs, strict, trade, monitor, pages."),
    ] = None,
    protocol: Annotated[str, typer.Option(help="paper, strict or both.")] = _BOTH,
    device: Annotated[str, typer.Option(help="cpu or cuda, for trainings and networks.")] = "cpu",
    workers: Annotated[int | None, typer.Option(help="Jobs under way at a time; one a core if not given.")] = None,
    page: Annotated[Path | None, typer.Option(help="Folder of the pages and figures; --out if not given.")] = None,
) -> None:
    """Train the study's models, score them, write its pages. Stopped runs go on: the same command again.

    Example: viewshed reproduce --preset tiny --out study
    """
    from viewshed.reproduce.plan import plan_named
    from viewshed.reproduce.protocols import PROTOCOLS
    from viewshed.reproduce.run import Scope, folder_of, named_steps
    from viewshed.reproduce.store import JobStore

    protocols = PROTOCOLS if protocol == _BOTH else (protocol,)
    scope = Scope(named_steps(only), protocols, device, workers)
    store = JobStore.open(folder_of(out), plan_named(preset))
    problems = _run(store, scope)
    if "pages" in scope.steps:
        _write(store, scope, page or out)
    if problems:
        raise ValueError(f"{problems} jobs are not done; what is finished is kept, the same command goes on")


def _run(store: JobStore, scope: Scope) -> int:
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

    from viewshed.reproduce.run import run_steps

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
        for line in run_steps(store, scope, told):
            problems += 1
            bars.console.print(f"viewshed: {line}", markup=False, highlight=False, soft_wrap=True)
        return problems
    finally:
        if tasks:
            bars.stop()


def _write(store: JobStore, scope: Scope, folder: Path) -> None:
    """Write the pages of the protocols and their figures."""
    from viewshed.atomic import write_bytes
    from viewshed.reproduce.pages import files_of
    from viewshed.reproduce.results import Results

    results = Results.read(store)
    folder.mkdir(parents=True, exist_ok=True)
    for protocol in scope.protocols:
        files = files_of(results, protocol)
        for name, content in files.items():
            write_bytes(folder / name, content)
        typer.echo(f"Look at {folder / next(reversed(files))}")
