"""Print what earlier sweeps cost and gain: ``python -m benchmarks.history [--scenes N]``.

Drives of the presets are simulated with exact truth. In each scene the last sweep of one agent is estimated by itself,
with five sweeps before it, a second apart, and where one of these confirms the claim. Once nobody attacks; once all
returns of a wedge that lie before an obstacle are moved far behind it (``far_wall``): how much area does that open that
is not visible? Once 150 returns are: which share of the claims in the wedge is visible? Of real drives with poses, of
the folder in VIEWSHED_REAL_DATA: which share of the area of one sweep do the other methods still claim?
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from itertools import islice
from operator import add
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import where_confirmed
from viewshed.fov.visibility import CAR
from viewshed.geometry import polar
from viewshed.grid import GRIDS
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
from viewshed_lab.studies.crossview.page import posed_scenes
from viewshed_lab.studies.formatting import format_rate
from viewshed_lab.studies.records import Case
from viewshed_lab.studies.samples import StudySample

PRESETS = ("carla", "nuscenes", "ugv")
SEED = 20_261_129
TIMES, INTERVAL_S, EVERY = 11, 0.5, 2
"""Sweeps of each agent, seconds between them, and step between the earlier sweeps that are used."""

FEW = "150"
"""Budget of the small attack in returns."""

PAST = 3
"""Number of sweeps at the start of a real drive that are not counted."""

METHODS = ("one sweep", "--history 5", "--history 5 --require-confirmation")


def claims(estimator: ShadowMap, sweep: Sweep, earlier: Sequence[Sweep]) -> Iterator[NDArray[np.bool_]]:
    """Yield the mask (cells, cells) that each of ``METHODS`` calls visible."""
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
    opened_m2, in_wedge = np.zeros(len(METHODS)), np.zeros((len(METHODS), 2))
    for scene in range(scenes):
        frames = [(scene * TIMES + time) * agents + scene % agents for time in range(TIMES)]
        sample, earlier = archive[frames[-1]], [archive[frame].sweep for frame in frames[:-1:EVERY]]
        estimator = ShadowMap(sample.truth.grid, CAR)
        truth, known = sample.truth.visible(CAR.name), sample.known
        study = StudySample(sample, tuple(reversed(earlier)))
        attacked, few = (
            apply(Case("attack", "far_wall", level), study, np.random.default_rng((SEED, scene)))
            for level in (DEFAULT, FEW)
        )
        assert few.wedge is not None
        wedge = known & few.wedge.holds(polar(estimator.grid.centers)[1])
        cell_m2 = estimator.grid.cell_m**2
        by_sweep = (claims(estimator, sweep, earlier) for sweep in (sample.sweep, attacked.sweep, few.sweep))
        for number, (clean, under_attack, under_few) in enumerate(zip(*by_sweep, strict=True)):
            counts[number].append(ConfusionCounts.of(clean, truth, known, cell_m2))
            opened_m2[number] += (under_attack & ~clean & ~truth & known).sum() * cell_m2
            in_wedge[number] += (under_few & truth & wedge).sum(), (under_few & wedge).sum()
    for method, of_scenes, area_m2, (true, claimed) in zip(METHODS, counts, opened_m2, in_wedge, strict=True):
        total = reduce(add, of_scenes)
        rates = map(format_rate, (total.precision, total.recall, total.f1))
        yield name, method, *rates, f"{area_m2 / scenes:.0f}", format_rate(true / max(claimed, 1.0))


def kept_of(data: Path) -> Iterator[tuple[str, ...]]:
    """Yield for each real drive the area claimed by the other methods, as a share of that of single sweeps."""
    estimator = ShadowMap(GRIDS["road"], CAR)
    for sensor, scenes in posed_scenes(data / "index.json").items():
        for sweeps in (scene for scene in scenes if len(scene) > 2 * PAST):
            areas_m2 = [
                sum(estimate.area_m2() for estimate in islice(stream, PAST, None))
                for stream in (
                    estimator.stream(sweeps), estimator.stream(sweeps, 5),
                    estimator.stream(sweeps, 5, require_confirmation=True),
                )
            ]  # fmt: skip
            yield f"{sensor}, {len(sweeps)} sweeps", *(format_rate(area_m2 / areas_m2[0]) for area_m2 in areas_m2[1:])


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="history", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenes", type=int, default=20, help="of each preset")
    arguments = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        rows = [row for name in PRESETS for row in rows_of(name, arguments.scenes, Path(folder))]
    few = f"precision in a wedge of {FEW} returns"
    header = ("preset", "method", "precision", "recall", "F1", "falsely opened by far_wall, m²", few)
    tables = [table(header, rows)]
    if data := os.environ.get("VIEWSHED_REAL_DATA"):
        tables.append(table(("real drive", *(f"area, {method}" for method in METHODS[1:])), list(kept_of(Path(data)))))
    print(page("Earlier sweeps", facts(seed=str(SEED), scenes=f"{arguments.scenes} of each preset"), *tables))


if __name__ == "__main__":
    main()
