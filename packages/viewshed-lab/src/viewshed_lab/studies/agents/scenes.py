"""Simulated scenes of several agents, stored as files: views, detections and truth, shared by all runs."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed.agents.registration import UNSTATED
from viewshed.agents.report import AgentReport
from viewshed.arrays import F64
from viewshed.detections import Detections, moved_boxes
from viewshed.estimators import load_estimator
from viewshed.fov.estimate import Basis, FovEstimate
from viewshed.fov.height_map import NODES, HeightMap
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS, BevGrid
from viewshed.objects.detector import Detector
from viewshed.preprocess.leveling import level
from viewshed.recordings.write.moment import DriveTruth, ObjectTruth
from viewshed.sweep import Sweep
from viewshed_lab.data.drive import drive_sweeps
from viewshed_lab.data.simulated import ScenePlan, world_of
from viewshed_lab.sim.world import World
from viewshed_lab.sim.worlds.layout import with_masts_of
from viewshed_lab.studies.agents.plan import AgentsPlan

FOLDER = "scenes"

GRID = GRIDS["road"]

MAST_M, PITCH_DEG = 20.0, 30.0
"""Height and downward pitch of the published infrastructure sensor."""

_NODES = BevGrid(NODES, GRID.half_extent_m).centers
"""Places at which ground heights are stored."""

LEVELS = 255
"""Number of steps of the stored probabilities."""


def with_tall_masts(world: World) -> World:
    """Return the world with masts of the published height and sensors of the published pitch."""
    return with_masts_of(world, MAST_M, float(np.radians(PITCH_DEG)))


@lru_cache(maxsize=2)
def scene_world(plan: AgentsPlan, split: str, number: int) -> World:
    """Return the world of a scene of a study, with tall masts if the plan says so."""
    world = world_of(plan.scene(split, number))
    return with_tall_masts(world) if plan.has_tall_masts(number) else world


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Data of T times of A agents."""

    times_s: F64  # (T,) of the sweeps
    prob: NDArray[np.uint8]  # (T, A, cells, cells) uint8 steps of the probability of visible
    state: NDArray[np.uint8]  # (T, A, cells, cells) uint8 states
    poses: F64  # (T, A, 4, 4) ``world_from_level``
    # (T, A, nodes, nodes) float16 ground heights that each agent estimates, in ``level``
    ground: NDArray[np.float16]
    bases: list[list[dict[str, Any]]]  # ``Basis`` of the estimates, T lists of A
    found: F64  # (D, 9) detections of all times and agents: box (7) in ``level``, kind, returns
    found_at: NDArray[np.int16]  # (D, 2) time and agent of each detection
    objects: F64  # (T, K, 7) boxes of all objects in the world
    returns: NDArray[np.int32]  # (T, A, K) int32 number of returns of each object for each agent
    carriers: NDArray[np.int64]  # (A,) object that carries each agent's sensor, -1 for a mast

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the agents."""
        return tuple(f"agent{number}" for number in range(len(self.carriers)))

    @classmethod
    def simulate(
        cls, plan: ScenePlan, detector: Detector, sweeps: Iterable[tuple[Sweep, DriveTruth]] | None = None
    ) -> Self:
        """Return a scene: simulate and level every sweep, estimate its view by the default method, detect objects.

        Args:
            plan: plan of the scene.
            detector: detects the objects.
            sweeps: sweeps to use instead of simulating them, for another world or attacks.
        """
        agents, estimator = plan.preset.agents, load_estimator("shadow_map", grid=GRID)
        times = plan.frames // agents
        times_s = np.asarray((np.arange(times) + 0.5) * plan.preset.interval_s, np.float64)
        shape = (times, agents)
        prob, state = (np.zeros((*shape, *GRID.shape), np.uint8) for _ in range(2))
        ground = np.zeros((*shape, NODES, NODES), np.float16)
        poses, carriers = np.zeros((*shape, 4, 4)), np.full(agents, -1, np.int64)
        objects, returns = list[F64](), list[NDArray[np.int32]]()
        bases: list[list[dict[str, Any]]] = [[] for _ in range(times)]
        found, found_at = [np.zeros((0, 9))], [np.zeros((0, 2), np.int16)]
        for frame, (sweep, truth) in enumerate(drive_sweeps(plan) if sweeps is None else sweeps):
            time, agent = divmod(frame, agents)
            leveled = level(sweep, GRID)
            estimate, detections = estimator.estimate(leveled), detector.detect(leveled)
            if estimate.world_from_level is None or estimate.basis is None:
                raise ValueError(
                    f"the sweeps of {plan.name} must have poses and points, got frame {frame} without them"
                )
            prob[time, agent], state[time, agent] = np.rint(LEVELS * estimate.visible_prob), estimate.state
            poses[time, agent] = estimate.world_from_level.as_matrix()
            ground[time, agent] = leveled.ground.at(_NODES)
            bases[time].append({name: getattr(estimate.basis, name) for name in Basis.__slots__})
            if agent == 0:
                objects.append(np.array([_box_of(one) for one in truth.objects]).reshape(-1, 7))
            if truth.carrier is not None:
                carriers[agent] = [one.number for one in truth.objects].index(truth.carrier)
            returns.append(truth.returns)
            found.append(np.column_stack([detections.boxes, detections.kinds, detections.returns]))
            found_at.append(np.tile(np.array([time, agent], np.int16), (len(detections), 1)))
        return cls(
            times_s, prob, state, poses, ground, bases, np.concatenate(found), np.concatenate(found_at),
            np.stack(objects), np.stack(returns).reshape(*shape, -1), carriers,
        )  # fmt: skip

    def reports(self, time: int) -> list[AgentReport]:
        """Return the honest reports of all agents at a time."""
        out = []
        for number, agent in enumerate(self.agents):
            pose = self.poses[time, number]
            estimate = FovEstimate(
                GRID, self.prob[time, number].astype(np.float32) / np.float32(LEVELS), self.state[time, number],
                method="shadow_map", world_from_level=Rigid(pose[:3, :3], pose[:3, 3]),
                t_ns=round(1e9 * self.times_s[time]), agent=agent, basis=Basis(**self.bases[time][number]),
            )  # fmt: skip
            rows = self.found[(self.found_at == (time, number)).all(axis=1)]
            detections = Detections(rows[:, :7], rows[:, 7].astype(np.uint8), rows[:, 8].astype(np.int32))
            carrier = self.carriers[number]
            own = None
            if carrier >= 0 and estimate.world_from_level is not None:
                own = moved_boxes(self.objects[time, [carrier]], estimate.world_from_level.inverse())[0]
            heights = self.ground[time, number].astype(np.float32)
            ground = HeightMap(heights, GRID.half_extent_m, np.ones(heights.shape, np.bool_))
            out.append(AgentReport(estimate, detections, own, UNSTATED, ground))
        return out

    def save(self, path: Path) -> None:
        """Write the scene atomically; equal scenes give equal bytes."""
        file = io.BytesIO()
        bases = np.frombuffer(json.dumps(self.bases).encode(), np.uint8)
        arrays = {name: getattr(self, name) for name in self.__slots__ if name != "bases"}
        np.savez_compressed(file, bases=bases, **arrays)
        write_atomic(path, file.getvalue())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Return the scene in a file.

        Raises:
            OSError, ValueError, KeyError: the file cannot be read.
        """
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in cls.__slots__}
        return replace(cls(**arrays), bases=json.loads(arrays["bases"].tobytes()))


def _box_of(one: ObjectTruth) -> list[float]:
    """Return the box (7,) of an object in the world."""
    return [*one.world_from_box.translation.tolist(), *one.size_m, one.world_from_box.yaw]


def scene_path(folder: Path, split: str, number: int) -> Path:
    """Return the file of a scene."""
    return folder / FOLDER / f"{split}-{number:04d}.npz"
