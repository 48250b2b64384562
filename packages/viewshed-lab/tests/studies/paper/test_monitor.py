"""The monitor tried with an estimator whose deviation is known by hand, so that AUROC and alarms follow on paper."""

from dataclasses import dataclass

import numpy as np
from tests.monitor.by_hand import estimate_of

from viewshed import BevGrid, Sample, Sweep, Truth
from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.monitor import DeviationMonitor
from viewshed_lab.studies.cases import DEFAULT
from viewshed_lab.studies.paper.monitor import rows_of, watch
from viewshed_lab.studies.records import BENIGN, Case, Results
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


def _sample(returns: int, seed: int = 0) -> StudySample:
    """Returns 1 to 5 m from the sensor, on level ground."""
    rng = np.random.default_rng([seed, returns])
    azimuth, range_m = rng.uniform(-np.pi, np.pi, returns), rng.uniform(1.0, 5.0, returns)
    points = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), np.full(returns, -1.5)], 1)
    sweep = Sweep(points, sensor_height_m=1.5, world_from_sensor=Rigid.from_yaw(0.0, (9.0, 4.0, 1.5)))
    known = np.ones(GRID.shape, np.bool_)
    return StudySample(Sample(sweep, Truth(GRID, {}, {}), known, scene=f"scene {seed}"))


def test_areas_alarms_and_refusals_worked_out_by_hand() -> None:
    """Scores count returns beyond 1000: clean 0, 100, 200, 300; 150 more under the attack; the limit lies at 180."""
    counter = _Counter()
    monitor = DeviationMonitor.fit(counter.estimate(_sample(RETURNS, seed).sweep) for seed in range(40))
    further = (counter.estimate(_sample(RETURNS + 10 * seed, seed).sweep) for seed in range(19))
    monitor = monitor.calibrated(further, 0.05)
    attacks = [Case("attack", name, DEFAULT) for name in ("replay", "uniform", "removal", "pose_spoof")]
    cases = [BENIGN, *attacks, Case("corruption", "dropped_beams", "5")]
    found = [
        row
        for number, more in enumerate((0, 100, 200, 300))
        for row in watch(
            monitor, counter, _sample(RETURNS + more, 77), cases, number, domain="ugv", method="mcd", seed=0
        )
    ]
    results = Results.of(None, found[::-1])
    assert [(case.name, why[:29], count) for (_, case, why), count in results.refused.items()] == [
        ("replay", "replay needs an earlier sweep", 4)
    ]
    frame = rows_of(results, "ugv", "mcd")
    assert frame.iloc[-1]["name"] == "replay"  # what could be made of no sweep comes last
    rows = {row.name or row.kind: row for row in frame.itertuples()}
    assert set(rows) == {"benign", "dropped_beams", *(case.name for case in attacks)}
    assert rows["benign"].alarms == 0.5
    assert np.isnan(rows["benign"].auroc)
    uniform = rows["uniform"]
    assert uniform.auroc == 13 / 16  # 150 beats 0 and 100; 250 beats three; 350 and 450 beat all
    assert (uniform.alarms, uniform.caught) == (0.75, 0.5)  # above 180: all but 150; above every clean one: 350 and 450
    assert uniform.low < 13 / 16 < uniform.high
    assert uniform.auroc_mean == 13 / 16
    assert rows["pose_spoof"].auroc == 0.5
    assert rows["dropped_beams"].auroc == 0.125  # 70 % are gone: four scores of 0 tie with the clean sweep's 0
    assert (rows["dropped_beams"].alarms, rows["dropped_beams"].caught) == (0.0, 0.0)
    assert rows["removal"].auroc < 0.5
    assert np.isnan(rows["replay"].auroc)
