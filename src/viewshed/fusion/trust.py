"""Which agents lie: the likelihood of all that they report, under each small set of agents that might.

Whom to believe cannot be decided agent by agent: that one contradicts another speaks against both alike. So the
hypotheses are sets of liars, none of them, each one, each pair, and each explains all reports at once. An object that
three agents report and a fourth denies is explained best by the fourth alone; where two contradict each other and no
third could see, "the one lies" and "the other lies" explain it equally well, and nobody is convicted: it is *disputed*.

**Model.** An object exists with probability 1/2. An honest agent reports one that exists with the chance that its view
and its detector give (:attr:`Reports.chance`), and one that does not exist with :attr:`TrustRules.false_report`. A liar
does the same, but about a share :attr:`TrustRules.lie` of the objects it lies, for as long as they are there: it
conceals them, puts them elsewhere, or invents them. So whoever is honest about many objects is not cleared of the one.
Honest positions scatter about one place as the detector does; those of lies about another one, on which liars agreed.

**Dependence.** Frames are no independent witnesses: an agent that misses an object misses it in the next frame as well.
So the log-likelihood of an object counts by the time that passed, as one report a second; and what one object says
against a hypothesis, over all time, is bounded by :attr:`TrustRules.most_of_object`. What is older fades.

**E-value.** For each agent, the mean likelihood of the hypotheses in which it lies over the largest of those in which
it does not: the ratio of universal inference (Wasserman, Ramdas, Balakrishnan 2020), of mean at most 1 for an honest
agent if the model were exact. It is not exact, so accusations are calibrated on benign scenes (:class:`TrustLimits`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.integrity.sectors import discoveries

Floats = NDArray[np.float64]

Mask = NDArray[np.bool_]

MOST_LIARS = 2
"""Agents that may lie together; never more than half of them."""


@dataclass(frozen=True, slots=True)
class TrustRules:
    """What honest agents and liars are taken to do.

    Attributes:
        false_report: chance that an honest agent reports an object that does not exist where others look.
        lie: share of the objects about which a liar lies.
        prior: chance that an agent is a liar, before it reports anything.
        least_miss: chance that an honest agent misses an object whatever its view claims: views and detectors err.
        disc_m: radius of the disc over which a lie puts an object.
        most_of_object: bound in nats of what one object says against a hypothesis.
        half_life_s: after so many seconds a report counts half.

    Raises:
        ValueError: a number is out of range.
    """

    false_report: float = 0.1
    lie: float = 0.05
    prior: float = 0.1
    least_miss: float = 0.1
    disc_m: float = 4.0
    most_of_object: float = 4.0
    half_life_s: float = 10.0

    def __post_init__(self) -> None:
        for name in ("false_report", "lie", "prior", "least_miss"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} must be a probability above 0 and below 1, got {getattr(self, name):g}")
        for name in ("disc_m", "most_of_object", "half_life_s"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name):g}")


@dataclass(frozen=True, slots=True, eq=False)
class Reports:
    """What A agents say of J objects at one time; each of the objects is reported by somebody.

    Attributes:
        ids: (J,) int64, the same for one object over time.
        chance: (J, A) probability that an honest agent in its place reports the object if it exists; 0 where it could
            not see, or said nothing at this time.
        seen: (J, A) bool, who reports it.
        xy_m: (J, A, 2) where, in the world; NaN where it is not reported.
        std_m: (J, A) standard deviation of an honest report's position along each axis.

    Raises:
        ValueError: the shapes do not fit, a chance is none, or a position is missing.
    """

    ids: NDArray[np.int64]
    chance: Floats
    seen: Mask
    xy_m: Floats
    std_m: Floats

    def __post_init__(self) -> None:
        shape = self.seen.shape
        if self.ids.shape != shape[:1] or self.chance.shape != shape or self.xy_m.shape != (*shape, 2):
            raise ValueError(
                f"reports of {len(self.ids)} objects must have chance and seen (J, A) and xy_m (J, A, 2), got"
                f" {self.chance.shape}, {shape} and {self.xy_m.shape}"
            )
        if not ((self.chance >= 0) & (self.chance <= 1)).all():
            raise ValueError("chance must be probabilities, got others")
        if self.std_m.shape != shape or not (self.std_m > 0).all():
            raise ValueError(f"std_m must be {shape} positive numbers, got {self.std_m.shape}")
        if not np.isfinite(self.xy_m[self.seen]).all():
            raise ValueError("xy_m must be finite wherever an object is reported")


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """What is believed of each of A agents, and of each of J objects.

    Attributes:
        evidence: (A,) natural logarithm of the e-value against "this agent is honest".
        doubt: how much better the best hypothesis with a liar explains the reports than "all are honest", in nats.
        trust: (A,) probability that the agent is honest.
        ids: (J,) of the objects of the last reports.
        existence: (J,) probability that each exists, whoever lies.
        suspects: (A,) bool, those who lie under the best explanations (within one nat), the ones with fewest liars.
    """

    evidence: Floats
    doubt: float
    trust: Floats
    ids: NDArray[np.int64]
    existence: Floats
    suspects: Mask


@dataclass(slots=True)
class Trust:
    """Follows what a number of agents report; see the module for the model.

    A report that is nobody's alone: three honest agents, the last of which denies what the others see.

    >>> trust, at = Trust(3), np.zeros((1, 3, 2))
    >>> chance, std_m = np.full((1, 3), 0.95), np.full((1, 3), 0.3)
    >>> reports = Reports(np.array([7]), chance, np.array([[True, True, False]]), at, std_m)
    >>> for _ in range(3):
    ...     verdicts = trust.add(reports, seconds=1.0)
    >>> int(verdicts.evidence.argmax()), bool(verdicts.existence[0] > 0.9), verdicts.suspects.tolist()
    (2, True, [False, False, True])

    Args:
        agents: how many there are.
        rules: of the model.
    """

    agents: int
    rules: TrustRules = field(default_factory=TrustRules)
    _lies: Mask = field(init=False, repr=False)
    _share_of_lies: Floats = field(init=False, repr=False)
    _of_objects: dict[int, Floats] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.agents < 1:
            raise ValueError(f"agents must be at least one, got {self.agents}")
        self._lies = hypotheses(self.agents)
        # Chance (H, H) that the liars of a hypothesis lie about an object as a set of agents, and all others do not.
        liars, among = self._lies.sum(axis=1), ~(self._lies[None] & ~self._lies[:, None]).any(axis=2)
        shares = self.rules.lie ** liars[None] * (1 - self.rules.lie) ** (liars[:, None] - liars[None])
        self._share_of_lies = np.where(among, shares, 0.0)

    def reset(self) -> None:
        """Forget all reports."""
        self._of_objects.clear()

    def add(self, reports: Reports, seconds: float) -> Verdicts:
        """Return what is believed after the next reports.

        Args:
            reports: of all agents.
            seconds: since the reports before; at most one second of them counts.

        Raises:
            ValueError: there are other agents, or no time has passed.
        """
        if reports.seen.shape[1] != self.agents or not seconds > 0:
            raise ValueError(
                f"reports must be of {self.agents} agents, some time after the last ones, got {reports.seen.shape[1]}"
                f" agents after {seconds:g} s"
            )
        # What is older fades; an object that says nothing any more is forgotten.
        fade = 0.5 ** (seconds / self.rules.half_life_s)
        faded = {number: fade * known for number, known in self._of_objects.items()}
        self._of_objects = {number: known for number, known in faded.items() if np.ptp(known) > 1e-3}
        for number, logs in zip(reports.ids.tolist(), min(seconds, 1.0) * self._likelihoods(reports), strict=True):
            self._of_objects[number] = self._of_objects.get(number, 0.0) + logs - logs.max()
        return self._verdicts(reports.ids)

    def _likelihoods(self, reports: Reports) -> Floats:
        """Return the log-likelihoods (J, 2, H) of the reports of each object, without the object and with it.

        Each set of agents stands for those who lie about the object; all others are honest about it.
        """
        rules, lies, area = self.rules, self._lies[None], np.pi * self.rules.disc_m**2
        seen, mute = reports.seen[:, None], ((reports.chance == 0) & ~reports.seen)[:, None]
        chance = np.clip(reports.chance, rules.false_report, 1.0 - rules.least_miss)[:, None]
        # With the object a lie conceals it or puts it elsewhere, without it a lie may report it.
        if_there = np.where(lies, 0.5, np.where(seen, chance, 1.0 - chance))
        if_not = np.where(lies, 0.5, np.where(seen, rules.false_report, 1.0 - rules.false_report))
        # Honest positions lie about one place if the object is there, anywhere if not; those of lies about another.
        honest = seen & ~lies
        of_lies = self._about_one_place(reports, seen & lies)
        place_if_there, place_if_not = self._about_one_place(reports, honest), -np.log(area) * honest.sum(axis=2)
        there = np.where(mute, 0.0, np.log(if_there)).sum(axis=2) + place_if_there + of_lies
        absent = np.where(mute, 0.0, np.log(if_not)).sum(axis=2) + place_if_not + of_lies
        return np.stack([absent, there], axis=1)

    def _about_one_place(self, reports: Reports, chosen: Mask) -> Floats:
        """Return the log-density (J, H) of the positions of the chosen (J, H, A) reports, scattered about one place.

        The place lies anywhere on the disc; over it the product of the normal densities has a closed integral.
        """
        weight = np.where(chosen, reports.std_m[:, None] ** -2.0, 0.0)
        xy_m = np.where(reports.seen[..., None], reports.xy_m, 0.0)
        total = weight.sum(axis=2)
        some = total > 0
        mean = np.einsum("jha,jad->jhd", weight, xy_m) / np.where(some, total, 1.0)[..., None]
        square = np.einsum("jha,jhad->jh", weight, (xy_m[:, None] - mean[:, :, None]) ** 2)
        log_weights = np.where(chosen, -np.log(2 * np.pi * reports.std_m[:, None] ** 2), 0.0).sum(axis=2)
        total = np.where(some, total, 1.0)
        logs = log_weights + np.log(2 * np.pi / total) - 0.5 * square - np.log(np.pi * self.rules.disc_m**2)
        return np.where(some, logs, 0.0)

    def _verdicts(self, ids: NDArray[np.int64]) -> Verdicts:
        """Return what is believed of the agents, and of some of the objects."""
        numbers = {number: place for place, number in enumerate(self._of_objects)}
        known = np.array(list(self._of_objects.values())).reshape(-1, 2, len(self._lies))
        # A hypothesis is the mean over the sets of its liars that may lie about an object.
        of_objects = _mixed(np.logaddexp(known[:, 0], known[:, 1]), self._share_of_lies)
        there = _mixed(known[:, 1], self._share_of_lies) - of_objects
        # What an object says against a hypothesis, beside the one that explains it best, is bounded.
        bound = self.rules.most_of_object
        logs = -bound * np.tanh((of_objects.max(axis=1, keepdims=True) - of_objects) / bound).sum(axis=0)
        # The mean of the hypotheses in which an agent lies over the largest of those in which it does not.
        evidence = np.empty(self.agents)
        for agent in range(self.agents):
            lies = self._lies[:, agent]
            evidence[agent] = _log_mean_exp(logs[lies]) - logs[~lies].max() if lies.any() else 0.0
        liars = self._lies.sum(axis=1)
        posterior = logs + liars * np.log(self.rules.prior) + (self.agents - liars) * np.log1p(-self.rules.prior)
        posterior = np.exp(posterior - posterior.max())
        posterior /= posterior.sum()
        best = logs >= logs.max() - 1.0
        best &= liars == liars[best].min()
        existence = np.exp(there) @ posterior
        return Verdicts(
            evidence, float(logs.max() - logs[0]), 1.0 - posterior @ self._lies, ids,
            existence[[numbers[number] for number in ids.tolist()]], self._lies[best].any(axis=0),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class TrustLimits:
    """Accuses agents at a stated rate, calibrated on benign scenes.

    Attributes:
        evidence: (N,) largest evidence, over time, against one random agent of each benign scene, ascending.
        doubt: (N,) largest doubt of each benign scene, ascending.
    """

    evidence: Floats
    doubt: Floats

    @classmethod
    def of(cls, evidence: NDArray[np.floating[Any]], doubt: NDArray[np.floating[Any]]) -> TrustLimits:
        """Return the limits of N benign scenes: largest evidence against a random agent, largest doubt.

        Raises:
            ValueError: there are none, or a number is not finite.
        """
        if evidence.shape != doubt.shape or evidence.ndim != 1 or not len(evidence):
            raise ValueError(f"evidence and doubt must be (N,) of benign scenes, got {evidence.shape}, {doubt.shape}")
        if not (np.isfinite(evidence).all() and np.isfinite(doubt).all()):
            raise ValueError("evidence and doubt must be finite; leave out scenes without reports")
        return cls(np.sort(evidence.astype(np.float64)), np.sort(doubt.astype(np.float64)))

    def to_json(self) -> str:
        """Return the limits as text."""
        return json.dumps({name: getattr(self, name).round(4).tolist() for name in ("evidence", "doubt")}) + "\n"

    @classmethod
    def from_json(cls, text: str) -> TrustLimits:
        """Return the limits in a text of :meth:`to_json`."""
        table = json.loads(text)
        return cls.of(np.array(table["evidence"]), np.array(table["doubt"]))

    def least_rate(self, agents: int) -> float:
        """Return the smallest rate that so many scenes support for so many agents."""
        return agents / (len(self.evidence) + 1.0)

    def accused(self, verdicts: Verdicts, rate: float) -> Mask:
        """Return who is accused (A,): of the accused at most this share is honest, expected over scenes.

        By Benjamini and Hochberg over agents. In a benign scene every accusation is false, so that somebody is accused
        in at most this share of them.

        Raises:
            ValueError: so few scenes support no such rate for so many agents.
        """
        self._check(rate / max(len(verdicts.evidence), 1))
        return discoveries(_p_values(self.evidence, verdicts.evidence), rate)

    def disputed(self, verdicts: Verdicts, rate: float) -> Mask:
        """Return who is disputed (A,): somebody lies, they are the ones it may be, and nobody says which.

        Raises:
            ValueError: so few scenes support no such rate.
        """
        somebody = _p_values(self.doubt, np.array([verdicts.doubt]))[0] <= rate
        return verdicts.suspects & ~self.accused(verdicts, rate) if somebody else np.zeros_like(verdicts.suspects)

    def _check(self, rate: float) -> None:
        need = int(np.ceil(1.0 / rate)) - 1 if 0 < rate < 1 else -1
        if need < 0 or len(self.evidence) < need:
            raise ValueError(
                f"rate must be in (0, 1), and {rate:g} needs {need} benign scenes, got {len(self.evidence)}"
            )


@lru_cache(maxsize=1)
def trust_limits() -> TrustLimits:
    """Return the limits in the box: of what agents report, in the calibration scenes of docs/results/agents.md."""
    return TrustLimits.from_json(resources.files("viewshed.fusion").joinpath("limits.json").read_text("utf-8"))


def hypotheses(agents: int) -> Mask:
    """Return who lies under each hypothesis (H, agents): first nobody, then each one, then each pair.

    >>> hypotheses(3).astype(int).tolist()
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    """
    most = min(MOST_LIARS, agents // 2)
    sets = [chosen for count in range(most + 1) for chosen in combinations(range(agents), count)]
    out = np.zeros((len(sets), agents), np.bool_)
    for line, chosen in zip(out, sets, strict=True):
        line[list(chosen)] = True
    return out


def _mixed(logs: Floats, shares: Floats) -> Floats:
    """Return the logarithms of the means (J, H) of likelihoods (J, H) given as logarithms, by shares (H, H)."""
    highest = logs.max(axis=1, keepdims=True)
    highest = np.where(np.isfinite(highest), highest, 0.0)
    return np.log(np.maximum(np.exp(logs - highest) @ shares.T, 1e-300)) + highest


def _log_mean_exp(logs: Floats) -> float:
    highest = float(logs.max())
    return highest + float(np.log(np.exp(logs - highest).mean()))


def _p_values(benign: Floats, values: Floats) -> Floats:
    """Return the conformal p-values (K,) of values (K,) against those of benign scenes (N,), ascending."""
    above = len(benign) - np.searchsorted(benign, values, "left")
    p_values: Floats = np.asarray((1.0 + above) / (1.0 + len(benign)), np.float64)
    return p_values
