"""Report what wedges that are aimed gain over wedges at random, as a table in the docs.

Usage: python tools/aimed_attacks.py [OUT.md] [SCENES]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from adaptive_report import Scene, scenes_of

from viewshed import load_estimator
from viewshed._page import facts, page, table
from viewshed.fov.estimate import FovEstimator
from viewshed.threats.attacks import ATTACKS, Placement, Tampered
from viewshed.threats.attacks.adaptive import cells_in

VICTIMS = ("shadow_map", "majority_vote", "viewnet")
PATCH_BUDGET, PATCH_DEG = 150, 10.0
_TRIED: dict[str, tuple[str, int | None, dict[str, float]]] = {
    "far wall": ("far_wall", None, {}),
    "patch of 150": ("far_wall", PATCH_BUDGET, {"sector_deg": PATCH_DEG}),
    "removal": ("removal", None, {}),
    "removal and far wall": ("removal_and_far_wall", None, {}),
}
_INTRODUCTION = """\
{scenes} simulated road scenes (HDL-32E, clear), one sweep each; the truth is exact, for a car. Wedges are 30° wide and
all of their beams may be attacked; the patch is a far wall of {budget} returns in {patch:g}°. Spoofers win beams and
place returns as measured on commercial sensors.

- **opened**: m² a sweep in the wedge that the victim claims under attack and not before, and that the truth does not
  show;
- **precision**: of all that the victim claims in the wedge under attack, the share that the truth shows, over all
  scenes; in brackets the same of the clean sweep.

`random` aims at a return of a near obstacle; the other two read the clean sweep, as the attacker sees it
([attacks](../attacks.md))."""
_CONCLUSION = """\
What one sweep cannot know: a beam that a spoofer makes return from behind an obstacle looks exactly like a beam through
an open view. Where an attacker moves all beams that the obstacle stopped, nothing in the sweep speaks for the obstacle
any more, and every method here claims what it hides. Only something beside the sweep can tell: earlier sweeps, another
agent, a map, a camera. A removal alone is no evidence of an open view: what it opens is the method's own fault."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one attack on one victim, one number a scene each.

    Attributes:
        opened_m2: newly claimed and wrong.
        claimed: cells claimed in the wedge.
        right: of these, cells that the truth shows.
        clean_claimed: cells claimed in the wedge in the clean sweep.
        clean_right: of these, cells that the truth shows.
    """

    opened_m2: float
    claimed: int
    right: int
    clean_claimed: int
    clean_right: int


def attacked(name: str, placement: Placement, scene: Scene, number: int) -> Tampered:
    """Return the sweep of a scene under one of the attacks that are tried."""
    attack_name, budget, changes = _TRIED[name]
    attack: Any = ATTACKS[attack_name](budget)
    tampered: Tampered = replace(attack, placement=placement, **changes).apply(
        scene.sweep, np.random.Generator(np.random.PCG64(number))
    )
    return tampered


def outcome(scene: Scene, victim: FovEstimator, tampered: Tampered) -> Outcome:
    """Return what the victim claims of an attacked sweep, in the wedge where the truth is known."""
    if tampered.wedge is None:
        raise ValueError("an attack that is aimed must have a wedge, got none")
    judged = scene.known & cells_in(scene.grid, scene.sweep, tampered.wedge)
    before, after = (victim.estimate(sweep).visible() & judged for sweep in (scene.sweep, tampered.sweep))
    opened_m2 = float((after & ~before & ~scene.visible).sum()) * scene.grid.cell_area_m2
    counts = (int(cells.sum()) for cells in (after, after & scene.visible, before, before & scene.visible))
    return Outcome(opened_m2, *counts)


def _row(attack: str, placement: str, outcomes: dict[str, list[Outcome]]) -> list[str]:
    cells = []
    for found in outcomes.values():
        precision = sum(one.right for one in found) / max(sum(one.claimed for one in found), 1)
        clean = sum(one.clean_right for one in found) / max(sum(one.clean_claimed for one in found), 1)
        cells += [f"{np.mean([one.opened_m2 for one in found]):.0f}", f"{precision:.3f} ({clean:.3f})"]
    return [attack, f"`{placement}`", *cells]


def report(scenes: list[Scene]) -> str:
    """Return the page."""
    victims = {name: load_estimator(name, grid=scenes[0].grid) for name in VICTIMS}
    rows = []
    for attack in _TRIED:
        for placement in get_args(Placement):
            outcomes: dict[str, list[Outcome]] = {name: [] for name in VICTIMS}
            for number, scene in enumerate(scenes):
                tampered = attacked(attack, placement, scene, number)
                for name, victim in victims.items():
                    outcomes[name].append(outcome(scene, victim, tampered))
            rows.append(_row(attack, placement, outcomes))
    header = ["attack", "placement", *(f"{name}: {what}" for name in VICTIMS for what in ("opened", "precision"))]
    about = _INTRODUCTION.format(scenes=len(scenes), budget=PATCH_BUDGET, patch=PATCH_DEG)
    return page("Aimed attacks: what they gain", facts(), about, table(header, rows), _CONCLUSION)


def main() -> None:
    """Write the report."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/results/aimed_attacks.md")
    out.write_text(report(scenes_of(int(sys.argv[2]) if len(sys.argv) > 2 else 24)), "utf-8")


if __name__ == "__main__":
    main()
