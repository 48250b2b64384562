"""``viewshed compare``: several estimators on one sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO, Device, Network, Passes, Reading, Seed, Weights, timed
from viewshed.cli._outputs import refuse_inputs

if TYPE_CHECKING:
    from viewshed.fov.estimate import CellState, FovEstimate, FovEstimator
    from viewshed.grid import BevGrid
    from viewshed.sweep import Sweep


_HEADER = ("method", "visible m²", "hidden", "unknown", "IoU with the first", "time ms")


def compare(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A sweep, in any known format.")],
    methods: Annotated[
        str, typer.Option(help="Estimators, with commas; 'all' for every one but the networks.")
    ] = "shadow_map,vote,first_blocker",
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    format: options.FormatName = AUTO,  # noqa: A002
    file_frame: options.FrameName = None,
    height: options.Height = None,
    attitude: options.Attitude = None,
    index: options.Index = None,
    target: options.TargetName = "car",
    profile: options.Profile = "sound",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    device: Device = "cpu",
    out: Annotated[Path, typer.Option(help="The picture.")] = Path("compare.png"),
) -> None:
    """Show several estimators side by side: a picture and a table.

    Example: viewshed compare sweep.bin --methods shadow_map,quantized,concave_hull
    """
    from viewshed._files import write_atomic
    from viewshed._page import table
    from viewshed.plot import Panel, comparison
    from viewshed.preprocess.leveling import level

    cells = options.parse_grid(grid)
    names = list(options.estimators_of(profile, cells)) if methods == "all" else methods.split(",")
    estimators = _estimators(names, cells, target, profile, Network(weights, passes, seed, device=device))
    [(path, entry)] = options.chosen([file], index)
    refuse_inputs([out], [file])
    sweep = Reading(sensor, format, file_frame, height, attitude).sweep(path, entry)
    leveled = level(sweep, cells)
    found = {name: _second(estimator, sweep) for name, estimator in estimators.items()}
    rows = [_row(name, estimate, elapsed_ms, found[names[0]][0]) for name, (estimate, elapsed_ms) in found.items()]
    write_atomic(
        out, comparison([Panel(estimate, name, leveled) for name, (estimate, _) in found.items()], rows, _HEADER)
    )
    typer.echo(table(_HEADER, rows))
    typer.echo(f"→ {out}")


def _estimators(
    names: list[str], grid: BevGrid, target: str, profile: str, network: Network
) -> dict[str, FovEstimator]:
    """Return the estimators by name; what is said about the network goes to those that are networks."""
    from viewshed.estimators.unet import LEARNED

    if network != Network() and not set(names) & set(LEARNED):
        raise ValueError(
            f"--weights, --passes, --seed and --device go with unet, mcd or viewnet, got methods {','.join(names)}"
        )
    one = Network(network.weights, device=network.device)
    rules = {"unet": one, "mcd": network, "viewnet": one}
    return {name: rules.get(name, Network()).estimator(name, grid, target, profile) for name in names}


def _second(estimator: FovEstimator, sweep: Sweep) -> tuple[FovEstimate, float]:
    """Return the estimate and the milliseconds of a second call; the first one loads compiled code."""
    timed(estimator, sweep)
    return timed(estimator, sweep)


def _row(name: str, estimate: FovEstimate, elapsed_ms: float, first: FovEstimate) -> list[str]:
    mask, reference = estimate.visible(), first.visible()
    either = int((mask | reference).sum())
    overlap = int((mask & reference).sum()) / either if either else 1.0
    shares = [f"{estimate.share(state):.1%}" for state in _hidden_and_unknown()]
    return [name, f"{estimate.area_m2():.0f}", *shares, f"{overlap:.3f}", f"{elapsed_ms:.1f}"]


def _hidden_and_unknown() -> tuple[CellState, CellState]:
    from viewshed.fov.estimate import CellState

    return CellState.HIDDEN, CellState.UNKNOWN
