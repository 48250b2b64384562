"""Simulated sweeps against real ones of the same sensors, statistic by statistic.

``python tools/realism_report.py INDEX.json`` writes ``docs/results/realism.md`` and ``realism.png`` beside it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from viewshed.atomic import write_bytes
from viewshed.beams import recover_beams
from viewshed.bev import BevGrid
from viewshed.io import IndexEntry, read_index, read_indexed
from viewshed.realism import (
    HEIGHT_EDGES_M,
    RANGE_EDGES_M,
    Agreement,
    SweepStatistics,
    agreement,
    range_noise,
    sweep_statistics,
)
from viewshed.report import facts, page, table
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sim.caster import cast_world
from viewshed.sim.measure import measure
from viewshed.sim.scan import Motion
from viewshed.sim.weather import CONDITIONS
from viewshed.sim.world import AgentPlan
from viewshed.sim.worlds import WORLDS
from viewshed.sweep import Sweep

ROAD, ROOM = BevGrid(256, 64.0), BevGrid(256, 16.0)
NAMES = {
    "rings": "returns of each ring",
    "ranges": "ranges",
    "heights": "heights above ground",
    "occupied": "occupied cells",
    "returns": "returns a beam",
}
STREETS = ("street", "junction", "residential", "parking")
WIDE = ("street", "junction", "residential", "parking", "highway")


@dataclass(frozen=True, slots=True)
class Group:
    """Real sweeps of one sensor in one kind of place, and the worlds that stand for it.

    Attributes:
        title: what it is.
        sensor: beam table.
        folders: parts of the path of its files in the index.
        worlds: names in the table of worlds.
        height_m: of the sensor above the ground.
        has_rings: whether the rings of the file are those of the beam table.
        period_s: duration of a revolution.
        places: how many different places the files show.
    """

    title: str
    sensor: str
    folders: tuple[str, ...]
    worlds: tuple[str, ...]
    height_m: float
    has_rings: bool = True
    period_s: float = 0.1
    places: int = 1

    @property
    def grid(self) -> BevGrid:
        """The grid on which cells are counted."""
        return ROOM if self.worlds[0] not in STREETS else ROAD


GROUPS = (
    Group("nuScenes, HDL-32E", "hdl32e", ("nuscenes/",), STREETS, 1.84, period_s=0.05, places=3),
    Group("narrow street, HDL-32E", "hdl32e", ("outdoor_hdl32_gicp/",), ("street",), 2.0),
    Group(
        "KITTI, HDL-64E",
        "hdl64e",
        ("odometry00/", "object/", "raw_udacity/", "raw_drive0001_seq/"),
        STREETS,
        1.73,
        places=7,
    ),
    Group("street, VLP-16", "vlp16", ("outdoor_vlp16_apollo/",), STREETS, 1.3),
    Group("PandaSet, Pandar64", "pandar64", ("pandaset/",), WIDE, 2.07, has_rings=False, places=3),
    Group("street, OS1-128", "os1_128", ("decoded/OS-1-128",), STREETS, 2.0),
    Group("street, OS1-32", "os1_32g", ("decoded/OS-1-32",), STREETS, 2.0),
    Group("campus, OS0-128", "os0_128", ("decoded/OS-0-128",), STREETS, 2.0),
    Group("CARLA, 256 channels", "carla256", ("carla_multiagent/",), STREETS, 1.9, period_s=0.0, places=8),
    Group("rooms, VLP-16", "vlp16", ("einride", "nebula/vlp16.pcd"), ("rooms", "corridor", "hall"), 1.0),
    Group("office, XT32", "xt32", ("nebula/xt32",), ("rooms",), 1.0),
)


def main() -> None:
    """Read, simulate, compare, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("index", type=Path)
    parser.add_argument("--sweeps", type=int, default=40, help="simulated sweeps of each group")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("docs/results/realism.md"))
    given = parser.parse_args()
    index = read_index(given.index)
    found = {}
    for group in GROUPS:
        real, model = _real(group, index)
        simulated = [sweep_statistics(sweep, group.grid) for sweep in _simulated(group, model, given)]
        if real and simulated:
            found[group] = {name: agreement(name, real, simulated) for name in _statistics(group)}, len(real)
            sys.stderr.write(f"{group.title}: {len(real)} real, {len(simulated)} simulated\n")
    _draw({group: agreed for group, (agreed, _) in found.items()}, given.out.with_suffix(".png"))
    told = facts(simulated=f"{given.sweeps} sweeps a group, clear, worlds {', '.join(WORLDS)}", seed=str(given.seed))
    write_bytes(given.out, page("Simulated against real sweeps", told, *_parts(found)).encode())


