"""``viewshed estimate``: estimate the fields of view of files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import (
    DEFAULT_READING,
    AbstainBelow,
    Device,
    HistorySweeps,
    MonitorFile,
    NetworkOptions,
    Passes,
    Reading,
    RequireConfirmation,
    Seed,
    Weights,
    WithMonitor,
)
from viewshed.cli._outputs import (
    Failures,
    Run,
    make_folder,
    output_names,
    parse_results,
    refuse_inputs,
    total_line,
)
from viewshed.cli._places import chosen_files
from viewshed.cli._profile import Method
from viewshed.cli._stream import named_sweeps
from viewshed.cli._verdicts import optional_monitor

Files = Annotated[
    list[Path] | None,
    typer.Argument(metavar="FILE...", help="Sweeps in any known format, folders of them, patterns, or recordings."),
]

Threshold = Annotated[
    float | None,
    typer.Option(help="Probability from which a cell counts as visible; the estimator's own if not given."),
]

Batch = Annotated[
    int,
    typer.Option(
        min=1, max=1024, help="Sweeps estimated at the same time, one on each core; above 1 no times are printed."
    ),
]

Certify = Annotated[
    str | None,
    typer.Option(
        metavar="THREAT",
        help="Claim only cells that no such attack can have made visible: added (any points), replaced:5 (beams),"
        " window:5, wedge:10 (degrees), dropped:5. Needs --sensor, --height and --attitude, unless the file states"
        " them.",
    ),
]

Together = Annotated[
    bool,
    typer.Option(
        "--together",
        help="Make one estimate of all sweeps: they are of several LiDARs of one vehicle at one time. Needs their"
        " mounting poses, by --poses or --index.",
    ),
]

Results = Annotated[
    str,
    typer.Option(help="Files to write for each sweep: some of png,geojson,npz, or other formats of viewshed export."),
]


def estimate(
    files: Files = None,
    method: Method = None,
    grid: options.GridOfWeights = None,
    reading: Reading = DEFAULT_READING,
    index: options.Index = None,
    crs: options.Crs = None,
    target: options.TargetOfWeights = None,
    parameters: options.Parameters = "sound",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    abstain_below: AbstainBelow = None,
    device: Device = "cpu",
    threshold: Threshold = None,
    history: HistorySweeps = 0,
    require_confirmation: RequireConfirmation = False,
    batch: Batch = 1,
    certify: Certify = None,
    together: Together = False,
    monitor: WithMonitor = False,
    monitor_file: MonitorFile = None,
    results: Results = "png,geojson,npz",
    dark: Annotated[bool, typer.Option("--dark", help="Draw pictures on a dark background.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="For programs: print one JSON object per sweep, one per line.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print only errors and warnings.")] = False,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("out"),
) -> None:
    """Estimate what each sweep could see: picture, GeoJSON and NPZ.

    A file that cannot be read gives one line on standard error and does not stop the others; the exit code is then 2.

    Example: viewshed estimate sweep.pcd.bin --out out
    """
    from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
    from viewshed.guarantees.envelope import Threat
    from viewshed.io.export.crs import crs_of

    if history and batch > 1:
        raise ValueError(
            "--history needs --batch 1: each sweep is added to the history before the next one is estimated"
        )
    if (monitor or monitor_file) and batch > 1:
        raise ValueError("--monitor needs --batch 1: it judges a sweep by those before it")
    if require_confirmation and not history:
        raise ValueError("--require-confirmation needs --history 1 or more: it claims what earlier sweeps saw")
    if together and (history or batch > 1 or certify or monitor or monitor_file):
        raise ValueError("--together makes one estimate: leave out --history, --batch, --certify and --monitor")
    if json and quiet:
        raise ValueError("--json and --quiet exclude each other; leave one out")
    kinds = parse_results(results)
    network = NetworkOptions(weights, passes, seed, abstain_below, device)
    estimator = network.estimator(method, None if grid is None else options.parse_grid(grid), target, parameters)
    if history:
        estimator = TemporalEstimator(estimator, SweepBuffer(history), require_confirmation)
    watch = optional_monitor(monitor, monitor_file)
    run = Run(estimator, network.threshold(threshold, estimator, parameters), out, kinds, watch, crs, dark)
    run.certify = None if certify is None else Threat.parse(certify)
    reading = replace(reading, crs=crs)
    if crs is not None:
        crs_of(crs)
    jobs = list(chosen_files(files or [], index))
    names = output_names([file for file, _ in jobs])
    joint_name = f"{names[0]}_together"
    output = [joint_name] if together else names
    refuse_inputs((place for name in output for place in run.places(name)), (file for file, _ in jobs))
    make_folder(out)
    failures, areas_m2, times_ms = Failures(), list[float](), list[float | None]()
    sweeps = named_sweeps(reading, jobs, names, failures, history=history)
    for summary in run.together(sweeps, joint_name) if together else run.summaries(sweeps, failures, batch):
        areas_m2.append(summary.estimate.area_m2())
        times_ms.append(summary.elapsed_ms)
        if not quiet:
            typer.echo(summary.json if json else summary.line)
    if len(areas_m2) > 1 and not quiet and not json:
        typer.echo(total_line(areas_m2, times_ms))
    if failures.count:
        raise typer.Exit(2)
