"""``viewshed compare``: compare several estimators on one sweep."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import DEFAULT_READING, Device, NetworkOptions, Passes, Reading, Seed, Weights
from viewshed.cli._outputs import refuse_inputs, report_doubts
from viewshed.cli._places import place_of_result
from viewshed.cli._stream import one_sweep

if TYPE_CHECKING:
    from viewshed.estimators import Estimator
    from viewshed.fov.estimate import FovEstimate
    from viewshed.grid import BevGrid
    from viewshed.preprocess.leveling import LeveledSweep


def compare(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A sweep, in any known format.")],
    methods: Annotated[
        str, typer.Option(help="Methods, separated by commas; 'all' for all but the networks.")
    ] = "shadow_map,majority_vote,first_blocker",
    grid: options.GridName = "road",
    reading: Reading = DEFAULT_READING,
    index: options.Index = None,
    number: options.Number = 0,
    target: options.TargetName = "car",
    parameters: options.Parameters = "sound",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    device: Device = "cpu",
    out: Annotated[str, typer.Option(help="Folder of the picture, or its file NAME.png.")] = "compare.png",
) -> None:
    """Show several estimators side by side: a picture and a table.

    Example: viewshed compare sweep.bin --methods shadow_map,quantized,concave_hull
    """
    from viewshed._files import write_atomic
    from viewshed.estimators import CLASSICAL, current_name, paper_estimators_on
    from viewshed.fov.estimate import UNSURE_M
    from viewshed.preprocess.leveling import level
    from viewshed.show.plot import Panel, comparison

    cells = options.parse_grid(grid)
    names = [current_name(name) for name in methods.split(",")]
    if methods == "all":
        names = list(paper_estimators_on(cells) if parameters == "paper" else CLASSICAL)
    estimators = _estimators(names, cells, target, parameters, NetworkOptions(weights, passes, seed, device=device))
    place = place_of_result(out, "compare.png")
    refuse_inputs([place], [file])
    sweep = one_sweep(reading, file, index, number)
    leveled = level(sweep, cells)  # shared by all estimators and not part of their times
    report_doubts(leveled, file.name)
    results = {name: _timed(estimator, leveled) for name, estimator in estimators.items()}
    first = results[names[0]][0]
    rows = [_row(name, estimate, elapsed_ms, first) for name, (estimate, elapsed_ms) in results.items()]
    panels = [Panel(estimate, name, leveled) for name, (estimate, _) in results.items()]
    header = [
        "method", "visible m²", "hidden", "unknown", f"ground unsure by {UNSURE_M:g} m", "by inferred beams",
        "IoU with the first", "time ms, leveled",
    ]  # fmt: skip
    write_atomic(place, comparison(panels, rows, header))
    typer.echo(_table(header, rows))
    if first.basis is not None:
        typer.echo(first.basis.height_line)
    typer.echo(f"→ {place}")


def _table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    line = "|---" * len(header) + "|"
    return "\n".join([f"| {' | '.join(header)} |", line, *(f"| {' | '.join(cells)} |" for cells in rows)])


def _estimators(
    names: list[str], grid: BevGrid, target: str, parameters: str, network: NetworkOptions
) -> dict[str, Estimator]:
    """Return the estimators by name; each gets the network options that it supports."""
    from viewshed.estimators import LEARNED

    if network != NetworkOptions() and not set(names) & set(LEARNED):
        raise ValueError(
            f"--weights, --passes, --seed and --device are for {', '.join(LEARNED)}, got methods {','.join(names)}"
        )
    one_pass = NetworkOptions(network.weights, device=network.device)
    supported = dict.fromkeys(LEARNED, one_pass) | {"mc_dropout": network}
    return {name: supported.get(name, NetworkOptions()).estimator(name, grid, target, parameters) for name in names}


def _timed(estimator: Estimator, leveled: LeveledSweep) -> tuple[FovEstimate, float]:
    """Return estimate and milliseconds of the second call; the first one is a warm-up."""
    estimator.estimate(leveled)
    start = time.perf_counter()
    return estimator.estimate(leveled), 1e3 * (time.perf_counter() - start)


def _row(name: str, estimate: FovEstimate, elapsed_ms: float, first: FovEstimate) -> list[str]:
    from viewshed.fov.estimate import CellState

    mask, reference = estimate.visible(), first.visible()
    either = int((mask | reference).sum())
    overlap = int((mask & reference).sum()) / either if either else 1.0
    shares = [f"{estimate.share(state):.1%}" for state in (CellState.HIDDEN, CellState.UNKNOWN)]
    basis = estimate.basis
    rests_on = ["", ""] if basis is None else [f"{basis.unsure_ground_share:.0%}", f"{basis.inferred_share:.0%}"]
    return [name, f"{estimate.area_m2():.0f}", *shares, *rests_on, f"{overlap:.3f}", f"{elapsed_ms:.1f}"]
