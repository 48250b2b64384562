"""Profiles: pipeline settings by use case."""

from __future__ import annotations

from dataclasses import dataclass

from viewshed.guarantees.envelope import Threat
from viewshed.pipeline.reactions import ReactionRules


@dataclass(frozen=True, slots=True)
class Profile:
    """The settings of a pipeline.

    Raises:
        ValueError: a number is negative.
    """

    method: str | None  # name of an estimator; None for the default
    grid: str  # name in :data:`viewshed.grid.GRIDS`
    history: int  # number of earlier sweeps of a sensor to use, if poses are known
    monitor: bool  # whether a monitor checks the stream
    rules: ReactionRules  # how caution rises and falls
    rate_hz: float  # maximum sweeps of a sensor to estimate in a second; 0 for all
    certify: Threat | None = None  # threat for which claims are certified, to keep them in an alarm; None for none

    def __post_init__(self) -> None:
        if self.history < 0 or not self.rate_hz >= 0.0:
            raise ValueError(f"history and rate_hz must not be negative, got {self.history} and {self.rate_hz}")


PROFILES = {
    "robot": Profile("shadow_map", "indoor", 0, True, ReactionRules(), 10.0),
    "infrastructure": Profile("shadow_map", "road", 0, True, ReactionRules(recover_sweeps=30), 10.0),
    "mapping": Profile("shadow_map", "road", 5, False, ReactionRules(), 0.0),
    "contested": Profile(
        "shadow_map",
        "road",
        5,
        True,
        ReactionRules(recover_sweeps=50, widen_sectors=2, most_suspect=0.0),
        0.0,
        certify=Threat("window", 5),
    ),
}
"""``robot``: a small vehicle among people; fine cells, at most 10 Hz.
``infrastructure``: a fixed sensor on a pole, whose pose adds no information; caution falls slowly.
``mapping``: probabilities of every sweep, using earlier ones; no monitor and no reactions.
``contested``: attacks are expected: any alarm leaves only claims that an earlier sweep confirms or that five replaced
beams at a target cannot have opened; caution falls one step after 50 calm sweeps."""


def profile_named(name: str) -> Profile:
    """Return the profile with this name.

    Raises:
        ValueError: there is none.
    """
    if name not in PROFILES:
        raise ValueError(f"profile must be one of {', '.join(PROFILES)}, got {name!r}")
    return PROFILES[name]
