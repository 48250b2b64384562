"""Draw the worlds that are neither flat nor square, and measure them: sizes, time, returns and share seen, as a page.

Usage: python tools/world_report.py [--out docs/results] [--seeds 20]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from viewshed import CAR, GRIDS, PEDESTRIAN, lidar_model
from viewshed._files import write_atomic
from viewshed._page import facts, page, table
from viewshed.sim.lidar.measurement import measure
from viewshed.sim.lidar.weather import CONDITIONS
from viewshed.sim.raycast.caster import cast_world
from viewshed.sim.truth.exact import exact_truth
from viewshed.sim.world import AgentPlan, World
from viewshed.sim.worlds import WORLDS
from viewshed.studies.preview import HEADINGS, PreviewSample, row_of, sheet

REFERENCE = "junction"
"""The world that the others' cost is compared with."""

OUTDOORS = (
    "country_road", "open_field", "embankment", "cutting", "bridge", "pit", "quay", "garage", "glass_fronts", "oblique",
    "slope_town", "site",
)  # fmt: skip

INDOORS = ("atrium", "loft", "tunnel")

_T_S, _SEED = 5.0, 4

_HEADER = (
    "world", "solids", "quads of ground", "made in ms", "a sweep in ms", "beside `junction`", "returns (least–most)",
    "seen, of the known cells (least–most)", "ground from the sensor's foot, m",
)  # fmt: skip

_TEXT = """\
HDL-32E, {height} m up outdoors and {indoor} m in buildings, all beams at once, no weather; {seeds} seeds of each world;
medians unless a span is given. *Seen* is for a car on the road grid, outdoors, and for a pedestrian on the indoor grid.
Heights are those of the lowest and the highest ground of all seeds within 30 m of the sensor (16 m in buildings), from
the ground below it."""


@dataclass(frozen=True, slots=True)
class Figures:
    """What is measured of one world."""

    solids: int
    quads: int
    made_ms: float
    sweep_ms: float
    returns: int
    seen: float
    low_m: float
    high_m: float


def main() -> None:
    """Draw, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    for name, kinds in (("worlds_outdoors", OUTDOORS), ("worlds_indoors", INDOORS)):
        rows = [row_of(_sample(kind, _SEED + k)) for k, kind in enumerate(kinds)]
        write_atomic(arguments.out / f"{name}.png", sheet(rows, HEADINGS, "python tools/world_report.py"))
    measured = {kind: [_figures(kind, seed) for seed in range(arguments.seeds)]
                for kind in (REFERENCE, *OUTDOORS, *INDOORS)}  # fmt: skip
    usual = _median([one.sweep_ms for one in measured[REFERENCE]])
    text = _TEXT.format(height=_plan(False).sensor_height_m, indoor=_plan(True).sensor_height_m, seeds=arguments.seeds)
    parts = [
        text,
        table(_HEADER, [_row(kind, figures, usual) for kind, figures in measured.items()]),
        "![Worlds outdoors: from above, by camera, as a sweep, and with their truth](worlds_outdoors.png)",
        "![Worlds in buildings: from above, by camera, as a sweep, and with their truth](worlds_indoors.png)",
    ]
    write_atomic(arguments.out / "worlds.md", page("Worlds out of the ordinary", facts(), *parts).encode())


def _plan(indoor: bool) -> AgentPlan:
    return AgentPlan(sensor="hdl32e", sensor_height_m=0.7 if indoor else 1.84, duration_s=10.0)


def _world(kind: str, seed: int) -> World:
    return WORLDS[kind](np.random.Generator(np.random.PCG64(seed)), _plan(kind in INDOORS))


def _sample(kind: str, seed: int) -> PreviewSample:
    """Return one sweep of a world with its truth."""
    world = _world(kind, seed)
    agent = world.agents[0]
    scan = cast_world(world.snapshot(_T_S), lidar_model("hdl32e"), world.world_from_sensor(agent, _T_S), seed=seed)
    height_m = _plan(kind in INDOORS).sensor_height_m
    sweep = measure(scan, CONDITIONS["clear"], np.random.default_rng(seed), sensor_height_m=height_m).sweep()
    truth, known = exact_truth(scan, world, GRIDS["indoor" if kind in INDOORS else "road"], agent=agent)
    return PreviewSample(world, 0, _T_S, sweep, truth, known, f"{kind} · {len(sweep)} returns")


def _figures(kind: str, seed: int) -> Figures:
    indoor = kind in INDOORS
    start = time.perf_counter()
    world = _world(kind, seed)
    made = time.perf_counter()
    agent, model = world.agents[0], lidar_model("hdl32e")
    pose, snapshot = world.world_from_sensor(agent, _T_S), world.snapshot(_T_S)
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        scan = cast_world(snapshot, model, pose, seed=seed)
        times.append(time.perf_counter() - begin)
    image = measure(scan, CONDITIONS["clear"], np.random.default_rng(seed))
    truth, known = exact_truth(scan, world, GRIDS["indoor" if indoor else "road"], agent=agent)
    around = np.linspace(-1.0, 1.0, 61) * (16.0 if indoor else 30.0)
    near = np.stack(np.meshgrid(around, around), axis=-1) + pose.translation[:2]
    ground = world.ground_of(agent)
    heights = ground.at(near) - float(ground.at(pose.translation[None])[0])
    return Figures(
        len(snapshot.kind), world.terrain.material.size, 1e3 * (made - start), 1e3 * min(times),
        int((image.steps > 0).sum()), float(truth.visible(PEDESTRIAN if indoor else CAR)[known].mean()),
        float(heights.min()), float(heights.max()),
    )  # fmt: skip


def _row(kind: str, figures: list[Figures], usual_ms: float) -> list[str]:
    returns, seen = ([getattr(one, name) for one in figures] for name in ("returns", "seen"))
    sweep_ms = _median([one.sweep_ms for one in figures])
    return [
        f"`{kind}`",
        *(f"{_median([getattr(one, name) for one in figures]):.0f}" for name in ("solids", "quads", "made_ms")),
        f"{sweep_ms:.1f}", f"{sweep_ms / usual_ms:.2f} ×",
        f"{_median(returns):.0f} ({min(returns)}–{max(returns)})",
        f"{_median(seen):.0%} ({min(seen):.0%}–{max(seen):.0%})",
        f"{min(one.low_m for one in figures):.1f} to {max(one.high_m for one in figures):+.1f}",
    ]  # fmt: skip


def _median(values: list[float]) -> float:
    return float(np.median(values))


if __name__ == "__main__":
    main()
