"""Ray casting beside embree: ``python -m benchmarks.casting [--page FILE]`` writes casting.md."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib import metadata
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.ray.ray_pyembree import RayMeshIntersector

from benchmarks.timing import interleaved
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab._page import facts, page, table
from viewshed_lab.sim.assets.shapes import BOX, CYLINDER, Box, Cylinder, Ellipsoid
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Snapshot, Thing, World
from viewshed_lab.sim.worlds import WORLDS

SEED = 3
TARGET_PER_S = 1000
SECONDS = 4.0
ROUND_SIDES = 16
"""Sides of a cylinder where it is made of triangles, and meridians of an ellipsoid."""


def block(seed: int = SEED) -> World:
    """Return a city block of about 5,000 triangles: cars, trees, houses on a hilly ground with curbs."""
    rng = np.random.default_rng(seed)
    things = [
        _placed(rng, "car", (Box(0, 0, 4.3, 1.8, 0.85, 0.2), Box(-0.2, 0, 2.3, 1.6, 1.48, 0.85)), 5) for _ in range(50)
    ]
    things += [
        _placed(rng, "tree", (Cylinder(0, 0, 0.2, 3.0), Ellipsoid(0, 0, 4, 4, 7, 2.5, material="bark")), 8)
        for _ in range(6)
    ]
    things += [_placed(rng, "house", (Box(0, 0, 20, 12, 9),), 25) for _ in range(14)]
    lines = np.unique(np.concatenate([np.linspace(-110, 110, 30), [-6, -5.97, 6, 6.03]]))
    terrain = Terrain.of(
        lines, lines, lambda x, y: 0.02 * x + 0.5 * np.sin(x / 30) * np.cos(y / 25) + 0.12 * (abs(y) > 6)
    )
    return World("block", terrain, tuple(things))


def _placed(rng: np.random.Generator, kind: str, parts: tuple[Box | Cylinder | Ellipsoid, ...], near_m: float) -> Thing:
    away, azimuth, yaw = rng.uniform(near_m, 80), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    return Thing(kind, parts, away * np.cos(azimuth), away * np.sin(azimuth), yaw)


def triangles(snapshot: Snapshot) -> int:
    """Return the triangles that the same scene would need: 12 a box, 64 a cylinder, 224 an ellipsoid, 2 a quad."""
    each = {BOX: 12, CYLINDER: 4 * ROUND_SIDES}
    solids = sum(each.get(int(kind), 2 * ROUND_SIDES * (ROUND_SIDES // 2 - 1)) for kind in snapshot.kind)
    return solids + 2 * snapshot.terrain.material.size


def mesh_of(snapshot: Snapshot) -> Any:
    """Return the scene as triangles."""
    parts = []
    for s, kind in enumerate(snapshot.kind):
        half = snapshot.half_m[s]
        if kind == BOX:
            solid = trimesh.creation.box(extents=2 * half)
        elif kind == CYLINDER:
            solid = trimesh.creation.cylinder(radius=half[0], height=2 * half[2], sections=ROUND_SIDES)
        else:
            solid = trimesh.creation.uv_sphere(radius=1.0, count=[ROUND_SIDES // 2, ROUND_SIDES])
            solid.vertices = solid.vertices * half
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = snapshot.rotation[s], snapshot.center_m[s]
        parts.append(solid.apply_transform(matrix))
    ground = snapshot.terrain
    nx, ny = len(ground.x_m), len(ground.y_m)
    x, y = np.meshgrid(ground.x_m, ground.y_m, indexing="ij")
    low = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
    faces = np.concatenate([np.stack([low, low + ny, low + ny + 1], 1), np.stack([low, low + ny + 1, low + 1], 1)])
    nodes = np.stack([x.ravel(), y.ravel(), ground.heights_m.ravel()], 1)
    return trimesh.util.concatenate([*parts, trimesh.Trimesh(nodes, faces, process=False)])


def _pose(world: World) -> Rigid:
    if world.agents:
        return world.world_from_sensor(world.agents[0], 1.0)
    return Rigid.from_yaw(0.3, (0.0, 0.0, 1.84 + float(world.terrain.at([[0.0, 0.0]])[0])))


def _by_embree(snapshot: Snapshot, model: LidarModel, pose: Rigid) -> Callable[[], NDArray[np.float32]]:
    caster = RayMeshIntersector(mesh_of(snapshot), scale_to_box=False)
    scan = cast_world(snapshot, model, pose)
    starts = (scan.origin_m.reshape(-1, 3) + pose.translation).astype(np.float32)
    ways = np.ascontiguousarray(scan.direction.reshape(-1, 3))
    first = caster._scene.run  # embree itself, without what trimesh does around it
    distance: NDArray[np.float32] = first(starts, ways, query="DISTANCE")
    ours = scan.depth_m.ravel()
    agree = float((np.abs(distance - ours) < 0.05)[np.isfinite(ours)].mean())
    if agree < 0.8:
        raise RuntimeError(f"embree met something else ({agree:.0%} agree): its time says nothing")
    return lambda: first(starts, ways, query="DISTANCE")


def _rate(job: tuple[str, str, float]) -> float:
    """Return sweeps a second of one process for some seconds, each from another yaw."""
    name, sensor, seconds = job
    snapshot, pose, model = _scene(name, sensor)
    cast_world(snapshot, model, pose)
    turns = [pose @ Rigid.from_yaw(0.01 * k) for k in range(100)]
    done, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        cast_world(snapshot, model, turns[done % 100])
        done += 1
    return done / (time.perf_counter() - start)


def _scene(name: str, sensor: str) -> tuple[Snapshot, Rigid, LidarModel]:
    if name == "block":
        world, model = block(), replace(lidar_model("hdl32e"), azimuth_columns=1080)
    else:
        world, model = WORLDS[name](np.random.default_rng(SEED), AgentPlan()), lidar_model(sensor)
    return world.snapshot(1.0), _pose(world), model


def _row(name: str, sensor: str, rng: np.random.Generator) -> list[str]:
    snapshot, pose, model = _scene(name, sensor)
    timings = interleaved(
        {"ours": lambda: cast_world(snapshot, model, pose), "embree": _by_embree(snapshot, model, pose)}, rng
    )
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        both = sum(pool.map(_rate, [(name, sensor, SECONDS)] * 2))
    ours, embree = timings["ours"].median_ms, timings["embree"].median_ms
    verdict = "–" if name != "block" else f"≥ {TARGET_PER_S}: {'met' if both >= TARGET_PER_S else '**missed**'}"
    beams = f"{model.name}, {model.rings} × {model.azimuth_columns}"
    return [
        name, beams, f"{len(snapshot.kind)}", f"{triangles(snapshot)}",
        f"{ours:.2f}", f"{1e3 / ours:.0f}", f"{both:.0f}", verdict, f"{embree / ours:.1f} ×",
    ]  # fmt: skip


HEAD = ["scene", "sensor", "solids", "as triangles", "median, ms", "sweeps/s, one process", "two processes", "target",
        "time of embree, as a multiple of ours"]  # fmt: skip
TEXT = """\
From a snapshot of a world to the first stop, thing, material and incidence of every beam. Scenes: a block of cars,
trees and houses on hilly ground, and a world of each outdoor kind (seed {seed}). *As triangles*: a box 12, a cylinder
64, an ellipsoid 224, a quad of the ground 2. Embree (by `embreex`, distances only, one thread, tree built before) casts
the same beams on those triangles, in the same run, round by round; it knows no volumes, so leaves are solid to it. Two
processes run side by side for {seconds:g} s each, every sweep from another yaw."""


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.casting", description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("casting.md"), help="where the Markdown goes")
    chosen = parser.parse_args()
    rng = np.random.default_rng(SEED)
    about = facts(
        load=f"{os.getloadavg()[0]:.1f} in the minute before",
        libraries=", ".join(f"{name} {metadata.version(name)}" for name in ("numba", "embreex")),
    )
    rows = [_row("block", "hdl32e", rng)]
    rows += [_row(name, "hdl32e", rng) for name in ("street", "junction", "highway", "parking", "residential")]
    rows += [_row("street", sensor, rng) for sensor in ("hdl64e", "os1_128", "vlp16")]
    chosen.page.write_text(
        page("Ray casting", about, TEXT.format(seed=SEED, seconds=SECONDS), table(HEAD, rows)), "utf-8"
    )


if __name__ == "__main__":
    main()
