"""Report whether attacks keep the beam model's rules, over many draws of each, as a table in the docs.

Usage: python -m tools.attack_properties [OUT.md] [DRAWS_A_FAMILY]
"""

from __future__ import annotations

import re
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tests.threats.attacks.drawn import broken, broken_by_null, drawn
from tests.threats.attacks.oracle import Scene, scenes

from viewshed._page import facts, page, table
from viewshed._results import write_page
from viewshed.threats.attacks import ATTACKS, FAMILY, FREE_FORM, INFORMED

NAMES = (*ATTACKS, *INFORMED)
WORKERS = 2
PART = 500
SAME_SCENE = 25
"""Draws in a row from one scene: the first attack finds its beams, the others remember them."""
SEEN_IN = (
    ("junction", "hdl32e", 120, 0.1, 3.0),
    ("highway", "os1_32", 96, 0.1, 2.0),
    ("street", "vlp32c", 90, 0.0, 4.0),
    ("parking", "vlp16", 180, 0.05, 1.0),
    ("rooms", "vlp16", 120, 0.1, 2.0),
)
"""World, sensor, columns, period of a revolution, time: coarse, so that many draws are affordable."""
_INTRODUCTION = """\
Each draw applies an attack with parameters drawn at random (budget, sector, azimuth, ranges, reliability, noise) to one
of {scenes} simulated sweeps: sensors on vehicles, robots and tilted masts, at rest and in motion. The oracle is the
simulator's own range image, motion and beam table, which the attack does not see. The draws of a family are shared
among its attacks.

**Rules on beams**: at most one return for each beam; each return added within 1 mm of its beam and within 1 µs of its
column's time; all changes inside the wedge; never more beams touched than the budget; ranges that the sensor reports;
rows in firing order.

**Rules for all**: the clean sweep is not modified; the same seed gives the same bytes, also for an equal sweep in other
memory; rows that are not touched keep their bytes and their order; the masks fit; intensities are the sweep's own;
never more points than the budget.

**Null attacks**: each draw is applied at zero strength as well. Rules on beams; rows keep their number, order, rings
and times."""


@dataclass(frozen=True, slots=True)
class Part:
    """Some draws of one attack."""

    name: str
    first: int
    draws: int


@dataclass(frozen=True, slots=True)
class Found:
    """What those draws broke, and how many of them changed anything."""

    part: Part
    effective: int
    violations: Counter[str]


@lru_cache(maxsize=1)
def _scenes() -> list[Scene]:
    return scenes(SEEN_IN)


def run(part: Part) -> Found:
    """Return what the draws of a part broke."""
    violations: Counter[str] = Counter()
    effective = 0
    for number in range(part.first, part.first + part.draws):
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([NAMES.index(part.name), number])))
        scene = _scenes()[number // SAME_SCENE % len(_scenes())]
        attack, budget = drawn(part.name, scene, rng)
        rules, tampered = broken(part.name, scene, attack, budget, number)
        effective += bool(tampered.added.any() or tampered.removed.any())
        rules += [f"null attack: {rule}" for rule in broken_by_null(part.name, scene, attack, number)]
        violations.update(re.sub(r"[0-9.]+", "…", rule) for rule in rules)
    return Found(part, effective, violations)


def _parts(name: str, draws: int) -> list[Part]:
    mine = -(-draws // Counter(FAMILY.values())[FAMILY[name]])
    return [Part(name, first, min(PART, mine - first)) for first in range(0, mine, PART)]


def report(found: list[Found], seconds: float) -> str:
    """Return the page."""
    rows = []
    for name in NAMES:
        mine = [one for one in found if one.part.name == name]
        broken_rules = sum((one.violations for one in mine), Counter[str]())
        rules = "for all" if name in FREE_FORM or name == "pose_spoof" else "on beams"
        told = "; ".join(f"{rule} ({times})" for rule, times in broken_rules.most_common(3))
        count = sum(one.part.draws for one in mine)
        cells = [str(FAMILY[name]), f"`{name}`", rules, str(count), str(sum(one.effective for one in mine))]
        rows.append([*cells, str(broken_rules.total()), told or "–"])
    total = sum(one.violations.total() for one in found)
    head = ["family", "attack", "rules", "draws", "of which touched returns", "violations", "which"]
    done = sum(one.part.draws for one in found)
    said = f"**{total} violations in {done} draws** (asked for: 0 in 10,000 of each family)."
    told_facts = facts(took=f"{seconds:.0f} s on {WORKERS} cores")
    return page("Rules that attacks keep", told_facts, _INTRODUCTION.format(scenes=len(_scenes())), said,
                table(head, rows))  # fmt: skip


def main() -> None:
    """Draw, check, write."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    draws = int(sys.argv[2]) if len(sys.argv) > 2 else 10_000
    parts = [part for name in NAMES for part in _parts(name, draws)]
    started = time.perf_counter()
    with ProcessPoolExecutor(WORKERS, get_context("spawn")) as pool:
        found = list(pool.map(run, parts))
    text = report(found, time.perf_counter() - started)
    if out is None:
        print(text)
    else:
        write_page(out, text)


if __name__ == "__main__":
    main()
