"""A study from start to end: what is in the store stays, an engine does the rest, job after job.

Attackers who ask their victim: each estimator, bare or behind a defense, meets an attack made against itself.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from viewshed._jobs import Engine
from viewshed.datasets.archive.schema import code_version
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.grid import BevGrid
from viewshed.studies import suite as contestants
from viewshed.studies.cases import Case, Trial, apply, cases_of, generator, visible_with
from viewshed.studies.robustness.plan import Job, Study
from viewshed.studies.robustness.store import ResultStore
from viewshed.studies.statistics import Reference, score
from viewshed.studies.suite import Contestants, Probs, Subject, subject_of
from viewshed.sweep import Sweep
from viewshed.threats.attacks import ATTACKS, Knowledge
from viewshed.threats.attacks.adaptive import ADAPTIVE, BlackBox, Evade
from viewshed.threats.attacks.base import Wedge
from viewshed.threats.defenses import DEFENSES, Defended, Defense, TemporalConsistency

AIMED_AS = Case("attack", "far_wall", "0")
"""The attack that does not ask and whose wedge these take over, so that both can be compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Behind:
    """An estimator that reads only what a defense leaves.

    Attributes:
        defense: that every sweep goes through first.
        estimator: that reads the rest.
    """

    defense: Defense
    estimator: FovEstimator

    @property
    def grid(self) -> BevGrid:
        """The estimator's."""
        return self.estimator.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the estimate from what is left."""
        return self.estimator.estimate(self.defense.apply(sweep).sweep)


@dataclass(frozen=True, slots=True, eq=False)
class Duels:
    """One sample on which attackers who ask meet their victims. What was found against a bare victim is kept.

    Attributes:
        study: budget, number of questions, and which victims are defended.
        subject: the sample.
        contestants: the victims and the truth.
        defenses: by name.
        rng_of: generator of a case on this sample: the same for every victim.
    """

    study: Study
    subject: Subject
    contestants: Contestants
    defenses: dict[str, Defense]
    rng_of: Callable[[Case], np.random.Generator]
    _found: dict[tuple[str, str], Sweep] = field(init=False, repr=False, default_factory=dict)

    def scores(self, case: Case) -> dict[str, list[float | int | None]]:
        """Return the scores of every victim of a case under the attack that was made against it.

        Raises:
            ValueError: the sweep cannot be attacked or defended so.
        """
        wedge = self.wedge
        inside = wedge.holds(self.contestants.reference.azimuth)
        victims = self.study.adaptive_defended if case.defense else tuple(self.contestants.estimators)
        found = {}
        for victim in victims:
            sweep = self.attacked(case, victim, wedge)
            if case.defense:
                sweep = self.defenses[case.defense].apply(sweep).sweep
            field_ = replace(self.contestants, estimators={victim: self.contestants.estimators[victim]})
            found[victim] = score(field_.probs(sweep)[victim], field_.threshold, field_.reference, inside)
        return found

    @property
    def wedge(self) -> Wedge:
        """Where all of these attackers work: where the far wall does."""
        half_extent_m = self.contestants.grid.half_extent_m
        attack = ATTACKS[AIMED_AS.name](0, Knowledge(half_extent_m=half_extent_m))
        wedge = attack.apply(self.subject.sample.sweep, self.rng_of(AIMED_AS)).wedge
        if wedge is None:
            raise ValueError(f"{AIMED_AS.name} must have a wedge, got none")
        return wedge

    def attacked(self, case: Case, victim: str, wedge: Wedge) -> Sweep:
        """Return the sweep as the attacker of a case leaves it, before any defense."""
        clean = self.subject.sample.sweep
        if case.level == "0":
            return clean
        bare = case.kind == "unaware" or not case.defense
        known = None if bare else self.defenses[case.defense]
        if not bare:
            return self._attack(case, victim, wedge, known).apply(clean, self.rng_of(case)).sweep
        key = case.name, victim
        if key not in self._found:
            told = replace(case, kind="adaptive", defense="")
            self._found[key] = self._attack(told, victim, wedge, None).apply(clean, self.rng_of(told)).sweep
        return self._found[key]

    def _attack(self, case: Case, victim: str, wedge: Wedge, defense: Defense | None) -> BlackBox:
        """Return an attacker who asks the victim; one who meets an alarm also takes care not to raise it."""
        estimator = self.contestants.estimators[victim]
        asked = estimator if defense is None else Behind(defense, estimator)
        attack = ADAPTIVE[case.name](int(case.level), Knowledge(estimator=asked))
        if not isinstance(attack, BlackBox):
            raise ValueError(f"{case.name} must ask its victim")
        sector_deg, queries = float(np.rad2deg(wedge.width)), self.study.adaptive_queries
        attack = replace(attack, queries=queries, azimuth=wedge.azimuth, sector_deg=sector_deg)
        if defense is None or defense.apply(self.subject.sample.sweep).alarm is None:
            return attack
        return replace(attack, objective=Evade(attack.objective, lambda sweep: float(defense.apply(sweep).alarm or 0)))


Line = dict[str, Any]
"""What became of one job or case, as plain values."""


def run_study(
    study: Study, store: ResultStore, engine: Engine, progress: Callable[[tuple[str, int, str]], None] | None = None
) -> list[str]:
    """Run what is not in the store yet and return one line for each job that failed.

    What is stored does not depend on the engine or on the number of workers, up to the order of the lines.

    Args:
        study: what is run.
        store: where results go, opened for this study.
        engine: does the jobs.
        progress: is told of each job that is there.
    """
    done = store.keys()
    left = [job for job in study.jobs() if job.key not in done]
    failed: list[str] = []
    for key in done:
        _tell(progress, key)
    with contextlib.closing(engine.run(do_job, left)) as run:
        for finished in run:
            job = left[finished.index]
            if finished.result is None:
                failed.append(f"{' '.join(map(str, job.key))}: {finished.error}")
            else:
                store.append(finished.result)
            _tell(progress, job.key)
    return failed


def _tell(progress: Callable[[tuple[str, int, str]], None] | None, key: tuple[str, int, str]) -> None:
    if progress is not None:
        progress(key)


def do_job(job: Job) -> Line:
    """Return what a job found, as plain values: for each case the scores of every estimator, or why it did not run."""
    bench = Bench.of(job)
    cases, sample = bench.lines(), bench.subject.sample
    about: Line = {"scene": sample.scene, "returns": len(sample.sweep), "cell_m2": bench.contestants.grid.cell_area_m2}
    about["commits"] = code_version()["commits"]
    return {"job": list(job.key), "about": about, "cases": cases}


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """One sample with those who are tried on it.

    Attributes:
        job: what is done.
        subject: the sample.
        contestants: estimators and truth.
        clean: what the estimators say of the clean sweep; empty where it is not needed again and again.
        defenses: by name.
    """

    job: Job
    subject: Subject
    contestants: Contestants
    clean: Probs
    defenses: dict[str, Defense]
    _references: dict[tuple[str, str], Reference] = field(init=False, repr=False, default_factory=dict)
    _trial: dict[Case, Trial] = field(init=False, repr=False, default_factory=dict)

    @classmethod
    def of(cls, job: Job) -> Bench:
        """Return the bench of a job."""
        subject = _subject(job.study.domains[job.place], job.number, job.study.samples[job.place], job.study.seed)
        only = job.study.defended if job.part == "defenses" else ()
        found = contestants.paper(subject.sample) if job.part == "paper" else contestants.strict(subject.sample, only)
        if job.part in ("defenses", "adaptive"):
            return cls(job, subject, found, {}, {name: _defense(name, subject) for name in job.study.defenses})
        return cls(job, subject, found, found.probs(subject.sample.sweep), {})

    def lines(self) -> list[Line]:
        """Return what became of each case of the job."""
        cases = cases_of(self.job.study, self.job.part)
        if self.job.part != "adaptive":
            return [dict(self.line(case)) for case in cases]
        duels = Duels(self.job.study, self.subject, self.contestants, self.defenses, self.rng_of)
        return [dict(_duel(duels, case)) for case in cases]

    def line(self, case: Case) -> Iterator[tuple[str, Any]]:
        """Yield what became of one case as keys and values."""
        yield "case", _plain(case)
        try:
            trial = self.trial(case)
            defended = self.defenses[case.defense].apply(trial.sweep) if case.defense else None
        except ValueError as error:
            yield "refused", " ".join(str(error).split())
            return
        if defended is not None:
            yield "defense", _judged(defended, trial)
        yield "scores", self._scores(case, trial, defended)

    def trial(self, case: Case) -> Trial:
        """Return the sweep as the case leaves it, without its defense; the last one is kept for the next defense.

        Raises:
            ValueError: the case cannot be made of this sample.
        """
        bare = replace(case, defense="")
        if bare not in self._trial:
            self._trial.clear()
            self._trial[bare] = apply(bare, self.subject, self.rng_of(bare))
        return self._trial[bare]

    def rng_of(self, case: Case) -> np.random.Generator:
        """Return the generator of a case on this sample, as it begins."""
        return generator(self.job.study.seed, self.job.study.domains[self.job.place], self.job.number, case)

    def reference_of(self, case: Case) -> Reference:
        """Return what a case is held against: the same truth for all but those that leave another sensor."""
        key = case.name, case.level
        if key not in self._references:
            usual = self.contestants.reference
            visible = visible_with(case, self.subject, self.rng_of(case))
            self._references[key] = usual if visible is None else replace(usual, visible=visible[usual.among])
        return self._references[key]

    def _scores(self, case: Case, trial: Trial, defended: Defended | None) -> dict[str, list[float | int | None]]:
        entered, reference = self.contestants, self.reference_of(case)
        sweep = trial.sweep if defended is None else defended.sweep
        probs = self.clean if self.clean and self._untouched(trial) else entered.probs(sweep)
        wedge = None if trial.wedge is None else trial.wedge.holds(reference.azimuth)
        return {name: score(prob, entered.threshold, reference, wedge) for name, prob in probs.items()}

    def _untouched(self, trial: Trial) -> bool:
        before = self.subject.sample.sweep
        same = trial.sweep.world_from_sensor is before.world_from_sensor and len(trial.sweep) == len(before)
        return trial.sweep is before or (trial.added is not None and same and not trial.added.any())


def _plain(case: Case) -> list[str]:
    return [case.kind, case.name, case.level, case.defense]


def _duel(duels: Duels, case: Case) -> Iterator[tuple[str, Any]]:
    """Yield what became of attackers who ask, one against each victim."""
    yield "case", _plain(case)
    try:
        yield "scores", duels.scores(case)
    except ValueError as error:
        yield "refused", " ".join(str(error).split())


def _defense(name: str, subject: Subject) -> Defense:
    """Return a defense; the temporal one knows the sweep just before, which nobody attacked."""
    defense = DEFENSES[name]()
    return replace(defense, earlier=subject.earlier[-1:]) if isinstance(defense, TemporalConsistency) else defense


def _judged(defended: Defended, trial: Trial) -> list[float | int | None]:
    """Return alarm (None, 0 or 1), attackers' returns dropped and all of them, others' returns dropped and all."""
    added = np.zeros(len(trial.sweep), np.bool_) if trial.added is None else trial.added
    caught, lost = int((defended.dropped & added).sum()), int((defended.dropped & ~added).sum())
    alarm = None if defended.alarm is None else int(defended.alarm)
    return [alarm, caught, int(added.sum()), lost, int((~added).sum())]


@lru_cache(maxsize=2)
def _subject(domain: str, number: int, count: int, seed: int) -> Subject:
    """The parts of one sample often fall to the same worker."""
    return subject_of(domain, number, count, seed)
