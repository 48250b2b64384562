"""Find out which agents lie: likelihood of all reports and views under each small set of liars.

Trust cannot be decided agent by agent, because a contradiction speaks against both agents alike. So the hypotheses are
sets of liars (none, each agent, each pair), and each hypothesis explains all reports and views. If three agents report
an object and a fourth denies it, the fourth alone is the best explanation. If two contradict each other and no third
could see, both explanations are about as likely, and nobody is accused: they are *disputed*.

**Objects.** Reports of honest agents follow :mod:`viewshed.agents.honest`: the probability to report what other honest
agents report or deny, how well the box fits the surfaces of its own view (*displaced*), and how well its position
agrees with the others'. Each agent is judged given the other honest ones: a pseudo-likelihood (Besag, 1975). Whether
honest reports of an object are *made up* is judged once, by the views of agents that could report it and are silent:
where three claim free ground, the one that reports a car lies; where three report a car, the one that claims free
ground does. A liar may forge its own view to agree with its lies, so this agreement is bounded. About an object, a liar
first reports or is silent with equal probability, and then mostly repeats itself (:attr:`TrustRules.keeps`). The share
of objects that it lies about is unknown: all of :attr:`TrustRules.lies` are equally likely.

**Views.** If two views fail a comparison (:mod:`viewshed.agents.view_evidence`) that honest views hardly ever fail,
this supports all hypotheses in which one of the two lies. If a view fails a comparison with its own past or with all
others, it supports those in which its agent lies.

**Dependence.** Successive frames are not independent. The probability of a report is conditional on the agent's own
last ones, and counts once per :attr:`TrustRules.look_s`. Evidence of one object is bounded by
:attr:`TrustRules.most_of_object`, and only the few objects with the most evidence (:attr:`TrustRules.objects`) count
against a hypothesis: an honest agent with a poor detector errs mildly about many, a liar grossly about some.
Comparisons count by their mean over a second; what opened or closed at once is held longer. Evidence fades with age.

**Probabilities.** Summed log-likelihoods are overconfident, so they are divided by :attr:`TrustRules.temper` before
they become probabilities (a tempered posterior; Grünwald 2012).

**Evidence.** For each agent: mean likelihood of the hypotheses in which it lies, over the maximum of those in which it
does not (Wasserman, Ramdas, Balakrishnan 2020). An accusation ranks three kinds of evidence (reports, the view by
itself, and withheld objects) among benign scenes of all terrain (:class:`TrustLimits`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.view_evidence import OWN, PAIR
from viewshed.arrays import F64, Mask

MAX_LIARS = 2
"""Maximum number of agents that lie together; never more than half of them."""

QUESTIONS = ("reports", "opened", "misplaced", "through", "withheld")
"""Kinds of evidence against an agent, each on its own scale because their noise differs: its reports; by how much more
its view opened at once than it closed; how its surfaces are displaced from those of others; what it sees through;
objects that it withholds after it had reported them."""

TOGETHER = 1.5
"""Exponent of the norm that combines the answers of an agent."""

SCENE_S = 6.0
"""Length of the benign scenes in seconds, and of the window over which an agent's largest answers are kept."""

USUAL, MIN_SPREAD = 0.9, 0.1
"""Quantile of honest answers that is taken as usual, and minimum of the mean excess of the others in nats."""


