"""The same sweeps with what the sensor measured before: honest, or attacked as well."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from viewshed.bev import BevGrid
from viewshed.datasets.simulate import simulate_frame
from viewshed.estimate import FovEstimate, FovEstimator
from viewshed.estimators.learned import heeds_past
from viewshed.evaluation import unorganised_no_sensor
from viewshed.level import LevelSweep, level_sweep
from viewshed.memory import where_supported
from viewshed.past import PAST_SWEEPS, Past
from viewshed.reproduce.protocols import generator
from viewshed.sweep import Sweep
from viewshed.training.attacking import Struck
from viewshed.vulnerability.subjects import Subject

ALONE, HONEST, ATTACKED = "alone", "past", "attacked past"
"""What stands behind the name of a contestant that is told of the past, or is not, on sweeps that have one."""
WARY = "wary, "
"""Stands before them where only what an earlier sweep has seen as well is claimed."""


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """What a sensor measured before a sweep.

    Attributes:
        sweeps: the last ones, the oldest first, as measured.
        levels: the same, levelled.
        grid: on which.
    """

    sweeps: tuple[Sweep, ...]
    levels: tuple[LevelSweep, ...]
    grid: BevGrid

    @classmethod
    def of(cls, subject: Subject) -> Remembered:
        """Return the five sweeps before a subject's, or as many as its scene has; a recorded one's own."""
        grid = subject.sample.truth.grid
        sweeps = subject.earlier if subject.frame is None else _simulated(subject)
        return cls(sweeps, tuple(level_sweep(sweep, grid) for sweep in sweeps), grid)

    @property
    def whole(self) -> bool:
        """Whether there are as many as an estimator may look at."""
        return len(self.sweeps) == PAST_SWEEPS

    def pasts(self, level: LevelSweep, struck: Struck | None, rng_of: tuple[int, int, str]) -> dict[str, Past | None]:
        """Return the pasts of a sweep: none, honest, and where it was attacked also as if the attack had lasted.

        Args:
            level: the sweep.
            struck: the attack on it, None where its rings were taken; then the past has none either.
            rng_of: seed, number of the subject and case, for the attacks on the past.
        """
        if struck is None:
            bare = [level_sweep(unorganised_no_sensor(sweep), self.grid) for sweep in self.sweeps]
            return {ALONE: None, HONEST: Past.of(level, bare)}
        honest = {ALONE: None, HONEST: Past.of(level, self.levels)}
        if struck.attack is None:
            return honest
        seed, number, case = rng_of
        before = struck.before(self.sweeps, generator(seed, "past", number, case))
        return honest | {ATTACKED: Past.of(level, [level_sweep(sweep, self.grid) for sweep in before])}


def _simulated(subject: Subject) -> tuple[Sweep, ...]:
    assert subject.frame is not None
    scene, frame = subject.frame
    step = scene.preset.agents
    return tuple(simulate_frame(scene, at).sweep for at in range(frame % step, frame, step)[-PAST_SWEEPS:])


def estimates(
    estimators: Mapping[str, FovEstimator], names: tuple[str, ...], level: LevelSweep, pasts: Mapping[str, Past | None]
) -> Iterator[tuple[str, FovEstimate]]:
    """Yield what those of the estimators that the past helps say with each past, wary or not, each with its name."""
    for name in names:
        estimator = estimators.get(name)
        if estimator is not None and heeds_past(estimator):
            for kind, past in pasts.items():
                found = estimator.estimate_level(level, past)
                yield f"{name}, {kind}", found
                if past is not None:
                    yield f"{name}, {WARY}{kind}", where_supported(found, past)
