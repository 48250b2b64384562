"""How a sensor sits on its carrier: anywhere, turned, tilted, low or tall, and in which frame its points are given."""

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
"""In which frame points are given: the ``sensor``'s; the carrier's axes with the origin at the sensor (its offset is
known and was taken off); or the carrier's ``base``, whose offset from the sensor is not given."""

_AXLE_M = (-1.35, 0.32)
"""x and z of the rear axle in the frame of a car, and so of the base frame; a robot's is below its middle."""

_ROBOT_M = 1.35
"""Carriers of sensors below this height are robots."""

_LIP_M = 0.09
"""A sensor at the roof's edge stands this far above the roof."""


@dataclass(frozen=True, slots=True)
class MountingFamily:
    """Bounds within which mountings are drawn, uniformly; signs of angles are drawn as well.

    Raises:
        ValueError: a name is unknown, bounds do not ascend, or a turned sensor is to have a base frame.
    """

    name: str  # of the family
    height_m: tuple[float, float]  # of the sensor above the ground below the carrier
    yaw_deg: tuple[float, float]  # angle of its turn to the left or right
    pitch_deg: tuple[float, float]  # angle of its tilt down; negative is up
    roll_deg: tuple[float, float]  # angle of its roll to the left or right
    forward_m: tuple[float, float]  # of the sensor from where the world's maker puts it
    left_m: tuple[float, float]  # to the left or right of there
    # whether the carrier's flat roof lies just below the sensor and ends a little before it and beside it, so that the
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

    family: MountingFamily  # that it was drawn from
    height_m: float  # of the sensor above the ground below the carrier
    yaw: float  # radians to the left
    pitch: float  # radians down
    roll: float  # radians
    forward_m: float  # from where the world's maker puts it
    left_m: float  # as ``forward_m``

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotation (3, 3) of ``carrier_from_sensor``."""
        return tilted(self.yaw, self.pitch, self.roll)

    def mounted(self, world: World, number: int) -> tuple[World, Agent]:
        """Return the world with one agent, its sensor mounted so, and that agent.

        Args:
            world: made for a sensor at :attr:`height_m`.
            number: of the agent.

        Raises:
            ValueError: the agent has no carrier.
        """
        agent = world.agents[number]
        if agent.carrier is None:
            raise ValueError(f"{agent.name} must have a carrier to mount its sensor on, got a mast; ask for one moving")
        at = agent.mount.translation + np.array([self.forward_m, self.left_m, 0.0])
        moved = replace(agent, mount=Rigid(self.rotation, at))
        things = list(world.things)
        if self.family.roof_edge:
            things[agent.carrier] = self._under(things[agent.carrier], at)
        return replace(world, things=tuple(things), agents=(moved,)), moved

    def _under(self, carrier: Thing, at: NDArray[np.float64]) -> Thing:
        """Return the carrier with a flat roof just below the sensor that ends a little before it and beside it."""
        robot, roof = self.height_m < _ROBOT_M, self.height_m - _LIP_M
        length, least_width, edge = (0.75, 0.5, 0.05) if robot else (4.6, 1.85, 0.15)
        width, middle = max(least_width, 2 * (abs(at[1]) + edge)), at[0] + edge - length / 2
        body = Box(middle, 0.0, length, width, roof, 0.15 * roof, 0.0, "paint")
        wheels = tuple(
            Box(middle + x, 0.0, 0.16 * length, width - 0.04, 0.15 * roof + 0.05, 0.0, 0.0, "rubber")
            for x in (0.3 * length, -0.3 * length)
        )
        return replace(carrier, parts=(body, *wheels))

    def origin_m(self, agent: Agent) -> tuple[float, float, float]:
        """Return where the origin of the points lies in the carrier's frame: at the sensor, or at the base."""
        if self.family.frame != "base":
            x, y, z = agent.mount.translation
            return float(x), float(y), float(z)
        return (0.0, 0.0, 0.05) if self.height_m < _ROBOT_M else (_AXLE_M[0], 0.0, _AXLE_M[1])

    def given(self, sweep: Sweep, agent: Agent) -> Sweep:
        """Return the sweep (in the sensor's frame) with its points in the frame that the family says."""
        if self.family.frame == "sensor":
            return sweep
        origin = np.asarray(self.origin_m(agent))
        points = sweep.points @ agent.mount.rotation.T + (agent.mount.translation - origin)
        return sweep.replace(points=points.astype(np.float32))


def draw_mounting(family: MountingFamily, rng: np.random.Generator) -> Mounting:
    """Return a mounting of a family; the same state of the generator gives the same mounting."""
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
