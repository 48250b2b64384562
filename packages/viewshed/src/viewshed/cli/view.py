"""``viewshed view``: show a recording's estimates as one HTML page, in Rerun or live in Foxglove."""

from __future__ import annotations

import os
import socket
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import (
    DEFAULT_READING,
    NO_OBJECTS,
    HistorySweeps,
    MonitorFile,
    NetworkOptions,
    ObjectOptions,
    Passes,
    Reading,
    Seed,
    Weights,
    WithMonitor,
)
from viewshed.cli._outputs import (
    Failures,
    Named,
    Streams,
    output_names,
    refuse_inputs,
    report_doubts,
    summary_line,
    warm_up,
)
from viewshed.cli._places import chosen_files
from viewshed.cli._profile import Method, PipelineOptions, ProfileName, at_rate
from viewshed.cli._record import Center, PendingSweep, answer, note_unmet, objects_line, repeated
from viewshed.cli._stream import history_buffer, named_sweeps
from viewshed.cli._terminal import BAD_INPUTS, complain, one_line
from viewshed.cli._verdicts import optional_monitor, stream_monitor, stream_verdicts, verdicts
from viewshed.cli.estimate import Files
from viewshed.cli.monitor import estimator_of
from viewshed.cli.replay import Pacer

if TYPE_CHECKING:
    from viewshed.agents.rounds import Round
    from viewshed.estimators import Estimator
    from viewshed.estimators.temporal import SweepBuffer
    from viewshed.fov.estimate import FovEstimate
    from viewshed.monitor import StreamMonitor
    from viewshed.monitor.stream_monitor import StreamReport
    from viewshed.pipeline.adversary import Adversary
    from viewshed.pipeline.profiles import Profile
    from viewshed.preprocess.leveling import LeveledSweep
    from viewshed.show.view import Frame, PackedFrame

    Check = Callable[[LeveledSweep, FovEstimate], tuple[StreamReport, str]]
    """Returns a monitor's report on the next sweep and its estimate, and the same as text."""

Step = Annotated[int, typer.Option(min=1, help="Take every Nth sweep.")]

MaxSweeps = Annotated[int | None, typer.Option("--sweeps", min=1, help="End after this number of sweeps.")]


def view(
    ctx: typer.Context,
    files: Files = None,
    html: Annotated[Path | None, typer.Option(help="HTML page to write, one file that needs no network.")] = None,
    rerun: Annotated[Path | None, typer.Option(help="The file to write for Rerun: NAME.rrd.")] = None,
    foxglove: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Serve live to Foxglove at this port, until Ctrl-C.")
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Serve a page on which to drop files, to this machine only, until Ctrl-C.")
    ] = False,
    profile: ProfileName = None,
    method: Method = None,
    grid: options.GridName = "road",
    reading: Reading = DEFAULT_READING,
    index: options.Index = None,
    target: options.TargetName = "car",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    monitor: WithMonitor = False,
    monitor_file: MonitorFile = None,
    history: HistorySweeps = 0,
    step: Step = 1,
    sweeps: MaxSweeps = None,
    object_options: ObjectOptions = NO_OBJECTS,
) -> None:
    """Show what sweeps could see: a page, a file for Rerun, or live.

    The page is for any browser, has a map and a timeline and needs no network. Foxglove gets the sweeps live, at the
    pace at which they were measured, over and over unless --sweeps is given, and late ones are dropped.

    A file that cannot be read gives one line on standard error and does not stop the others; the exit code is then 2.

    Example: viewshed view drive.mcap --html run.html --step 5
    """
    if [html, rerun, foxglove].count(None) + (not serve) != 3:
        raise ValueError("give exactly one of --html run.html, --rerun run.rrd, --foxglove PORT and --serve")
    of_files = (files, index, monitor, monitor_file, history, sweeps, step > 1, object_options != NO_OBJECTS)
    if serve and any(of_files):
        alone = "FILES, --index, --monitor, --history, --sweeps, --step, --objects, --fuse and --attack"
        raise ValueError(f"--serve takes files on its page, one after the other: leave out {alone}, or use --html")
    settings = PipelineOptions(profile, method, grid, history=history, monitor=monitor).settings(ctx)
    network, cells = NetworkOptions(weights, passes, seed), options.parse_grid(settings.grid)
    if serve:
        _serve_page(reading, network.estimator(settings.method, cells, target))
        return
    jobs = list(chosen_files(files or [], index))
    places = [file for file, _ in jobs]
    failures, names = Failures(), output_names(places)

    def read() -> Iterator[Named]:
        return named_sweeps(reading, jobs, names, failures, history=history)

    if foxglove is not None:
        estimator = network.estimator(settings.method, cells, target)
        watch, live = optional_monitor(settings.monitor, monitor_file), repeated(read, loop=sweeps is None)
        taken = islice(at_rate(live, settings.rate_hz), 0, None if sweeps is None else step * sweeps, step)
        buffer = history_buffer(estimator, settings.history)
        _serve(foxglove, taken, estimator, buffer, watch, settings, failures, object_options)
    else:
        fitted_on, check, watch = None, None, None
        if settings.monitor or monitor_file:
            fitted_on, check, watch = _monitored(monitor_file, weights, method)
        estimator = fitted_on or network.estimator(settings.method, cells, target)
        taken = islice(at_rate(read(), settings.rate_hz), 0, None if sweeps is None else step * sweeps, step)
        buffer = history_buffer(estimator, settings.history)
        reacting = None if profile is None else settings
        frames = _frames(taken, estimator, buffer, check, failures, object_options, watch, reacting)
        title = f"{places[0].name or places[0]}{f' and {len(places) - 1} more' if len(places) > 1 else ''}"
        typer.echo(_written(html, rerun or Path(), frames, title, places))
    if failures.count:
        raise typer.Exit(2)


