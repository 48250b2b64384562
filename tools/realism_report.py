"""Simulated sweeps against real ones of the same sensors, statistic by statistic.

``python tools/realism_report.py INDEX.json`` writes ``docs/results/realism.md`` and ``realism.png`` beside it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from realism import (
    HEIGHT_EDGES_M,
    RANGE_EDGES_M,
    ROAD_EDGES_M,
    Agreement,
    Floats,
    SweepStatistics,
    agreement,
    range_noise,
    road_seen,
    sweep_statistics,
)

from viewshed._page import facts, page, table
from viewshed._results import write_page
from viewshed.grid import BevGrid
from viewshed.io import IndexEntry, read_index, read_indexed
from viewshed.preprocess.ring_recovery import recover_rings
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sim.lidar.measurement import measure
from viewshed.sim.lidar.weather import CONDITIONS
from viewshed.sim.raycast.caster import cast_world
from viewshed.sim.raycast.scan import Motion
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
TOWN = ("street", "junction", "residential")
STREETS = ("street", "junction", "residential", "parking")
WIDE = ("street", "junction", "residential", "parking", "highway")


@dataclass(frozen=True, slots=True)
class Group:
    """Real sweeps of one sensor in one kind of place, and the worlds that stand for it.

    Attributes:
        title: what it is.
        sensor: beam table.
        places: for each place that the files show, a part of the path of its files in the index.
        worlds: names in the table of worlds.
        height_m: of the sensor above the ground.
        has_rings: whether the rings of the file are those of the beam table.
        period_s: duration of a revolution.
        max_range_m: where the files were cut, or None.
    """

    title: str
    sensor: str
    places: tuple[str, ...]
    worlds: tuple[str, ...]
    height_m: float
    has_rings: bool = True
    period_s: float = 0.1
    max_range_m: float | None = None

    @property
    def grid(self) -> BevGrid:
        """The grid on which cells are counted."""
        return ROAD if "street" in self.worlds else ROOM

    @property
    def judged(self) -> bool:
        """Whether it shows enough places to tell how they differ."""
        return len(self.places) > 2


_KITTI = (
    "odometry00/00000", "odometry00/000095", "odometry00/000199", "object/000000", "object/000001", "object/000002",
    "object/000100", "raw_udacity/data_1_0000000000", "raw_udacity/data_1_0000000021", "raw_drive0001_seq/",
)  # fmt: skip
_CARLA = ("31_30/ego1", "31_30/ego2", "31_85/ego1", "31_85/ego2", "autopilot/ego1", "autopilot/ego2")
GROUPS = (
    Group("nuScenes, HDL-32E", "hdl32e", ("1533151603", "1533151612", "1532402927"), WIDE, 1.84, period_s=0.05),
    Group("KITTI, HDL-64E", "hdl64e", _KITTI, TOWN, 1.73, max_range_m=80.0),
    Group("PandaSet, Pandar64", "pandar64", ("000200", "000500", "000800"), WIDE, 2.07, has_rings=False),
    Group("CARLA, 256 channels", "carla256", _CARLA, WIDE, 1.9, period_s=0.0),
    Group("alley, HDL-32E", "hdl32e", ("outdoor_hdl32_gicp/",), ("street",), 2.0),
    Group("street, VLP-16", "vlp16", ("outdoor_vlp16_apollo/",), STREETS, 1.1),
    Group("street, OS1-128", "os1_128", ("decoded/OS-1-128",), STREETS, 1.94),
    Group("street, OS1-32", "os1_32g", ("decoded/OS-1-32",), STREETS, 1.88),
    Group("campus, OS0-128", "os0_128", ("decoded/OS-0-128",), STREETS, 1.92),
    Group("rooms, VLP-16", "vlp16", ("einride", "nebula/vlp16.pcd"), ("rooms",), 0.8),
    Group("office, XT32", "xt32", ("nebula/xt32",), ("rooms",), 0.75),
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
    found = [one for group in GROUPS for one in _compared(group, index, given)]
    _draw(found, given.out.with_suffix(".png"))
    told = facts(simulated=f"{given.sweeps} sweeps a group, clear, worlds {', '.join(WORLDS)}", seed=str(given.seed))
    write_page(given.out, page("Simulated against real sweeps", told, *_parts(found)))


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A group, its agreements by statistic, its number of real sweeps; noise and road seen, real and simulated."""

    group: Group
    agreed: dict[str, Agreement]
    count: int
    noise_m: tuple[float, float]
    road: tuple[Floats, Floats]


