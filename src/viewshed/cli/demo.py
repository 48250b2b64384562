"""``viewshed demo``: a simulated junction, what its sensor saw, and what it could have seen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import NetworkOptions
from viewshed.cli._outputs import Run

if TYPE_CHECKING:
    from viewshed.fov.estimate import FovEstimate
    from viewshed.grid import BevGrid
    from viewshed.sim.observe import Observation


SEED, TIME_S = 20, 5.0


def demo(
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("demo"),
    seed: Annotated[int, typer.Option(help="Of the junction and all in it.", min=0)] = SEED,
) -> None:
    """Simulate a junction, estimate what a sensor in it sees, and compare with the exact truth.

    Writes demo.png (the estimate), demo_truth.png (estimate and truth side by side), GeoJSON and NPZ.

    Example: viewshed demo --out demo
    """
    from viewshed._files import write_atomic

    out.mkdir(parents=True, exist_ok=True)
    grid = options.parse_grid("road")
    estimator = NetworkOptions().estimator(None, grid, "car")
    seen = _junction(seed, grid)
    sweep = seen.image.sweep()
    estimate, summary = Run(estimator, estimator.threshold, out).one(sweep, "demo")
    typer.echo(summary)
    picture, line = _beside_truth(estimate, seen)
    write_atomic(out / "demo_truth.png", picture)
    typer.echo(f"demo: {line} → {out / 'demo_truth.png'}")
    typer.echo(f"Look at {(out / 'demo.png').resolve()}")


def _junction(seed: int, grid: BevGrid) -> Observation:
    import numpy as np

    from viewshed.sim.observe import Setting, observe
    from viewshed.sim.world import AgentPlan
    from viewshed.sim.worlds import WORLDS

    world = WORLDS["junction"](np.random.default_rng(seed), AgentPlan())
    return observe(world, world.agents[0], TIME_S, Setting(grid), np.random.SeedSequence(seed))


def _beside_truth(estimate: FovEstimate, seen: Observation) -> tuple[bytes, str]:
    """Return a PNG of estimate and truth, and precision and recall of the estimate in one line."""
    import numpy as np

    from viewshed.fov.estimate import FovEstimate
    from viewshed.metrics import ConfusionCounts
    from viewshed.plot import Panel, comparison

    name, true = estimate.target.name, seen.truth.visible(estimate.target)
    exact = FovEstimate(estimate.grid, true.astype(np.float32), seen.truth.state[name], method="exact truth")
    counts = ConfusionCounts.of(estimate.visible(), true, seen.known, estimate.grid.cell_area_m2)
    scores = [f"{value:.3f}" for value in (counts.precision, counts.recall, counts.f1)]
    panels = [Panel(estimate, estimate.method), Panel(exact, "exact truth")]
    rows = [
        [estimate.method, f"{estimate.area_m2():.0f}", *scores],
        ["exact truth", f"{exact.area_m2():.0f}", "", "", ""],
    ]
    header = ["", "visible, m²", "precision", "recall", "F1"]
    line = "against the exact truth: precision {}, recall {}, F1 {}".format(*scores)
    return comparison(panels, rows, header), line