def _written(
    html: Path | None, rerun: Path, frames: Iterator[tuple[Frame, str]], title: str, inputs: list[Path]
) -> str:
    """Write the page, or else the file for Rerun; print a line for each frame; return a line with path and size."""
    from viewshed.show.view import pack_frame, write_page

    def packed() -> Iterator[PackedFrame]:
        for frame, line in frames:
            packed_frame = pack_frame(frame)
            typer.echo(f"{line}; {len(packed_frame.data) / 1e3:.1f} kB")
            yield packed_frame

    def shown() -> Iterator[Frame]:
        for frame, line in frames:
            typer.echo(line)
            yield frame

    refuse_inputs([html or rerun], inputs)
    if html is not None:
        return f"{html}: {write_page(html, packed(), title) / 1e6:.2f} MB"
    from viewshed.show.view.rerun import write_rerun

    return f"{rerun}: {write_rerun(rerun, shown(), title) / 1e6:.2f} MB"


PAGE_PORT = 8765
"""Port of the drop page, unless it is taken."""

_SWEEPS_SHOWN = 50
"""Maximum number of sweeps shown of a dropped file."""


def _serve_page(reading: Reading, estimator: Estimator) -> None:
    """Serve the drop page until Ctrl-C."""
    from viewshed.preprocess.plausibility import doubts
    from viewshed.show.view import pack_frame, write_page
    from viewshed.show.view.serve import RefusedFileError, serving

    def page_of(name: str, content: bytes) -> tuple[bytes, str]:
        message: list[str] = []

        def packed(frames: Iterator[tuple[Frame, str]]) -> Iterator[PackedFrame]:
            for frame, line in frames:
                typer.echo(line)
                message[:] = [line, *(doubts(frame.leveled) if frame.leveled is not None else ())]
                yield pack_frame(frame)

        with tempfile.TemporaryDirectory(prefix="viewshed") as folder:
            file, page = Path(folder, name), Path(folder, "page.html")
            file.write_bytes(content)
            try:
                sweeps = islice((Named(sweep, name, file) for sweep in reading.sweeps(file)), _SWEEPS_SHOWN)
                frames = _frames(sweeps, estimator, None, None, _Raising(), NO_OBJECTS)
                write_page(page, packed(frames), name)
            except BAD_INPUTS as error:
                line = one_line(error).replace(f"{folder}{os.sep}", "")
                complain(line)
                raise RefusedFileError(line) from error
            return page.read_bytes(), "; ".join(message)

    with socket.socket() as probe:
        is_taken = probe.connect_ex(("127.0.0.1", PAGE_PORT)) == 0
    with serving(0 if is_taken else PAGE_PORT, page_of) as server:
        typer.echo(f"open http://127.0.0.1:{server.server_address[1]}/ and drop a file on it; Ctrl-C ends")
        server.serve_forever()


class _Raising(Failures):
    """Raises failures instead of reporting them, for a single file."""

    def report(self, file: Path | str, error: Exception) -> None:
        """Raise the error."""
        raise error


def _serve(
    port: int,
    sweeps: Iterable[Named],
    estimator: Estimator,
    buffer: SweepBuffer | None,
    watch: StreamMonitor | None,
    settings: Profile,
    failures: Failures,
    object_options: ObjectOptions,
) -> None:
    """Show sweeps live in Foxglove, at their measured pace."""
    from viewshed.recordings.write.foxglove_topics import foxglove_server

    pace = Pacer(1.0)
    with foxglove_server(port) as record:
        typer.echo(f"open ws://localhost:{port} in Foxglove; Ctrl-C ends")
        pending = (PendingSweep(one.sweep.agent, pace.time_s, one.sweep, scene=one.scene) for one in pace.kept(sweeps))
        answer([record], pending, estimator, buffer, watch, settings, object_options, failures, is_live=True)


