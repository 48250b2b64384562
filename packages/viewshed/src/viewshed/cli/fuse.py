"""``viewshed fuse``: fuse the views of several agents, and detect agents that contradict the others."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import DEFAULT_READING, Reading
from viewshed.cli._outputs import Failures, Named, make_folder, output_names, parse_results
from viewshed.cli._places import chosen_files
from viewshed.cli._profile import Method
from viewshed.cli._stream import named_sweeps
from viewshed.cli._terminal import BAD_INPUTS, note
from viewshed.cli.estimate import Files

if TYPE_CHECKING:
    from viewshed.agents.registration import PoseStd
    from viewshed.agents.report import AgentReport
    from viewshed.agents.rounds import Round
    from viewshed.estimators import Estimator
    from viewshed.objects.detector import Detector
    from viewshed.sweep import Sweep

FUSED, PAGE = "fused.jsonl", "fused.html"


def fuse(
    files: Files = None,
    method: Method = None,
    grid: options.GridName = "road",
    reading: Reading = DEFAULT_READING,
    index: options.Index = None,
    slop: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Maximum time difference of sweeps fused with each other, in seconds."),
    ] = 0.1,
    pose_std: Annotated[
        str | None,
        typer.Option(
            help="Standard deviation of poses: METERS,DEGREES up to 0.25,0.6; that stated by each sweep if not given."
        ),
    ] = None,
    results: Annotated[str, typer.Option(help="Files to write: some of jsonl,png,html.")] = "jsonl,png,html",
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("fused"),
) -> None:
    """Fuse what several agents see, and find who contradicts whom.

    The agents are those of a recording, or one for each file; their sweeps need times, and poses in one world frame.
    Prints one line for each time. Writes all numbers to fused.jsonl, and pictures and a page that show the agents,
    their joint view, the belief in each object, and who contradicts whom.

    Example: viewshed fuse junction.mcap --out fused
    """
    from viewshed._files import write_atomic
    from viewshed.agents.rounds import Round, Rounds
    from viewshed.objects.detector import Detector
    from viewshed.show.fused import fused_page, fused_picture

    kinds, std = parse_results(results, ("jsonl", "png", "html")), parse_pose_std(pose_std)
    estimator = options.NetworkOptions().estimator(method, options.parse_grid(grid), "car")
    detector = Detector()
    jobs = list(chosen_files(files or [], index))
    names = output_names([file for file, _ in jobs])
    make_folder(out)
    failures, center = Failures(), Rounds()
    done, pictures = list[Round](), list[bytes]()
    streams = [named_sweeps(reading, [job], [name], failures) for job, name in zip(jobs, names, strict=True)]
    for t_s, sweeps in rounds(streams, slop, failures):
        reports = []
        for sweep in sweeps:
            try:
                reports.append(report_of(sweep, estimator, detector, std))
            except BAD_INPUTS as error:  # go on with the other sweeps
                failures.report(f"{sweep.agent}, {t_s:.2f} s", error)
        fused = center.together(t_s, reports)
        for line in center.notes:
            note(line)
        if fused is None:
            failures.report(f"{t_s:.2f} s", ValueError("no report of this time could be fused with others"))
            continue
        typer.echo(line_of(fused))
        note_gaps(fused, done[-1] if done else None)
        done.append(fused)
        if {"png", "html"} & set(kinds):
            pictures.append(fused_picture(fused))
        if "png" in kinds:
            write_atomic(out / f"fused_{len(done) - 1:04}.png", pictures[-1])
    if "jsonl" in kinds and done:
        write_atomic(out / FUSED, "".join(f"{json.dumps(one.numbers())}\n" for one in done).encode())
    if "html" in kinds and done:
        write_atomic(out / PAGE, fused_page(done, pictures, f"{len(done[-1].picture.agents)} agents fused"))
    if done:
        typer.echo(f"{len(done)} times → {out}")
    if failures.count or not done:
        if not done and not failures.count:
            raise ValueError("sweeps must have times and poses to be fused, got none that do")
        raise typer.Exit(2)


def rounds(streams: list[Iterator[Named]], slop: float, failures: Failures) -> Iterator[tuple[float, list[Sweep]]]:
    """Yield groups of sweeps of about the same time, at most one per agent; report sweeps without time or pose."""
    posed = (_with_times(stream, number, failures) for number, stream in enumerate(streams))
    together: dict[str, Sweep] = {}
    began_ns = 0
    for t_ns, number, _, named in heapq.merge(*posed, key=lambda row: row[:3]):
        agent = named.sweep.agent if len(streams) == 1 else f"{named.sweep.agent}{number}"
        if together and (t_ns - began_ns > 1e9 * slop or agent in together):
            yield began_ns / 1e9, list(together.values())
            together = {}
        if not together:
            began_ns = t_ns
        together[agent] = named.sweep.replace(agent=agent)
    if together:
        yield began_ns / 1e9, list(together.values())


def _with_times(stream: Iterator[Named], number: int, failures: Failures) -> Iterator[tuple[int, int, int, Named]]:
    for place, named in enumerate(stream):
        if named.sweep.t_ns is None or named.sweep.world_from_sensor is None:
            problem = "sweeps must have a time and a pose to be fused; give --poses FILE"
            failures.report(named.file, ValueError(problem))
        else:
            yield named.sweep.t_ns, number, place, named


def parse_pose_std(words: str | None) -> PoseStd | None:
    """Parse standard deviations METERS,DEGREES; None stays None."""
    from math import degrees, radians

    from viewshed.agents.registration import MAX_STD_M, MAX_YAW_STD, PoseStd

    if words is None:
        return None
    try:
        place_m, yaw_deg = (float(part) for part in words.split(","))
        std = PoseStd(place_m, radians(yaw_deg))
    except ValueError as error:
        raise ValueError(f"--pose-std must be METERS,DEGREES, both 0 or more, got {words!r}; as 0.2,0.5") from error
    if std.bounded != std:
        note(f"--pose-std {words}: reduced to the maximum, {MAX_STD_M:g} m and {degrees(MAX_YAW_STD):g}°")
    return std


def report_of(sweep: Sweep, estimator: Estimator, detector: Detector, pose_std: PoseStd | None = None) -> AgentReport:
    """Return the report of a sweep's agent; ``pose_std`` None is the deviation that the sweep states."""
    from dataclasses import replace

    from viewshed.agents.registration import PoseStd
    from viewshed.agents.report import AgentReport
    from viewshed.preprocess.leveling import leveled_on

    leveled = leveled_on(sweep, estimator.grid)
    estimate = replace(estimator.estimate(leveled), agent=sweep.agent)
    return AgentReport.of(estimate, detector.detect(leveled), pose_std or PoseStd.stated_by(sweep), leveled.ground)


def note_gaps(done: Round, before: Round | None) -> None:
    """Note why nobody can contradict an agent, unless the last round had the same gap."""
    known = [] if before is None else before.gaps()
    for line in done.gaps():
        if line not in known:
            note(line)


def line_of(done: Round) -> str:
    """Return one line about a round: objects, accused agents with reasons, and disputed agents."""
    picture = done.picture
    accused = [f"{agent} ({why})" for agent, why in done.reasons().items()]
    disputed = [agent for agent, flag in zip(picture.agents, done.disputed, strict=True) if flag]
    verdicts = "".join(
        f"; {word} {', '.join(agents)}" for word, agents in (("ACCUSED", accused), ("disputed", disputed)) if agents
    )
    objects = f"{picture.believed.sum()} of {len(picture.tracks)} objects believed"
    return f"{picture.t_s:.2f} s: {objects}{verdicts}"
