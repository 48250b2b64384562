"""Attacks on a sweep: the tables by name, the protocol, and the record of changes.

>>> from viewshed_lab.threats.attacks import ADAPTIVE, ATTACKS
>>> "far_wall" in ATTACKS, "adaptive_over_claim" in ADAPTIVE
(True, True)

``ATTACKS[name](budget)`` makes an attack; ``BUDGETS`` and ``SEVERITIES`` hold the values that studies try.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, cast

from viewshed_lab.threats.attacks._gradient import Expectation, WhiteBox
from viewshed_lab.threats.attacks.adaptive import (
    ADAPTIVE,
    BlackBox,
    Evade,
    Objective,
    OverClaim,
    SearchResult,
    UnderClaim,
)
from viewshed_lab.threats.attacks.base import NOTHING, ROAD_EXTENT_M, Attack, AttackFactory, Knowledge, Tampered, Wedge
from viewshed_lab.threats.attacks.ghosts import FarWall, GhostCar, GhostWall, RemovalAndFarWall
from viewshed_lab.threats.attacks.informed import CopiedObject, VanishedObject
from viewshed_lab.threats.attacks.points import (
    PAPER_ATTACK,
    PAPER_INDOOR_ATTACK,
    Cluster,
    Frustum,
    Uniform,
    WedgeCluster,
)
from viewshed_lab.threats.attacks.replay import CoherentPhantom, PoseSpoof, Replay
from viewshed_lab.threats.attacks.spoofer import CLEAN_SPOOFER, RELIABILITY, Spoofer
from viewshed_lab.threats.attacks.wedge_attack import HighFrequencyRemoval, Jamming, PhysicalRemoval, Placement, Relay
from viewshed_lab.threats.attacks.whole_cloud import (
    Blinding,
    Mirror,
    SensorNoise,
    ShiftedAxis,
    TrojanInjects,
    TrojanSuppresses,
)

__all__ = [
    "ADAPTIVE", "ATTACKS", "BUDGETS", "CLEAN_SPOOFER", "EARLIER", "FAMILY", "FREE_FORM", "FULL_WEDGE", "INFORMED",
    "PAPER_ATTACK", "PAPER_INDOOR_ATTACK", "RELIABILITY", "ROAD_EXTENT_M", "SEVERITIES", "WHOLE_CLOUD", "Attack",
    "AttackFactory", "BlackBox", "CopiedObject", "Evade", "Expectation", "Knowledge", "Objective", "OverClaim",
    "Placement", "SearchResult", "Spoofer", "Tampered", "UnderClaim", "VanishedObject", "Wedge", "WhiteBox",
    "at_severity",
]  # fmt: skip

FULL_WEDGE = 1_000_000_000
"""A budget larger than any wedge: every beam in it."""


def _replay(known: Knowledge) -> Attack:
    if not known.earlier:
        raise ValueError("replay needs an earlier sweep, got none; give Knowledge(earlier=(sweep, …))")
    return Replay(known.earlier[-1])


def _coherent_phantom(known: Knowledge) -> Attack:
    first = known.earlier[0] if known.earlier else None
    pose, first_ns = (None, None) if first is None else (first.world_from_sensor, first.t_ns)
    return CoherentPhantom(pose, first_ns, range_m=max(12.0 * known.scale, 4.0), reach_m=(3.0, 50.0 * known.scale))


def _cluster(known: Knowledge) -> Cluster:
    return Cluster(range_m=(10.0 * known.scale, 70.0 * known.scale))


def _frustum(known: Knowledge) -> Frustum:
    return Frustum(apart_m=8.0 * known.scale, range_m=(4.0 * known.scale, 40.0 * known.scale))


_MAKERS: dict[str, Callable[[Knowledge], Attack]] = {
    "uniform": lambda known: Uniform(half_extent_m=known.half_extent_m),
    "uniform_on_beams": lambda known: Uniform(half_extent_m=known.half_extent_m, mode="beam_constrained"),
    "cluster": _cluster,
    "cluster_on_beams": lambda known: replace(_cluster(known), mode="beam_constrained"),
    "wedge_cluster": lambda known: WedgeCluster(range_m=10.0 * known.scale),
    "wedge_cluster_free": lambda known: WedgeCluster(range_m=10.0 * known.scale, mode="free_form"),
    "frustum": _frustum,
    "frustum_before": lambda known: Frustum(
        side="before", apart_m=4.0 * known.scale, range_m=(8.0 * known.scale, 40.0 * known.scale)
    ),
    "frustum_free": lambda known: replace(_frustum(known), mode="free_form"),
    "ghost_car": lambda known: GhostCar(range_m=max(10.0 * known.scale, 4.0)),
    "ghost_wall": lambda known: GhostWall(range_m=15.0 * known.scale),
    "far_wall": lambda known: FarWall(near_m=25.0 * known.scale, far_m=50.0 * known.scale),
    "removal": lambda known: PhysicalRemoval(aim_m=30.0 * known.scale),
    "high_frequency_removal": lambda known: HighFrequencyRemoval(aim_m=30.0 * known.scale),
    "jamming": lambda known: Jamming(),
    "replay": _replay,
    "coherent_phantom": _coherent_phantom,
    "relay": lambda known: Relay(offset_m=5.0 * known.scale, aim_m=30.0 * known.scale),
    "pose_spoof": lambda known: PoseSpoof(shift_m=known.scale),
    "removal_and_far_wall": lambda known: RemovalAndFarWall(far_m=50.0 * known.scale),
}


def _changed(name: str, changes: dict[str, Any], known: Knowledge) -> Attack:
    return cast(Attack, replace(cast(Any, _MAKERS[name](known)), **changes))


_MAKERS |= {
    f"{name}_{word}": partial(_changed, name, changes)
    for word, changes, names in (
        ("aimed", {"placement": "largest_hidden_area"}, ("far_wall", "removal", "removal_and_far_wall")),
        ("clean", {"spoofer": CLEAN_SPOOFER},
         ("wedge_cluster", "ghost_car", "ghost_wall", "far_wall", "removal_and_far_wall")),
    )
    for name in names
}  # fmt: skip
_MAKERS |= {
    "vanished_object": lambda known: VanishedObject(near_m=25.0 * known.scale),
    "copied_object": lambda known: CopiedObject(near_m=25.0 * known.scale),
}


def _make(name: str, budget: int | None = None, knowledge: Knowledge = NOTHING) -> Attack:
    attack: Any = _MAKERS[name](knowledge)
    if budget is None:
        return cast(Attack, attack)
    if name == "pose_spoof":  # changes no return: a budget of 0 is no attack, any other is the full attack
        return PoseSpoof(0.0, 0.0) if budget == 0 else attack
    return cast(Attack, replace(attack, budget=budget))


INFORMED: dict[str, AttackFactory] = {name: partial(_make, name) for name in ("vanished_object", "copied_object")}
"""Attacks of family 15, designed to avoid what a monitor checks in one sweep."""

ATTACKS: dict[str, AttackFactory] = {name: partial(_make, name) for name in _MAKERS if name not in INFORMED}
"""By name, with reasonable parameters. Attacks over time need ``Knowledge(earlier=…)``."""


_WHOLE: dict[str, Callable[[Knowledge], Attack]] = {
    "shifted_axis": lambda known: ShiftedAxis(),
    "sensor_noise": lambda known: SensorNoise(),
    "blinding": lambda known: Blinding(),
    "mirror_adds": lambda known: Mirror(range_m=8.0 * known.scale),
    "mirror_removes": lambda known: Mirror(range_m=8.0 * known.scale, turn_deg=0.0, tilt_deg=40.0),
    "trojan_injects": lambda known: TrojanInjects(range_m=max(12.0 * known.scale, 4.0)),
    "trojan_suppresses": lambda known: TrojanSuppresses(far_m=max(30.0 * known.scale, 8.0)),
}


def _make_whole(name: str, budget: int | None = None, knowledge: Knowledge = NOTHING) -> Attack:
    if budget is not None:
        raise ValueError(f"attack {name} must have no budget, got {budget}: it works on the whole cloud")
    return _WHOLE[name](knowledge)


WHOLE_CLOUD: dict[str, AttackFactory] = {name: partial(_make_whole, name) for name in _WHOLE}
"""Attacks on the whole cloud, mirrors, and trojans in the driver: without a budget, and not tied to beams."""


FAMILY: dict[str, int] = {
    "uniform": 1, "uniform_on_beams": 1, "cluster": 2, "cluster_on_beams": 2, "wedge_cluster": 3,
    "wedge_cluster_free": 3, "frustum": 4, "frustum_before": 4, "frustum_free": 4, "ghost_car": 5, "ghost_wall": 6,
    "far_wall": 7, "removal": 8, "high_frequency_removal": 9, "jamming": 10, "replay": 11, "coherent_phantom": 11,
    "relay": 12, "pose_spoof": 13, "removal_and_far_wall": 14, "far_wall_aimed": 7, "removal_aimed": 8,
    "removal_and_far_wall_aimed": 14, "wedge_cluster_clean": 17, "ghost_car_clean": 17, "ghost_wall_clean": 17,
    "far_wall_clean": 17, "removal_and_far_wall_clean": 17, "vanished_object": 15, "copied_object": 15,
    "shifted_axis": 18, "sensor_noise": 18,
    "blinding": 19, "mirror_adds": 20, "mirror_removes": 20, "trojan_injects": 21, "trojan_suppresses": 21,
}  # fmt: skip
"""Family number of each attack in ``ATTACKS``, ``INFORMED`` and ``WHOLE_CLOUD``."""

FREE_FORM = frozenset({"uniform", "cluster", "wedge_cluster_free", "frustum_free"})
"""Attacks that add points anywhere; ``pose_spoof`` changes no return, and all others stay on the beams."""

EARLIER = frozenset({"replay"})
"""Attacks that require an earlier sweep."""

_COUNTS = (0, 50, 100, 150, 200, 1000)

BUDGETS: dict[str, tuple[int, ...]] = {
    name: (0,) if name == "pose_spoof" else _COUNTS if name in FREE_FORM else (*_COUNTS, FULL_WEDGE) for name in ATTACKS
}
"""The budgets that a study runs. Free points have no wedge to fill; ``pose_spoof`` has no points."""

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
"""For attacks with a strength other than the number of points: attributes and values, from mild to strong."""


def at_severity(name: str, attribute: str, value: float, knowledge: Knowledge = NOTHING) -> Attack:
    """Return the attack ``name`` with one attribute changed, for example one of ``SEVERITIES``.

    For ``pose_spoof`` the other attributes are 0.

    >>> at_severity("ghost_wall", "sector_deg", 80.0).sector_deg
    80.0
    """
    attack = PoseSpoof(0.0, 0.0) if name == "pose_spoof" else ATTACKS[name](None, knowledge)
    return cast(Attack, replace(cast(Any, attack), **{attribute: value}))
