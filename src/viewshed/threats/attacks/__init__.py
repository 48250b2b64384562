"""Attacks on a sweep: the table, the role, and the record of what was touched.

>>> from viewshed.threats.attacks import ADAPTIVE, ATTACKS
>>> "far_wall" in ATTACKS, "adaptive_over_claim" in ADAPTIVE
(True, True)

The attacks by name: ``ATTACKS[name](budget)`` makes one; what each is tried with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, cast

from viewshed.fov.estimate import FovEstimator
from viewshed.sweep import Sweep
from viewshed.threats.attacks.base import Attack, Tampered, Wedge
from viewshed.threats.attacks.ghosts import FarWall, GhostCar, GhostWall, RemovalAndFarWall
from viewshed.threats.attacks.points import (
    PAPER_ATTACK,
    PAPER_INDOOR_ATTACK,
    Cluster,
    Frustum,
    Mode,
    Side,
    Uniform,
    WedgeCluster,
)
from viewshed.threats.attacks.removal import HighFrequencyRemoval, Jamming, PhysicalRemoval, Relay
from viewshed.threats.attacks.replay import CoherentPhantom, PoseSpoof, Replay
from viewshed.threats.attacks.spoofer import FINGERPRINT_RELIABILITY, RELIABILITY, Spoofer

if TYPE_CHECKING:
    from viewshed.threats.attacks._gradient import Expectation, WhiteBox
    from viewshed.threats.attacks.adaptive import (
        ADAPTIVE,
        BlackBox,
        Evade,
        Objective,
        OverClaim,
        SearchResult,
        Trip,
        UnderClaim,
    )


FULL_WEDGE = 1_000_000_000
"""A budget that no wedge holds: every beam in it."""

ROAD_EXTENT_M = 64.0


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What an attacker has beside the sweep that is attacked.

    Attributes:
        earlier: sweeps of the same sensor before this one, the oldest first; the first is where phantoms appear, the
            last is what is replayed.
        estimator: what the victim runs, for attackers that adapt to it.
        half_extent_m: half the side of the victim's grid; ranges are in proportion to it, 64 m on roads.
    """

    earlier: tuple[Sweep, ...] = ()
    estimator: FovEstimator | None = None
    half_extent_m: float = ROAD_EXTENT_M

    @property
    def scale(self) -> float:
        """Ranges of an attack as a multiple of those on roads."""
        return self.half_extent_m / ROAD_EXTENT_M


NOTHING = Knowledge()


class AttackFactory(Protocol):
    """Makes an attack with at most ``budget`` returns; None for the attack's own default."""

    def __call__(self, budget: int | None = None, knowledge: Knowledge = NOTHING) -> Attack:
        """Return the attack."""
        ...


def _uniform(budget: int | None, known: Knowledge, mode: Mode) -> Attack:
    return Uniform(150 if budget is None else budget, known.half_extent_m, mode)


def _cluster(budget: int | None, known: Knowledge, mode: Mode) -> Attack:
    range_m = (10.0 * known.scale, 70.0 * known.scale)
    return Cluster(150 if budget is None else budget, range_m=range_m, mode=mode)


def _wedge_cluster(budget: int | None, known: Knowledge, mode: Mode) -> Attack:
    return WedgeCluster(100 if budget is None else budget, range_m=10.0 * known.scale, mode=mode)


def _frustum(budget: int | None, known: Knowledge, side: Side, mode: Mode = "beam_constrained") -> Attack:
    k, behind = known.scale, side == "behind"
    range_m = ((4.0 if behind else 8.0) * k, 40.0 * k)
    return Frustum(200 if budget is None else budget, side, (8.0 if behind else 4.0) * k, range_m, mode=mode)


def _replay(budget: int | None, known: Knowledge) -> Attack:
    if not known.earlier:
        raise ValueError("replay needs an earlier sweep, got none; give Knowledge(earlier=(sweep, …))")
    return Replay(known.earlier[-1], budget)


def _coherent_phantom(budget: int | None, known: Knowledge) -> Attack:
    first = known.earlier[0] if known.earlier else None
    pose = None if first is None else first.world_from_sensor
    range_m, reach_m = max(12.0 * known.scale, 4.0), (3.0, 50.0 * known.scale)
    return CoherentPhantom(pose, None if first is None else first.t_ns, budget, range_m, reach_m=reach_m)


_MAKERS: dict[str, Callable[[int | None, Knowledge], Attack]] = {
    "uniform": lambda budget, known: _uniform(budget, known, "free_form"),
    "uniform_on_beams": lambda budget, known: _uniform(budget, known, "beam_constrained"),
    "cluster": lambda budget, known: _cluster(budget, known, "free_form"),
    "cluster_on_beams": lambda budget, known: _cluster(budget, known, "beam_constrained"),
    "wedge_cluster": lambda budget, known: _wedge_cluster(budget, known, "beam_constrained"),
    "wedge_cluster_free": lambda budget, known: _wedge_cluster(budget, known, "free_form"),
    "frustum": lambda budget, known: _frustum(budget, known, "behind"),
    "frustum_before": lambda budget, known: _frustum(budget, known, "before"),
    "frustum_free": lambda budget, known: _frustum(budget, known, "behind", "free_form"),
    "ghost_car": lambda budget, known: GhostCar(budget, range_m=max(10.0 * known.scale, 4.0)),
    "ghost_wall": lambda budget, known: GhostWall(budget, range_m=15.0 * known.scale),
    "far_wall": lambda budget, known: FarWall(budget, near_m=25.0 * known.scale, far_m=50.0 * known.scale),
    "removal": lambda budget, known: PhysicalRemoval(budget, aim_m=30.0 * known.scale),
    "high_frequency_removal": lambda budget, known: HighFrequencyRemoval(budget, aim_m=30.0 * known.scale),
    "jamming": lambda budget, known: Jamming(budget),
    "replay": _replay,
    "coherent_phantom": _coherent_phantom,
    "relay": lambda budget, known: Relay(budget, 5.0 * known.scale, aim_m=30.0 * known.scale),
    "pose_spoof": lambda budget, known: PoseSpoof(0.0, 0.0) if budget == 0 else PoseSpoof(shift_m=known.scale),
    "removal_and_far_wall": lambda budget, known: RemovalAndFarWall(budget, far_m=50.0 * known.scale),
}


