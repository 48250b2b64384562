"""Report what attackers who know a monitor gain, which evidence finds them, and how few returns raise an alarm.

Usage: python -m tools.informed_attacks [OUT.md] [SCENES]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed import ESTIMATORS, GRIDS, Sweep
from viewshed.monitor.evidence import EVIDENCE, MonitoredSweep
from viewshed.monitor.roc import auroc
from viewshed.monitor.score import measure_all
from viewshed.monitor.sweep_monitor import shipped_monitor
from viewshed.preprocess.leveling import level
from viewshed_lab._page import facts, page, table
from viewshed_lab.data.simulated import ScenePlan, measure_frame
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.monitor.plan import BEFORE, MonitorPlan
from viewshed_lab.threats.attacks import (
    ATTACKS,
    BITS,
    INFORMED,
    NULL,
    Knowledge,
    MonitorScore,
    OverClaim,
    UnderClaim,
    smallest_budget,
    tripped_shares,
)

SHOWN = (
    "vanished_object", "copied_object", "far_wall_clean", "removal_and_far_wall_clean", "ghost_wall_clean",
    "ghost_car_clean", "far_wall", "ghost_wall", "ghost_car",
)  # fmt: skip
NULLS = ("vanished_object", "copied_object", "far_wall", "ghost_wall", "relay", "jamming", "replay", "uniform")
EARLIER = 5
FRAME = BEFORE + EARLIER
TRIPPED_SCENES = 8
ASKED = 0.8
GRID = GRIDS["road"]
VICTIM = ESTIMATORS["shadow_map"](GRID)
ALL = ATTACKS | INFORMED

INTRODUCTION = """\
{scenes} drives of the study of the monitor, a scene each: one sweep is attacked, the five before it, .1 s apart, are
not. Over-claim and under-claim are areas in the attacker's wedge that `shadow_map` claims or loses against its own
clean estimate; an attack that finds no place does nothing and counts as that.

Each kind of evidence is one number here: its strongest sector. AUROC is against the same scenes unattacked. The score
that the study trains and calibrates combines them and can do better, or worse; its page has the rates.

