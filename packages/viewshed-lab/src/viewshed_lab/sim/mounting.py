"""Sensor mountings: position and rotation on the carrier, and the frame in which points are given."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sweep import Sweep
from viewshed_lab._config import one_of
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.world import Agent, Thing, World, tilted

FRAMES = ("sensor", "base_shifted_back", "base")
"""Frame of the points: the ``sensor``'s; the carrier's axes with the origin at the sensor (the known offset was
subtracted); or the carrier's ``base``, whose offset from the sensor is unknown."""

_AXLE_M = (-1.35, 0.32)
"""x and z of the rear axle in the frame of a car, which is the base frame; a robot's base is below its center."""

_ROBOT_M = 1.35
"""Carriers of sensors below this height are robots."""

_LIP_M = 0.09
"""Height of a sensor at the roof's edge above the roof."""


@dataclass(frozen=True, slots=True)
class MountingFamily:
    """Bounds from which mountings are sampled uniformly; yaw, roll and ``left_m`` get random signs.

    Raises:
        ValueError: a name is unknown, bounds do not ascend, or the sensor has a yaw but its frame is not ``sensor``.
    """

    name: str  # of the family
    height_m: tuple[float, float]  # of the sensor above the ground below the carrier
    yaw_deg: tuple[float, float]  # to the left or right
    pitch_deg: tuple[float, float]  # down; negative is up
    roll_deg: tuple[float, float]  # to the left or right
    forward_m: tuple[float, float]  # from the sensor position of the generated world
    left_m: tuple[float, float]  # to the left or right of that position
    # whether the carrier has a flat roof just below the sensor that ends shortly before and beside it, so that the
    # sensor sees much of its carrier
    roof_edge: bool
    frame: str  # of ``FRAMES``

    def __post_init__(self) -> None:
        one_of(f"{self.name}: frame", self.frame, FRAMES)
        for key in ("height_m", "yaw_deg", "pitch_deg", "roll_deg", "forward_m", "left_m"):
            low, high = getattr(self, key)
            if not low <= high:
                raise ValueError(f"{self.name}: {key} must ascend, got {low}, {high}")
        if self.frame != "sensor" and self.yaw_deg != (0.0, 0.0):
            raise ValueError(f"{self.name}: yaw_deg must be 0, 0 in frame {self.frame}, got {self.yaw_deg}")
        if self.height_m[0] < 0.2:
            raise ValueError(f"{self.name}: height_m must be 0.2 or more, got {self.height_m[0]}")


@dataclass(frozen=True, slots=True)
class Mounting:
    """One mounting."""

    family: MountingFamily
    height_m: float  # of the sensor above the ground below the carrier
    yaw: float  # radians to the left
    pitch: float  # radians down
    roll: float  # radians
    forward_m: float  # from the sensor position of the generated world
    left_m: float  # as ``forward_m``

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotation (3, 3) of ``carrier_from_sensor``."""
        return tilted(self.yaw, self.pitch, self.roll)

    def mounted(self, world: World, number: int) -> tuple[World, Agent]:
        """Mount an agent's sensor; return the world with only that agent, and the agent.

        Args:
            world: made for a sensor at :attr:`height_m`.
            number: index of the agent.

        Raises:
            ValueError: the agent has no carrier.
        """
        agent = world.agents[number]
        if agent.carrier is None:
            raise ValueError(f"{agent.name} must have a carrier to mount its sensor on, got a mast; use a moving agent")
        at = agent.mount.translation + np.array([self.forward_m, self.left_m, 0.0])
        moved = replace(agent, mount=Rigid(self.rotation, at))
        things = list(world.things)
        if self.family.roof_edge:
            things[agent.carrier] = self._under(things[agent.carrier], at)
        return replace(world, things=tuple(things), agents=(moved,)), moved

    def _under(self, carrier: Thing, at: NDArray[np.float64]) -> Thing:
        """Return the carrier with a flat roof just below the sensor that ends shortly before and beside it."""
        robot, roof = self.height_m < _ROBOT_M, self.height_m - _LIP_M
        length, min_width, edge = (0.75, 0.5, 0.05) if robot else (4.6, 1.85, 0.15)
        width, center = max(min_width, 2 * (abs(at[1]) + edge)), at[0] + edge - length / 2
        body = Box(center, 0.0, length, width, roof, 0.15 * roof, 0.0, "paint")
        wheels = tuple(
            Box(center + x, 0.0, 0.16 * length, width - 0.04, 0.15 * roof + 0.05, 0.0, 0.0, "rubber")
            for x in (0.3 * length, -0.3 * length)
        )
        return replace(carrier, parts=(body, *wheels))

    def origin_m(self, agent: Agent) -> tuple[float, float, float]:
        """Return the origin of the points in the carrier's frame: the sensor, or the base."""
        if self.family.frame != "base":
            x, y, z = agent.mount.translation
            return float(x), float(y), float(z)
        return (0.0, 0.0, 0.05) if self.height_m < _ROBOT_M else (_AXLE_M[0], 0.0, _AXLE_M[1])

    def given(self, sweep: Sweep, agent: Agent) -> Sweep:
        """Return the sweep with its points transformed from the sensor's frame to the family's frame."""
        if self.family.frame == "sensor":
            return sweep
        origin = np.asarray(self.origin_m(agent))
        points = sweep.points @ agent.mount.rotation.T + (agent.mount.translation - origin)
        return sweep.replace(points=points.astype(np.float32))


def draw_mounting(family: MountingFamily, rng: np.random.Generator) -> Mounting:
    """Sample a mounting of a family; the same generator state gives the same mounting."""
    height, yaw, pitch, roll, forward, left = (
        float(rng.uniform(*bounds))
        for bounds in (
            family.height_m, family.yaw_deg, family.pitch_deg, family.roll_deg, family.forward_m, family.left_m,
        )
    )  # fmt: skip
    yaw_sign, roll_sign, left_sign = rng.choice([-1.0, 1.0], 3)
    return Mounting(
        family, height, float(np.deg2rad(yaw * yaw_sign)), float(np.deg2rad(pitch)),
        float(np.deg2rad(roll * roll_sign)), forward, float(left * left_sign),
    )  # fmt: skip