def _statistics(group: Group) -> list[str]:
    return [name for name in NAMES if group.has_rings or name not in ("rings", "returns")]


def _real(group: Group, index: list[IndexEntry]) -> tuple[list[SweepStatistics], LidarModel]:
    """Return the statistics of the real sweeps, and the sensor with the columns that they have."""
    entries = [entry for entry in index if entry.points and any(part in str(entry.file) for part in group.folders)]
    model = lidar_model(group.sensor)
    sweeps = [read_indexed(entry) for entry in entries]
    if not group.has_rings:
        return [sweep_statistics(sweep, group.grid, model) for sweep in sweeps], model
    sweeps = [sweep.replace(model=model) for sweep in sweeps]
    columns = [_firings(sweep) for sweep in sweeps]
    return [sweep_statistics(sweep, group.grid) for sweep in sweeps], replace(
        model, azimuth_columns=int(np.median(columns)) if columns else model.azimuth_columns
    )


def _firings(sweep: Sweep) -> int:
    beams = recover_beams(sweep)
    return max(beams.columns, int(np.bincount(beams.ring[beams.ring >= 0], minlength=1).max()))


def _simulated(group: Group, model: LidarModel, given: argparse.Namespace) -> Iterator[Sweep]:
    """Yield measured sweeps: a new world each, the kinds in turn, at a random time."""
    worlds = [name for name in group.worlds if name in WORLDS]
    plan = AgentPlan(sensor=group.sensor, sensor_height_m=group.height_m)
    for number in range(given.sweeps if worlds else 0):
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([given.seed, number])))
        world = WORLDS[worlds[number % len(worlds)]](rng, plan)
        agent, t_s = world.agents[0], float(rng.uniform(1.0, plan.duration_s - 1.0))
        before, pose, after = (world.world_from_sensor(agent, t_s + dt) for dt in (-0.05, 0.0, 0.05))
        motion = Motion(tuple((after.translation - before.translation) / 0.1), 0.0, group.period_s)
        scan = cast_world(world.snapshot(t_s), model, pose, motion, number)
        yield measure(scan, CONDITIONS["clear"], rng, sensor_height_m=group.height_m).sweep()


def _parts(found: dict[Group, tuple[dict[str, Agreement], int]]) -> list[str]:
    typical = {name: _typical(name, found) for name in NAMES}
    rows, numbers = [], []
    for group, (agreed, count) in found.items():
        for name, one in agreed.items():
            allowed = max(one.spread, typical[name])
            good = one.within if group.places > 2 else one.distance <= allowed
            verdict = "within" if good else f"**outside** ({one.distance / allowed:.1f} of what is allowed)"
            rows.append([
                group.title, NAMES[name], f"{one.distance:.3g}", f"{one.spread:.3g}" if count > 1 else "–",
                f"{allowed:.3g}", f"{one.inside_share:.0%}", verdict,
            ])  # fmt: skip
            if len(one.real) == 1:
                numbers.append([
                    group.title, NAMES[name], str(count), f"{one.low[0]:.3g}", f"{one.real[0]:.3g}",
                    f"{one.high[0]:.3g}", f"{one.simulated[0]:.3g}",
                ])  # fmt: skip
    head = ("sensor, place", "statistic", "distance", "spread", "allowed", "entries inside", "verdict")
    return [
        _WORDS, "![Simulated against real](realism.png)", "## Distances", table(head, rows), "## Numbers",
        table(("sensor, place", "statistic", "real sweeps", "least", "mean", "greatest", "simulated"), numbers),
        "## Histograms", table(("sensor, place", "statistic", "bin", "least", "greatest", "simulated"), _gaps(found)),
    ]  # fmt: skip


