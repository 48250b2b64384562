"""``viewshed study``: run or resume studies, and write their pages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from viewshed.cli._options import EngineName, MonitorFile, Workers
from viewshed.cli._terminal import raise_if_interrupted
from viewshed_lab.cli.evaluate import crossview

if TYPE_CHECKING:
    from viewshed_lab.studies.plan import Plan
    from viewshed_lab.studies.runner import Progress

study_app = typer.Typer(help="Run a study and write its page; a stopped study resumes.")


Out = Annotated[
    Path | None, typer.Option(help="Folder of data, models, results and pages; named after the study if not given.")
]

Run = Annotated[bool, typer.Option(help="Run what is not done yet; --no-run only writes the page.")]

Pages = Annotated[Path | None, typer.Option("--page", help="Folder of the pages and figures; --out if not given.")]

_BOTH = "both"

_Work = Callable[..., Iterator[str]]
"""Runs the jobs of a store and yields one line per failed job."""

_Files = Callable[[Any], dict[str, bytes]]
"""Returns the pages of a store, by file name."""


@study_app.callback()
def study() -> None:
    """Run a study and write its page; a stopped study resumes."""


@study_app.command()
def robustness(
    out: Out = None,
    preset: Annotated[str, typer.Option(help="Size of the study: tiny, small, full.")] = "small",
    workers: Workers = None,
    engine: EngineName = "local",
    run: Run = True,
    page: Annotated[Path | None, typer.Option(help="Markdown page to write; figures go beside it.")] = None,
) -> None:
    """Estimators under attacks, corruptions and defenses.

    A stopped run resumes. The results are the same for any --workers.

    Example: viewshed study robustness --preset small --out study
    """
    from viewshed_lab._jobs import engine_named
    from viewshed_lab.studies.robustness.jobs import run_study
    from viewshed_lab.studies.robustness.page import files_of
    from viewshed_lab.studies.robustness.plan import RobustnessPlan

    folder = _folder(out, "robustness")
    main_page = page or folder / "robustness.md"
    work = partial(run_study, engine=engine_named(engine, workers)) if run else None
    _run(RobustnessPlan.load(preset), folder, main_page.parent, work, partial(files_of, stem=main_page.stem))


@study_app.command()
def paper(
    preset: Annotated[str, typer.Option(help="Size of the study: tiny, small, medium, paper.")] = "small",
    out: Out = None,
    only: Annotated[
        str | None,
        typer.Option(
            metavar="STEPS",
            help="Only these steps, separated by commas: data, crossval, models, pairs, strict, trade, monitor, pages.",
        ),
    ] = None,
    protocol: Annotated[
        str, typer.Option(help="Truth and grid: paper (as published), strict (exact truth), or both.")
    ] = _BOTH,
    device: Annotated[str, typer.Option(help="cpu or cuda, for trainings and networks.")] = "cpu",
    workers: Workers = None,
    page: Pages = None,
) -> None:
    """The published study: train its models, score them, write pages.

    The same command resumes a stopped run.

    Example: viewshed study paper --preset tiny --out study
    """
    from viewshed_lab.studies.paper.jobs import Scope, run_study
    from viewshed_lab.studies.paper.page import files_of
    from viewshed_lab.studies.paper.plan import PROTOCOLS, STEPS, PaperPlan
    from viewshed_lab.studies.paper.published import PaperResults
    from viewshed_lab.studies.store import ResultStore

    protocols = PROTOCOLS if protocol == _BOTH else (protocol,)
    scope = Scope(_steps(only, STEPS), protocols, device, workers)
    folder = _folder(out, "paper")
    store = ResultStore.open(folder, PaperPlan.load(preset))
    failed = _with_bars(lambda progress: run_study(store, scope, progress))
    if "pages" in scope.steps:
        results = PaperResults.read(store)
        for name in protocols:
            _show(page or folder, files_of(results, name))
    _require_all_done(failed)


@study_app.command()
def monitor(
    out: Out = None,
    preset: Annotated[str, typer.Option(help="Which streams: shipped or tiny.")] = "shipped",
    workers: Workers = None,
    run: Run = True,
    page: Pages = None,
    traces: Annotated[
        list[Path] | None, typer.Option(help="Public traces of spoofed drives, .tar.xz, see study spoofing.")
    ] = None,
) -> None:
    """Stream alarms: calibrate on some worlds, report on others.

    Writes the calibration (monitor.npz) and the page. A stopped run resumes with the next stream.

    Example: viewshed study monitor --out study
    """
    from viewshed.monitor import Calibration, StreamMonitor, load_calibration, save_calibration
    from viewshed_lab._jobs import LocalEngine
    from viewshed_lab.studies.monitor.page import files_of
    from viewshed_lab.studies.monitor.plan import MonitorPlan
    from viewshed_lab.studies.monitor.streams import read_streams, run_streams
    from viewshed_lab.studies.monitor.traces import call_trace
    from viewshed_lab.studies.monitor.tried import tried

    plan, folder = MonitorPlan.load(preset), _folder(out, "monitor")
    failed = list(run_streams(plan, folder / "streams", LocalEngine(workers), typer.echo)) if run else []
    for line in failed:
        typer.echo(line, err=True)
    calibrated = folder / "monitor.npz"
    if run or not calibrated.exists():
        streams = list(read_streams(plan, folder / "streams", "calibration"))
        fitted = Calibration.fit(
            [one.benign for one in streams], plan.hz,
            facts={"per_hour": "6", "streams": f"{len(streams)} simulated, {plan.seconds:g} s each"},
        )  # fmt: skip
        save_calibration(fitted, calibrated)
    calibration = load_calibration(calibrated)
    calls = [call for trace in traces or () for call in call_trace(trace, StreamMonitor(calibration))]
    report, benign = (read_streams(plan, folder / "streams", part) for part in ("report", "benign"))
    _show(page or folder, files_of(plan, calibration, report, benign, calls, tried(plan)))
    _require_all_done(failed)


@study_app.command()
def spoofing(
    traces: Annotated[
        list[Path], typer.Argument(metavar="TRACE...", help="blackout.tar.xz, noise.tar.xz, … or folders of PCD files.")
    ],
    monitor_file: MonitorFile = None,
    key: Annotated[
        str | None,
        typer.Option(metavar="NUMBERS", help="Numbers of the spoofed sweeps of the trace, separated by commas."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Page to write.")] = Path("spoofing.md"),
) -> None:
    """What the monitor flags in public traces of spoofed drives.

    For the two public traces, which sweeps are spoofed is inferred from the data; for another trace, give --key.

    Example: viewshed study spoofing blackout.tar.xz noise.tar.xz
    """
    from viewshed.cli._verdicts import stream_monitor
    from viewshed_lab._results import write_page
    from viewshed_lab.studies.monitor.page import trace_page
    from viewshed_lab.studies.monitor.traces import call_trace

    numbers = None if key is None else [int(word) if word.strip().isdecimal() else -1 for word in key.split(",")]
    if numbers is not None and (len(traces) > 1 or min(numbers) < 0):
        raise ValueError(f"--key must be numbers of sweeps of one trace, got {key!r} for {len(traces)} traces")
    stream = stream_monitor(monitor_file)
    calls = [call for trace in traces for call in call_trace(trace, stream, numbers)]
    written = write_page(out, trace_page(calls, stream.limit, stream.per_hour))
    counts = [
        f"{sum(call.inconsistent for call in group)} of {len(group)} {what}"
        for is_spoofed, what in ((True, "spoofed sweeps"), (False, "honest sweeps"), (None, "sweeps without a --key"))
        if (group := [call for call in calls if call.is_spoofed is is_spoofed])
    ]
    typer.echo(f"flagged: {', '.join(counts)}; look at {written}")


@study_app.command()
def agents(
    preset: Annotated[str, typer.Option(help="Size of the study: tiny, short, small, full.")] = "small",
    out: Out = None,
    only: Annotated[
        str | None, typer.Option(metavar="STEPS", help="Only these steps, separated by commas: scenes, runs, page.")
    ] = None,
    workers: Workers = None,
    engine: EngineName = "local",
    page: Pages = None,
) -> None:
    """Many agents, some of whom lie: liars detected, honest accused.

    They lie about objects or about what they see.

    Example: viewshed study agents --preset tiny --out study
    """
    from viewshed_lab._jobs import engine_named
    from viewshed_lab.studies.agents.jobs import run_study
    from viewshed_lab.studies.agents.page import files_of
    from viewshed_lab.studies.agents.plan import STEPS, AgentsPlan

    steps = _steps(only, STEPS)
    work = partial(run_study, engine=engine_named(engine, workers), steps=steps)
    _run(AgentsPlan.load(preset), _folder(out, "agents"), page, work, files_of if "page" in steps else None)


@study_app.command()
def cases(
    scenes: Annotated[int, typer.Option(min=1, help="Scenes of each case; 24 take about three minutes.")] = 24,
    page: Annotated[Path, typer.Option(help="Markdown page to write.")] = Path("cases.md"),
) -> None:
    """The four published cases: robot, mast, perception, trust.

    Example: viewshed study cases --scenes 2
    """
    from viewshed_lab._results import write_page
    from viewshed_lab.studies.published_cases import cases_page

    written = write_page(page, cases_page(scenes, progress=lambda title: typer.echo(f"{title} …")))
    typer.echo(f"Look at {written}")


@study_app.command()
def tracks(
    preset: Annotated[str, typer.Option(help="Size of the study: tiny, quick, small, full.")] = "small",
    out: Out = None,
    only: Annotated[
        str | None,
        typer.Option(metavar="STEPS", help="Only these steps, separated by commas: count, limit, test, lidar, page."),
    ] = None,
    workers: Workers = None,
    engine: EngineName = "local",
    page: Pages = None,
) -> None:
    """Tracks and fusion with each field of view, under attack.

    On simulated drives with forged detections.

    Example: viewshed study tracks --preset tiny --out study
    """
    from viewshed_lab._jobs import engine_named
    from viewshed_lab.studies.tracks.jobs import run_study
    from viewshed_lab.studies.tracks.page import files_of
    from viewshed_lab.studies.tracks.plan import STEPS, TracksPlan

    steps = _steps(only, STEPS)
    work = partial(run_study, engine=engine_named(engine, workers), steps=steps)
    _run(TracksPlan.load(preset), _folder(out, "tracks"), page, work, files_of if "page" in steps else None)


@study_app.command()
def wild(
    preset: Annotated[
        str,
        typer.Option(
            help="tiny, hard (hard places, with pictures), small (development set), networks (roads), sealed."
        ),
    ] = "small",
    out: Out = None,
    workers: Workers = None,
    run: Run = True,
    page: Pages = None,
    open_sealed: Annotated[
        str, typer.Option(metavar="REASON", help="Open the sealed set for this reason; it is logged first.")
    ] = "",
    log: Annotated[Path, typer.Option(help="File that logs the openings of the sealed set.")] = Path(
        "docs/results/wild_openings.md"
    ),
    network: Annotated[list[Path] | None, typer.Option(help="File of another network to evaluate.")] = None,
) -> None:
    """Every estimator on worlds and sensors it was not designed for.

    Compares with exact truth.

    Example: viewshed study wild --preset tiny --out study
    """
    from viewshed.networks.runtime import load_runner
    from viewshed_lab._jobs import LocalEngine
    from viewshed_lab.studies.wild.jobs import run_study
    from viewshed_lab.studies.wild.openings import SetOpening
    from viewshed_lab.studies.wild.page import files_of
    from viewshed_lab.studies.wild.plan import WildPlan

    folder, plan = _folder(out, "wild"), WildPlan.load(preset)
    for file in network or ():
        load_runner(file)  # an unreadable file fails here instead of in every job
    plan = replace(plan, networks=tuple(map(str, network or ())))
    opening = None
    if run and plan.opens_sealed and open_sealed:
        opening = SetOpening(open_sealed, plan.judged)
        opening.log(log)
    work = partial(run_study, engine=LocalEngine(workers), opening=opening) if run else None
    _run(plan, folder, page, work, files_of)


@study_app.command()
def guarantees(
    preset: Annotated[str, typer.Option(help="Size of the study: tiny, small, full.")] = "small",
    out: Out = None,
    run: Run = True,
    page: Pages = None,
    ship: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write the calibrations to this file.")] = None,
    survey: Annotated[
        Path | None, typer.Option(metavar="LOG", help="Folder of an Argoverse 2 log with its map, to judge the masks.")
    ] = None,
    real: Annotated[
        Path | None, typer.Option(metavar="INDEX", help="Index (JSON) of real posed sweeps, which judge the masks.")
    ] = None,
) -> None:
    """Guarantees against over-claiming: certificates, attacks, masks.

    Finished parts do not run again: for another preset, or after a change of the default estimator, give a new --out.

    Example: viewshed study guarantees --preset tiny --out study
    """
    from viewshed_lab.studies.guarantees import jobs
    from viewshed_lab.studies.guarantees.page import files_of
    from viewshed_lab.studies.guarantees.scenes import crossview_of, survey_of

    if preset not in jobs.SIZES:
        raise ValueError(f"preset must be one of {', '.join(jobs.SIZES)}, got {preset!r}")
    folder, sizes = _folder(out, "guarantees"), jobs.SIZES[preset]
    if run:
        jobs.run_study(folder, sizes, lambda line: typer.echo(line, err=True))
    elif any(folder.glob("*.jsonl")):
        jobs.check_sizes(folder, sizes)
    if survey is not None:
        jobs.judge(folder, "survey", partial(survey_of, survey))
    if real is not None:
        jobs.judge(folder, "crossview", partial(crossview_of, real))
    if ship is not None:
        jobs.ship(folder, ship)
    _show(page or folder, files_of(folder))


study_app.command()(crossview)


def _run(plan: Plan, folder: Path, page: Path | None, work: _Work | None, files_of: _Files | None) -> None:
    """Run the open jobs of a plan (None: none), write its pages (None: none); raise a ValueError if a job failed."""
    from viewshed_lab.studies.store import PLAN, ResultStore

    if work is None and not (folder / PLAN).exists():
        raise ValueError(f"{folder} must hold results, got none; run without --no-run")
    store = ResultStore.open(folder, plan)
    failed = _with_bars(lambda progress: work(store, on_progress=progress)) if work else []
    if files_of is not None:
        _show(page or folder, files_of(store))
    _require_all_done(failed)


def _folder(out: Path | None, name: str) -> Path:
    """Return the absolute path of a study's folder: jobs may run in another working directory."""
    return (out or Path(name)).expanduser().resolve()