@dataclass(frozen=True, slots=True)
class TrustRules:
    """Parameters of the models of honest agents and of liars.

    Raises:
        ValueError: a number is out of range.
    """

    false_report: float = 0.2  # probability that an honest agent alone reports an object where others see none
    lies: tuple[float, ...] = (0.05, 0.2, 0.5)  # shares of the objects that a liar may lie about
    prior: float = 0.1  # probability that an agent lies, before its first report
    least: float = 0.005  # minimum probability of an honest report or silence; smaller ones are not known well enough
    most_ratio: float = 6.0  # bound in nats on what views say about a made-up or displaced box
    agreeing: float = 0.5  # share of liars' boxes that agree with the liars' own, possibly forged, views
    disc_m: float = 4.0  # radius of the disc in which a lie places an object
    # share of outliers among honest positions, distributed as those of lies (boxes of partly visible objects)
    astray: float = 0.4
    lied_and_there: float = 0.1  # probability that an object exists where only liars report one
    keeps: float = 0.9  # probability that a liar repeats what it said of an object at its last look
    begins: float = 0.3  # probability that a lie about an object begins at a look; earlier reports of it were honest
    objects: int = 4  # maximum number of objects, those with the most evidence, that count against a hypothesis
    most_of_object: float = 20.0  # bound in nats on the evidence of one object against a hypothesis
    look_s: float = 0.5  # reports of one object count once in this interval, for which the honest model is fitted
    half_life_s: float = 4.0  # half-life of the evidence
    mean_s: float = 1.0  # time constant of the mean of view comparisons
    temper: float = 5.0  # divisor of log-likelihoods before they become probabilities

    def __post_init__(self) -> None:
        chances = ("false_report", "lies", "prior", "least", "agreeing", "astray", "lied_and_there", "keeps", "begins")
        for name in chances:
            values = np.atleast_1d(getattr(self, name))
            if not (len(values) and ((values > 0.0) & (values < 1.0)).all()):
                raise ValueError(f"{name} must be a probability above 0 and below 1, got {getattr(self, name)}")
        for name in ("most_ratio", "disc_m", "objects", "most_of_object", "look_s", "half_life_s", "mean_s", "temper"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name):g}")


@dataclass(frozen=True, slots=True, eq=False)
class Reports:
    """Reports of A agents about J objects at one time; at least one agent reports each object.

    Raises:
        ValueError: the shapes do not fit, or a number is missing.
    """

    ids: NDArray[np.int64]  # (J,) int64, constant over time for one object
    seen: Mask  # (J, A) bool, agents that report it
    able: Mask  # (J, A) bool, agents that could report it
    sees: Mask  # (J, A) bool, agents that could and claim to see it, so that their silence denies it
    reported: F64  # (J, A) log-odds that an honest agent reports what others report, without ``of_others``
    of_others: F64  # (others, deniers) log-odds added for the numbers of other agents that report and that deny it
    invented: F64  # (J, A) log-ratio, by the reporter's own view, of a made-up place over an honest report
    # (2, J, A) term of each silent but able agent's view in the log-ratio of a made-up place over a report by one
    # honest agent, and over a report by several
    silent_views: F64
    silent_bias: F64  # (2,) biases of these two log-ratios
    displaced: F64  # (J, A) log-ratio of a moved box over an honest one
    there: F64  # (J, A) log-odds that each agent's report or silence adds for the existence of the object
    there_bias: float  # log-odds of existence without any
    xy_m: F64  # (J, A, 2) reported positions in the world; NaN where there is none
    std_m: F64  # (J, A) standard deviation of an honest position along each axis
    # (J, A) 1 where the agent repeats its last look (report or silence), -1 where it does not, 0 at the first
    repeats: NDArray[np.int8]

    def __post_init__(self) -> None:
        shape = self.seen.shape
        if self.ids.shape != shape[:1] or self.xy_m.shape != (*shape, 2):
            raise ValueError(
                f"reports of {len(self.ids)} objects must have seen (J, A) and xy_m (J, A, 2), got {shape}"
            )
        for name in ("able", "sees", "reported", "invented", "silent_views", "displaced", "there", "std_m", "repeats"):
            values = getattr(self, name)
            if values.shape != ((2, *shape) if name == "silent_views" else shape) or not np.isfinite(values).all():
                raise ValueError(f"{name} must be {shape} finite numbers, got {values.shape}")
        if not (self.std_m > 0).all():
            raise ValueError("std_m must be positive, got others")
        if not np.isfinite(self.xy_m[self.seen]).all():
            raise ValueError("xy_m must be finite wherever an object is reported")


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """Trust in each of A agents, and existence of each of J objects."""

    evidence: F64  # (A,) natural logarithm of the likelihood ratio against "this agent is honest"
    doubt: float  # log-likelihood in nats of the best hypothesis over that of "all are honest"
    trust: F64  # (A,) probability that the agent is honest
    ids: NDArray[np.int64]  # (J,) of the objects of the last reports
    existence: F64  # (J,) probability that each exists, averaged over the hypotheses
    suspects: Mask  # (A,) bool, liars of the best hypotheses (within one nat) with the fewest liars
    against: F64  # (A, A) nats against both of two agents by comparing their views; on the diagonal, against one view
    answers: F64  # (A, 5) maximum in nats over the last ``SCENE_S`` of each kind of evidence, by ``QUESTIONS``