def _monitored(
    file: Path | None, weights: str | None, method: str | None
) -> tuple[Estimator | None, Check, StreamMonitor | None]:
    """Return the estimator that a monitor was fitted on or None, a check of each sweep, and a stream monitor if any."""
    from viewshed.monitor import load_monitor
    from viewshed.monitor.calibration import kind_of_monitor
    from viewshed.monitor.deviation import NAME as DEVIATION
    from viewshed.monitor.stream_monitor import StreamReport

    if file is not None and kind_of_monitor(file) == DEVIATION:
        if method not in {None, "mc_dropout"}:
            raise ValueError(f"--monitor-file was fitted on mc_dropout, got --method {method}; leave out --method")
        fitted = load_monitor(file)

        def check_estimate(_: LeveledSweep, estimate: FovEstimate) -> tuple[StreamReport, str]:
            report = fitted.check(estimate)
            return StreamReport(report, report.alarm), verdicts(report)

        return estimator_of(fitted, weights), check_estimate, None
    stream = stream_monitor(file)

    def check(leveled: LeveledSweep, estimate: FovEstimate) -> tuple[StreamReport, str]:
        report = stream.check(leveled, estimate.grid)
        return report, stream_verdicts(report)

    return None, check, stream


def _frames(
    sweeps: Iterable[Named],
    estimator: Estimator,
    buffer: SweepBuffer | None,
    check: Check | None,
    failures: Failures,
    object_options: ObjectOptions,
    watch: StreamMonitor | None = None,
    profile: Profile | None = None,
) -> Iterator[tuple[Frame, str]]:
    """Yield a frame and a line of text for each sweep; the sensor of the last sweep is tried first.

    If agents are fused, yield a frame for each round instead. With a profile, its reactions withdraw claims.
    """
    from viewshed.agents.legend import tracks_of_agent
    from viewshed.pipeline.reactions import ReactionState, react
    from viewshed.pipeline.stream import claims_left, finding_on
    from viewshed.preprocess.leveling import level
    from viewshed.preprocess.sensor_identification import UNIDENTIFIED
    from viewshed.show.view import Frame

    adversary = object_options.adversary()
    objects, center = object_options.object_stream(adversary), Center(adversary) if object_options.fuse else None
    sensor, is_warm, seen = UNIDENTIFIED, False, None
    streams, states = Streams(is_judged=watch is not None), dict[str, ReactionState]()  # of each agent
    for named in sweeps:
        if streams.begins(named.scene, named.sweep):
            sensor = UNIDENTIFIED
            states.clear()
            for memory in (buffer, objects, watch):
                if memory is not None:
                    memory.reset()
            center = Center(adversary) if object_options.fuse else None
        try:
            if not is_warm:
                warm_up(estimator, named.sweep)
                is_warm = True
            begin_s = time.perf_counter()
            sweep = named.sweep if adversary is None else adversary.sweep(named.sweep)
            leveled = level(sweep, estimator.grid, sensor)
            history = None if buffer is None else buffer.history(leveled)
            leveled = leveled if history is None else history.now
            estimate = estimator.estimate(leveled, history)
            elapsed_ms = 1e3 * (time.perf_counter() - begin_s)
            of_stream, findings = (None, "") if check is None else check(leveled, estimate)
            report = None if of_stream is None else of_stream.now
            seen = None if objects is None else objects.follow(leveled, estimate, report)
            if profile is not None:
                is_accused = center is not None and sweep.agent in center.accused
                finding = finding_on(estimate, of_stream, seen, is_accused=is_accused)
                state = react(finding, states.get(sweep.agent, ReactionState()), profile.rules)
                states[sweep.agent] = state
                estimate, notes = claims_left(
                    estimate, leveled, history, finding, state, profile.rules, profile.certify
                )
                findings = "; ".join(filter(None, [findings, *notes]))
            done = None if center is None or seen is None else center.add(sweep, estimate, seen)
        except BAD_INPUTS as error:
            failures.report(named.file, error)
            continue
        if buffer is not None:
            buffer.add(leveled)
        sensor = leveled.sensor_id
        report_doubts(leveled, named.name)
        line = f"{named.name}: {summary_line(estimate, elapsed_ms)}{f'; {findings}' if findings else ''}"
        line += "" if seen is None else objects_line(seen)
        if done is not None:
            yield _round_frame(done, adversary), line
        elif center is None:
            detections = None if seen is None else seen.detections
            tracks = None if seen is None else tracks_of_agent(seen).moved(seen.tracks_from_level.inverse())
            yield Frame(named.name, estimate, leveled, report, detections, tracks), line
    note_unmet(adversary)


def _round_frame(done: Round, adversary: Adversary | None) -> Frame:
    """Return the frame of a round: joint view, joint tracks, and trust in each agent."""
    from viewshed.agents.legend import tracks_of_center
    from viewshed.show.view import AgentTrust, Frame

    picture, joint = done.picture, done.joint
    trust = tuple(
        AgentTrust(
            agent, float(picture.verdicts.trust[n]), bool(done.accused[n]), bool(done.disputed[n]),
            adversary is not None and adversary.attacks(agent),
        )
        for n, agent in enumerate(picture.agents)
    )  # fmt: skip
    tracks = tracks_of_center(picture).moved(joint.world_from_grid.inverse())
    return Frame(
        f"{len(done.reports)} agents, {picture.t_s:.2f} s", joint.estimate(done.t_ns), tracks=tracks, trust=trust,
        lies=tuple(done.sentences()),
    )  # fmt: skip