def _steps(only: str | None, known: tuple[str, ...]) -> tuple[str, ...]:
    chosen = known if only is None else tuple(only.split(","))
    if unknown := [step for step in chosen if step not in known]:
        raise ValueError(f"--only must be some of {', '.join(known)}, got {unknown[0]!r}")
    return chosen


def _require_all_done(failed: list[str]) -> None:
    if failed:
        raise ValueError(f"{len(failed)} jobs failed; finished jobs are kept, and the same command runs the rest")


def _show(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the pages of a study and print the path of the main page, the last one."""
    from viewshed._files import write_atomic
    from viewshed_lab._results import write_page

    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        if name.endswith(".md"):
            write_page(folder / name, content.decode())
        else:
            write_atomic(folder / name, content)
    typer.echo(f"Look at {folder / [*files][-1]}")


def _with_bars(run: Callable[[Progress], Iterator[str]]) -> list[str]:
    """Run jobs with a progress bar per step; print and return one line for each failed job."""
    from rich.progress import TaskID, TimeElapsedColumn, TimeRemainingColumn

    from viewshed.cli._outputs import progress_bar

    tasks: dict[str, TaskID] = {}
    fiftieths: dict[str, int] = {}
    bars = progress_bar(TimeElapsedColumn(), TimeRemainingColumn())

    def on_progress(step: str, done: int, total: int) -> None:
        raise_if_interrupted()
        if not bars.console.is_terminal:
            # Without a terminal, print a line for every fiftieth of the jobs.
            if (now := done * 50 // total) > fiftieths.get(step, 0):
                fiftieths[step] = now
                typer.echo(f"{step}: {done} of {total}", err=True)
            return
        if not tasks:
            bars.start()
        if step not in tasks:
            tasks[step] = bars.add_task(step, total=total)
        bars.update(tasks[step], completed=done)

    failed = []
    try:
        for line in run(on_progress):
            failed.append(line)
            bars.console.print(f"viewshed: {line}", markup=False, highlight=False, soft_wrap=True)
        return failed
    finally:
        if tasks:
            bars.stop()
