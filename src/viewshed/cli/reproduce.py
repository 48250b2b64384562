"""``viewshed reproduce``: the published study made again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from viewshed.reproduce.plan import StudyPlan
    from viewshed.reproduce.run import Scope
    from viewshed.reproduce.store import JobStore

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
    from viewshed.reproduce.plan import plan_named
    from viewshed.reproduce.protocols import PROTOCOLS
    from viewshed.reproduce.run import Scope, folder_of, named_steps, run_steps
    from viewshed.reproduce.store import JobStore

    protocols = PROTOCOLS if asked.protocol == _BOTH else (asked.protocol,)
    scope = Scope(named_steps(asked.only), protocols, asked.device, asked.workers)
    store = JobStore.open(folder_of(asked.out), plan_named(asked.preset))
    problems = _told(lambda told: run_steps(store, scope, told))
    if "pages" in scope.steps:
        _write(store, scope, asked.page or asked.out)
    return problems


def _successor(asked: _Asked) -> int:
    """Return how many jobs of the ablation are not done."""
    from viewshed.atomic import write_bytes
    from viewshed.reproduce.run import folder_of
    from viewshed.reproduce.store import JobStore
    from viewshed.successor.page import page_of
    from viewshed.successor.plan import ablation_named
    from viewshed.successor.run import STEPS, run_steps

    if asked.protocol != _BOTH or asked.device != "cpu":
        raise ValueError("--protocol and --device go with the published study, not with successor")
    steps = STEPS if asked.only is None else tuple(asked.only.split(","))
    store = JobStore.open(folder_of(asked.out), ablation_named(asked.preset))
    problems = _told(lambda told: run_steps(store, steps, asked.workers, told))
    if "page" in steps:
        folder = asked.page or asked.out
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(folder / "successor.md", page_of(store).encode())
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


def _write(store: JobStore[StudyPlan], scope: Scope, folder: Path) -> None:
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
