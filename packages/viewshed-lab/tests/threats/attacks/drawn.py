"""Attacks with random parameters, and the rules that one application of them violates."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from tests.threats.attacks.oracle import COLUMNS, Scene, broken_by_any, broken_on_beams

from viewshed_lab.threats.attacks import ATTACKS, FREE_FORM, FULL_WEDGE, INFORMED, Attack, Knowledge, Spoofer, Tampered

BUDGETS = (None, 0, 1, 7, 50, 150, 1000, FULL_WEDGE)
MOVE_RETURNS = {
    "frustum", "frustum_before", "far_wall", "far_wall_aimed", "far_wall_clean", "removal", "removal_aimed", "relay",
}  # fmt: skip
"""Attacks that do not need the beam table: they move existing returns."""
RANGES: dict[str, tuple[float, float]] = {
    "sector_deg": (0.1, 150.0), "azimuth": (-7.0, 7.0), "heading": (-4.0, 4.0), "far_m": (5.0, 150.0),
    "near_m": (2.0, 60.0), "noise_rate": (0.0, 1.0), "noise_m": (1.0, 80.0), "share": (0.0, 1.0),
    "blind_share": (0.0, 1.0), "offset_m": (-10.0, 30.0), "apart_m": (0.2, 30.0), "height_m": (0.3, 6.0),
    "yaw_deg": (0.0, 5.0), "shift_m": (0.0, 2.0), "tilt_deg": (0.0, 3.0), "spread_m": (0.1, 8.0),
}  # fmt: skip


def generator(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed if len(seed) > 1 else seed[0]))


def drawn(name: str, scene: Scene, rng: np.random.Generator) -> tuple[Attack, int | None]:
    """Return an attack called ``name`` with random parameters, and its budget."""
    budget = BUDGETS[rng.integers(len(BUDGETS))]
    if name in FREE_FORM and budget == FULL_WEDGE:
        budget = 1500
    attack: Any = (ATTACKS | INFORMED)[name](budget, Knowledge((scene.earlier,), None, scene.half_extent_m))
    known = {field.name for field in fields(attack)}
    changes: dict[str, Any] = {
        key: float(rng.uniform(*RANGES[key])) for key in sorted(known & RANGES.keys()) if rng.random() < 0.5
    }
    if "spoofer" in known and rng.random() < 0.5:
        changes["spoofer"] = Spoofer(float(rng.random()), float(rng.uniform(0, 0.3)), float(rng.uniform(0, 0.6)))
    if name == "coherent_phantom" and rng.random() < 0.5:
        changes["anchor"] = "sensor"
    return replace(attack, **changes), budget


def broken(name: str, scene: Scene, attack: Attack, budget: int | None, seed: int) -> tuple[list[str], Tampered]:
    """Apply an attack twice; return the rules that it violates, and the tampered sweep."""
    before = scene.sweep.points.tobytes()
    tampered = attack.apply(scene.sweep, generator(seed))
    found = [] if before == scene.sweep.points.tobytes() else ["the clean sweep changed"]
    if not same(tampered, attack.apply(scene.again(), generator(seed))):
        found.append("the same seed gave other bytes")
    if name in FREE_FORM or name == "pose_spoof":
        found += broken_by_any(scene.sweep, tampered, budget if name in FREE_FORM else 0)
    else:
        found += broken_on_beams(scene, tampered, budget)
    return found, tampered


def same(one: Tampered, other: Tampered) -> bool:
    """Return whether two records and their sweeps are equal byte by byte."""
    pairs: list[tuple[Any, Any]] = [(one.added, other.added), (one.removed, other.removed)]
    pairs += [(getattr(one.sweep, name), getattr(other.sweep, name)) for name in COLUMNS]
    pose, again = one.sweep.world_from_sensor, other.sweep.world_from_sensor
    if pose is not None and again is not None:
        pairs.append((pose.as_matrix(), again.as_matrix()))
    return one.wedge == other.wedge and all((a is None and b is None) or a.tobytes() == b.tobytes() for a, b in pairs)
