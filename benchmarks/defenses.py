"""What defenses cost: ``python -m benchmarks.defenses [--page FILE]`` writes docs/results/defenses_cost.md."""

from __future__ import annotations

import argparse
import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import clouds
from benchmarks.timing import interleaved
from viewshed._page import facts, page, table
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.io import read_index, read_indexed
from viewshed.preprocess.leveling import level
from viewshed.preprocess.sensor_identification import infer_sensor
from viewshed.sensors import lidar_model
from viewshed.sim.lidar.measurement import measure
from viewshed.sim.lidar.weather import CONDITIONS
from viewshed.sim.observe import pose_and_motion
from viewshed.sim.raycast.caster import cast_world
from viewshed.sim.world import AgentPlan
from viewshed.sim.worlds import WORLDS
from viewshed.sweep import Sweep
from viewshed.threats.defenses import DEFENSES, Defense, TemporalConsistency

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "defenses_cost.md"
SEED = 20_250_307
GRID = BevGrid(256, 64.0)
FAR_M = 30.0
TIMES_S = (0.8, 0.9, 1.0)
SEEDS = 6
SIMULATED = {
    "outdoors, HDL-32E": ("hdl32e", ("street", "junction", "highway", "parking", "residential")),
    "outdoors, HDL-64E": ("hdl64e", ("street", "junction", "highway")),
    "indoors, VLP-16": ("vlp16", ("rooms", "corridors", "hall", "warehouse")),
}
PAST = 2
"""Earlier sweeps that the temporal check is given."""
CAMERA_CROPPED = "front_fov_cropped"
DROPPED = f"""## Good returns dropped

Percent of the good returns that a defense drops from sweeps that nobody tampered with, and after the slash of those
beyond {FAR_M:.0f} m; means over the sweeps. Good returns are those that estimators use: null returns and those of the
vehicle itself are left out. `empty_sector` drops nothing; the number of its false alarms is given. `temporal` has up to
{PAST} earlier sweeps of the same drive. A dash: the sweeps lack what the defense needs, or have no such returns.

What [defenses](../attacks.md#defenses) are for, and which parameters they have here."""
TIME = f"""## Time

Median (10th to 90th percentile) on simulated sweeps of a junction; `temporal` has {PAST} earlier sweeps."""


class Clean(NamedTuple):
    """A sweep that nobody tampered with, and the sweeps before it that have poses in the same map."""

    sweep: Sweep
    earlier: tuple[Sweep, ...]


def simulated() -> Iterator[tuple[str, Clean]]:
    """Yield the name of a set and a sweep, for every set, world and seed."""
    for name, (sensor, worlds) in SIMULATED.items():
        for number, kind in enumerate(worlds):
            for seed in range(SEEDS):
                sweeps = _drive(kind, sensor, np.random.SeedSequence([SEED, number, seed]))
                yield f"simulated {name}", Clean(sweeps[-1], sweeps[:-1])


def _drive(kind: str, sensor: str, seed: np.random.SeedSequence) -> tuple[Sweep, ...]:
    rng = np.random.Generator(np.random.PCG64(seed))
    plan = AgentPlan(sensor=sensor, sensor_height_m=0.6 if sensor == "vlp16" else 1.8)
    world = WORLDS[kind](rng, plan)
    agent = world.agents[0]
    return tuple(
        measure(
            cast_world(
                world.snapshot(t_s), lidar_model(sensor), world.world_from_sensor(agent, t_s),
                pose_and_motion(world, agent, t_s, 0.1)[1], seed=int(rng.integers(2**31)),
            ),
            CONDITIONS["clear"],
            rng,
        ).sweep()
        for t_s in TIMES_S
    )  # fmt: skip


def real() -> Iterator[tuple[str, Clean]]:
    """Yield the folder and each sweep of the index in VIEWSHED_REAL_DATA; nothing where it is not set."""
    folder = os.environ.get("VIEWSHED_REAL_DATA")
    if not folder:
        return
    past: dict[str, list[Sweep]] = defaultdict(list)
    root = Path(folder).resolve()
    for entry in read_index(root / "index.json"):
        if not entry.points:
            continue
        parts = entry.file.relative_to(root).parts
        sweep = _with_sensor(read_indexed(entry))
        drive = past[entry.seq] if entry.seq and sweep.world_from_sensor else []
        name = "kitti, cropped to the camera" if CAMERA_CROPPED in parts else parts[0]
        yield f"real {name}", Clean(sweep, tuple(drive[-PAST:]))
        drive.append(sweep)


