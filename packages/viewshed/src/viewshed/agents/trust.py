"""Which agents lie: the likelihood of all that they report and claim, under each small set of agents that might.

Whom to believe cannot be decided agent by agent: that one contradicts another speaks against both alike. So the
hypotheses are sets of liars, none of them, each one, each pair, and each explains all reports and views at once. An
object that three agents report and a fourth denies is explained best by the fourth alone; where two contradict each
other and no third could see, "the one lies" and "the other lies" explain it about as well, and nobody is convicted: it
is *disputed*.

**Objects.** What an honest agent reports follows :mod:`viewshed.agents.honest`: whether it reports what other honest
agents report and deny, whether its box lies on the surfaces of its own view (*displaced*), and whether its position
agrees with theirs. Each agent is judged given the other honest ones: a pseudo-likelihood (Besag, 1975). What honest
agents report together is judged once by what the views of those show who are silent (*made up*): where three claim
free ground, the one that reports a car lies; where three report a car, the one that claims free ground does. A liar's
own view may be forged to agree with its lies, so it vouches for them within a bound only. About an object that it lies
about, a liar says first one thing as likely as the other, and then mostly the same again (:attr:`TrustRules.keeps`);
about how many it lies is unknown: all of :attr:`TrustRules.lies` are as likely.

**Views.** A comparison of two views (:mod:`viewshed.agents.view_evidence`) that honest views hardly ever fail speaks
for all hypotheses in which one of the two lies; one of a view with its past or with all others for those in which its
agent does.

**Dependence.** Frames are no independent witnesses. The chance of a report is given the agent's own last ones, and
counts once in :attr:`TrustRules.look_s`; what one object says is bounded by :attr:`TrustRules.most_of_object`, and
against a hypothesis only the few objects count that say most (:attr:`TrustRules.objects`): an honest agent whose
detector is poor errs mildly about many, a liar grossly about some. Comparisons count by their mean over a second, and
what opened or closed at once is remembered. What is older fades.

**Probabilities.** Log-likelihoods that add up make up their mind too soon, so they are divided by
:attr:`TrustRules.temper` before they become probabilities (a tempered posterior; Grünwald 2012).

**Evidence.** For each agent, the mean likelihood of the hypotheses in which it lies over the largest of those in which
it does not (Wasserman, Ramdas, Balakrishnan 2020). Accusations are one rank of that of the reports, of what
each view says by itself, and of what an agent withholds that it had reported, among benign scenes of all terrain
(:class:`TrustLimits`).
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

MOST_LIARS = 2
"""Agents that may lie together; never more than half of them."""

QUESTIONS = ("reports", "opened", "misplaced", "through", "withheld")
"""What may speak against an agent, each on a scale of its own, for the noise of one drowns another: evidence of its
reports; by how much more its view opened at once than it closed; how its surfaces lie beside those of others; what it
sees through; evidence that it withholds objects that it had reported."""

TOGETHER = 1.5
"""Exponent of the norm that puts answers together."""

SCENE_S = 6.0
"""Length of the benign scenes of the limits: an agent is judged by the most that speaks against it in such a time."""

USUAL, LEAST_SPREAD = 0.9, 0.1
"""Share of honest agents whose answers are usual, and nats by which the others go beyond on average at least."""


@dataclass(frozen=True, slots=True)
class TrustRules:
    """What honest agents and liars are taken to do.

    Raises:
        ValueError: a number is out of range.
    """

    false_report: float = 0.2  # chance that an honest agent reports an object that nobody else does where others see
    lies: tuple[float, ...] = (0.05, 0.2, 0.5)  # shares of the objects about which a liar may lie
    prior: float = 0.1  # chance that an agent is a liar, before it reports anything
    # no report, and no silence, of an honest agent is less likely: what is rare is known no better
    least: float = 0.005
    most_ratio: float = 6.0  # bound in nats of what views say about a made-up or a displaced box
    agreeing: float = 0.5  # share of the liars' boxes that agree with the liars' views, which may be forged as well
    disc_m: float = 4.0  # radius of the disc over which a lie puts an object
    # outlier share: of honest positions, those that are as in lies (boxes of objects that are seen in part)
    astray: float = 0.4
    lied_and_there: float = 0.1  # chance that there is an object where liars alone report one
    keeps: float = 0.9  # chance that who lies about an object says of it what it said at its last look
    begins: float = 0.3  # chance that a lie about an object begins with a look at it: it was reported as it is before
    objects: int = 4  # most objects that count against a hypothesis, those that say most
    most_of_object: float = 20.0  # bound in nats of what one object says against a hypothesis
    look_s: float = 0.5  # reports of one object count once in this time: honest chances are those of looks so far apart
    half_life_s: float = 4.0  # after this time a report counts half
    mean_s: float = 1.0  # time over which comparisons of views are averaged
    temper: float = 5.0  # log-likelihoods are divided by this before they become probabilities

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
    """What A agents say of J objects at one time; each of the objects is reported by somebody.

    Raises:
        ValueError: the shapes do not fit, or a number is missing.
    """

    ids: NDArray[np.int64]  # (J,) int64, the same for one object over time
    seen: Mask  # (J, A) bool, who reports it
    able: Mask  # (J, A) bool, who could
    sees: Mask  # (J, A) bool, who could and claims to see it, so that its silence denies the object
    reported: F64  # (J, A) log-odds that an honest agent reports what others report, but for how many they are
    of_others: F64  # (others, deniers) log-odds by the numbers of others that report an object and that deny it
    invented: F64  # (J, A) log-ratio of a place elsewhere over what honest agents report, in the reporter's own view
    # (2, J, A) what the view of each who could report an object and does not adds to the log-ratio of a place elsewhere
    # over what one honest agent reports alone, and over what several do, ...
    silent_views: F64
    silent_bias: F64  # (2,) ... and the ratios without any
    displaced: F64  # (J, A) log-ratio of a box that was moved over one of an honest agent
    there: F64  # (J, A) log-odds that each agent's report or silence adds to those that the object is one, ...
    there_bias: float  # ... and those without any
    xy_m: F64  # (J, A, 2) where it is reported, in the world; NaN where it is not
    std_m: F64  # (J, A) standard deviation of an honest report's position along each axis
    # (J, A) 1 where the agent says of the object what it said at its last look, -1 where it does not, 0 at the first
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
    """What is believed of each of A agents, and of each of J objects."""

    evidence: F64  # (A,) natural logarithm of the likelihood ratio against "this agent is honest"
    doubt: float  # how much better the best hypothesis with a liar explains all than "all are honest", in nats
    trust: F64  # (A,) probability that the agent is honest
    ids: NDArray[np.int64]  # (J,) of the objects of the last reports
    existence: F64  # (J,) probability that each exists, whoever lies
    suspects: Mask  # (A,) bool, those who lie under the best explanations (within one nat), the ones with fewest liars
    against: F64  # (A, A) nats that comparisons of two views speak against both, and on the diagonal that one's own do
    answers: F64  # (A, 5) most that spoke against each in the last ``SCENE_S``, by ``QUESTIONS``: nats


_AT_ONCE = np.array([name in ("opened", "closed") for name in OWN])
"""What a view does once, so that its mean over a second would lose it."""


@dataclass(slots=True)
class Trust:
    """Follows what a number of agents report and claim; see the module for the model.

    Args:
        agents: how many there are.
        rules: of the model.
    """

    agents: int
    rules: TrustRules = field(default_factory=TrustRules)
    _lies: Mask = field(init=False, repr=False)
    _share_of_lies: F64 = field(init=False, repr=False)
    _of_objects: dict[int, F64] = field(default_factory=dict, repr=False)
    _pairs: F64 = field(init=False, repr=False)
    _own: F64 = field(init=False, repr=False)
    _answers: list[tuple[float, F64]] = field(default_factory=list, repr=False)  # ages, and answers so old

    def __post_init__(self) -> None:
        if self.agents < 1:
            raise ValueError(f"agents must be at least one, got {self.agents}")
        self._follow(self.agents)
        self._pairs, self._own = np.zeros((self.agents, self.agents, len(PAIR))), np.zeros((self.agents, len(OWN)))

    def _follow(self, agents: int) -> None:
        self.agents, self._lies = agents, hypotheses(agents)
        # Chance (L, H, H) that the liars of a hypothesis lie about an object as a set of agents, and all others do not.
        liars, among = self._lies.sum(axis=1), ~(self._lies[None] & ~self._lies[:, None]).any(axis=2)
        lie = np.array(self.rules.lies)[:, None, None]
        self._share_of_lies = np.where(among, lie ** liars[None] * (1 - lie) ** (liars[:, None] - liars[None]), 0.0)

    def regroup(self, kept: Sequence[int]) -> None:
        """Follow other agents: who stays keeps its record, who comes begins at the prior.

        Args:
            kept: for each agent from now on, its number so far; -1 for one that comes.
        """
        known = np.array(list(self._of_objects.values())).reshape(-1, len(self._lies))
        # What is known of each set of liars among those who stay. Who goes may have lied or not, as explains most.
        stays, numbers = frozenset(kept), dict[frozenset[int], list[int]]()
        for number, line in enumerate(self._lies):
            numbers.setdefault(stays.intersection(np.flatnonzero(line).tolist()), []).append(number)
        logs = {liars: known[:, columns].max(axis=1) for liars, columns in numbers.items()}
        nobody = logs[frozenset()]
        self._follow(len(kept))
        columns = []
        for line in self._lies:
            # A new agent has reported nothing yet: it explains as much as if it were honest.
            liars = frozenset(kept[agent] for agent in np.flatnonzero(line).tolist()) - {-1}
            if liars in logs:
                columns.append(logs[liars])
                continue
            # A pair that was no hypothesis so far explains what both do, and no more than the better one alone.
            gains = np.array([logs.get(frozenset({liar}), nobody) - nobody for liar in liars])
            columns.append(nobody + np.minimum(gains.sum(axis=0), gains.max(axis=0)))
        carried = np.stack(columns, axis=1)
        carried -= carried[:, :1]
        self._of_objects = dict(zip(self._of_objects, carried, strict=True))
        # The last row and column are those of who comes.
        self._pairs = np.pad(self._pairs, ((0, 1), (0, 1), (0, 0)))[np.ix_(kept, kept)]
        self._own = np.pad(self._own, ((0, 1), (0, 0)))[list(kept)]
        unasked = np.full((1, len(QUESTIONS)), -np.inf)
        self._answers = [(age_s, np.vstack([answers, unasked])[list(kept)]) for age_s, answers in self._answers]

    def add(
        self, reports: Reports, seconds: float, views: tuple[F64, F64] | None = None, withheld: F64 | None = None
    ) -> Verdicts:
        """Return what is believed after the next reports.

        Args:
            reports: of all agents.
            seconds: since the reports before.
            views: surprises of comparisons of views (A, A, 2) and (A, 3), NaN where nothing was compared.
            withheld: evidence (A,) in nats that each agent withholds objects; None is 0.

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
        weight = min(seconds / self.rules.look_s, 1.0)
        faded = {number: fade * known for number, known in self._of_objects.items()}
        self._of_objects = {number: known for number, known in faded.items() if np.ptp(known) > 1e-3}
        begins, nothing = weight * self.rules.begins, np.zeros(len(self._lies))
        new, kept = weight * self._likelihoods(reports), weight * self._kept(reports)
        for number, logs, on in zip(reports.ids.tolist(), new, kept, strict=True):
            # Against that nobody lies. A lie goes on, or begins now (Shiryaev, 1963): honesty before excuses nothing.
            known = np.logaddexp(self._of_objects.get(number, nothing) + np.log1p(-begins) + on, np.log(begins))
            known[0] = 0.0
            self._of_objects[number] = known + logs - logs[0]
        if views is not None:
            part = -np.expm1(-seconds / self.rules.mean_s)
            pairs, own = (
                np.where(np.isfinite(new), new, old) for new, old in zip(views, (self._pairs, self._own), strict=True)
            )
            self._pairs = self._pairs + part * (pairs - self._pairs)
            steady = self._own + part * (own - self._own)
            at_once = np.maximum(fade * self._own, np.where(np.isfinite(views[1]), views[1], 0.0))
            self._own = np.where(_AT_ONCE, at_once, steady)
        self._answers = [(age_s + seconds, said) for age_s, said in self._answers if age_s + seconds < SCENE_S]
        return self._verdicts(reports, np.zeros(self.agents) if withheld is None else withheld)

    def _likelihoods(self, reports: Reports) -> F64:
        """Return the log-likelihoods (J, H) of the reports of each object, for each set of agents that lie about it."""
        rules, honest, seen = self.rules, ~self._lies[None], reports.seen[:, None]
        # How many other honest agents report the object, and how many deny it: (J, H, A).
        reporters, deniers = seen & honest, (reports.sees & ~reports.seen)[:, None] & honest
        others = reporters.sum(axis=2, keepdims=True) - reporters
        denied = deniers.sum(axis=2, keepdims=True) - deniers
        most = np.array(reports.of_others.shape) - 1
        odds = reports.reported[:, None] + reports.of_others[np.minimum(others, most[0]), np.minimum(denied, most[1])]
        chance = np.clip(1.0 / (1.0 + np.exp(-odds)), rules.least, 1.0 - rules.least)
        # A lie's box may agree with its own view as an honest one does, for the view may be forged.
        displaced = self._unless_forged(reports.displaced)[:, None]
        with_others = np.where(
            seen, np.log(chance) - displaced + self._agreement(reports, reporters), np.log1p(-chance)
        )
        # Who alone reports an object errs seldom where others see; where they do not, it is as good as silence.
        silence = np.log1p(-rules.false_report)
        alone = np.where(seen & (denied > 0), np.log(rules.false_report), silence)
        # Those who lie together agree on a place as well.
        lied = np.log(0.5) + np.where(seen & ~honest, self._agreement(reports, seen & ~honest), 0.0)
        logs = np.where(honest, np.where(others > 0, with_others, alone), lied)
        summed: F64 = np.where((reports.able | reports.seen)[:, None], logs, 0.0).sum(axis=2)
        return summed - self._made_up(reports, reporters)

    def _kept(self, reports: Reports) -> F64:
        """Return the log-ratio (J, H) of what liars say of each object if their lie goes on over if it begins."""
        # By ``repeats``: 0 at the first look, 1 for the same again, and -1, the last one, for the other.
        says = np.array([0.0, np.log(2.0 * self.rules.keeps), np.log(2.0 - 2.0 * self.rules.keeps)])[reports.repeats]
        kept: F64 = np.where(reports.able | reports.seen, says, 0.0) @ self._lies.T.astype(np.float64)
        return kept

    def _made_up(self, reports: Reports, reporters: Mask) -> F64:
        """Return the log-ratio (J, H) that what honest agents report is a place elsewhere, 0 where none reports it."""
        count, own = reporters.sum(axis=2), np.where(reports.seen, self._unless_forged(reports.invented), 0.0)
        own_mean = (own[:, None] * reporters).sum(axis=2) / np.maximum(count, 1)
        alone, shared = reports.silent_views @ (~self._lies).T.astype(np.float64) + reports.silent_bias[:, None, None]
        ratio = self._unless_forged(own_mean + np.where(count > 1, shared, alone))
        return np.where(count > 0, ratio, 0.0)

    def _unless_forged(self, ratios: F64) -> F64:
        """Return log-ratios (…,) of what views say, if those of liars agree with some lies."""
        bounded = np.exp(np.clip(ratios, -self.rules.most_ratio, self.rules.most_ratio))
        return np.log(self.rules.agreeing + (1.0 - self.rules.agreeing) * bounded)

    def _agreement(self, reports: Reports, reporters: Mask) -> F64:
        """Return the log-ratio (J, H, A) of each position about the mean of the other reporters' over one anywhere.

        Positions are normal about it, but for a share of outliers.
        """
        of_agents = reports.std_m**-2.0
        # Sums over all reporters but the agent itself.
        weight = np.where(reporters, of_agents[:, None], 0.0)
        rest = weight.sum(axis=2, keepdims=True) - weight
        some = rest > 1e-9
        rest = np.where(some, rest, 1.0)
        apart_m2 = np.zeros_like(rest)
        for along in np.moveaxis(np.where(reports.seen[..., None], reports.xy_m, 0.0), 2, 0):
            moment = weight * along[:, None]
            apart_m2 += (along[:, None] - (moment.sum(axis=2, keepdims=True) - moment) / rest) ** 2
        variance = (1.0 / of_agents)[:, None] + 1.0 / rest
        ratio = self.rules.disc_m**2 / (2.0 * variance) * np.exp(-apart_m2 / (2.0 * variance))
        return np.where(some, np.log((1.0 - self.rules.astray) * ratio + self.rules.astray), 0.0)

    def _of_views(self) -> tuple[F64, F64]:
        """Return what views say against both of two agents (A, A), against one on the diagonal, and for each set."""
        # A view that opens and closes flickers, as honest ones do: only by how much more of the one counts.
        opened, closed = self._own[:, _AT_ONCE].T
        own = np.abs(opened - closed) + self._own[:, ~_AT_ONCE].sum(axis=1)
        against = self._pairs.sum(axis=2)
        against = np.triu(against + against.T, 1)
        touched = self._lies[:, :, None] | self._lies[:, None]
        gain = np.where(touched, against, 0.0).sum(axis=(1, 2)) + self._lies @ own
        return against + against.T + np.diag(own), gain

    def _verdicts(self, reports: Reports, withheld: F64) -> Verdicts:
        """Return what is believed of the agents, and of the objects of the last reports."""
        known = np.array(list(self._of_objects.values())).reshape(-1, len(self._lies))
        # A hypothesis is the mean over the sets of its liars that may lie about an object, ...
        of_objects = _mixed(known, self._share_of_lies)
        # What an object says for hypotheses, against that nobody lies, is scaled down to the bound, and few objects
        # count. All hypotheses are scaled alike: the worse ones, bounded each by itself, would catch up over time.
        gain, bound = of_objects - of_objects[..., :1], self.rules.most_of_object
        largest = np.maximum(np.abs(gain).max(axis=2, initial=0.0, keepdims=True), 1e-9)
        gain *= bound * np.tanh(largest / bound) / largest
        most = np.sort(np.maximum(gain, 0.0), axis=1)[:, ::-1][:, : self.rules.objects]
        against, of_views = self._of_views()
        of_shares = most.sum(axis=1) + np.minimum(gain, 0.0).sum(axis=1)
        # Who withholds objects is trusted less in all that it says.
        of_views = of_views + self._lies @ np.maximum(withheld, 0.0)
        # ... and over the shares of the objects about which they may.
        logs = np.logaddexp.reduce(of_shares, axis=0) - np.log(len(of_shares)) + of_views
        opened, closed = self._own[:, _AT_ONCE].T
        others = max(self.agents - 1, 1)
        answers = np.column_stack([
            self._evidence(logs - of_views), np.maximum(opened - closed, 0.0), self._own[:, OWN.index("misplaced")],
            self._pairs[..., PAIR.index("through")].sum(axis=1) / others, withheld,
        ])  # fmt: skip
        self._answers.append((0.0, answers))
        liars = self._lies.sum(axis=1)
        prior = liars * np.log(self.rules.prior) + (self.agents - liars) * np.log1p(-self.rules.prior)
        posterior = prior + logs / self.rules.temper
        posterior = np.exp(posterior - posterior.max())
        posterior /= posterior.sum()
        best = logs >= logs.max() - 1.0
        best &= liars == liars[best].min()
        # An object is one by what those say who are honest.
        honest = (~self._lies).T.astype(np.float64)
        alone = np.log(self.rules.lied_and_there / (1.0 - self.rules.lied_and_there))
        odds = np.where(reports.seen @ honest > 0, reports.there_bias, alone) + reports.there @ honest
        existence = 1.0 / (1.0 + np.exp(-odds)) @ posterior
        return Verdicts(
            self._evidence(logs), float(logs.max() - logs[0]), 1.0 - posterior @ self._lies, reports.ids, existence,
            self._lies[best].any(axis=0), against, np.max([said for _, said in self._answers], axis=0),
        )  # fmt: skip

    def _evidence(self, logs: F64) -> F64:
        """Return the mean of hypotheses (H,) in which each agent lies over the best of those in which it does not."""
        evidence = np.zeros(self.agents)
        for agent, lies in enumerate(self._lies.T):
            if lies.any():
                evidence[agent] = _log_mean_exp(logs[lies]) - logs[~lies].max()
        return evidence


