"""Profiles: the settings of a pipeline, by what it is for."""

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

    method: str | None  # name of an estimator; None for the usual one
    grid: str  # name in :data:`viewshed.grid.GRIDS`
    history: int  # earlier sweeps of a sensor that help, where poses are known
    monitor: bool  # whether the stream is watched
    rules: ReactionRules  # how caution rises and falls
    rate_hz: float  # sweeps of a sensor that are estimated in a second; 0 for all of them
    certify: Threat | None = None  # the threat whose certificate an alarm falls back to; None for none

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
"""``robot``: a small vehicle among people, fine cells around it, no more work than its sensor's usual 10 Hz.
``infrastructure``: a sensor on a pole, whose own pose tells nothing new; calm returns slowly.
``mapping``: probabilities of every sweep, helped by earlier ones; nobody reacts.
``contested``: somebody may be lying: earlier sweeps confirm claims, caution rises at once and falls after 50 sweeps,
and what no five replaced beams at a target can have opened stays claimed."""


def profile_named(name: str) -> Profile:
    """Return the profile of a name.

    Raises:
        ValueError: there is none of this name.
    """
    if name not in PROFILES:
        raise ValueError(f"profile must be one of {', '.join(PROFILES)}, got {name!r}")
    return PROFILES[name]