_AT_ONCE = np.array([name in ("opened", "closed") for name in OWN])
"""Comparisons of single events, which a mean over a second would lose."""


@dataclass(slots=True)
class _Means:
    """Running means of comparisons of views: new values weigh by the time since the last ones, at any rate."""

    values: F64
    since_s: F64  # since the last comparison

    def add(self, new: F64, seconds: float, rules: TrustRules) -> None:
        """Add new values, NaN where nothing was compared; what nothing renews for a scene's time fades."""
        since_s, is_new = self.since_s + seconds, np.isfinite(new)
        weight = -np.expm1(-np.minimum(since_s, max(seconds, rules.look_s)) / rules.mean_s)
        kept = np.where(since_s > SCENE_S, 0.5 ** (seconds / rules.half_life_s), 1.0) * self.values
        self.values = np.where(is_new, self.values + weight * (np.where(is_new, new, 0.0) - self.values), kept)
        self.since_s = np.where(is_new, 0.0, since_s)

    def regroup(self, kept: Sequence[int]) -> None:
        """Keep the agents with these numbers, -1 for a new one, along all axes but the last."""
        axes = self.values.ndim - 1
        for name in ("values", "since_s"):
            padded = np.pad(getattr(self, name), [(0, 1)] * axes + [(0, 0)])
            setattr(self, name, padded[np.ix_(*[kept] * axes)])