def _with_sensor(sweep: Sweep) -> Sweep:
    return sweep if sweep.model is not None else sweep.replace(model=infer_sensor(sweep.points, sweep.ring)[0])


def _made(name: str, clean: Clean) -> Defense | None:
    """Return the defense, or None where the sweep lacks what it needs."""
    if name != "temporal":
        return DEFENSES[name]()
    try:
        return TemporalConsistency(clean.earlier) if clean.earlier else None
    except ValueError:
        return None


def cost(sets: Iterator[tuple[str, Clean]]) -> dict[str, dict[str, list[Any]]]:
    """Return, by set and defense, a row a sweep: share of good returns dropped, of those beyond 30 m, and the alarm."""
    found: dict[str, dict[str, list[Any]]] = {}
    for set_name, clean in sets:
        rows = found.setdefault(set_name, {name: [] for name in DEFENSES})
        good = level(clean.sweep, GRID).rows
        far = good[np.linalg.norm(clean.sweep.points[good], axis=1) > FAR_M]
        for name in DEFENSES:
            defense = _made(name, clean)
            try:
                defended = defense.apply(clean.sweep) if defense else None
            except ValueError:  # no rings
                defended = None
            if defended is not None:
                shares = [float(defended.dropped[some].mean()) if len(some) else np.nan for some in (good, far)]
                rows[name].append((*shares, defended.alarm))
        rows.setdefault("sweeps", []).append(1)
    return found


def _cell(rows: list[Any]) -> str:
    if not rows:
        return "–"
    if rows[0][2] is not None:
        return f"{sum(bool(row[2]) for row in rows)} of {len(rows)}"
    return " / ".join(_percent([row[k] for row in rows]) for k in (0, 1))


def _percent(shares: list[float]) -> str:
    known = [share for share in shares if np.isfinite(share)]
    return f"{100 * float(np.mean(known)):.2f}" if known else "–"


def _cost_table(found: Mapping[str, Mapping[str, list[Any]]]) -> str:
    rows = [[name, str(len(row["sweeps"])), *(_cell(row[each]) for each in DEFENSES)] for name, row in found.items()]
    return table(["sweeps", "number", *(f"`{name}`" for name in DEFENSES)], rows)


def _time_table(rng: np.random.Generator) -> str:
    timings: dict[str, dict[str, str]] = {name: {} for name in DEFENSES}
    for size in clouds.SENSORS:
        sweep = clouds.synthetic(size, rng).replace(world_from_sensor=Rigid.identity())
        jobs = {name: _job(_made(name, Clean(sweep, (sweep, sweep))), sweep) for name in DEFENSES}
        for name, timing in interleaved(jobs, rng, budget_s=10.0).items():
            timings[name][size] = f"{timing.median_ms:.1f} ({timing.low_ms:.1f}–{timing.high_ms:.1f})"
    rows = [[f"`{name}`", *timings[name].values()] for name in DEFENSES]
    return table(["defense", *(f"{size} returns, ms" for size in clouds.SENSORS)], rows)


def _job(defense: Defense | None, sweep: Sweep) -> Callable[[], object]:
    if defense is None:
        raise RuntimeError("the sweep to measure on must have poses and rings")
    return lambda: defense.apply(sweep)


def main() -> None:
    """Measure everything and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.defenses", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    chosen = parser.parse_args()
    told = facts(
        command="`python -m benchmarks.defenses`",
        libraries=", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "numba")),
        load=f"{os.getloadavg()[0]:.1f} in the minute before, on all cores; every job on one thread",
        simulated=f"{SEEDS} seeds each of {', '.join(sorted({w for _, kinds in SIMULATED.values() for w in kinds}))}",
    )
    times = _time_table(np.random.default_rng(SEED))
    rows = cost(simulated()) | cost(real())
    chosen.page.write_text(
        page("What defenses cost on clean sweeps", told, DROPPED, _cost_table(rows), TIME, times), encoding="utf-8"
    )
    print(f"written to {chosen.page}")


if __name__ == "__main__":
    main()
