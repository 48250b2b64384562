"""``viewshed quantize``: quantize a trained network to int8."""

from __future__ import annotations

from typing import Annotated

import typer


def quantize(
    config: Annotated[
        str, typer.Argument(metavar="CONFIG", help="Its training config: a TOML file, or a shipped one (road, indoor).")
    ],
    network: Annotated[str, typer.Argument(metavar="NETWORK", help="network.onnx of that training.")],
    out: Annotated[str, typer.Option(help="File to write.")],
    frames: Annotated[
        int, typer.Option(help="Number of simulated sweeps to calibrate on; as many others are for the check.")
    ] = 64,
) -> None:
    """Quantize a network to 8-bit integers, which run faster.

    Nothing is written if F1 falls by more than 0.002 in one pass or, with dropout, in ten.

    Example: viewshed quantize road network.onnx --out network_int8.onnx
    """
    from viewshed_lab.training import read_config
    from viewshed_lab.training.calibrate_int8 import quantize as run

    for cost in run(read_config(config), network, out, frames):
        deviations = f"deviation {cost.deviation_int8:.4f} and {cost.deviation:.4f}, " if cost.passes > 1 else ""
        typer.echo(
            f"{out}: F1 {cost.f1_int8:.4f} in int8, {cost.f1:.4f} in float32; {deviations}probabilities"
            f" {cost.mean_difference:.4f} apart, {cost.flipped_share:.2%} of the cells flipped; passes: {cost.passes}"
        )
