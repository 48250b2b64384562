"""How rare a score is on benign streams, and the limit above which a chosen number of false alarms an hour lies.

What is counted are *alarms*, not sweeps: neighbors in a stream are nearly the same sweep, and a latched alarm is one.
Above a level that benign streams pass often, the heights of their peaks are those of a generalized Pareto distribution
(peaks over a threshold; Pickands, 1975). How many there are an hour, how high they are and how heavy their tail is are
known from few, so each has a spread: the rate of a limit is the mean over that, and the promise says its upper end.
So a limit for one alarm an hour can be given from less than an hour; it is an extrapolation, which the promise says.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed._files import DAMAGED, read_arrays, write_atomic
from viewshed.arrays import F32, F64, Mask
from viewshed.monitor.evidence import EARLIER_SWEEPS, EVIDENCE, SECTORS, Evidence
from viewshed.monitor.score import (
    BESIDE,
    MEMORY_SWEEPS,
    ONSET_SWEEPS,
    Past,
    SurpriseScale,
    numbers_of,
    of_place,
    sector_scores,
)
from viewshed.monitor.tails import chance_of_more, heights_of, peaks_of, shape_of
from viewshed.monitor.watch import Watch

CONFIDENCE = 0.9
"""Probability with which a promise says the upper end of a rate."""

LEAST_MINUTES = 1.0
"""Driving without which nothing is calibrated."""

ATTACKED_SHARE, ATTACKED_CHANCE = 0.1, 1e-3
"""Sweeps that the base calls are left out as attacked if they are no larger share, with those that an attack disturbs
after it, and if the tail of the others makes so many and so high alarms less probable than this."""

PARTS = 7
"""Parts of the benign streams, each of which is scored by the others."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What is usual in benign streams.

    Attributes:
        names: (E,) kinds of evidence, in their order.
        of_place: (E,) bool, which kinds change with the place and count as one.
        prior_scale: (E,) median over the streams of the scale of each kind, see ``score.Past``.
        changes: scale (E, K) of standardized changes of the strongest sector on benign sweeps.
        scores: scale (1, K) of scores on benign sweeps.
        peaks: (P,) heights of the peaks of the score, one for each alarm that a limit below it would have raised.
        shape: of the tail of the peaks, 0 of an exponential, less where it ends; a few minutes cannot say it.
        hours: of benign driving.
        facts: what else must be known, by name: where the streams are from.
        evidence: :data:`EVIDENCE_ID` of the evidence that it is calibrated on.

    Raises:
        ValueError: the parts do not fit, or there is too little driving.
    """

    names: tuple[str, ...]
    of_place: Mask
    prior_scale: F32
    changes: SurpriseScale
    scores: SurpriseScale
    peaks: F64
    shape: float
    hours: float
    facts: Mapping[str, str] = field(default_factory=dict)
    evidence: str = ""

    def __post_init__(self) -> None:
        kinds = len(self.names)
        shapes = self.prior_scale.shape, self.of_place.shape, (len(self.changes.values),)
        if set(shapes) != {(kinds,)} or len(self.scores.values) != 1:
            raise ValueError(f"a calibration must be of {kinds} kinds of evidence, got {shapes}; calibrate it again")
        if not self.hours * 60.0 >= LEAST_MINUTES - 1e-6:
            raise ValueError(
                f"benign drives must last {LEAST_MINUTES:g} minute at least, got {self.hours * 60.0:.2g}; give more"
            )

    @classmethod
    def fit(
        cls,
        streams: Sequence[F32],
        hz: float,
        kinds: Mapping[str, Evidence] = EVIDENCE,
        base: Calibration | None = None,
        facts: Mapping[str, str] | None = None,
    ) -> Self:
        """Return the calibration of benign streams.

        Args:
            streams: of each stream the evidence (T, E, SECTORS) of its sweeps.
            hz: sweeps a second.
            kinds: of the evidence.
            base: its scales are kept and only the rates are from these streams: a few minutes of an own vehicle cannot
                say how rare a change is. Sweeps that seem attacked are left out; ``facts`` then says how many. None
                fits all.
            facts: what else must be known.

        Raises:
            ValueError: there is too little driving.
        """
        pasts = [evidence.astype(np.float32) for evidence in streams if len(evidence) > EARLIER_SWEEPS]
        hours = sum(map(len, pasts)) / (3600.0 * hz)
        if hours * 60.0 < LEAST_MINUTES - 1e-6:
            short = sum(map(len, streams)) - sum(map(len, pasts))
            why = f" besides {short} sweeps in streams of {EARLIER_SWEEPS} or fewer, without a past" if short else ""
            raise ValueError(
                f"benign drives must last {LEAST_MINUTES:g} minute at least, got {hours * 60.0:.2g}{why}; give more"
            )
        # 1. The usual scale of each kind: what the first seconds of a stream are standardized by.
        prior = base.prior_scale if base is not None else _prior_scale(pasts, kinds)
        if base is not None:
            scale, (scores, left_out) = base.changes, _own_scores(pasts, base, kinds)
            facts = dict(facts or {}) | ({"left_out": str(left_out)} if left_out else {})
        else:
            # 2. Standardized changes of all streams, and how rare they are.
            changes = [changes_of(one, prior, kinds) for one in pasts]
            strongest = [np.fmax.reduce(one, axis=2) for one in changes]
            scale = SurpriseScale.fit(strongest)
            # 3. Scores, those of each part of the streams by how rare changes are in the other parts.
            scales = [scale] * len(changes)
            if len(changes) > 1:
                others = [
                    SurpriseScale.fit([one for number, one in enumerate(strongest) if number % PARTS != part])
                    for part in range(min(PARTS, len(changes)))
                ]
                scales = [others[number % PARTS] for number in range(len(changes))]
            once = of_place(kinds)
            scores = [sector_scores(by(one), once).max(axis=1) for by, one in zip(scales, changes, strict=True)]
        # 4. Their peaks.
        peaks = np.sort(np.concatenate([peaks_of(one) for one in scores]).astype(np.float64))
        shape = base.shape if base is not None else shape_of(heights_of(peaks)[1])
        return cls(
            tuple(kinds), of_place(kinds), prior, scale, SurpriseScale.fit([one[:, None] for one in scores]), peaks,
            shape, hours, dict(facts or {}), evidence_id(kinds),
        )  # fmt: skip

    def score(self, changes: F32) -> tuple[float, F32]:
        """Return the score of standardized changes (E, SECTORS), and the surprise (E, SECTORS) of each."""
        surprises = self.changes(changes[None])
        return float(sector_scores(surprises, self.of_place).max()), surprises[0]

    def p_value(self, score: float) -> float:
        """Return the share of benign sweeps that score as high at least, going on beyond the highest."""
        return float(np.clip(10.0 ** -self.scores(np.array([[score]], np.float32))[0, 0], 1e-12, 1.0))

    @property
    def least_per_hour(self) -> float:
        """The smallest number of false alarms an hour that the streams themselves support, without extrapolation."""
        return 1.0 / self.hours

    def limit(self, per_hour: float, *, extrapolate: bool = False) -> float:
        """Return the score above which the expected number of false alarms an hour is the chosen one.

        Args:
            per_hour: false alarms.
            extrapolate: whether fewer may be asked for than the streams are hours long, by their tail.

        Raises:
            ValueError: the number is not positive, or needs more driving.
        """
        if not per_hour > 0.0:
            raise ValueError(f"per_hour must be positive, got {per_hour:g}")
        if per_hour < self.least_per_hour * (1.0 - 1e-9) and not extrapolate:
            raise ValueError(
                f"{per_hour:g} false alarms an hour need {60.0 / per_hour:.0f} minutes of benign driving, got"
                f" {self.hours * 60.0:.1f}; give more drives, or ask for {math.ceil(self.least_per_hour * 10) / 10:g}"
            )
        # The rate falls as the limit rises: halve the interval in which it is the chosen one.
        low, high = self._tail()[0], 1e4
        for _ in range(60):
            middle = (low + high) / 2.0
            low, high = (middle, high) if self.per_hour(middle) > per_hour else (low, middle)
        return high

    def per_hour(self, limit: float, confidence: float | None = None) -> float:
        """Return the number of false alarms an hour above a limit: expected, or not exceeded with a confidence.

        Posterior draws of how many peaks an hour there are and of the scale of their heights, both gamma; the shape is
        the median of its own posterior.
        """
        begin, scale, count = self._tail()
        peaks_an_hour, per_scale = _draws_of(count)
        within = np.maximum(1.0 + self.shape * max(limit - begin, 0.0) / scale * per_scale, 0.0)
        rates = peaks_an_hour / self.hours * within ** (-1.0 / self.shape)
        return float(rates.mean() if confidence is None else np.quantile(rates, confidence))

    def promise(self, per_hour: float) -> str:
        """Return in a line what a limit for this many false alarms an hour rests on."""
        limit = self.limit(per_hour, extrapolate=True)
        how = "" if per_hour >= self.least_per_hour else ", an extrapolation of the tail of their scores"
        most = self.per_hour(limit, CONFIDENCE)
        return (
            f"score above {limit:.2f}: {per_hour:g} false alarms an hour, at most {most:.2g}"
            f" with probability {CONFIDENCE:g}, by {self.hours * 60.0:.0f} minutes of benign driving{how}"
        )

    def _tail(self) -> tuple[float, float, int]:
        """Return where the tail of the peaks begins, the scale of their heights above that, and how many there are."""
        begin, heights = heights_of(self.peaks)
        if not len(heights):
            return begin, 1.0, 0
        # The scale by the median, which a few odd peaks hardly move.
        scale = float(np.median(heights)) * self.shape / (2.0**self.shape - 1.0)
        return begin, max(scale, 0.1), len(heights)


@lru_cache(maxsize=8)
def _draws_of(count: int) -> tuple[F64, F64]:
    """Return draws of the number of peaks and of the inverse of their scale, of ``count`` peaks of scale 1."""
    rng = np.random.default_rng(34)
    return rng.gamma(count + 0.5, 1.0, 4000), rng.gamma(max(count, 1), 1.0 / max(count, 1), 4000)


def changes_of(stream: F32, prior_scale: F32, kinds: Mapping[str, Evidence] = EVIDENCE) -> F32:
    """Return the changes (T - EARLIER_SWEEPS, E, SECTORS) of a benign stream's evidence (T, E, SECTORS)."""
    past, changes = Past(prior_scale, kinds), []
    for evidence in stream:
        if past.sweeps >= EARLIER_SWEEPS:
            changes.append(past.reference().changes(numbers_of(past.onset(evidence), kinds)))
        past.add(evidence)
    return np.array(changes, np.float32).reshape(-1, len(prior_scale), SECTORS)