def _make(name: str, budget: int | None = None, knowledge: Knowledge = NOTHING) -> Attack:
    return _MAKERS[name](budget, knowledge)


ATTACKS: dict[str, AttackFactory] = {name: partial(_make, name) for name in _MAKERS}
"""By name, with sound parameters. Attacks that last need ``Knowledge(earlier=…)``."""

FAMILY: dict[str, int] = {
    "uniform": 1, "uniform_on_beams": 1, "cluster": 2, "cluster_on_beams": 2, "wedge_cluster": 3,
    "wedge_cluster_free": 3, "frustum": 4, "frustum_before": 4, "frustum_free": 4, "ghost_car": 5, "ghost_wall": 6,
    "far_wall": 7, "removal": 8, "high_frequency_removal": 9, "jamming": 10, "replay": 11, "coherent_phantom": 11,
    "relay": 12, "pose_spoof": 13, "removal_and_far_wall": 14,
}  # fmt: skip
"""The number of the family that each belongs to."""

FREE_FORM = frozenset({"uniform", "cluster", "wedge_cluster_free", "frustum_free"})
"""Attacks that add points anywhere; ``pose_spoof`` touches no return, and all others keep to the beams."""

EARLIER = frozenset({"replay"})
"""Attacks that cannot be made without an earlier sweep."""

_COUNTS = (0, 50, 100, 150, 200, 1000)

BUDGETS: dict[str, tuple[int, ...]] = {
    name: (0,) if name == "pose_spoof" else _COUNTS if name in FREE_FORM else (*_COUNTS, FULL_WEDGE) for name in ATTACKS
}
"""The budgets that a study runs. Free points have no wedge to fill, and a pose has no points."""

SEVERITIES: dict[str, tuple[tuple[str, float], ...]] = {
    "wedge_cluster": (("budget", 60), ("budget", 100), ("budget", 200)),
    "ghost_wall": (("sector_deg", 10.0), ("sector_deg", 20.0), ("sector_deg", 30.0), ("sector_deg", 80.0)),
    "far_wall": (("sector_deg", 10.0), ("sector_deg", 30.0), ("sector_deg", 80.0)),
    "removal": (("sector_deg", 5.0), ("sector_deg", 15.0), ("sector_deg", 30.0), ("sector_deg", 45.0)),
    "high_frequency_removal": (("sector_deg", 13.0), ("sector_deg", 20.0), ("sector_deg", 80.0)),
    "jamming": (("share", 0.1), ("share", 0.3), ("share", 0.6), ("share", 1.0)),
    "relay": (("offset_m", 1.0), ("offset_m", 2.0), ("offset_m", 5.0), ("offset_m", 10.0)),
    "pose_spoof": (("yaw_deg", 0.5), ("yaw_deg", 1.0), ("yaw_deg", 2.0), ("yaw_deg", 5.0),
                   ("shift_m", 0.2), ("shift_m", 0.5), ("shift_m", 1.0), ("shift_m", 2.0)),
    "removal_and_far_wall": (("sector_deg", 10.0), ("sector_deg", 30.0), ("sector_deg", 80.0)),
}  # fmt: skip
"""For attacks that are not a matter of points alone: attributes and values, from mild to strong."""


def at_severity(name: str, attribute: str, value: float, knowledge: Knowledge = NOTHING) -> Attack:
    """Return the attack called ``name`` with one attribute changed, for example those of ``SEVERITIES``.

    A pose is spoofed in that attribute alone.

    >>> at_severity("ghost_wall", "sector_deg", 80.0).sector_deg
    80.0
    """
    attack = PoseSpoof(0.0, 0.0) if name == "pose_spoof" else ATTACKS[name](None, knowledge)
    return cast(Attack, replace(cast(Any, attack), **{attribute: value}))


_HOMES = {
    "ADAPTIVE": "adaptive", "BlackBox": "adaptive", "SearchResult": "adaptive",
    "Expectation": "_gradient", "WhiteBox": "_gradient",
    "Evade": "adaptive", "Objective": "adaptive", "OverClaim": "adaptive", "Trip": "adaptive",
    "UnderClaim": "adaptive",
}  # fmt: skip

__all__ = [
    "ADAPTIVE", "ATTACKS", "BUDGETS", "EARLIER", "FAMILY", "FINGERPRINT_RELIABILITY", "FREE_FORM", "FULL_WEDGE",
    "PAPER_ATTACK", "PAPER_INDOOR_ATTACK", "RELIABILITY", "SEVERITIES", "Attack", "AttackFactory", "BlackBox", "Evade",
    "Expectation", "Knowledge", "Objective", "OverClaim", "SearchResult", "Spoofer", "Tampered", "Trip", "UnderClaim",
    "Wedge", "WhiteBox", "at_severity",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import what attackers who adapt need when it is first used; most attacks need none of it."""
    if name not in _HOMES:
        raise AttributeError(f"module 'viewshed.threats.attacks' has no attribute {name!r}")
    return getattr(import_module(f"viewshed.threats.attacks.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
