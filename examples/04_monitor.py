"""An alarm for doubtful estimates: what deviation is usual is learned on benign sweeps, and what is more is told.

The paper's monitor watches the standard deviation of Monte Carlo dropout. It takes any estimate that has one; here
three classical estimators stand in for the passes of a network, so that nothing has to be trained.
"""

from itertools import islice

import numpy as np

from viewshed import ESTIMATORS, BevGrid, FovEstimate, Sweep
from viewshed.monitor import DeviationMonitor
from viewshed_lab.studies.samples import sample_of
from viewshed_lab.threats.attacks import ATTACKS, Knowledge

GRID = BevGrid(64, 16.0)


class Disagreement:
    """Mean and standard deviation of three estimators, as if they were passes of a network."""

    grid = GRID

    def __init__(self) -> None:
        self.members = [ESTIMATORS[name](GRID) for name in ("shadow_map", "first_blocker", "continuous")]

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return mean and deviation (64, 64) over the three."""
        found = [member.estimate(sweep) for member in self.members]
        probs = np.stack([each.visible_prob for each in found])
        return FovEstimate(GRID, probs.mean(axis=0), found[0].state, probs.std(axis=0), method="disagreement")


def benign(number: int) -> Sweep:
    """Return a simulated sweep of an indoor robot, each from a scene of its own."""
    return sample_of("ugv", number, 50, seed=1).sweep


estimator = Disagreement()
estimates = (estimator.estimate(benign(number)) for number in range(40))
monitor = DeviationMonitor.fit(islice(estimates, 20)).calibrated(estimates, false_alarm_rate=0.05)
print(f"alarms above {monitor.limit:.4f}, fitted on {monitor.sweeps[0]} sweeps, calibrated on {monitor.sweeps[1]}")

print(f"{'attack':<10}{'alarms':>8}{'mean score':>12}{'suspect m²':>12}")
others = [benign(number) for number in range(40, 50)]
for name in ("none", "uniform", "cluster", "removal", "jamming"):
    reports = []
    for number, sweep in enumerate(others):
        seen = sweep
        if name in ATTACKS:
            attack = ATTACKS[name](None, Knowledge(half_extent_m=GRID.half_extent_m))
            seen = attack.apply(sweep, np.random.default_rng(number)).sweep
        reports.append(monitor.check(estimator.estimate(seen)))
    alarms, score = sum(report.alarm for report in reports), np.mean([report.score for report in reports])
    area = np.mean([report.suspect_m2 for report in reports])
    print(f"{name:<10}{f'{alarms} of 10':>8}{score:>12.4f}{area:>12.1f}")