def _typical(name: str, found: dict[Group, tuple[dict[str, Agreement], int]]) -> float:
    """Return the median spread of the groups of several places."""
    yardsticks = [agreed for group, (agreed, _) in found.items() if group.places > 2 and "carla" not in group.sensor]
    spreads = [agreed[name].spread for agreed in yardsticks if name in agreed]
    return float(np.median(spreads)) if spreads else 0.0


def _gaps(found: dict[Group, tuple[dict[str, Agreement], int]]) -> Iterator[list[str]]:
    """Yield every bin of the groups of several places whose simulated mean lies outside the real sweeps."""
    for group, (agreed, _) in found.items():
        for name, edges in (("ranges", RANGE_EDGES_M), ("heights", HEIGHT_EDGES_M)):
            one = agreed[name]
            for k in range(len(edges) - 1):
                if group.places > 2 and not one.low[k] <= one.simulated[k] <= one.high[k]:
                    yield [
                        group.title, NAMES[name], f"{edges[k]:g} to {edges[k + 1]:g} m", f"{one.low[k]:.3f}",
                        f"{one.high[k]:.3f}", f"{one.simulated[k]:.3f}",
                    ]  # fmt: skip


def _draw(found: dict[Group, dict[str, Agreement]], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(len(found), 3, figsize=(12, 2.1 * len(found)), squeeze=False, layout="constrained")
    for row, (group, agreed) in zip(axes, found.items(), strict=True):
        for axis, name in zip(row, ("rings", "ranges", "heights"), strict=True):
            _panel(axis, agreed.get(name))
            axis.set_title(f"{group.title}: {NAMES[name]}", fontsize=8)
        _ticks(row[1], RANGE_EDGES_M)
        _ticks(row[2], HEIGHT_EDGES_M)
    axes[0, 0].legend(fontsize=7)
    figure.savefig(path, dpi=70)


def _panel(axis: Any, one: Agreement | None) -> None:
    axis.tick_params(labelsize=7)
    if one is None:
        axis.text(0.5, 0.5, "the rings of the file are not the sensor's", ha="center", fontsize=7)
        return
    at = np.arange(len(one.real))
    axis.fill_between(at, one.low, one.high, color="#9ab", alpha=0.6, step="mid", label="real, least to greatest")
    axis.step(at, one.real, color="#456", where="mid", label="real, mean")
    axis.step(at, one.simulated, color="#c40", where="mid", label="simulated, mean")
    axis.set_ylim(bottom=0)


def _ticks(axis: Any, edges: tuple[float, ...]) -> None:
    axis.set_xticks(np.arange(len(edges) - 1), [f"{high:g}" for high in edges[1:]], fontsize=6)


_WORDS = """\
Returns of the vehicle itself and null returns are left out on both sides. *Rings*: returns of each ring divided by the
columns. *Ranges, heights*: histograms of the share of returns, heights above the local ground as it is estimated from
the sweep. *Occupied cells*: of 256 × 256 with a return, 0.5 m outdoors and 0.125 m indoors.

*Distance*: of the simulated mean from the real mean; half the sum of the differences of two histograms, the mean
difference of rings, the difference of two numbers. *Spread*: the greatest distance of one real sweep from the mean of
the others. *Within*: a histogram no farther away than that; a number between the least and the greatest real one.
Where the sweeps of a sensor come from one or two places their spread is not that of places: there the distance is held
against what is *allowed*, the larger of their own spread and the median spread of nuScenes, KITTI and PandaSet.
*Entries inside*: share of the bins or rings whose simulated mean lies between the least and the greatest real sweep."""


if __name__ == "__main__":
    main()
