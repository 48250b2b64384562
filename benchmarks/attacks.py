"""Sweeps attacked in a second: ``python -m benchmarks.attacks [--page FILE]`` writes docs/results/attack_speed.md."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.timing import interleaved
from viewshed._page import facts, page, table
from viewshed._results import write_page
from viewshed.grid import GRIDS
from viewshed.sim.observe import Setting, observe
from viewshed.sim.world import AgentPlan
from viewshed.sim.worlds import WORLDS
from viewshed.sweep import Sweep
from viewshed.threats.attacks import ATTACKS, FAMILY, PAPER_ATTACK, Attack, Knowledge

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "attack_speed.md"
SEED = 3
TARGET_PER_S = 200
SECONDS = 2.0
PROCESSES = 2
TEXT = """\
Attacks with their defaults on a simulated street as a moving HDL-32E sees it: {points} returns, {beams} beams, motion
undone. **First**: median of one call on a sweep that no attack has met, whose motion, beams and ground must be found.
**Again**: the same sweep once more, all of which is remembered. **Sweeps a second**: {processes} processes side by side
for {seconds:g} s each, every sweep a new one, on the clock; and by processor time, as {processes} cores would give that
nothing else uses. Asked for: {target} of the latter; the clock's tell how busy the machine was."""


@dataclass(frozen=True, slots=True, eq=False)
class Fresh:
    """Attacks an equal sweep that is new to it, so that nothing is remembered."""

    attack: Attack
    sweep: Sweep

    def __call__(self) -> object:
        """Attack once."""
        return self.attack.apply(self.sweep.replace(), np.random.Generator(np.random.PCG64(SEED)))


def sweeps() -> tuple[Sweep, Sweep]:
    """Return a sweep of a moving HDL-32E and the one half a second before."""
    world = WORLDS["street"](np.random.Generator(np.random.PCG64(SEED)), AgentPlan(1, 0, sensor="hdl32e"))
    setting, seed = Setting(GRIDS["road"]), np.random.SeedSequence([SEED])
    earlier, now = (observe(world, world.agents[0], t_s, setting, seed).image.sweep() for t_s in (3.5, 4.0))
    return now, earlier


def made(name: str, earlier: Sweep) -> Attack:
    """Return the attack called ``name``."""
    return PAPER_ATTACK if name == "PAPER_ATTACK" else ATTACKS[name](None, Knowledge((earlier,)))


def rate(name: str) -> tuple[float, float]:
    """Return sweeps a second of one process for some seconds, and milliseconds of processor time for each."""
    sweep, earlier = sweeps()
    attack = Fresh(made(name, earlier), sweep)
    attack()
    done, start, used_s = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - start < SECONDS:
        attack()
        done += 1
    used_s = time.process_time() - used_s
    return done / (time.perf_counter() - start), 1e3 * used_s / done


def _jobs(name: str, sweep: Sweep, earlier: Sweep) -> dict[str, Callable[[], object]]:
    attack = made(name, earlier)
    return {
        "first": Fresh(attack, sweep),
        "again": lambda: attack.apply(sweep, np.random.Generator(np.random.PCG64(SEED))),
    }


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.attacks", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE)
    chosen = parser.parse_args()
    rng = np.random.default_rng(SEED)
    told = facts(load=f"{os.getloadavg()[0]:.1f} in the minute before")
    sweep, earlier = sweeps()
    rows = []
    for name in [*ATTACKS, "PAPER_ATTACK"]:
        jobs = _jobs(name, sweep, earlier)
        first, again = (interleaved({key: jobs[key]}, rng, 0.5)[key].median_ms for key in ("first", "again"))
        with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as pool:
            rates, used_ms = zip(*pool.map(rate, [name] * PROCESSES), strict=True)
        own = sum(1e3 / ms for ms in used_ms)
        verdict = "met" if own >= TARGET_PER_S else "**missed**"
        family = str(FAMILY.get(name, "paper"))
        rows.append([family, f"`{name}`", f"{first:.1f}", f"{again:.1f}", f"{sum(rates):.0f}", f"{own:.0f}", verdict])
        print(" | ".join(rows[-1]), flush=True)
    assert sweep.model is not None
    beams = sweep.model.rings * sweep.model.azimuth_columns
    text = TEXT.format(points=len(sweep), beams=beams, processes=PROCESSES, seconds=SECONDS, target=TARGET_PER_S)
    head = ["family", "attack", "first, ms", "again, ms", "sweeps a second, clock", "processor time", ""]
    write_page(chosen.page, page("Speed of attacks", told, text, table(head, rows)))


if __name__ == "__main__":
    main()
