"""Print what earlier sweeps cost and gain: ``python -m benchmarks.history [--scenes N]``.

Drives of the presets are simulated with exact truth. In each scene the last sweep of one agent is estimated by itself,
with five sweeps before it, a second apart, and where one of these confirms the claim. Once nobody attacks; once returns
before an obstacle are moved far behind it (``far_wall``): how much area does that open that is not visible?
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import where_confirmed
from viewshed.fov.visibility import CAR
from viewshed.metrics import ConfusionCounts
from viewshed.preprocess.history import history_of
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_lab._jobs import LocalEngine
from viewshed_lab._page import facts, page, table
from viewshed_lab.data import Storage
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import simulate
from viewshed_lab.studies.cases import DEFAULT, apply
from viewshed_lab.studies.formatting import format_rate
from viewshed_lab.studies.records import Case
from viewshed_lab.studies.samples import StudySample

PRESETS = ("carla", "nuscenes", "ugv")
SEED = 20_261_129
TIMES, INTERVAL_S, EVERY = 11, 0.5, 2
"""Sweeps of each agent, seconds between them, and how many further back each earlier one lies."""

METHODS = ("one sweep", "--history 5", "--history 5 --require-confirmation")


def claims(estimator: ShadowMap, sweep: Sweep, earlier: Sequence[Sweep]) -> Iterator[NDArray[np.bool_]]:
    """Yield what each of the methods calls visible."""
    leveled = level(sweep, estimator.grid)
    yield estimator.estimate(leveled).visible()
    history = history_of(leveled, earlier, estimator.grid)
    assert history is not None
    with_history = estimator.estimate(history.now, history)
    yield with_history.visible()
    yield where_confirmed(with_history, history).visible()


def rows_of(name: str, scenes: int, folder: Path) -> Iterator[tuple[str, ...]]:
    """Yield a line of the table for each method on the scenes of a preset."""
    preset = preset_named(name)
    agents = preset.agents
    drives = replace(
        preset, splits=("test",), scenes=(scenes,), frames=(scenes * TIMES * agents,), interval_s=INTERVAL_S, seed=SEED
    )
    archive = simulate(drives, Storage.of(folder / name), LocalEngine(1))
    counts: list[list[ConfusionCounts]] = [[] for _ in METHODS]
    opened_m2 = np.zeros(len(METHODS))
    for scene in range(scenes):
        frames = [(scene * TIMES + time) * agents + scene % agents for time in range(TIMES)]
        sample, earlier = archive[frames[-1]], [archive[frame].sweep for frame in frames[:-1:EVERY]]
        estimator = ShadowMap(sample.truth.grid, CAR)
        truth, known = sample.truth.visible(CAR.name), sample.known
        study = StudySample(sample, tuple(reversed(earlier)))
        attacked = apply(Case("attack", "far_wall", DEFAULT), study, np.random.default_rng((SEED, scene))).sweep
        both = zip(claims(estimator, sample.sweep, earlier), claims(estimator, attacked, earlier), strict=True)
        cell_m2 = estimator.grid.cell_m**2
        for number, (clean, lied) in enumerate(both):
            counts[number].append(ConfusionCounts.of(clean, truth, known, cell_m2))
            opened_m2[number] += (lied & ~clean & ~truth & known).sum() * cell_m2
    for method, of_scenes, area_m2 in zip(METHODS, counts, opened_m2, strict=True):
        whole = reduce(add, of_scenes)
        rates = map(format_rate, (whole.precision, whole.recall, whole.f1))
        yield name, method, *rates, f"{area_m2 / scenes:.0f}"


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="history", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenes", type=int, default=20, help="of each preset")
    given = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        rows = [row for name in PRESETS for row in rows_of(name, given.scenes, Path(folder))]
    header = ("preset", "method", "precision", "recall", "F1", "falsely opened by far_wall, m²")
    print(page("Earlier sweeps", facts(seed=str(SEED), scenes=f"{given.scenes} of each preset"), table(header, rows)))


if __name__ == "__main__":
    main()
