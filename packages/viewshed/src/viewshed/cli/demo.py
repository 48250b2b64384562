"""``viewshed demo``: estimate the field of view on a sample of a road junction, and compare it with the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import NetworkOptions
from viewshed.cli._outputs import Run, make_folder

if TYPE_CHECKING:
    from viewshed.fov.estimate import FovEstimate


def demo(out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("demo")) -> None:
    """Estimate on the embedded sample; compare with the exact truth.

    Writes demo.png (the estimate), demo_truth.png (estimate and truth side by side), GeoJSON, NPZ, and the sweep as
    sweep.pcd.bin.gz, for the other commands. The sample is a simulated junction; viewshed simulate makes others.

    Example: viewshed demo --out demo
    """
    from viewshed._files import write_atomic
    from viewshed.io import read_sweep
    from viewshed.io.samples import junction_path

    make_folder(out)
    estimator = NetworkOptions().estimator(None, options.parse_grid("road"), "car")
    summary = Run(estimator, estimator.threshold, out).one(read_sweep(junction_path()), "demo")
    typer.echo(summary.line)
    write_atomic(out / "sweep.pcd.bin.gz", junction_path().read_bytes())
    picture, line = _beside_truth(summary.estimate)
    write_atomic(out / "demo_truth.png", picture)
    typer.echo(f"demo: {line} → {out / 'demo_truth.png'}")
    typer.echo(f"Look at {(out / 'demo.png').resolve()}")


def _beside_truth(estimate: FovEstimate) -> tuple[bytes, str]:
    """Return a PNG of estimate and truth, and precision and recall of the estimate in one line."""
    import numpy as np

    from viewshed.fov.estimate import FovEstimate
    from viewshed.io.samples import junction_truth
    from viewshed.metrics import ConfusionCounts
    from viewshed.show.plot import Panel, comparison

    truth, known = junction_truth()
    true = truth.visible(estimate.target)
    exact = FovEstimate(
        truth.grid, true.astype(np.float32), truth.state[estimate.target.name], method="exact truth"
    )  # fmt: skip
    counts = ConfusionCounts.of(estimate.visible(), true, known, estimate.grid.cell_area_m2)
    scores = [f"{value:.3f}" for value in (counts.precision, counts.recall, counts.f1)]
    panels = [Panel(estimate, estimate.method), Panel(exact, "exact truth")]
    rows = [
        [estimate.method, f"{estimate.area_m2():.0f}", *scores],
        ["exact truth", f"{exact.area_m2():.0f}", "", "", ""],
    ]
    header = ["", "visible, m²", "precision", "recall", "F1"]
    line = "against the exact truth: precision {}, recall {}, F1 {}".format(*scores)
    return comparison(panels, rows, header), line
