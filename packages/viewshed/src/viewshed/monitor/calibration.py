"""Rates that alarms keep: conformal p-values of a score, calibrated on the scores of benign scenes.

What is exchangeable is a scene, not a sweep: neighbors in a drive are nearly the same sweep. So each scene gives one
score, that of a random sweep of it (the rate is then per sweep) or the largest of its drive (the rate is per drive).
Of n benign scores the alarm leaves m above its limit. Two promises follow, for any distribution of the scores:

- *expected*: a further benign scene alarms with probability (m + 1) / (n + 1) at most, over all draws of the
  calibration scenes (Vovk, Gammerman and Shafer, 2005);
- *confident*: with probability .9 over the calibration scenes, the rate from then on is at most the quantile of
  Beta(m + 1, n - m), the distribution of an order statistic (Vovk, 2012).

Simulated scores can be corrected by a few real ones, :class:`RealScores`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed.arrays import F64

Promise = Literal["expected", "confident"]
"""Which of the two rates must not exceed the chosen one."""

Per = Literal["sweep", "drive"]
"""What alarms are counted in: single sweeps, or drives that alarm at any of their sweeps."""

Earlier = Literal["none", "unposed", "posed"]
"""Earlier sweeps of a sweep: none, some without poses, all with poses."""

CONFIDENCE = 0.9
"""Probability of the confident promise."""

TAIL_SHARE = 0.1
"""Share of the benign scores, the highest, to which an exponential tail is fitted."""

_LEAST_TAIL = 1e-12


class Group(NamedTuple):
    """Scenes that are calibrated together (Mondrian conformal prediction): one sensor, the same kind of history."""

    sensor: str
    earlier: Earlier

    def __str__(self) -> str:
        """Return the group in words."""
        kinds = {"none": "single sweeps", "unposed": "earlier sweeps without poses", "posed": "earlier sweeps"}
        return f"{self.sensor}, {kinds[self.earlier]}"


def p_values(benign: ArrayLike, scores: ArrayLike, rng: np.random.Generator | None = None) -> F64:
    """Return the conformal p-values (M,) of scores: the share of benign ones, and itself, that are as high.

    Args:
        benign: (n,) scores of benign scenes.
        scores: (M,) scores.
        rng: draws where a score stands among equal ones (smoothed p-values, which are uniform); without it the score
            counts as the lowest of them, and the p-values are too large rather than too small.

    Raises:
        ValueError: there are no scores, or one is NaN.

    >>> p_values([1.0, 2.0, 2.0, 3.0], [0.0, 2.0, 9.0])
    array([1. , 0.8, 0.2])
    """
    return _p_values_of_ordered(np.sort(_checked("benign", benign)), _checked("scores", scores), rng)


def _p_values_of_ordered(ordered: F64, scores: F64, rng: np.random.Generator | None) -> F64:
    """Return the p-values (M,) of scores against ascending benign ones, all of them numbers."""
    above = len(ordered) - np.searchsorted(ordered, scores, "right")
    equal = len(ordered) - np.searchsorted(ordered, scores, "left") - above
    share = np.ones(scores.shape) if rng is None else rng.random(scores.shape)
    result: F64 = np.maximum(above + share * (equal + 1.0), np.finfo(float).tiny) / (len(ordered) + 1.0)
    return result


def tail_p_values(ordered: F64, scores: ArrayLike) -> F64:
    """Return p-values (M,) of scores that go on where conformal ones end, at 1 / (n + 1).

    Above the highest tenth of the benign scores their excess is taken for exponential, as that of most distributions
    nearly is far out (peaks over a threshold; Pickands, 1975). An estimate that promises nothing: it tells high scores
    from still higher ones, so that a limit of what they add up to can promise something, see ``over_time``.

    Args:
        ordered: (n,) scores of benign scenes, ascending.
        scores: (M,) scores.

    >>> tail_p_values(np.arange(1.0, 20.0), [1.0, 17.0, 18.5, 100.0]).round(4)
    array([1.    , 0.2   , 0.0552, 0.    ])
    """
    values, count = np.asarray(scores, np.float64), len(ordered)
    p = _p_values_of_ordered(ordered, values, None)
    above = math.ceil(TAIL_SHARE * (count + 1))
    if above >= count:
        return p
    start = float(ordered[count - above - 1])
    excess = float(ordered[count - above :].mean()) - start
    if excess > 0.0:
        beyond = (above + 1) / (count + 1) * np.exp(-np.maximum(values - start, 0.0) / excess)
        p = np.where(values > start, np.maximum(beyond, _LEAST_TAIL), p)
    return p


def tail_p_values_among_others(chosen: F64, sweeps: Sequence[F64]) -> list[F64]:
    """Return the tail p-values of each scene's sweeps among the other scenes, as those of a further scene would be.

    Args:
        chosen: (n,) the score with which each scene is calibrated.
        sweeps: of each of the n scenes the scores of its sweeps.
    """
    ordered = np.sort(chosen)
    places = np.searchsorted(ordered, chosen)
    return [
        tail_p_values(np.delete(ordered, place), scores) if len(ordered) > 1 else np.ones(len(scores))
        for place, scores in zip(places, sweeps, strict=True)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class HighestScores:
    """The highest benign scores of several columns, sectors or kinds of evidence: all that small p-values need.

    Attributes:
        scenes: number n of benign scenes.
        highest: (K, C) float32, the K highest of each column, descending; -inf for NaN.

    Raises:
        ValueError: the shapes do not fit or the columns do not descend.
    """

    scenes: int
    highest: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.highest.ndim != 2 or not 0 < len(self.highest) <= self.scenes:
            raise ValueError(f"highest must be (1 to {self.scenes}, C), got {self.highest.shape}")
        if not (self.highest[1:] <= self.highest[:-1]).all() or np.isnan(self.highest[0]).any():
            raise ValueError("highest must descend without NaN, got others")

    @classmethod
    def of(cls, scores: ArrayLike, share: float = 0.1) -> Self:
        """Return the highest of benign scores (n, C), as many as p-values up to ``share`` need."""
        lowered = np.nan_to_num(np.asarray(scores, np.float32), nan=-np.inf, posinf=np.inf, neginf=-np.inf)
        keep = min(len(lowered), math.ceil(share * (len(lowered) + 1)))
        return cls(len(lowered), -np.sort(-lowered, axis=0)[:keep])

    def p_values(self, scores: ArrayLike) -> F64:
        """Return the p-values (C,) of scores (C,), or of any number of scores in a single column.

        They are 1 where a score is below those kept, or NaN.
        """
        values = np.asarray(scores, np.float32)
        if self.highest.shape[1] == 1:
            reached = len(self.highest) - np.searchsorted(self.highest[::-1, 0], values)
        else:
            reached = (self.highest >= values).sum(axis=0)
        known = (reached < len(self.highest)) & ~np.isnan(np.asarray(scores, np.float64))
        return np.where(known, (reached + 1.0) / (self.scenes + 1.0), 1.0)


def alarms_allowed(scenes: int, rate: float, promise: Promise = "expected", *, unit: str = "scenes") -> int:
    """Return how many of the benign scores of ``scenes`` scenes may lie above the limit of an alarm with this rate.

    Args:
        scenes: number of benign scores.
        rate: of false alarms, in (0, 1).
        promise: which rate it is.
        unit: what the message calls them.

    Raises:
        ValueError: there are too few for the rate, even with none above.

    >>> alarms_allowed(999, 0.001), alarms_allowed(2302, 0.001, "confident")
    (0, 0)
    """
    if not 0.0 < rate < 1.0:
        raise ValueError(f"a false-alarm rate must lie in (0, 1), got {rate}")
    if promise not in get_args(Promise):
        raise ValueError(f"promise must be expected or confident, got {promise}")
    if promise == "expected":
        need = math.ceil(1.0 / rate - 1e-9) - 1
        allowed = math.floor((scenes + 1) * rate + 1e-9) - 1
    else:
        # With m above the limit the rate is Beta(m + 1, n - m), which exceeds `rate` as often as Binomial(n, rate) ≤ m.
        need = math.ceil(math.log(1.0 - CONFIDENCE) / math.log1p(-rate) - 1e-9)
        allowed = int(np.searchsorted(_binomial_cdf(scenes, rate), 1.0 - CONFIDENCE + 1e-12, "right")) - 1
    if scenes < need or allowed < 0:
        word = "" if promise == "expected" else f" with probability {CONFIDENCE:g}"
        raise ValueError(f"a false-alarm rate of {rate:g}{word} needs at least {need} benign {unit}, got {scenes}")
    return allowed


def alarm_limit(benign: ArrayLike, rate: float, promise: Promise = "expected", *, unit: str = "sweeps") -> float:
    """Return the score above which a further benign one lies with at most this probability.

    The (n - m)-th smallest of n scores, with m = ``alarms_allowed(n, rate, promise)``: for the expected rate the
    ⌈(n + 1)(1 - rate)⌉-th.

    Raises:
        ValueError: the rate is not in (0, 1), there are too few scores for it, or one is NaN.

    >>> alarm_limit(range(1, 20), 0.1)
    18.0
    """
    scores = np.asarray(benign, np.float64)
    allowed = alarms_allowed(len(scores), rate, promise, unit=unit)
    return float(np.sort(_checked("benign", scores))[len(scores) - 1 - allowed])


@dataclass(frozen=True, slots=True)
class Promised:
    """What a limit promises that leaves some of the benign scores above it.

    Attributes:
        scenes: number of benign scores.
        above: how many of them lie above the limit.
    """

    scenes: int
    above: int

    @property
    def expected(self) -> float:
        """The expected false-alarm rate is at most this."""
        return (self.above + 1) / (self.scenes + 1)

    @property
    def confident(self) -> float:
        """With probability .9 the false-alarm rate is at most this: a quantile of Beta(above + 1, scenes - above)."""
        if self.above >= self.scenes:
            return 1.0
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            missed = _binomial_cdf(self.scenes, middle)[self.above]
            low, high = (middle, high) if missed > 1.0 - CONFIDENCE else (low, middle)
        return high

    def __str__(self) -> str:
        """Return both promises in a line."""
        return (
            f"{self.above} of {self.scenes} benign scenes above the limit: expected rate at most {self.expected:.3%}, "
            f"at most {self.confident:.3%} with probability {CONFIDENCE:g}"
        )


def one_per_scene(
    scenes: Sequence[str], scores: ArrayLike, per: Per, rng: np.random.Generator
) -> tuple[list[str], F64]:
    """Return the scenes in order of appearance and a score (n, …) of each: of a random sweep, or the largest of all.

    Args:
        scenes: (N,) the scene of each sweep.
        scores: (N, …) scores of sweeps.
        per: what alarms are to be counted in.
        rng: draws the sweeps; nothing is drawn per drive.
    """
    rows: dict[str, list[int]] = {}
    for row, scene in enumerate(scenes):
        rows.setdefault(scene, []).append(row)
    every = np.asarray(scores, np.float64)
    if per == "sweep":
        return list(rows), every[[own[int(rng.integers(len(own)))] for own in rows.values()]]
    if per != "drive":
        raise ValueError(f"per must be sweep or drive, got {per}")
    # NaN, where evidence abstained, counts as lower than any number.
    lowered = np.where(np.isnan(every), -np.inf, every)
    return list(rows), np.stack([lowered[own].max(axis=0) for own in rows.values()])


@dataclass(frozen=True, slots=True, eq=False)
class RealScores:
    """A few real benign scenes among the simulated ones: what corrects a simulated calibration.

    The p-value of a real sweep among simulated scenes is only as good as the simulation. But among m real scenes its
    rank is uniform, whatever the simulation. So the real ones give its rank, in steps of 1 / (m + 1), and the simulated
    ones say where it lies between its two real neighbors. (The idea to correct synthetic by few real calibration scores
    is that of C-PP-COAD, arXiv 2505.01783; the construction is ours.) Exactly, for a benign real sweep:

    1. P(p ≤ k / (m + 1)) ≤ k / (m + 1) for every whole k, however wrong the simulation is; so an alarm at rate α has an
       expected rate of at most ⌈α (m + 1)⌉ / (m + 1).
    2. P(p ≤ α) ≤ α for every α if, in one group, simulated and real scores are exchangeable *between* real neighbors,
       that is, if the simulation has the right shape there; it may be wrong about how often scores are so high. Scores
       must not tie; where they do, p is too large rather than too small. Where real scenes are of several groups,
       2 holds up to a factor of 1 + (m + 1) / (n + 1), n simulated scenes.

    Attributes:
        place: (m,) where each stands among the simulated scores of its group, smaller where it is higher; see
            :func:`_place`.
        strict: (m,) p-values that count simulated scores above the real one only.
        weak: (m,) p-values that count equal ones as well.

    Raises:
        ValueError: they are no p-values, or strict ones are larger.
    """

    place: F64
    strict: F64
    weak: F64

    def __post_init__(self) -> None:
        if self.place.ndim != 1 or not self.place.shape == self.strict.shape == self.weak.shape:
            raise ValueError(f"real scores must be three rows alike, got {self.place.shape} and {self.weak.shape}")
        if not ((self.strict > 0) & (self.strict <= self.weak) & (self.weak <= 1) & (self.place >= 0)).all():
            raise ValueError("real scores must be p-values in (0, 1], strict ones no larger than weak ones, got others")

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.place)

    def correct(self, place: float, p: float, simulated: int) -> float:
        """Return the corrected p-value of a score with that place and p-value among ``simulated`` scores."""
        step, counted = 1.0 / (simulated + 1), self.place <= place
        # The nearest real scores above and below it; without one, where the simulated scores end.
        above = np.flatnonzero(counted & (self.place == self.place[counted].max(initial=-1.0)))
        low = max(self.weak[above].max(initial=0.0), step)
        high = self.strict[~counted].min(initial=1.0)
        # Below a real score that simulated ones equal it is unknown how many of these lie between.
        tied = (self.strict[above] < self.weak[above] - 1e-9 * step).any()
        share = 1.0 if tied else min((max(p - low, 0.0) + step) / (max(high - low, 0.0) + step), 1.0)
        return float(min((counted.sum() + share) / (len(self) + 1), 1.0))


NO_REAL_SCORES = RealScores(np.zeros(0), np.zeros(0), np.zeros(0))


def _place(ordered: F64, score: float) -> tuple[float, float, float]:
    """Return where a score stands among ascending ones: its place, strict and weak p-value, all falling as it rises.

    The place is the share of the scores above, linear between two of them and going on beyond the highest, so that two
    scores which no third one separates have two places.
    """
    count = len(ordered)
    weak, strict = count - np.searchsorted(ordered, score, "left"), count - np.searchsorted(ordered, score, "right")
    spread = float(ordered[-1] - ordered[count // 2]) or 1.0
    if score > ordered[-1]:
        rank = 1.0 / (1.0 + (score - float(ordered[-1])) / spread)
    elif score <= ordered[0]:
        rank = count + 1.0 - 1.0 / (1.0 + (float(ordered[0]) - score) / spread)
    else:
        below, above = float(ordered[count - weak - 1]), float(ordered[count - weak])
        rank = weak + (above - score) / (above - below)
    return rank / (count + 1), (1 + int(strict)) / (count + 1), (1 + int(weak)) / (count + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Benign scores of one verdict by group, the chosen rate of false alarms, and what is promised.

    A sweep of a group without benign scores takes the largest p-value over the groups with the same history: its rate
    holds if it is like any one of them. Where there is no such group it is refused.

    Attributes:
        scores: (n,) of each group, one for each benign scene.
        rate: of false alarms.
        promise: which rate that is.
        real: real scenes that correct simulated ones; none unless :meth:`corrected`.

    Raises:
        ValueError: there is no group, a score is NaN, or a group has too few scenes for the rate.

    >>> calibration = Calibration({Group("VLP-16", "none"): np.arange(99.0)}, rate=0.01)
    >>> calibration.limit(Group("VLP-16", "none")), calibration.p_value(98.5, Group("VLP-16", "none"))
    (98.0, 0.01)
    """

    scores: Mapping[Group, F64]
    rate: float
    promise: Promise = "expected"
    real: RealScores = NO_REAL_SCORES
    _limits: dict[Group, tuple[float, int]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.scores:
            raise ValueError("a calibration must have benign scores of one group at least, got none")
        ordered = {group: np.sort(_checked(str(group), scores)) for group, scores in self.scores.items()}
        object.__setattr__(self, "scores", ordered)
        limits = {}
        for group, scores in ordered.items():
            try:
                limit = (
                    self._corrected_limit(group)
                    if len(self.real)
                    else alarm_limit(scores, self.rate, self.promise, unit="scenes")
                )
            except ValueError as error:
                raise ValueError(f"{group}: {error}") from None
            limits[group] = (limit, len(scores) - int(np.searchsorted(scores, limit, "right")))
        object.__setattr__(self, "_limits", limits)

    def _corrected_limit(self, group: Group) -> float:
        """Return the limit of a group above which the corrected p-value is low enough."""
        level, real = self.rate, len(self.real)
        if self.promise == "confident":
            level = (alarms_allowed(real, self.rate, self.promise, unit="real scenes") + 1) / (real + 1)
        if self.p_value(math.inf, group) > level + 1e-12:
            raise ValueError(
                f"a false-alarm rate of {self.rate:g} needs simulated scores beyond those of the {real} real scenes,"
                f" got too few; ask for a rate of {1 / (real + 1):.3g} or give more real scenes"
            )
        scores = self.scores[group]
        low, high = float(scores[0]) - 1.0, float(scores[-1]) + 1.0
        while self.p_value(high, group) > level + 1e-12:
            low, high = high, 2.0 * high - float(scores[0])
        while self.p_value(low, group) <= level + 1e-12:
            low, high = 2.0 * low - float(scores[-1]), low
        # The p-value falls as the score rises: halve until two neighboring numbers are left.
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (low, middle) if self.p_value(middle, group) <= level + 1e-12 else (middle, high)
        return low

    def alike(self, group: Group) -> tuple[Group, ...]:
        """Return the groups that stand for a group: itself, or all of the same history where it was not calibrated.

        Raises:
            ValueError: there is none.
        """
        if group in self.scores:
            return (group,)
        found = tuple(each for each in self.scores if each.earlier == group.earlier)
        if not found:
            known = "; ".join(map(str, self.scores))
            raise ValueError(f"sweep must be of a calibrated group ({known}), got {group}; calibrate on such sweeps")
        return found

    def p_value(self, score: float, group: Group, rng: np.random.Generator | None = None) -> float:
        """Return the p-value of a score; smoothed with ``rng``, else too large rather than too small where scores tie.

        Raises:
            ValueError: the score is NaN, or the group unknown and without a like.
        """
        if math.isnan(score):
            raise ValueError("score must be a number, got NaN")
        return max(
            self._corrected(score, float(_p_values_of_ordered(scores, np.array([score]), rng)[0]), scores)
            for scores in (self.scores[each] for each in self.alike(group))
        )

    def tail_p_value(self, score: float, group: Group) -> float:
        """Return the p-value of a score that goes on beyond the benign ones: see :func:`tail_p_values`.

        Raises:
            ValueError: as :meth:`p_value`.
        """
        if math.isnan(score):
            raise ValueError("score must be a number, got NaN")
        return max(
            self._corrected(score, float(tail_p_values(scores, [score])[0]), scores)
            for scores in (self.scores[each] for each in self.alike(group))
        )

    def _corrected(self, score: float, p: float, scores: F64) -> float:
        """Return the p-value of a score among a group's, corrected if there are real scores."""
        return self.real.correct(_place(scores, score)[0], p, len(scores)) if len(self.real) else p

    def limit(self, group: Group) -> float:
        """Return the score above which a sweep of a group alarms. Raises as :meth:`p_value` does."""
        return max(self._limits[each][0] for each in self.alike(group))

    def promised(self, group: Group) -> Promised:
        """Return what is promised for a calibrated group; corrected by real scenes, see :class:`RealScores` instead."""
        return Promised(len(self.scores[group]), self._limits[group][1])

    def promise_of(self, group: Group) -> str:
        """Return what is promised for a calibrated group in a line."""
        if not len(self.real):
            return str(self.promised(group))
        steps = len(self.real) + 1
        return (
            f"corrected by {len(self.real)} real scenes: expected rate at most"
            f" {math.ceil(self.rate * steps - 1e-9) / steps:.3%} however wrong the simulation is, {self.rate:.3%} if it"
            " has the right shape between them"
        )

    def corrected(self, real: Iterable[tuple[Group, float]]) -> Self:
        """Return the calibration corrected by the scores of real benign scenes, one each, see :class:`RealScores`.

        Raises:
            ValueError: there are none, one is NaN or of no calibrated group, or they leave no limit for the rate.
        """
        return replace(self, real=self.real_scores(real))

    def real_scores(self, real: Iterable[tuple[Group, float]]) -> RealScores:
        """Return the p-values of real scenes among these scores. Raises as :meth:`corrected` does, but for the rate."""
        found = []
        for group, score in real:
            _checked("real scores", np.array([score]))
            # A sensor that was not simulated takes its largest p-value, as it will when it is checked.
            found.append(np.max([_place(self.scores[each], score) for each in self.alike(group)], axis=0))
        if not found:
            raise ValueError("real benign scenes must be one at least, got none")
        return RealScores(*np.array(found).T.copy())


def betting_martingale(p: ArrayLike) -> F64:
    """Return the e-value (N,) after each of N p-values, by bets that these are not independent and uniform.

    The Simple Jumper (Vovk et al., 2021, arXiv 2102.10439): it puts its money on small or on large p-values, and moves
    1 % of it after each. If they are, the e-value ever reaches c with probability 1 / c at most.
    """
    slopes = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    jump, accounts = 0.01, np.full(5, 0.2)
    values = np.asarray(p, np.float64)
    e_values = np.empty(len(values))
    for number, value in enumerate(values):
        accounts *= 1.0 + slopes * (value - 0.5)
        e_values[number] = accounts.sum()
        accounts = (1.0 - jump) * accounts + jump * e_values[number] / 5
    return e_values


def online_p_values(scores: ArrayLike, rng: np.random.Generator) -> F64:
    """Return the smoothed p-value (N,) of each score among those before it; uniform if they are exchangeable."""
    values = np.asarray(scores, np.float64)
    draws, found = rng.random(len(values)), np.empty(len(values))
    for number, value in enumerate(values):
        before = values[:number]
        found[number] = ((before > value).sum() + draws[number] * ((before == value).sum() + 1)) / (number + 1)
    return found


WORRYING = 100.0
"""E-value of the betting martingale from which a set is warned of: at most one exchangeable set in a hundred."""


def drift_warning(scores: Mapping[Group, ArrayLike], rng: np.random.Generator) -> str | None:
    """Return a line if the scores of calibration scenes drift or jump in the order in which they are given, else None.

    Promises rest on scenes that are exchangeable. A part of them that was attacked, or another place, sensor or weather
    shows as a run of high or low scores. What is attacked at random throughout the set does not show.
    """
    p = [online_p_values(each, rng) for each in scores.values()]
    e_values = betting_martingale(np.concatenate([*p, np.zeros(0)]))
    if not e_values.size or e_values.max() < WORRYING:
        return None
    return (
        f"benign scenes must be exchangeable, but their scores drift (betting martingale {e_values.max():.3g} at scene"
        f" {int(e_values.argmax()) + 1} of {len(e_values)}; exchangeable ones reach {WORRYING:g} in 1 of {WORRYING:g}"
        " sets); look for attacked or foreign scenes, no rate is promised"
    )


def _binomial_cdf(trials: int, rate: float) -> F64:
    """Return P(Binomial(trials, rate) ≤ j) for j of 0 to ``trials``."""
    j = np.arange(1, trials + 1)
    steps = np.log((trials - j + 1) / j) + math.log(rate) - math.log1p(-rate)
    logs = np.concatenate([[0.0], np.cumsum(steps)]) + trials * math.log1p(-rate)
    cdf: F64 = np.minimum(np.cumsum(np.exp(logs)), 1.0)
    return cdf


def _checked(name: str, values: ArrayLike) -> F64:
    scores = np.asarray(values, np.float64)
    if scores.ndim != 1 or not scores.size or np.isnan(scores).any():
        raise ValueError(f"{name} must be one or more scores, none of them NaN, got shape {scores.shape}")
    return scores