def _compared(group: Group, index: list[IndexEntry], given: argparse.Namespace) -> Iterator[Compared]:
    places = _places(group, index)
    real = [sweep for sweeps in places for sweep in sweeps]
    worlds = [name for name in group.worlds if name in WORLDS]
    if not real or not worlds:
        return
    model = _as_measured(group, real)
    simulated = [_simulated(group, model, worlds[k % len(worlds)], (given.seed, k)) for k in range(given.sweeps)]
    noise = [float(np.nanmedian([range_noise(sweep, model) for sweep in sweeps])) for sweeps in (real, simulated)]
    means = [_mean([sweep_statistics(sweep, group.grid, model) for sweep in sweeps]) for sweeps in places]
    drawn = [sweep_statistics(sweep, group.grid, model) for sweep in simulated]
    names = [name for name in NAMES if group.has_rings or name not in ("rings", "returns")]
    agreed = {name: agreement(name, means, drawn) for name in names}
    sys.stderr.write(f"{group.title}: {len(real)} real, {len(simulated)} simulated\n")
    road = [road_seen(sweeps, model, group.height_m) for sweeps in (real, simulated)]
    yield Compared(group, agreed, len(real), (noise[0], noise[1]), (road[0], road[1]))


def _places(group: Group, index: list[IndexEntry]) -> list[list[Sweep]]:
    """Return the real sweeps of each place."""
    model = lidar_model(group.sensor) if group.has_rings else None
    entries = [[entry for entry in index if entry.points and part in str(entry.file)] for part in group.places]
    return [[read_indexed(entry).replace(model=model) for entry in some] for some in entries if some]


def _mean(some: list[SweepStatistics]) -> SweepStatistics:
    return SweepStatistics(*(np.mean([getattr(one, name) for one in some], axis=0) for name in NAMES))


def _as_measured(group: Group, real: list[Sweep]) -> LidarModel:
    """Return the sensor with the columns and the maximum range that the files show."""
    model = lidar_model(group.sensor)
    columns = int(np.median([_firings(sweep) for sweep in real])) if group.has_rings else model.azimuth_columns
    return replace(model, azimuth_columns=columns, max_range_m=group.max_range_m or model.max_range_m)


def _firings(sweep: Sweep) -> int:
    """Return the columns of a revolution, as in :mod:`realism`."""
    beams = recover_rings(sweep)
    return max(beams.columns, int(np.bincount(beams.ring[beams.ring >= 0], minlength=1).max()))


def _simulated(group: Group, model: LidarModel, world_name: str, seed: tuple[int, int]) -> Sweep:
    """Return a measured sweep in a new world at a random time."""
    plan = AgentPlan(sensor=group.sensor, sensor_height_m=group.height_m)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    world = WORLDS[world_name](rng, plan)
    agent, t_s = world.agents[0], float(rng.uniform(1.0, plan.duration_s - 1.0))
    before, pose, after = (world.world_from_sensor(agent, t_s + dt) for dt in (-0.05, 0.0, 0.05))
    x, y, z = ((after.translation - before.translation) / 0.1).tolist()
    scan = cast_world(world.snapshot(t_s), model, pose, Motion((x, y, z), 0.0, group.period_s), seed[1])
    return measure(scan, CONDITIONS["clear"], rng, sensor_height_m=group.height_m).sweep()


def _parts(found: list[Compared]) -> list[str]:
    head = (
        "sensor, place",
        "statistic",
        "real sweeps",
        "places",
        "distance",
        "spread",
        "allowed",
        "entries inside",
        "",
    )
    noise = [[one.group.title, *(f"{1e3 * value:.1f}" for value in one.noise_m)] for one in found]
    return [
        _WORDS, "![Simulated against real](realism.png)", "## Gaps", _GAPS,
        "## Distances", table(head, _verdicts(found)), "## Numbers",
        table(("sensor, place", "statistic", "least", "mean", "greatest", "simulated"), _numbers(found)),
        "## Range noise, mm", _NOISE, table(("sensor, place", "real", "simulated"), noise),
        "## Road seen", _ROAD_SEEN, table(("sensor, place", "", *_bounds(ROAD_EDGES_M)), _roads(found)),
        "## Bins outside", table(("sensor, place", "statistic", "bin", "least", "greatest", "simulated"), _gaps(found)),
    ]  # fmt: skip


def _verdicts(found: list[Compared]) -> Iterator[list[str]]:
    typical = {name: _typical(name, found) for name in NAMES}
    for one in found:
        for name, told in one.agreed.items():
            allowed = told.spread if one.group.judged else max(told.spread, typical[name])
            good = told.within if one.group.judged else told.distance <= allowed
            spread = f"{told.spread:.3g}" if len(one.group.places) > 1 else "–"
            yield [
                one.group.title, NAMES[name], str(one.count), str(len(one.group.places)),
                f"{told.distance:.3g}", spread, f"{allowed:.3g}", f"{told.inside_share:.0%}",
                "within" if good else "**outside**",
            ]  # fmt: skip


def _numbers(found: list[Compared]) -> Iterator[list[str]]:
    for one in found:
        for name, told in one.agreed.items():
            if len(told.real) == 1:
                values = (told.low[0], told.real[0], told.high[0], told.simulated[0])
                yield [one.group.title, NAMES[name], *(f"{value:.3g}" for value in values)]