def scores_of(stream: F32, base: Calibration, limit: float, kinds: Mapping[str, Evidence] = EVIDENCE) -> F32:
    """Return the scores (T,) of a stream's evidence (T, E, SECTORS) by a calibration; NaN where it has no past.

    Sweeps above the limit do not become part of the past, as those of an alarm.
    """
    watch = Watch(base, limit, kinds)
    return np.array([watch.check(evidence).score for evidence in stream], np.float32)


def _own_scores(streams: Sequence[F32], base: Calibration, kinds: Mapping[str, Evidence]) -> tuple[list[F32], int]:
    """Return the scores (T,) of each stream by a base, NaN in sweeps that seem attacked, and how many those are.

    Alarms at the base's limit of one an hour are an attack's if the tail of the other peaks does not go on to them.
    Where it does, the streams are rougher than the base's, and where the base calls many sweeps it is another sensor:
    then all sweeps count.
    """
    limit = base.limit(1.0, extrapolate=True)
    scores = [scores_of(one, base, limit, kinds) for one in streams]
    calm = [np.where(one > limit, np.float32(np.nan), one) for one in scores]
    peaks = np.concatenate([peaks_of(one) for one in scores])
    called, count = peaks[peaks > limit], sum(int((one > limit).sum()) for one in scores)
    if not count:
        return scores, 0
    if count <= ATTACKED_SHARE * sum(map(len, scores)):
        begin, heights = heights_of(np.sort(np.concatenate([peaks_of(one) for one in calm])).astype(np.float64))
        # The higher half of the alarms: how high they are says as much as how many.
        middle = float(np.median(called))
        many = int((called >= middle).sum())
        usual = base._tail()[1]
        if chance_of_more(heights, base.shape, usual, limit - begin, middle - begin, many) < ATTACKED_CHANCE:
            return calm, count
    return [scores_of(one, base, np.inf, kinds) for one in streams], 0