@dataclass(slots=True)
class Trust:
    """Tracks the evidence against a group of agents; the module documents the model.

    Args:
        agents: number of agents.
        rules: parameters of the model.
    """

    agents: int
    rules: TrustRules = field(default_factory=TrustRules)
    _lies: Mask = field(init=False, repr=False)
    _share_of_lies: F64 = field(init=False, repr=False)
    _of_objects: dict[int, F64] = field(default_factory=dict, repr=False)
    _pairs: _Means = field(init=False, repr=False)
    _own: _Means = field(init=False, repr=False)
    _answers: list[tuple[float, F64]] = field(default_factory=list, repr=False)  # (age in seconds, answers)

    def __post_init__(self) -> None:
        if self.agents < 1:
            raise ValueError(f"agents must be at least one, got {self.agents}")
        self._follow(self.agents)
        pairs, own = (self.agents, self.agents, len(PAIR)), (self.agents, len(OWN))
        self._pairs, self._own = (_Means(np.zeros(shape), np.zeros(shape)) for shape in (pairs, own))

    def _follow(self, agents: int) -> None:
        self.agents, self._lies = agents, hypotheses(agents)
        # (L, H, H) probability, under a hypothesis, that exactly the liars of another one lie about an object.
        liars, among = self._lies.sum(axis=1), ~(self._lies[None] & ~self._lies[:, None]).any(axis=2)
        lie = np.array(self.rules.lies)[:, None, None]
        self._share_of_lies = np.where(among, lie ** liars[None] * (1 - lie) ** (liars[:, None] - liars[None]), 0.0)

    def regroup(self, kept: Sequence[int]) -> None:
        """Change the group of agents: those that stay keep their record, new ones begin at the prior.

        Args:
            kept: previous number of each agent, -1 for a new one.
        """
        evidence = np.array(list(self._of_objects.values())).reshape(-1, len(self._lies))
        # Evidence by the set of liars among those that stay; maximize over whether those that leave lied.
        staying, numbers = frozenset(kept), dict[frozenset[int], list[int]]()
        for number, line in enumerate(self._lies):
            numbers.setdefault(staying.intersection(np.flatnonzero(line).tolist()), []).append(number)
        logs = {liars: evidence[:, columns].max(axis=1) for liars, columns in numbers.items()}
        nobody = logs[frozenset()]
        self._follow(len(kept))
        columns = []
        for line in self._lies:
            # A new agent has no evidence yet: ignore it in the set of liars.
            liars = frozenset(kept[agent] for agent in np.flatnonzero(line).tolist()) - {-1}
            if liars in logs:
                columns.append(logs[liars])
                continue
            # A pair that was no hypothesis before gains the sum of both, but at most the better single gain.
            gains = np.array([logs.get(frozenset({liar}), nobody) - nobody for liar in liars])
            columns.append(nobody + np.minimum(gains.sum(axis=0), gains.max(axis=0)))
        carried = np.stack(columns, axis=1)
        carried -= carried[:, :1]
        self._of_objects = dict(zip(self._of_objects, carried, strict=True))
        self._pairs.regroup(kept)
        self._own.regroup(kept)
        no_answers = np.full((1, len(QUESTIONS)), -np.inf)
        self._answers = [(age_s, np.vstack([answers, no_answers])[list(kept)]) for age_s, answers in self._answers]

    def add(
        self,
        reports: Reports,
        seconds: float,
        views: tuple[F64, F64] | None = None,
        withheld: F64 | None = None,
        present: Mask | None = None,
    ) -> Verdicts:
        """Update with the next reports and return the verdicts.

        Args:
            reports: of all agents.
            seconds: since the last reports.
            views: surprises of view comparisons (A, A, 2) and (A, 3), NaN where nothing was compared.
            withheld: evidence (A,) in nats that each agent withholds objects; None is 0.
            present: (A,) bool, agents that reported lately: at most half of these lie. None is all.

        Raises:
            ValueError: the number of agents differs, or ``seconds`` is not positive.
        """
        if reports.seen.shape[1] != self.agents or not seconds > 0:
            raise ValueError(
                f"reports must be of {self.agents} agents, some time after the last ones, got {reports.seen.shape[1]}"
                f" agents after {seconds:g} s"
            )
        # Let evidence fade, and drop objects without any left.
        fade = 0.5 ** (seconds / self.rules.half_life_s)
        weight = min(seconds / self.rules.look_s, 1.0)
        faded = {number: fade * evidence for number, evidence in self._of_objects.items()}
        self._of_objects = {number: evidence for number, evidence in faded.items() if np.ptp(evidence) > 1e-3}
        begins, nothing = weight * self.rules.begins, np.zeros(len(self._lies))
        new, kept = weight * self._likelihoods(reports), weight * self._kept(reports)
        for number, logs, keep in zip(reports.ids.tolist(), new, kept, strict=True):
            # Relative to "nobody lies". A lie goes on or begins now (Shiryaev, 1963): earlier honesty is no excuse.
            evidence = np.logaddexp(self._of_objects.get(number, nothing) + np.log1p(-begins) + keep, np.log(begins))
            evidence[0] = 0.0
            self._of_objects[number] = evidence + logs - logs[0]
        if views is not None:
            at_once = np.maximum(fade * self._own.values, np.where(np.isfinite(views[1]), views[1], 0.0))
            self._pairs.add(views[0], seconds, self.rules)
            self._own.add(views[1], seconds, self.rules)
            self._own.values = np.where(_AT_ONCE, at_once, self._own.values)
        self._answers = [(age_s + seconds, answers) for age_s, answers in self._answers if age_s + seconds < SCENE_S]
        withheld = np.zeros(self.agents) if withheld is None else withheld
        return self._verdicts(reports, withheld, np.ones(self.agents, np.bool_) if present is None else present)

    def _likelihoods(self, reports: Reports) -> F64:
        """Return log-likelihoods (J, H) of the reports of each object under each set of agents that lie about it."""
        rules, honest, seen = self.rules, ~self._lies[None], reports.seen[:, None]
        # (J, H, A) number of other honest agents that report the object, and that deny it.
        reporters, deniers = seen & honest, (reports.sees & ~reports.seen)[:, None] & honest
        others = reporters.sum(axis=2, keepdims=True) - reporters
        denied = deniers.sum(axis=2, keepdims=True) - deniers
        max_counts = np.array(reports.of_others.shape) - 1
        odds = (
            reports.reported[:, None]
            + reports.of_others[np.minimum(others, max_counts[0]), np.minimum(denied, max_counts[1])]
        )
        prob = np.clip(1.0 / (1.0 + np.exp(-odds)), rules.least, 1.0 - rules.least)
        # A liar may forge its view to agree with its box.
        displaced = self._unless_forged(reports.displaced)[:, None]
        with_others = np.where(seen, np.log(prob) - displaced + self._agreement(reports, reporters), np.log1p(-prob))
        # A report by one agent alone is rarely false where others deny it; elsewhere it counts like silence.
        silence = np.log1p(-rules.false_report)
        alone = np.where(seen & (denied > 0), np.log(rules.false_report), silence)
        # Liars may agree on a position, too.
        lying = np.log(0.5) + np.where(seen & ~honest, self._agreement(reports, seen & ~honest), 0.0)
        logs = np.where(honest, np.where(others > 0, with_others, alone), lying)
        summed: F64 = np.where((reports.able | reports.seen)[:, None], logs, 0.0).sum(axis=2)
        return summed - self._made_up(reports, reporters)

    def _kept(self, reports: Reports) -> F64:
        """Return the log-ratio (J, H) of the liars' reports if their lie goes on over if it begins now."""
        # Indexed by ``repeats``: 0 first look, 1 repeated, -1 changed.
        logs = np.array([0.0, np.log(2.0 * self.rules.keeps), np.log(2.0 - 2.0 * self.rules.keeps)])[reports.repeats]
        kept: F64 = np.where(reports.able | reports.seen, logs, 0.0) @ self._lies.T.astype(np.float64)
        return kept

    def _made_up(self, reports: Reports, reporters: Mask) -> F64:
        """Return the log-ratio (J, H) that the place of honest reports is made up; 0 where no honest agent reports."""
        count, own = reporters.sum(axis=2), np.where(reports.seen, self._unless_forged(reports.invented), 0.0)
        own_mean = (own[:, None] * reporters).sum(axis=2) / np.maximum(count, 1)
        alone, shared = reports.silent_views @ (~self._lies).T.astype(np.float64) + reports.silent_bias[:, None, None]
        ratio = self._unless_forged(own_mean + np.where(count > 1, shared, alone))
        return np.where(count > 0, ratio, 0.0)

    def _unless_forged(self, ratios: F64) -> F64:
        """Return log-ratios (…,) by views, bounded because some liars' views agree with their lies."""
        bounded = np.exp(np.clip(ratios, -self.rules.most_ratio, self.rules.most_ratio))
        return np.log(self.rules.agreeing + (1.0 - self.rules.agreeing) * bounded)

    def _agreement(self, reports: Reports, reporters: Mask) -> F64:
        """Return the log-ratio (J, H, A) of each position given the mean of the other reporters' over a uniform one.

        Positions are normal about that mean, with a share of outliers.
        """
        of_agents = reports.std_m**-2.0
        # Sums over all other reporters.
        weight = np.where(reporters, of_agents[:, None], 0.0)
        other_weight = weight.sum(axis=2, keepdims=True) - weight
        has_others = other_weight > 1e-9
        other_weight = np.where(has_others, other_weight, 1.0)
        squared_m2 = np.zeros_like(other_weight)
        for coordinate in np.moveaxis(np.where(reports.seen[..., None], reports.xy_m, 0.0), 2, 0):
            moment = weight * coordinate[:, None]
            squared_m2 += (coordinate[:, None] - (moment.sum(axis=2, keepdims=True) - moment) / other_weight) ** 2
        variance = (1.0 / of_agents)[:, None] + 1.0 / other_weight
        ratio = self.rules.disc_m**2 / (2.0 * variance) * np.exp(-squared_m2 / (2.0 * variance))
        return np.where(has_others, np.log((1.0 - self.rules.astray) * ratio + self.rules.astray), 0.0)

    def _of_views(self) -> tuple[F64, F64]:
        """Return evidence of views against both of two agents (A, A), one agent (diagonal), and per hypothesis (H,)."""
        # A view that opens and closes flickers, as honest ones do: only the difference counts.
        opened, closed = self._own.values[:, _AT_ONCE].T
        own = np.abs(opened - closed) + self._own.values[:, ~_AT_ONCE].sum(axis=1)
        against = self._pairs.values.sum(axis=2)
        against = np.triu(against + against.T, 1)
        touched = self._lies[:, :, None] | self._lies[:, None]
        gain = np.where(touched, against, 0.0).sum(axis=(1, 2)) + self._lies @ own
        return against + against.T + np.diag(own), gain

    def _verdicts(self, reports: Reports, withheld: F64, present: Mask) -> Verdicts:
        """Return the verdicts on the agents and on the objects of the last reports."""
        object_evidence = np.array(list(self._of_objects.values())).reshape(-1, len(self._lies))
        # Average each hypothesis over the subset of its liars that lies about an object, ...
        of_objects = _mixed(object_evidence, self._share_of_lies)
        # Scale the evidence of an object relative to "nobody lies" down to the bound, and sum only the top objects.
        # One factor scales all hypotheses: bounded one by one, the worse ones would catch up over time.
        gain, bound = of_objects - of_objects[..., :1], self.rules.most_of_object
        largest = np.maximum(np.abs(gain).max(axis=2, initial=0.0, keepdims=True), 1e-9)
        gain *= bound * np.tanh(largest / bound) / largest
        top_gains = np.sort(np.maximum(gain, 0.0), axis=1)[:, ::-1][:, : self.rules.objects]
        against, of_views = self._of_views()
        of_shares = top_gains.sum(axis=1) + np.minimum(gain, 0.0).sum(axis=1)
        # Withholding objects lowers the trust in everything that an agent says.
        of_views = of_views + self._lies @ np.maximum(withheld, 0.0)
        # ... and over the share of objects that liars lie about.
        logs = np.logaddexp.reduce(of_shares, axis=0) - np.log(len(of_shares)) + of_views
        # Of those present at most half lie. Agents that left count neither there nor among those that are seen through.
        logs = np.where(2 * self._lies[:, present].sum(axis=1) <= present.sum(), logs, -np.inf)
        own, through = self._own.values, self._pairs.values[..., PAIR.index("through")]
        opened, closed = own[:, _AT_ONCE].T
        others = np.maximum(present.sum() - present, 1)
        answers = np.column_stack([
            self._evidence(logs - of_views), np.maximum(opened - closed, 0.0), own[:, OWN.index("misplaced")],
            np.where(present, through, 0.0).sum(axis=1) / others, withheld,
        ])  # fmt: skip
        self._answers.append((0.0, answers))
        liars = self._lies.sum(axis=1)
        prior = liars * np.log(self.rules.prior) + (self.agents - liars) * np.log1p(-self.rules.prior)
        posterior = prior + logs / self.rules.temper
        posterior = np.exp(posterior - posterior.max())
        posterior /= posterior.sum()
        best = logs >= logs.max() - 1.0
        best &= liars == liars[best].min()
        # Existence of an object by the honest agents of each hypothesis.
        honest = (~self._lies).T.astype(np.float64)
        alone = np.log(self.rules.lied_and_there / (1.0 - self.rules.lied_and_there))
        odds = np.where(reports.seen @ honest > 0, reports.there_bias, alone) + reports.there @ honest
        existence = 1.0 / (1.0 + np.exp(-odds)) @ posterior
        return Verdicts(
            self._evidence(logs), float(logs.max() - logs[0]), 1.0 - posterior @ self._lies, reports.ids, existence,
            self._lies[best].any(axis=0), against, np.max([recent for _, recent in self._answers], axis=0),
        )  # fmt: skip

    def _evidence(self, logs: F64) -> F64:
        """Return per agent the log mean of hypotheses (H,) in which it lies over the best in which it does not."""
        evidence = np.zeros(self.agents)
        for agent, lies in enumerate(self._lies.T):
            allowed = lies & np.isfinite(logs)
            if allowed.any():
                evidence[agent] = _log_mean_exp(logs[allowed]) - logs[~lies].max()
        return evidence