def _roads(found: list[Compared]) -> Iterator[list[str]]:
    for one in found:
        if one.group.grid is ROAD and one.group.has_rings:
            for side, values in zip(("real", "simulated"), one.road, strict=True):
                yield [one.group.title, side, *("–" if np.isnan(value) else f"{value:.2f}" for value in values)]


def _bounds(edges: tuple[float, ...]) -> list[str]:
    return [f"{low:g} to {high:g} m" for low, high in pairwise(edges)]


def _typical(name: str, found: list[Compared]) -> float:
    """Return the median spread of the groups of several places."""
    yardsticks = [one for one in found if one.group.judged and "carla" not in one.group.sensor]
    spreads = [one.agreed[name].spread for one in yardsticks if name in one.agreed]
    return float(np.median(spreads)) if spreads else 0.0


def _gaps(found: list[Compared]) -> Iterator[list[str]]:
    """Yield every bin of the groups of several places whose simulated mean lies outside the real sweeps."""
    for one in found:
        for name, edges in (("ranges", RANGE_EDGES_M), ("heights", HEIGHT_EDGES_M)):
            told = one.agreed[name]
            for k in np.flatnonzero((told.simulated < told.low) | (told.simulated > told.high)):
                if one.group.judged:
                    values = (told.low[k], told.high[k], told.simulated[k])
                    yield [one.group.title, NAMES[name], _bounds(edges)[k], *(f"{value:.3f}" for value in values)]


def _draw(found: list[Compared], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(len(found), 3, figsize=(12, 2.1 * len(found)), squeeze=False, layout="constrained")
    for row, one in zip(axes, found, strict=True):
        for axis, name in zip(row, ("rings", "ranges", "heights"), strict=True):
            _panel(axis, one.agreed.get(name))
            axis.set_title(f"{one.group.title}: {NAMES[name]}", fontsize=8)
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
firings of a revolution. *Ranges, heights*: histograms of the share of returns, heights above the local ground as it is
estimated from the sweep. *Occupied cells*: of 256 × 256 with a return, 0.5 m outdoors and 0.125 m indoors. Real sweeps
of one place are averaged first: a place counts once, however many of its sweeps there are.

*Distance*: of the simulated mean from the real mean; half the sum of the differences of two histograms, the mean
difference of rings, the difference of two numbers. *Spread*: the greatest distance of one real place from the mean of
the others. *Within*: a histogram no farther away than that; a number between the least and the greatest real place.
Sensors with one or two places do not show how places differ: there the distance is held against what is *allowed*, the
larger of their own spread and the median spread of nuScenes, KITTI and PandaSet. *Entries inside*: share of the bins or
rings whose simulated mean lies between the least and the greatest real place.

The measurement was tuned on the range noise of every sensor and on how far nuScenes, KITTI, VLP-16 and OS1-128 see the
road; the roof below the sensor on the lowest rings of nuScenes and KITTI. Which worlds stand for a group was chosen by
looking at its sweeps (wide roads for nuScenes and PandaSet, no parking lots for KITTI). So nuScenes and KITTI are no
test of what was tuned on them, PandaSet and OS1-32 are. Nothing was fitted to a single sweep. PandaSet's files
are not in the sensor's frame, so its rings are not compared; KITTI's end at 80 m, and so do the simulated ones."""

_GAPS = """\
What lies outside, or within only because places differ so much, and why:

- **CARLA.** Its car carries the sensor close above a wide roof, which hides the road out to 6 m on all sides; ours
  stands free. CARLA's sweeps are a simulator's themselves.
- **Alley.** Walls 3 to 6 m away on both sides, dark cars: there is no such world in the table.
- **Campus.** Crowns of trees hang over the road and fill the rings above 20° of an OS0; our trees stand beside it.
- **Rooms, office.** The real sensors stand on a desk or a platform that hides their lower rings, or returns nearer than
  0.5 m; ours rides on a robot. That is no fault of the rooms, so these numbers say little. The real rooms also have
  directions without any return, to windows and open doors.
- **Streets and junctions** alone are more closed than those of nuScenes; the mix with highways, lots and gardens is
  not.
- **Vehicles beside the sensor.** A few simulated returns lie within 2.5 m outside the vehicle's own box, hardly any
  real ones.
- **Asphalt.** One nuScenes junction loses the road at half the distance of the others; all simulated roads are of the
  same few materials.
- **Weather** has no real counterpart at hand."""

_NOISE = """\
Standard deviation between neighboring columns on smooth surfaces, 3 to 25 m away, median over the sweeps (see
`realism.range_noise`). Offsets that a beam keeps, which the makers' accuracies include, do not show."""

_ROAD_SEEN = """\
Share of the beams that see the road, by where level ground would be met: of those that return from the ground or not at
all (see `realism.road_seen`). The lowest beams are hidden by the vehicle itself."""


if __name__ == "__main__":
    main()