def _prior_scale(streams: Sequence[F32], kinds: Mapping[str, Evidence]) -> F32:
    """Return the median over streams of the scale (E,) of each kind of evidence; 1 where none has any spread."""
    nothing = np.zeros(len(kinds), np.float32)
    scales = []
    for stream in streams:
        past = Past(nothing, kinds)
        for evidence in stream[-MEMORY_SWEEPS:]:
            past.add(evidence)
        scales.append(past.reference().scale)
    found = np.array(scales)
    found[found <= 0.0] = np.nan
    some = np.isfinite(found).any(axis=0)
    return np.where(some, np.nanmedian(np.where(some, found, 1.0), axis=0), 1.0).astype(np.float32)


def alarms_allowed(scenes: int, rate: float, *, unit: str = "scenes") -> int:
    """Return how many of the benign scores of ``scenes`` scenes may lie above the limit of an alarm with this rate.

    Args:
        scenes: number of benign scores.
        rate: of false alarms, in (0, 1), expected.
        unit: what the message calls them.

    Raises:
        ValueError: there are too few for the rate, even with none above.

    >>> alarms_allowed(999, 0.001), alarms_allowed(1999, 0.001)
    (0, 1)
    """
    if not 0.0 < rate < 1.0:
        raise ValueError(f"a false-alarm rate must lie in (0, 1), got {rate}")
    need = math.ceil(1.0 / rate - 1e-9) - 1
    if scenes < need:
        raise ValueError(f"a false-alarm rate of {rate:g} needs at least {need} benign {unit}, got {scenes}")
    return math.floor((scenes + 1) * rate + 1e-9) - 1