@dataclass(frozen=True, slots=True, eq=False)
class TrustLimits:
    """Thresholds of accusations with a stated false-alarm rate, calibrated on benign scenes.

    Answers to all ``QUESTIONS`` are normalized by those of honest agents with the same sensor height (low or elevated).
    The unit is the scene, for the shipped limits 6 s of five agents; a drive of ten minutes is about 100 scenes. An
    agent is accused if its score exceeds the maximum scores of nearly all benign scenes, each normalized by the other
    scenes (a jackknife: one scene hardly changes the scale). If a scene is exchangeable with the benign ones, the
    stated share bounds the probability of any accusation in it, however its agents depend on each other.
    """

    usual: F64  # (2, 5) ``USUAL`` quantile of the answers, by whether the sensor is elevated and by question
    spread: F64  # (2, 5) mean excess of the other answers
    score: F64  # (N,) highest score of any agent in each benign scene, ascending
    doubt: F64  # (N,) largest doubt of each benign scene, ascending

    @classmethod
    def of(cls, answers: F64, elevated: Mask, doubt: F64) -> TrustLimits:
        """Return the limits from benign scenes, each scored on the scale of all others, as a new scene is.

        Args:
            answers: (N, A, 5) largest answers of each agent of each scene.
            elevated: (A,) bool, agents whose sensors look over the traffic.
            doubt: (N,) largest doubt of each scene.

        Raises:
            ValueError: there are fewer than two scenes, or a number is not finite.
        """
        if not len(answers) == len(doubt) > 1:
            raise ValueError(f"limits must come from two benign scenes or more, got {len(answers)} and {len(doubt)}")
        if not (np.isfinite(answers).all() and np.isfinite(doubt).all()):
            raise ValueError("answers and doubt must be finite; leave out scenes without reports")
        score = np.zeros(len(answers))
        for scene, own in enumerate(answers):
            usual, spread = _scale_of(np.delete(answers, scene, axis=0), elevated)
            score[scene] = cls(usual, spread, doubt, doubt).scores(own, elevated).max()
        return cls(*_scale_of(answers, elevated), np.sort(score), np.sort(doubt))

    def to_json(self) -> str:
        """Return the limits as JSON text."""
        return json.dumps({name: getattr(self, name).round(4).tolist() for name in self.__slots__}) + "\n"

    @classmethod
    def from_json(cls, text: str) -> TrustLimits:
        """Return the limits from the text of :meth:`to_json`."""
        table = json.loads(text)
        return cls(*(np.array(table[name]) for name in cls.__slots__))

    @property
    def least_rate(self) -> float:
        """Smallest false-alarm rate that the number of scenes supports."""
        return 1.0 / (len(self.score) + 1.0)

    def beyond(self, answers: F64, elevated: Mask) -> F64:
        """Return the normalized excess (A, 5) of the answers of each agent over the usual ones of its sensor height."""
        kind = elevated.astype(np.intp)
        return np.asarray((answers - self.usual[kind]) / self.spread[kind])

    def scores(self, answers: F64, elevated: Mask) -> F64:
        """Return the norm (A,) of the excesses of the answers (A, 5) of each agent.

        With the exponent ``TOGETHER``, the norm lies between the maximum and the sum: liars often are unusual in
        several answers, honest agents at times. If no answer is in excess, it is the largest (negative) difference.
        """
        beyond = self.beyond(answers, elevated)
        norm = (np.maximum(beyond, 0.0) ** TOGETHER).sum(axis=1) ** (1.0 / TOGETHER)
        return np.asarray(norm + np.minimum(beyond.max(axis=1), 0.0))

    def accused(self, answers: F64, elevated: Mask, rate: float) -> Mask:
        """Return which agents are accused (A,) by their answers (A, 5), at a rate of benign scenes with an accusation.

        Raises:
            ValueError: there are too few scenes for this rate.
        """
        self._check(rate)
        return np.asarray(_p_values(self.score, self.scores(answers, elevated)) <= rate * (1.0 + 1e-9))

    def disputed(self, verdicts: Verdicts, accused: Mask, rate: float) -> Mask:
        """Return which agents are disputed (A,): one of these suspects lies, and it is unknown which.

        Raises:
            ValueError: there are too few scenes for this rate.
        """
        self._check(rate)
        has_liar = _p_values(self.doubt, np.array([verdicts.doubt]))[0] <= rate
        return verdicts.suspects & ~accused if has_liar else np.zeros_like(verdicts.suspects)

    def _check(self, rate: float) -> None:
        need = int(np.ceil(1.0 / rate - 1e-9)) - 1 if 0 < rate < 1 else -1
        if need < 0 or len(self.doubt) < need:
            raise ValueError(f"rate must be in (0, 1), and {rate:g} needs {need} benign scenes, got {len(self.doubt)}")


