"""``viewshed attack`` and ``viewshed corrupt``: tamper with the sweeps of a data set, a recording or a file."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO, Reading
from viewshed.cli._outputs import refuse_inputs
from viewshed.cli._terminal import complain
from viewshed.recordings.recording import is_data_set
from viewshed_lab.cli._data_sets import build_with_bar, data_set_line

if TYPE_CHECKING:
    from viewshed.grid import BevGrid
    from viewshed_lab.data.tampered import AttackPlan, Sweeps, TamperPlan


Out = Annotated[str, typer.Option(help="Folder or URI of the data set; for one sweep also a file (sweep.npz).")]
Seed = Annotated[int, typer.Option(help="Random seed.")]


def attack(
    sources: options.Sources,
    attack: Annotated[
        str, typer.Option(help="far_wall, relay, jamming, … (an unknown name lists all), or paper: the published mix.")
    ],
    out: Out,
    budget: Annotated[
        str | None,
        typer.Option(help="Number of returns the attacker may change, or full; the attack's own limit if not given."),
    ] = None,
    mode: Annotated[
        str | None,
        typer.Option(help="Where false points may lie: free_form (anywhere) or beam_constrained (on beams)."),
    ] = None,
    placement: Annotated[
        str | None,
        typer.Option(help="Direction of the attack: random, behind_nearest_obstacle or largest_hidden_area."),
    ] = None,
    victim: Annotated[
        str | None,
        typer.Option(help="For adaptive attacks: the method that the attacker queries; shadow_map if not given."),
    ] = None,
    seed: Seed = 0,
    split: options.Split = None,
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    workers: options.Workers = None,
    engine: options.EngineName = "local",
) -> None:
    """Attack every sweep of a data set; its truth does not change.

    The output records which returns changed. A sweep that cannot be attacked is skipped with one line on standard
    error; the exit code is then 2. A stopped run resumes. The output is the same, byte for byte, for any --workers.

    Example: viewshed attack sweeps --attack far_wall --budget 150 --out attacked
    """
    from viewshed_lab.threats.attacks import EARLIER

    chosen = (attack, budget, mode, placement, victim)
    _attack_plan(*chosen, options.parse_grid(grid))  # rejects invalid options before SRC is read
    sweeps = _opened(sources, split, grid, sensor)
    if attack in EARLIER and all(part.last <= 1 for part in sweeps.parts):
        raise ValueError(f"{attack} needs an earlier sweep, got one sweep per scene; give a recording or a data set")
    plan = _attack_plan(*chosen, sweeps.layout.grid)
    _run(sources, sweeps, plan, out, seed, engine, workers)


def _attack_plan(
    attack: str, budget: str | None, mode: str | None, placement: str | None, victim: str | None, grid: BevGrid
) -> AttackPlan:
    from viewshed_lab.data.tampered import AttackPlan
    from viewshed_lab.threats.attacks.adaptive import ADAPTIVE

    half_m, returns = float(grid.half_extent_m), _budget(budget, attack)
    if attack not in ADAPTIVE:
        if victim is not None:
            raise ValueError(f"--victim goes with {', '.join(ADAPTIVE)}, got {attack}")
        return AttackPlan(attack, returns, mode, half_m, placement)
    name = victim or "shadow_map"
    estimator = options.NetworkOptions().estimator(name, grid, "car")
    return AttackPlan(attack, returns, mode, half_m, placement, name, estimator)


def corrupt(
    sources: options.Sources,
    corruption: Annotated[str, typer.Option(help="rain, fog, snow, fewer_beams, … (an unknown name lists all).")],
    out: Out,
    severity: Annotated[int, typer.Option(help="From 1 (mild) to 5 (severe).")] = 3,
    seed: Seed = 0,
    split: options.Split = None,
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    workers: options.Workers = None,
    engine: options.EngineName = "local",
) -> None:
    """Corrupt every sweep of a data set: weather, sensor faults.

    Its truth does not change. A sweep that cannot be read is skipped. A stopped run resumes.

    Example: viewshed corrupt sweeps --corruption fog --severity 4 --out foggy
    """
    from viewshed_lab.data.tampered import CorruptionPlan

    plan = CorruptionPlan(corruption, severity)
    _run(sources, _opened(sources, split, grid, sensor), plan, out, seed, engine, workers)


def _file_of(sources: Sequence[str], out: str) -> Path | None:
    """Return the file to write if the source is one file and ``out`` is named like a sweep, else None."""
    from viewshed.io import FORMATS

    written = tuple(suffix for form in FORMATS.values() if form.write is not None for suffix in form.suffixes)
    is_sweep = "://" not in out and out.lower().removesuffix(".gz").endswith(written)
    return Path(out) if is_sweep and len(sources) == 1 and Path(sources[0]).is_file() else None


def _budget(text: str | None, attack: str) -> int | None:
    """Parse a budget; ``full`` is every beam of the wedge.

    >>> _budget("150", "far_wall")
    150
    """
    from viewshed_lab.threats.attacks import FREE_FORM, FULL_WEDGE

    if text is None or text.isdecimal():
        return None if text is None else int(text)
    if text != "full":
        raise ValueError(f"budget must be a whole number of returns or full, got {text!r}")
    if attack in FREE_FORM:
        raise ValueError(
            f"budget must be a number for {attack}: it places free points and has no wedge to fill, got full"
        )
    return FULL_WEDGE


def _opened(sources: Sequence[str], split: str | None, grid: str, sensor: str) -> Sweeps:
    from viewshed.io.formats import is_recording
    from viewshed_lab.data import Archive
    from viewshed_lab.data.tampered import sweeps_of_archive, sweeps_of_files, sweeps_of_recording

    first, parsed = Path(sources[0]), options.parse_grid(grid)
    if len(sources) == 1 and is_data_set(sources[0]):
        return sweeps_of_archive(Archive.open(sources[0]), split)
    if split is not None:
        raise ValueError(f"--split goes with a data set that has splits, got {sources[0]}")
    if len(sources) == 1 and is_recording(first):
        return sweeps_of_recording(str(first.absolute()), parsed)
    for path in map(Path, sources):
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such file; name one data set, one recording, or files")
    return sweeps_of_files([Path(source) for source in sources], Reading(sensor).sweeps, parsed)


def _run(
    sources: Sequence[str], sweeps: Sweeps, plan: TamperPlan, out: str, seed: int, engine: str, workers: int | None
) -> None:
    from viewshed_lab._jobs import engine_named
    from viewshed_lab.data.archive.storage import Storage
    from viewshed_lab.data.tampered import tamper

    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    for problem in sweeps.problems:
        complain(problem)
    failed, file = len(sweeps.problems), _file_of(sources, out)
    if file is not None:
        _to_file(Path(sources[0]), sweeps, plan, file, seed)
    else:
        make = partial(tamper, sweeps, plan, Storage.of(out), engine_named(engine, workers), seed)
        archive, problems = build_with_bar(plan.name, sweeps.count, make)
        failed += problems
        typer.echo(data_set_line(archive, f"{len(archive)} of {sweeps.count} sweeps"))
    if failed:
        raise typer.Exit(2)


def _to_file(source: Path, sweeps: Sweeps, plan: TamperPlan, file: Path, seed: int) -> None:
    from viewshed._files import write_atomic
    from viewshed.io import write_sweep
    from viewshed_lab.data.tampered import tampered_sweep

    if sweeps.count != 1:
        raise ValueError(f"{file} holds one sweep, the source has {sweeps.count}; name a folder as --out")
    record = file.with_name(f"{file.name}.touched.json")
    refuse_inputs((file, record), [source])
    sweep, about = tampered_sweep(sweeps, plan, seed)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_sweep(sweep, file)
    write_atomic(record, about.encode())
    typer.echo(f"{file}: {len(sweep)} returns; {record.name} records which changed")
