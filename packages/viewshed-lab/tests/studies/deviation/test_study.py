"""The study with estimators whose deviation is known by hand, so that AUROC and found cells follow on paper."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import run
from tests.monitor.by_hand import estimate_of

from viewshed import BevGrid, Sample, Sweep, Truth
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.geometry import Rigid
from viewshed_lab.studies.deviation.jobs import fit_monitor, watch
from viewshed_lab.studies.deviation.page import REGIONS, rows_of
from viewshed_lab.studies.deviation.plan import Trials
from viewshed_lab.studies.records import Results, Row
from viewshed_lab.studies.samples import StudySample

GRID = BevGrid(64, 64.0)
RETURNS = 1000


@dataclass(frozen=True)
class _Counter:
    """Deviates in as many cells as the sweep has returns, always in the same order of cells."""

    grid: BevGrid = GRID

    def estimate(self, sweep: Sweep) -> FovEstimate:
        std = np.where(np.arange(GRID.cells**2) < len(sweep), 0.5, 0.0)
        return estimate_of(std.reshape(GRID.shape), grid=GRID)


@dataclass(frozen=True)
class _Outside:
    """Deviates in cells that hold a return farther than 6 m, and calls them visible."""

    grid: BevGrid = GRID

    def estimate(self, sweep: Sweep) -> FovEstimate:
        far = sweep.points[np.hypot(*sweep.points[:, :2].T) > 6.0]
        held = self.grid.count(far) > 0
        found = estimate_of(np.where(held, 0.4, 0.01), grid=GRID)
        return FovEstimate(GRID, np.where(held, 0.9, 0.1).astype(np.float32), found.state, found.std, found.method)


def _sample(returns: int, seed: int = 0) -> StudySample:
    """Returns 1 to 5 m from the sensor, on level ground."""
    rng = np.random.default_rng([seed, returns])
    azimuth, range_m = rng.uniform(-np.pi, np.pi, returns), rng.uniform(1.0, 5.0, returns)
    points = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), np.full(returns, -1.5)], 1)
    sweep = Sweep(points, sensor_height_m=1.5, world_from_sensor=Rigid.from_yaw(0.0, (9.0, 4.0, 1.5)))
    known = np.ones(GRID.shape, np.bool_)
    return StudySample(Sample(sweep, Truth(GRID, {}, {}), known, scene=f"scene {seed}"))


def _sets(more: Sequence[int]) -> list[list[StudySample]]:
    same = [_sample(RETURNS, seed) for seed in range(40)]
    calibrate = [_sample(RETURNS + 10 * seed, seed) for seed in range(19)]
    return [same, calibrate, [_sample(RETURNS + count, 77) for count in more]]


def _records(estimator: FovEstimator, sets: list[list[StudySample]], trials: Trials) -> list[Row]:
    fit, calibrate, report = sets
    monitor = fit_monitor(estimator, fit, calibrate, trials)
    return [
        row
        for number, sample in enumerate(report)
        for row in watch(monitor, estimator, sample, trials, domain="ugv", method="mcd", number=number)
    ]


def _rows(rows: Iterable[Row]) -> dict[str, Any]:
    """Return what was found by case."""
    found = rows_of(Results.of(None, rows), "ugv", "mcd")
    return {row["name"] or row["kind"]: SimpleNamespace(**row) for row in found.to_dict("records")}


def test_areas_alarms_and_refusals_worked_out_by_hand() -> None:
    """Scores count returns beyond 1000: clean 0, 100, 200, 300; 150 more under the attack; the limit lies at 180."""
    plan = Trials(("uniform", "removal", "pose_spoof", "replay"), ("dropped_beams",), 5)
    rows = _rows(_records(_Counter(), _sets((0, 100, 200, 300)), plan))
    assert set(rows) == {"benign", *plan.attacks, *plan.corruptions}
    assert (rows["benign"].alarms, rows["benign"].frames) == (0.5, 4)
    assert np.isnan(rows["benign"].auroc)
    uniform = rows["uniform"]
    assert uniform.auroc == 13 / 16  # 150 beats 0 and 100; 250 beats three; 350 and 450 beat all
    assert (uniform.alarms, uniform.caught) == (0.75, 0.5)  # above 180: all but 150; above every clean one: 350 and 450
    assert uniform.low < 13 / 16 < uniform.high
    assert uniform.auroc_mean == 13 / 16
    assert (rows["pose_spoof"].auroc, _cells(rows["pose_spoof"])) == (0.5, [0, 0, 0])
    assert rows["dropped_beams"].auroc == 0.125  # 70 % are gone: four scores of 0 tie with the clean sweep's 0
    assert (rows["dropped_beams"].alarms, rows["dropped_beams"].caught) == (0.0, 0.0)
    assert rows["removal"].auroc < 0.5
    assert _cells(rows["removal"])[0] > 10, "cells that lost a return"
    assert [rows[name].idle for name in ("uniform", "removal", "pose_spoof")] == [0, 0, 4]
    assert (rows["replay"].frames, rows["replay"].refused) == (0, 4)
    assert np.isnan(rows["replay"].auroc)


def test_suspect_cells_are_those_that_were_touched() -> None:
    """What an attacker puts beyond 6 m is all that lies there: each such cell is suspect, and no other."""
    plan = Trials(("wedge_cluster_free", "relay", "uniform"), ())
    rows = _rows(_records(_Outside(), _sets([5 * k for k in range(6)]), plan))
    cluster, relay, spread = (rows[name] for name in plan.attacks)
    assert (cluster.auroc, cluster.caught, cluster.alarms, cluster.idle) == (1.0, 1.0, 1.0, 0)
    for region in ("touched", "changed"):
        cells, *rates = (vars(cluster)[f"{region} {word}"] for word in ("cells", "precision", "recall", "chance"))
        assert cells > 6
        assert rates == [1.0, 1.0, cells / (6 * GRID.cells**2)]
    located = vars(relay)
    assert located["wedge chance"] == pytest.approx(30 / 360, abs=0.003)
    assert located["wedge precision"] > 6 * located["wedge chance"]  # a cell of 2 m at 8 m often has its middle outside
    assert located["touched precision"] == 1.0
    assert [cells > 0 for cells in _cells(spread)] == [True, False, True]
    assert 0.7 < vars(spread)["touched recall"] <= 1.0


def _cells(row: SimpleNamespace) -> list[float]:
    """Return the watched cells of each region."""
    return [vars(row)[f"{region} cells"] for region in REGIONS]


def test_the_command_runs_goes_on_and_writes_its_page(tmp_path: Path) -> None:
    words = ("study", "deviation", "--preset", "tiny", "--out", tmp_path, "--workers", 1)
    assert run(*words)[0] == 0
    page, results = tmp_path / "deviation.md", sorted((tmp_path / "jobs").iterdir())
    text = page.read_text("utf-8")
    assert all(f"\n| {name} " in text for name in ("*benign*", "uniform (1)", "removal (8)", "fog"))
    assert "sweeps: 4 to fit, 4 to calibrate, 4 of 4 to report" in text
    assert run(*words, "--no-run")[0] == 0
    assert sorted((tmp_path / "jobs").iterdir()) == results
