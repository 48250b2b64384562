"""``viewshed demo``: the main job on the sample that travels with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from viewshed.cli import options
from viewshed.cli.estimate import Run
from viewshed.cli.options import Reading


def demo(
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("demo"),
) -> None:
    """Estimate what the sensor saw in the embedded sample, and say where the picture is.

    Example: viewshed demo --out demo
    """
    from viewshed.samples import junction_path

    out.mkdir(parents=True, exist_ok=True)
    sweep = Reading().sweep(junction_path())
    estimator = options.make_estimator("shadow_map", options.parse_grid("road"), "car")
    typer.echo(Run(estimator, options.parse_threshold(None, "sound"), out).one(sweep, "demo"))
    typer.echo(f"Look at {(out / 'demo.png').resolve()}")