def _scale_of(answers: F64, elevated: Mask) -> tuple[F64, F64]:
    """Return quantile and mean excess (2, 5) of answers (N, A, 5), by whether the sensors are elevated."""
    usual, spread = np.zeros((2, len(QUESTIONS))), np.ones((2, len(QUESTIONS)))
    for kind in np.unique(elevated.astype(np.intp)):
        own = answers[:, elevated == kind].reshape(-1, len(QUESTIONS))
        usual[kind] = np.quantile(own, USUAL, axis=0)
        beyond = np.maximum(own - usual[kind], 0.0).mean(axis=0) / (1.0 - USUAL)
        spread[kind] = np.maximum(beyond, MIN_SPREAD)
    return usual, spread


@lru_cache(maxsize=1)
def trust_limits() -> TrustLimits:
    """Return the shipped limits, from the calibration scenes of docs/results/agents.md."""
    return TrustLimits.from_json(resources.files("viewshed.agents").joinpath("limits.json").read_text("utf-8"))


def hypotheses(agents: int) -> Mask:
    """Return the liars of each hypothesis (H, agents): first nobody, then each agent, then each pair.

    >>> hypotheses(3).astype(int).tolist()
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    """
    max_liars = min(MAX_LIARS, agents // 2)
    sets = [chosen for count in range(max_liars + 1) for chosen in combinations(range(agents), count)]
    lies = np.zeros((len(sets), agents), np.bool_)
    for line, chosen in zip(lies, sets, strict=True):
        line[list(chosen)] = True
    return lies


def _mixed(logs: F64, shares: F64) -> F64:
    """Return log means (L, J, H) of likelihoods given as logs (J, H), weighted by shares (L, H, H)."""
    highest = logs.max(axis=1, keepdims=True)
    mixed: F64 = np.log(np.maximum(np.exp(logs - highest) @ np.swapaxes(shares, 1, 2), 1e-300)) + highest
    return mixed


def _log_mean_exp(logs: F64) -> float:
    """Return the log of the mean of exponentials.

    >>> round(_log_mean_exp(np.log([2.0, 4.0])), 4)
    1.0986
    """
    highest = float(logs.max())
    return highest + float(np.log(np.exp(logs - highest).mean()))


def _p_values(benign: F64, values: F64) -> F64:
    """Return the conformal p-values (K,) of values (K,) against those of benign scenes (N,), ascending."""
    above = len(benign) - np.searchsorted(benign, values, "left")
    p_values: F64 = np.asarray((1.0 + above) / (1.0 + len(benign)), np.float64)
    return p_values
