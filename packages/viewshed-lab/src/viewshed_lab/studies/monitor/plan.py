"""What the study of the monitor runs: drives of three splits, what is done to them, and how the score is trained."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import ClassVar

from viewshed.monitor.evidence import EVIDENCE
from viewshed_lab.data.presets import Preset, preset_named, preset_names
from viewshed_lab.studies.cases import DEFAULT, corruption_cases, generator, strength_cases
from viewshed_lab.studies.plan import JobKey, Plan, check_names, check_seed
from viewshed_lab.studies.records import Case
from viewshed_lab.threats.attacks import ATTACKS, FAMILY, INFORMED
from viewshed_lab.threats.corruptions import CORRUPTIONS

SPLITS = ("train", "calibration", "test", "benign")
"""No scene is in two of them: the score is trained on the first, calibrated on the second, reported on the third.

False alarms are counted on the fourth as well, which nobody attacks.
"""

ATTACKED_SPLITS = ("train", "test")

FRAMES = 10
"""Sweeps of a drive, .1 s apart."""

ONSET = 5
"""The frame from which on a drive is attacked or corrupted."""

BEFORE = 20
"""Frames of the scene before the drive: an attacker may have recorded them."""

INTERVAL_S = 0.1

CORRUPTED = 0.3
"""Share of the drives that are corrupted from their first frame on, benign ones as all others."""

CLEAN = "_clean"
"""Ends the names of attacks by a spoofer without extra range noise."""

FROZEN, OLDER = "frozen", "older"
"""Replays beside the default one, of .5 s before: the last sweep before the onset again and again; of 2.5 s before."""

ALL_FAMILIES = "all"
"""Name of the score that is trained on attacks of all families."""

PUBLISHED = "published"
"""Step in which the published detector is tried on some of the drives."""

STEPS = ("drives", PUBLISHED, "score", "page")

ALL_ATTACKS = ATTACKS | INFORMED
"""Attacks by name, those of attackers who know what a monitor looks at among them."""

BUDGETS = (10, 30, 100, 300, 1000)
"""Returns that an attacker touches, to find the smallest number that raises an alarm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorPlan(Plan):
    """The study of the monitor of all evidence.

    Attributes:
        domains: presets of simulated data whose worlds and sensors the drives have, each drive a scene of its own.
        train: drives of each domain that the score is trained on.
        unattacked: further ones to train on, none of which is attacked: they cost little, and what is usual is in them.
        calibration: drives of each domain that its limits are from.
        test: drives of each domain that it is reported on.
        benign: further ones, none of which is attacked: they cost little, and false alarms are counted on many.
        attacked: drives of each domain, in training and in test, that are tried in several cases as well.
        cases: of each such drive, in turn.
        published: drives of the first domain that the published detector is fitted, calibrated and tried on, each a
            network's work; none where 0.
        evidence: that is measured, all there is.
        attacks: names of ``ALL_ATTACKS``, each with its own budget.
        budgeted: names of those that are tried with ``BUDGETS`` as well.
        corruptions: names of ``CORRUPTIONS``.
        severities: of the corruptions of such drives: faults begin in their middle, weather and things last.
        epochs: of the training.
        seed: of all that is random.

    Raises:
        ValueError: a name is not known, a number is out of range, or lists differ in length.
    """

    FOLDER: ClassVar[str] = "studies/monitor/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {
        "attacks": ALL_ATTACKS,
        "corruptions": CORRUPTIONS,
        "evidence": EVIDENCE,
    }

    name: str
    about: str
    domains: tuple[str, ...]
    train: tuple[int, ...]
    unattacked: tuple[int, ...]
    calibration: tuple[int, ...]
    test: tuple[int, ...]
    benign: tuple[int, ...]
    attacked: tuple[int, ...]
    cases: int
    published: tuple[int, ...]
    evidence: tuple[str, ...]
    attacks: tuple[str, ...]
    budgeted: tuple[str, ...]
    corruptions: tuple[str, ...]
    severities: tuple[int, ...]
    epochs: int
    seed: int

    def __post_init__(self) -> None:
        check_names("domains", self.domains, preset_names(), once=True)
        check_names("evidence", self.evidence, EVIDENCE, once=True)
        check_names("attacks", self.attacks, ALL_ATTACKS)
        check_names("budgeted", self.budgeted, ATTACKS)
        check_names("corruptions", self.corruptions, CORRUPTIONS)
        check_names("severities", self.severities, (1, 2, 3, 4, 5))
        check_seed("seed", self.seed)
        self.check_at_least(1, "epochs")
        self.check_at_least(0, "cases")
        for key in (*SPLITS, "unattacked", "attacked"):
            counts = getattr(self, key)
            least = 0 if key in ("benign", "unattacked", "attacked") else 1
            if len(counts) != len(self.domains) or min(counts) < least:
                raise ValueError(f"{key} must have a number of drives for each of {len(self.domains)} domains")
        most = (self.drives_of(0, "train"), self.calibration[0], self.test[0])
        if len(self.published) != 3 or not all(0 <= n <= of for n, of in zip(self.published, most, strict=True)):
            raise ValueError(f"published must be three numbers of drives up to {most}, got {self.published}")

    def job_keys(self) -> list[JobKey]:
        """Return the names of all jobs: one a drive, then those of the published detector, then one a score."""
        return self.drive_keys() + self.published_keys() + self.score_keys()

    def drive_keys(self) -> list[JobKey]:
        """Return the names of the drives' jobs: domain, split, number.

        Those to train on come first, then all others in turn: a run that is stopped has some of each.
        """
        keys = [
            (split != "train", number / count, ("drive", domain, split, str(number)))
            for place, domain in enumerate(self.domains)
            for split in SPLITS
            for count in [self.drives_of(place, split)]
            for number in range(count)
        ]
        return [key for _, _, key in sorted(keys)]

    def published_keys(self) -> list[JobKey]:
        """Return the names of the published detector's jobs: its fit, then a drive each, those of the test attacked."""
        fit, calibration, test = self.published
        attacked = (n for n in range(self.test[0]) if self.cases_of(self.domains[0], "test", n))
        drives = [("calibration", n) for n in range(calibration)] + [("test", n) for n in islice(attacked, test)]
        return [(PUBLISHED, "fit"), *((PUBLISHED, split, str(n)) for split, n in drives)] if fit else []

    def drives_of(self, place: int, split: str) -> int:
        """Return how many drives a split of the domain at a place has, further ones to train on among them."""
        drives: int = getattr(self, split)[place]
        return drives + self.unattacked[place] if split == "train" else drives

    def score_keys(self) -> list[JobKey]:
        """Return the names of the scores' jobs: trained on all families, then without one family each."""
        families = sorted({family_of(name) for name in self.attacks})
        return [("score", ALL_FAMILIES), *(("score", str(family)) for family in families)]

    def preset(self, domain: str) -> Preset:
        """Return what a domain is simulated with: the worlds and sensors of its preset, in clear weather at 10 Hz.

        Scenes do not depend on how many there are: a larger plan of the same seed begins with the same ones.
        """
        return replace(
            preset_named(domain), splits=SPLITS, scenes=(1,) * len(SPLITS), frames=(BEFORE + FRAMES,) * len(SPLITS),
            interval_s=INTERVAL_S, conditions=("clear",), condition_weights=(1.0,), seed=self.seed,
        )  # fmt: skip

    def all_cases(self) -> list[Case]:
        """Return all that is done to drives from frame ``ONSET`` on."""
        cases = [Case("attack", name, DEFAULT) for name in self.attacks]
        if "replay" in self.attacks:
            cases += [Case("attack", "replay", FROZEN), Case("attack", "replay", OLDER)]
        for name in self.attacks:
            cases += strength_cases(name)
        cases += [Case("attack", name, str(budget)) for name in self.budgeted for budget in BUDGETS]
        cases += [Case("null", name) for name in self.attacks]
        return cases + corruption_cases(self.corruptions, self.severities)

    def cases_of(self, domain: str, split: str, number: int) -> list[Case]:
        """Return what is done to a drive, each in its turn: nothing in the splits that nobody attacks."""
        every = self.all_cases()
        order = generator(self.seed, "cases").permutation(len(every))
        place = self.domains.index(domain)
        attacked, drives = self.attacked[place], getattr(self, split)[place]
        if number >= drives:
            return []
        # Attacked drives lie evenly among the others; the turn is how many there were before.
        turn, after = number * attacked // drives, (number + 1) * attacked // drives
        if split not in ATTACKED_SPLITS or turn == after:
            return []
        count = min(self.cases, len(every))
        return [every[order[(turn * count + k) % len(every)]] for k in range(count)]


def family_of(name: str) -> int:
    """Return the number of an attack's family; a clean spoofer's attack is of the family of the same attack with noise.

    So nothing like an attack is trained on when its family is left out.

    >>> family_of("ghost_wall_clean") == family_of("ghost_wall")
    True
    """
    return FAMILY[name.removesuffix(CLEAN)]