def alarm_limit(benign: ArrayLike, rate: float, *, unit: str = "sweeps") -> float:
    """Return the score above which a further benign one lies with at most this probability.

    The (n - m)-th smallest of n scores, with m = ``alarms_allowed(n, rate)``: the ⌈(n + 1)(1 - rate)⌉-th.

    Raises:
        ValueError: the rate is not in (0, 1), there are too few scores for it, or one is NaN.

    >>> alarm_limit(range(1, 20), 0.1)
    18.0
    """
    scores = np.asarray(benign, np.float64)
    allowed = alarms_allowed(len(scores), rate, unit=unit)
    return float(np.sort(checked_scores("benign", scores))[len(scores) - 1 - allowed])


def evidence_id(kinds: Mapping[str, Evidence]) -> str:
    """Return what identifies evidence: a hash of names, versions and grains in their order, and of the sectors."""
    rows = [[name, kind.version, kind.grain, kind.two_sided, kind.of_place] for name, kind in kinds.items()]
    return hashlib.sha256(json.dumps([SECTORS, EARLIER_SWEEPS, ONSET_SWEEPS, BESIDE, rows]).encode()).hexdigest()[:16]


EVIDENCE_ID = evidence_id(EVIDENCE)
"""Of the evidence of this version; other numbers void a calibration, a release does not."""

