"""What the ablation found, as figures of contestants."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from viewshed.metrics import STEPS, Scores
from viewshed.reproduce.store import JobStore
from viewshed.successor.contest import BARE, BENIGN, TOUCHING, Said
from viewshed.successor.parts import SENSOR
from viewshed.successor.plan import WHOLE, AblationPlan
from viewshed.successor.remembered import ALONE, ATTACKED, HONEST

JAMMING = "jamming"
_PASTS = (f", {ALONE}", f", {HONEST}", f", {ATTACKED}")
OVER_CLAIM = ("ghost_wall", "far_wall", "removal", "high_frequency_removal", "relay", "removal_and_far_wall")


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Everything that was said on one split of one setting.

    Attributes:
        plan: of the ablation.
        setting: of the plan's.
        said: by contestant and case, all sweeps together.
    """

    plan: AblationPlan
    setting: str
    said: dict[str, dict[str, Said]]

    @classmethod
    def read(cls, store: JobStore[AblationPlan], split: str, setting: str) -> Results:
        """Return what the finished jobs of a split found in a setting.

        Raises:
            ValueError: a line is damaged.
        """
        found: dict[str, dict[str, Said]] = defaultdict(lambda: defaultdict(Said))
        for line in store.jobs(split, setting):
            for name, cases in line["said"].items():
                for case, told in cases.items():
                    found[name][case] = found[name][case] + Said.from_json(told)
        return cls(store.plan, setting, {name: dict(cases) for name, cases in found.items()})

    @property
    def alone(self) -> list[str]:
        """Contestants that see one sweep alone."""
        return [name for name in self.said if not name.endswith(_PASTS)]

    def remembering(self, name: str) -> list[str]:
        """Return those that are a contestant on sweeps that have a past: alone, with it, and wary with it."""
        return [each for each in self.said if each.startswith(f"{name}, ") and each.endswith(_PASTS)]

    @property
    def attacks(self) -> tuple[str, ...]:
        """Attacks that our network is trained on."""
        return self.plan.config_in(self.setting).attacks

    @property
    def trained(self) -> tuple[str, ...]:
        """Those of the attacks that our network is trained on, jamming apart."""
        return tuple(name for name in TOUCHING if name in self.attacks and name != JAMMING)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Attacks that it never met."""
        return tuple(name for name in TOUCHING if name not in self.attacks)

    @property
    def opening(self) -> tuple[list[str], list[str]]:
        """Attacks that open a view: those that our network is trained on, and those it never met."""
        seen, unseen = ([case for case in OVER_CLAIM if case in group] for group in (self.trained, self.unseen))
        return seen, unseen

    @property
    def sure(self) -> float:
        """Probability from which the whole network's claims in opened wedges have the plan's precision."""
        return sure_from(self.wedge(WHOLE, self.opening[0]), self.plan.claim_precision)

    def view(self, name: str, cases: Iterable[str]) -> list[Scores]:
        """Return the scores of the whole view in those of the cases that there are."""
        return [self.said[name][case].view for case in cases if case in self.said[name]]

    def wedge(self, name: str, cases: Iterable[str]) -> Scores:
        """Return the scores in the wedges of several cases together."""
        return sum((self.said[name][case].wedge for case in cases if case in self.said[name]), Scores())

    def f1(self, name: str, cases: Iterable[str]) -> float:
        """Return the mean F1 of the view over cases; NaN for none."""
        scores = self.view(name, cases)
        return float(np.mean([each.f1() for each in scores])) if scores else float("nan")

    @property
    def parts(self) -> dict[str, int]:
        """Parts of the untouched view, sensors last and in alphabetical order, with the sweeps that have them."""
        parts = {part: row[0] for name in self.alone for part, row in self.said[name][BENIGN].parts.items()}
        return dict(sorted(parts.items(), key=lambda part: part[0] if part[0].startswith(SENSOR) else ""))

    def f1_of_part(self, name: str, part: str) -> float:
        """Return the F1 of a part of the untouched view; NaN where nothing of it is visible or claimed."""
        _, both, over, under, _ = self.said[name][BENIGN].parts[part]
        return 2 * both / (2 * both + over + under) if both + over + under else float("nan")

    def ece(self, name: str, cases: Iterable[str]) -> float:
        """Return the expected calibration error of the view over cases together."""
        return sum(self.view(name, cases), Scores()).ece()

    def figures(self, name: str) -> dict[str, float]:
        """Return what one line of the ablation says of a contestant."""
        seen, unseen = (self.wedge(name, cases) for cases in self.opening)
        return {
            "benign": self.f1(name, [BENIGN]), "no rings": self.f1(name, [BARE]),
            "trained": self.f1(name, self.trained), "unseen": self.f1(name, self.unseen),
            "jamming": self.f1(name, [JAMMING]), "worst": min(s.f1() for s in self.view(name, TOUCHING)),
            "wedge precision": seen.precision(), "wedge recall": seen.recall(),
            "unseen wedge precision": unseen.precision(), "unseen wedge recall": unseen.recall(),
            "ECE benign": self.ece(name, [BENIGN]), "ECE unseen": self.ece(name, self.unseen),
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sure:
    """What is told where only sure cells are: claimed from a probability on, denied below 1 less it.

    Attributes:
        share: of the cells of which anything is told.
        claims: share of the claimed cells that are visible; NaN where none is claimed.
        denials: share of the denied cells that are not visible; NaN where none is denied.
    """

    share: float
    claims: float
    denials: float

    @classmethod
    def of(cls, scores: Scores, sure: float) -> Sure:
        """Return what is told of the cells of some scores from ``sure`` on, a multiple of .001 in [.5, 1).

        >>> scores = Scores()
        >>> scores.add([0.95, 0.9, 0.5, 0.05], [True, False, True, False])
        >>> Sure.of(scores, 0.9)
        Sure(share=0.75, claims=0.5, denials=1.0)
        """
        step = round(sure * STEPS)
        claimed, denied = scores.steps[step:].sum(axis=0), scores.steps[: STEPS - step].sum(axis=0)
        told, nan = int(claimed.sum() + denied.sum()), float("nan")
        return cls(
            told / scores.cells if scores.cells else nan,
            float(claimed[1] / claimed.sum()) if claimed.any() else nan,
            float(denied[0] / denied.sum()) if denied.any() else nan,
        )


def sure_from(scores: Scores, precision: float) -> float:
    """Return the lowest probability from which claims have a precision, in whole steps; 1 if none does.

    >>> scores = Scores()
    >>> scores.add([0.4, 0.7, 0.9], [False, False, True])
    >>> sure_from(scores, 0.8)
    0.701
    """
    for step in range(1, STEPS + 1):
        found = scores.precision(step / STEPS)
        if found >= precision:
            return step / STEPS
    return 1.0