@dataclass(frozen=True, slots=True, eq=False)
class TrustLimits:
    """Accuses agents at a stated rate, calibrated on benign scenes.

    Answers to all ``QUESTIONS`` are put on one scale by those of honest agents, low or elevated, of benign scenes. The
    unit is the scene, for the shipped limits 6 s of five agents, so that a drive of ten minutes is about 100 of them:
    whoever is accused must stand higher on that scale than anybody of nearly all benign scenes does on the scale of
    the others (a jackknife: one scene moves the scale hardly). If the scene at hand is one like those (exchangeable),
    somebody is accused in at most the stated share of benign scenes, however the agents of one scene depend on each
    other.
    """

    usual: F64  # (2, 5) nine in ten answers are smaller, by whether the sensor is elevated and by question
    spread: F64  # (2, 5) mean of what the others are beyond
    score: F64  # (N,) highest score of any agent in each benign scene, over time, ascending
    doubt: F64  # (N,) largest doubt of each benign scene, ascending

    @classmethod
    def of(cls, answers: F64, elevated: Mask, doubt: F64) -> TrustLimits:
        """Return the limits of benign scenes; each is scored on the scale of all others, as a further scene is.

        Args:
            answers: (N, A, 5) largest answers of each agent of each scene.
            elevated: (A,) bool, whose sensors look over the traffic.
            doubt: (N,) largest doubt of each scene.

        Raises:
            ValueError: there are fewer than two, or a number is not finite.
        """
        if not len(answers) == len(doubt) > 1:
            raise ValueError(f"limits must be of two benign scenes or more, got {len(answers)} and {len(doubt)}")
        if not (np.isfinite(answers).all() and np.isfinite(doubt).all()):
            raise ValueError("answers and doubt must be finite; leave out scenes without reports")
        score = np.zeros(len(answers))
        for scene, own in enumerate(answers):
            usual, spread = _scale_of(np.delete(answers, scene, axis=0), elevated)
            score[scene] = cls(usual, spread, doubt, doubt).scores(own, elevated).max()
        return cls(*_scale_of(answers, elevated), np.sort(score), np.sort(doubt))

    def to_json(self) -> str:
        """Return the limits as text."""
        return json.dumps({name: getattr(self, name).round(4).tolist() for name in self.__slots__}) + "\n"

    @classmethod
    def from_json(cls, text: str) -> TrustLimits:
        """Return the limits in a text of :meth:`to_json`."""
        table = json.loads(text)
        return cls(*(np.array(table[name]) for name in cls.__slots__))

    @property
    def least_rate(self) -> float:
        """The smallest rate that the number of scenes supports."""
        return 1.0 / (len(self.score) + 1.0)

    def beyond(self, answers: F64, elevated: Mask) -> F64:
        """Return by how much the answers (A, 5) of each agent are beyond the usual ones of its kind, on one scale."""
        kind = elevated.astype(np.intp)
        return np.asarray((answers - self.usual[kind]) / self.spread[kind])

    def scores(self, answers: F64, elevated: Mask) -> F64:
        """Return the norm (A,) of what the answers (A, 5) of each agent are beyond the usual ones of its kind.

        The norm of the exponent ``TOGETHER`` is more than the largest and less than the sum: liars are often unusual in
        several answers, honest agents at times. Where all answers are usual it is the one nearest to that, below 0.
        """
        beyond = self.beyond(answers, elevated)
        norm = (np.maximum(beyond, 0.0) ** TOGETHER).sum(axis=1) ** (1.0 / TOGETHER)
        return np.asarray(norm + np.minimum(beyond.max(axis=1), 0.0))

    def accused(self, answers: F64, elevated: Mask, rate: float) -> Mask:
        """Return who is accused (A,) by the answers of each (A, 5): somebody in this share of benign scenes.

        Raises:
            ValueError: there are too few scenes for this rate.
        """
        self._check(rate)
        return np.asarray(_p_values(self.score, self.scores(answers, elevated)) <= rate * (1.0 + 1e-9))

    def disputed(self, verdicts: Verdicts, accused: Mask, rate: float) -> Mask:
        """Return who is disputed (A,): somebody lies, they are the ones it may be, and it is unknown which.

        Raises:
            ValueError: there are too few scenes for this rate.
        """
        self._check(rate)
        somebody = _p_values(self.doubt, np.array([verdicts.doubt]))[0] <= rate
        return verdicts.suspects & ~accused if somebody else np.zeros_like(verdicts.suspects)

    def _check(self, rate: float) -> None:
        need = int(np.ceil(1.0 / rate - 1e-9)) - 1 if 0 < rate < 1 else -1
        if need < 0 or len(self.doubt) < need:
            raise ValueError(f"rate must be in (0, 1), and {rate:g} needs {need} benign scenes, got {len(self.doubt)}")


