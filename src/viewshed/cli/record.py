"""``viewshed record``: make recordings in a simulator that runs elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

record_app = typer.Typer(help="Record sweeps in another simulator.")


@record_app.callback()
def record() -> None:
    """Record sweeps in another simulator."""


@record_app.command()
def carla(
    out: Annotated[Path, typer.Option(help="New or empty folder for the recording.")],
    host: Annotated[str, typer.Option(help="Where the CARLA server runs.")] = "localhost",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Its port.")] = 2000,
    town: Annotated[str | None, typer.Option(help="Map to load (Town03); the server's own if not given.")] = None,
    agents: Annotated[int, typer.Option(help="Vehicles with a sensor, on autopilot.")] = 2,
    roadside: Annotated[int, typer.Option(help="Sensors on masts beside the road.")] = 1,
    ticks: Annotated[int, typer.Option(help="Sweeps of each sensor.")] = 100,
    traffic: Annotated[int, typer.Option(help="Further vehicles.")] = 30,
    step: Annotated[float, typer.Option(help="Seconds of a tick and of a revolution.")] = 0.1,
    seed: Annotated[int, typer.Option(help="Seed of places, models and traffic.")] = 0,
    timeout: Annotated[float, typer.Option(help="Seconds to wait for the server to answer.")] = 5.0,
) -> None:
    """Record LiDAR sweeps, poses and boxes in a running CARLA server.

    Example: viewshed record carla --town Town03 --agents 3 --roadside 2 --ticks 200 --out town03
    """
    from viewshed.datasets.record_carla import Plan, connect, record_carla

    plan = Plan(town=town, agents=agents, roadside=roadside, ticks=ticks, traffic=traffic, step_s=step, seed=seed)
    client = connect(host, port, timeout)
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("ticks", total=plan.ticks)
        record_carla(client, plan, out, lambda _: bar.advance(task))
    typer.echo(f"{out}: {plan.ticks} ticks of {plan.agents} vehicle(s) and {plan.roadside} mast(s)")