NAME, FORMAT_VERSION = "stream", 8

SHIPPED = Path(__file__).parent / "monitors" / "simulated.npz"
"""The shipped calibration."""

_MAX_BYTES = 1 << 24
"""Largest part of a file, unpacked."""


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration to ``path`` (compressed NPZ) at once or not at all; the same calibration, the same bytes.

    Raises:
        OSError: the file cannot be written.
    """
    about = {
        "version": FORMAT_VERSION, "monitor": NAME, "evidence": calibration.evidence, "names": calibration.names,
        "hours": calibration.hours, "shape": calibration.shape, "facts": dict(calibration.facts),
    }  # fmt: skip
    arrays: dict[str, Any] = {name: getattr(calibration, name) for name in ("of_place", "prior_scale", "peaks")}
    for name in ("changes", "scores"):
        scale: SurpriseScale = getattr(calibration, name)
        arrays |= {f"{name}.values": scale.values, f"{name}.surprises": scale.surprises}
    file = io.BytesIO()
    np.savez_compressed(file, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)
    write_atomic(path, file.getvalue())


def load_calibration(path: str | Path) -> Calibration:
    """Return the calibration in a file of :func:`save_calibration`; nothing is unpickled.

    Raises:
        ValueError: the file is none, of other evidence, or damaged.
        OSError: it cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        arrays = read_arrays(raw, _MAX_BYTES)
        about = read_about(arrays, NAME, FORMAT_VERSION)
        if about["evidence"] != EVIDENCE_ID:
            raise ValueError(f"a monitor of evidence {about['evidence']} (this version has {EVIDENCE_ID})")
        changes, scores = (
            SurpriseScale(*(np.asarray(arrays[f"{name}.{part}"], np.float32) for part in ("values", "surprises")))
            for name in ("changes", "scores")
        )
        return Calibration(
            tuple(map(str, about["names"])), np.asarray(arrays["of_place"], np.bool_),
            np.asarray(arrays["prior_scale"], np.float32), changes, scores,
            np.asarray(arrays["peaks"], np.float64), float(about["shape"]), float(about["hours"]),
            {str(key): str(text) for key, text in about["facts"].items()}, str(about["evidence"]),
        )  # fmt: skip
    except DAMAGED as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"{path} must be a whole monitor file of this version, got: {why}; make it again:"
            " viewshed monitor calibrate DRIVES --out FILE"
        ) from error


def read_about(arrays: Mapping[str, NDArray[Any]], name: str, version: int) -> dict[str, Any]:
    """Return what a monitor file says of itself, checked to be of the monitor ``name`` in the format ``version``.

    Raises:
        DAMAGED: it is not; ValueError says what it is.
    """
    if "about" not in arrays:
        raise ValueError("no monitor")
    about: dict[str, Any] = json.loads(arrays["about"].tobytes())
    if about["monitor"] != name:
        raise ValueError(f"a file of the monitor {about['monitor']}, not of {name}")
    if about["version"] != version:
        raise ValueError(f"a monitor of format {about['version']} (this version reads {version})")
    return about


def shipped_calibration() -> Calibration:
    """Return the shipped calibration, of simulated streams; see docs/monitor.md for its measured rates."""
    return load_calibration(SHIPPED)


def kind_of_monitor(path: str | Path) -> str:
    """Return the name of the monitor that wrote a file; empty where none did.

    Raises:
        OSError: it cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        return str(json.loads(read_arrays(raw, _MAX_BYTES, ("about",))["about"].tobytes())["monitor"])
    except DAMAGED:
        return ""


def checked_scores(name: str, values: ArrayLike) -> F64:
    """Return scores (N,), one or more, or raise a ValueError that begins with their name."""
    scores = np.asarray(values, np.float64)
    if scores.ndim != 1 or not scores.size or np.isnan(scores).any():
        raise ValueError(f"{name} must be one or more scores, none of them NaN, got shape {scores.shape}")
    return scores