def _scale_of(answers: F64, elevated: Mask) -> tuple[F64, F64]:
    """Return what is usual and what others are beyond (2, 5), by whether sensors are elevated, of answers (N, A, 5)."""
    usual, spread = np.zeros((2, len(QUESTIONS))), np.ones((2, len(QUESTIONS)))
    for kind in np.unique(elevated.astype(np.intp)):
        own = answers[:, elevated == kind].reshape(-1, len(QUESTIONS))
        usual[kind] = np.quantile(own, USUAL, axis=0)
        beyond = np.maximum(own - usual[kind], 0.0).mean(axis=0) / (1.0 - USUAL)
        spread[kind] = np.maximum(beyond, LEAST_SPREAD)
    return usual, spread


@lru_cache(maxsize=1)
def trust_limits() -> TrustLimits:
    """Return the shipped limits, of the calibration scenes of docs/results/agents.md."""
    return TrustLimits.from_json(resources.files("viewshed.agents").joinpath("limits.json").read_text("utf-8"))


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


def _mixed(logs: F64, shares: F64) -> F64:
    """Return the logarithms of the means (L, J, H) of likelihoods (J, H) given as logarithms, by shares (L, H, H)."""
    highest = logs.max(axis=1, keepdims=True)
    mixed: F64 = np.log(np.maximum(np.exp(logs - highest) @ np.swapaxes(shares, 1, 2), 1e-300)) + highest
    return mixed


def _log_mean_exp(logs: F64) -> float:
    highest = float(logs.max())
    return highest + float(np.log(np.exp(logs - highest).mean()))


def _p_values(benign: F64, values: F64) -> F64:
    """Return the conformal p-values (K,) of values (K,) against those of benign scenes (N,), ascending."""
    above = len(benign) - np.searchsorted(benign, values, "left")
    p_values: F64 = np.asarray((1.0 + above) / (1.0 + len(benign)), np.float64)
    return p_values