A **null attack** redraws the noise of the returns that it touches. Evidence with an AUROC far from .50 there has
learned the forger."""

ALARMS = """\
The shipped monitor, at its limit for 1 %, looks at single sweeps. The attacker asks it {asked} times for each budget
and sees its exact score. {watched} sweeps that do not alarm by themselves."""


@dataclass(slots=True)
class Found:
    """What was measured, by case: (E, SECTORS) of each scene, alone and with earlier sweeps; areas and returns."""

    alone: dict[str, list[NDArray[np.float32]]] = field(default_factory=dict)
    timed: dict[str, list[NDArray[np.float32]]] = field(default_factory=dict)
    over_m2: dict[str, list[float]] = field(default_factory=dict)
    under_m2: dict[str, list[float]] = field(default_factory=dict)
    touched: dict[str, list[int]] = field(default_factory=dict)


def _scene(number: int) -> ScenePlan:
    return ScenePlan(MonitorPlan.load("small").preset("drives"), 0, number)


def measure(scenes: int) -> Found:
    """Return what all evidence says of some drives, as they are, attacked, and attacked at zero strength."""
    found = Found()
    for number in range(scenes):
        scene = _scene(number)
        *before, sweep = (measure_frame(scene, FRAME - EARLIER + step) for step in range(EARLIER + 1))
        again = measure_frame(scene, FRAME, again=1)
        knowledge = Knowledge((before[0],), None, GRID.half_extent_m, again)
        earlier = tuple(level(one, GRID) for one in before)
        cases = [("benign", sweep)]
        for name in SHOWN:
            tampered = ALL[name](None, knowledge).apply(sweep, generator(1, number, name))
            cases.append((name, tampered.sweep))
            for claimed, areas in ((OverClaim(VICTIM), found.over_m2), (UnderClaim(VICTIM), found.under_m2)):
                wedge = tampered.wedge
                areas.setdefault(name, []).append(0.0 if wedge is None else claimed.on(sweep, wedge)(tampered.sweep))
            found.touched.setdefault(name, []).append(int(tampered.added.sum() + tampered.removed.sum()))
        for name in NULLS:
            tampered = NULL[name](None, knowledge).apply(sweep, generator(1, number, name))
            cases.append((f"null {name}", tampered.sweep))
        for name, seen in cases:
            leveled = level(seen, GRID)
            found.alone.setdefault(name, []).append(measure_all(MonitoredSweep(leveled)))
            found.timed.setdefault(name, []).append(measure_all(MonitoredSweep(leveled, earlier)))
    return found


def _strongest(evidence: Sequence[NDArray[np.float32]]) -> NDArray[np.float64]:
    """Return the strongest sector (N, E) of each evidence, lower than any other where it abstains."""
    matrices = np.stack(evidence).astype(np.float64)
    strongest: NDArray[np.float64] = np.where(np.isnan(matrices), -np.inf, matrices).max(axis=-1)
    return strongest


def _ranks(name: str, measured: dict[str, list[NDArray[np.float32]]]) -> list[tuple[float, str]]:
    """Return the AUROC of each evidence for a case against benign scenes, the largest first."""
    case, benign = _strongest(measured[name]), _strongest(measured["benign"])
    finite = [np.nan_to_num(values, neginf=-1e9) for values in (case, benign)]
    areas = [auroc(finite[1][:, number], finite[0][:, number]) for number in range(len(EVIDENCE))]
    return sorted(((float(area), kind) for area, kind in zip(areas, EVIDENCE, strict=True)), reverse=True)


def _first(ranks: list[tuple[float, str]], count: int = 3) -> str:
    return ", ".join(f"`{kind}` {area:.2f}" for area, kind in ranks[:count])


def effects(found: Found) -> str:
    """Return the table of what attacks gain and which evidence finds them."""
    rows = []
    for name in SHOWN:
        acts = np.array(found.touched[name]) > 0
        rows.append([
            f"`{name}`", f"{acts.mean():.0%}", f"{np.median(np.array(found.touched[name])[acts]):.0f}",
            f"{np.mean(found.over_m2[name]):.0f}", f"{np.mean(found.under_m2[name]):.0f}",
            _first(_ranks(name, found.alone)), _first(_ranks(name, found.timed)),
        ])  # fmt: skip
    head = ["attack", "acts", "returns (median)", "over-claim m²", "under-claim m²", "AUROC, one sweep",
            "AUROC, with five earlier"]  # fmt: skip
    return table(head, rows)


def verdict(found: Found) -> str:
    """Return what was asked for against attackers who know the monitor, and what the best single evidence reaches."""
    results = []
    for name in INFORMED:
        alone, timed = _ranks(name, found.alone)[0][0], _ranks(name, found.timed)[0][0]
        words = "reached" if timed >= ASKED else "missed"
        results.append(f"`{name}` {alone:.2f} by one sweep, {timed:.2f} with earlier ones ({words})")
    return (
        f"Asked for: an AUROC of {ASKED:.2f} against attackers who know the evidence. Best kind: {'; '.join(results)}."
    )


def nulls(found: Found) -> str:
    """Return the table of null attacks: the evidence farthest from .50."""
    rows = []
    for name in NULLS:
        cells = [f"`{name}`"]
        for measured in (found.alone, found.timed):
            ranks = sorted(_ranks(f"null {name}", measured), key=lambda one: -abs(one[0] - 0.5))
            cells.append(_first(ranks, 2))
        rows.append(cells)
    return table(["null attack", "farthest from .50, one sweep", "with five earlier"], rows)


def _watched(scenes: int) -> Iterator[tuple[Sweep, MonitorScore]]:
    monitor = shipped_monitor()

    def above_limit(monitored: MonitoredSweep) -> float:
        report = monitor.check(monitored)
        return report.score - report.threshold

    for number in range(scenes, scenes + 4 * TRIPPED_SCENES):
        sweep, score = measure_frame(_scene(number), FRAME), MonitorScore(above_limit, GRID)
        if score(sweep) <= 0.0:
            yield sweep, score


def alarms(scenes: int, places: int = 2, queries: int = 14) -> str:
    """Return the paragraph and table of the returns that it takes to raise an alarm."""
    watched = list(islice(_watched(scenes), TRIPPED_SCENES))
    rows = []
    for mode, words in (("free_form", "free-form"), ("beam_constrained", "on beams")):
        shares = tripped_shares(watched, 0.0, generator(2, words), mode=mode, places=places, queries=queries)  # type: ignore[arg-type]
        needed = smallest_budget(shares)
        rows.append([words, *(f"{share:.0%}" for share in shares), "none" if needed is None else str(needed)])
    text = ALARMS.format(asked=places * queries, watched=len(watched))
    return f"## Returns that raise an alarm\n\n{text}\n\n{table(['spoofing', *map(str, BITS), 'half'], rows)}"


def main() -> None:
    """Measure, write."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    scenes = int(sys.argv[2]) if len(sys.argv) > 2 else 60
    started = time.perf_counter()
    found = measure(scenes)
    parts = [INTRODUCTION.format(scenes=scenes), effects(found), verdict(found), "## Null attacks", nulls(found)]
    parts.append(alarms(scenes))
    took = facts(took=f"{time.perf_counter() - started:.0f} s")
    text = page("Attackers who know the monitor", took, *parts)
    if out is None:
        print(text)
    else:
        out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
