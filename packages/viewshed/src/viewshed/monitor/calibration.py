"""Calibrate scores on benign streams: their p-values, and the limit for a chosen number of false alarms an hour.

The rate counts *alarms*, not sweeps: consecutive sweeps are nearly equal, and a latched alarm counts once. Above a
high threshold the peaks of benign scores follow a generalized Pareto distribution (peaks over a threshold; Pickands,
1975). Its rate, scale and shape come from few peaks and are therefore uncertain: the rate of a limit is the mean over
their posterior, and the promise gives its upper quantile. A limit for one alarm an hour can thus be extrapolated from
less than an hour of driving; the promise then says so.
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
    MEMORY_SWEEPS,
    NEIGHBOR_SECTORS,
    ONSET_SWEEPS,
    Past,
    SurpriseScale,
    numbers_of,
    of_place,
    sector_scores,
)
from viewshed.monitor.tails import exceedance_probability, heights_of, peaks_of, shape_of
from viewshed.monitor.watch import Watch

CONFIDENCE = 0.9
"""Confidence of the upper bound of a rate in a promise."""

MIN_MINUTES = 1.0
"""Minimum benign driving for a calibration."""

ATTACKED_SHARE, ATTACKED_PROBABILITY = 0.1, 1e-3
"""Sweeps above the base's limit are left out as attacked if they (including sweeps that an attack disturbs after it)
are at most this share, and if the tail of the other sweeps gives so many and so high alarms a lower probability."""

PARTS = 7
"""Folds of the benign streams: the scores of each fold use surprise scales fitted on the others."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Statistics of benign streams.

    Attributes:
        names: (E,) kinds of evidence, in order.
        of_place: (E,) bool, kinds that change with the place and count as one.
        prior_scale: (E,) median over the streams of the scale of each kind, see ``score.Past``.
        changes: surprise scale (E, K) of the standardized change of the strongest sector on benign sweeps.
        scores: surprise scale (1, K) of the scores of benign sweeps.
        peaks: (P,) heights of the score's peaks; each is one alarm under any limit below it.
        shape: of the tail of the peaks: 0 is exponential, negative has an end. A few minutes cannot determine it.
        hours: of benign driving.
        facts: further information by name, such as the origin of the streams.
        evidence: :data:`EVIDENCE_ID` of the evidence that it is calibrated on.

    Raises:
        ValueError: the shapes do not match, or there is too little driving.
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
        if not self.hours * 60.0 >= MIN_MINUTES - 1e-6:
            raise ValueError(
                f"benign drives must last {MIN_MINUTES:g} minute at least, got {self.hours * 60.0:.2g}; give more"
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
            streams: evidence (T, E, SECTORS) of the sweeps of each stream.
            hz: sweeps a second.
            kinds: of the evidence.
            base: calibration whose scales are kept; only the rates are then fitted on these streams, because a few
                minutes of driving cannot determine how rare a change is. Sweeps that seem attacked are left out and
                counted in ``facts``. None fits everything.
            facts: further information by name.

        Raises:
            ValueError: there is too little driving.
        """
        pasts = [evidence.astype(np.float32) for evidence in streams if len(evidence) > EARLIER_SWEEPS]
        hours = sum(map(len, pasts)) / (3600.0 * hz)
        if hours * 60.0 < MIN_MINUTES - 1e-6:
            short = sum(map(len, streams)) - sum(map(len, pasts))
            why = (
                f" besides {short} sweeps in streams of {EARLIER_SWEEPS} or fewer, which are too short" if short else ""
            )
            raise ValueError(
                f"benign drives must last {MIN_MINUTES:g} minute at least, got {hours * 60.0:.2g}{why}; give more"
            )
        # 1. The prior scale of each kind, which standardizes the first seconds of a stream.
        prior = base.prior_scale if base is not None else _prior_scale(pasts, kinds)
        if base is not None:
            scale, (scores, left_out) = base.changes, _own_scores(pasts, base, kinds)
            facts = dict(facts or {}) | ({"left_out": str(left_out)} if left_out else {})
        else:
            # 2. Standardized changes of all streams, and their surprise scale.
            changes = [changes_of(one, prior, kinds) for one in pasts]
            strongest = [np.fmax.reduce(one, axis=2) for one in changes]
            scale = SurpriseScale.fit(strongest)
            # 3. Scores; those of each fold by the surprise scale of the other folds.
            scales = [scale] * len(changes)
            if len(changes) > 1:
                others = [
                    SurpriseScale.fit([one for number, one in enumerate(strongest) if number % PARTS != part])
                    for part in range(min(PARTS, len(changes)))
                ]
                scales = [others[number % PARTS] for number in range(len(changes))]
            once = of_place(kinds)
            scores = [sector_scores(by(one), once).max(axis=1) for by, one in zip(scales, changes, strict=True)]
        # 4. Peaks of the scores.
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
        """Return the share of benign sweeps that score at least as high, extrapolated beyond the highest."""
        return float(np.clip(10.0 ** -self.scores(np.array([[score]], np.float32))[0, 0], 1e-12, 1.0))

    @property
    def least_per_hour(self) -> float:
        """The smallest number of false alarms an hour that the streams themselves support, without extrapolation."""
        return 1.0 / self.hours

    def limit(self, per_hour: float, *, extrapolate: bool = False) -> float:
        """Return the score limit whose expected number of false alarms an hour is ``per_hour``.

        Args:
            per_hour: false alarms an hour.
            extrapolate: allow a rate below ``least_per_hour``, extrapolated from the tail of the peaks.

        Raises:
            ValueError: the rate is not positive, or needs more driving.
        """
        if not per_hour > 0.0:
            raise ValueError(f"per_hour must be positive, got {per_hour:g}")
        if per_hour < self.least_per_hour * (1.0 - 1e-9) and not extrapolate:
            raise ValueError(
                f"{per_hour:g} false alarms an hour need {60.0 / per_hour:.0f} minutes of benign driving, got"
                f" {self.hours * 60.0:.1f}; give more drives, or choose {math.ceil(self.least_per_hour * 10) / 10:g}"
            )
        # Bisection: the rate falls as the limit rises.
        low, high = self._tail()[0], 1e4
        for _ in range(60):
            middle = (low + high) / 2.0
            low, high = (middle, high) if self.per_hour(middle) > per_hour else (low, middle)
        return high

    def per_hour(self, limit: float, confidence: float | None = None) -> float:
        """Return the number of false alarms an hour above a limit: expected, or its upper bound at a confidence.

        Samples the number of peaks and the inverse scale of their heights from gamma posteriors; the shape is fixed at
        the median of its own posterior.
        """
        begin, scale, count = self._tail()
        peak_counts, inverse_scales = _posterior_samples(count)
        within = np.maximum(1.0 + self.shape * max(limit - begin, 0.0) / scale * inverse_scales, 0.0)
        rates = peak_counts / self.hours * within ** (-1.0 / self.shape)
        return float(rates.mean() if confidence is None else np.quantile(rates, confidence))

    def promise(self, per_hour: float) -> str:
        """Return one line that states the limit for this false-alarm rate, its upper bound and its basis."""
        limit = self.limit(per_hour, extrapolate=True)
        how = "" if per_hour >= self.least_per_hour else ", an extrapolation of the tail of their scores"
        upper_bound = self.per_hour(limit, CONFIDENCE)
        return (
            f"score above {limit:.2f}: {per_hour:g} false alarms an hour, at most {upper_bound:.2g}"
            f" with probability {CONFIDENCE:g}, by {self.hours * 60.0:.0f} minutes of benign driving{how}"
        )

    def _tail(self) -> tuple[float, float, int]:
        """Return the threshold at which the tail of the peaks begins, the scale of the excesses, and their number."""
        begin, heights = heights_of(self.peaks)
        if not len(heights):
            return begin, 1.0, 0
        # The scale from the median excess, which is robust to a few outliers.
        scale = float(np.median(heights)) * self.shape / (2.0**self.shape - 1.0)
        return begin, max(scale, 0.1), len(heights)


@lru_cache(maxsize=8)
def _posterior_samples(count: int) -> tuple[F64, F64]:
    """Return 4,000 posterior samples of the number of peaks and of their inverse scale, given ``count`` of scale 1."""
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
    """Return the scores (T,) of a stream's evidence (T, E, SECTORS) under a calibration; NaN where it has no past.

    Sweeps above the limit do not become part of the past.
    """
    watch = Watch(base, limit, kinds)
    return np.array([watch.check(evidence).score for evidence in stream], np.float32)


def _own_scores(streams: Sequence[F32], base: Calibration, kinds: Mapping[str, Evidence]) -> tuple[list[F32], int]:
    """Return the scores (T,) of each stream under a base, NaN in sweeps that seem attacked, and their number.

    Alarms at the base's limit of one an hour are taken for an attack if the tail of the other peaks does not explain
    them. If it does, the streams are rougher than the base's; if many sweeps exceed the limit, the sensor is another
    one. In both cases all sweeps count.
    """
    limit = base.limit(1.0, extrapolate=True)
    scores = [scores_of(one, base, limit, kinds) for one in streams]
    calm = [np.where(one > limit, np.float32(np.nan), one) for one in scores]
    peaks = np.concatenate([peaks_of(one) for one in scores])
    alarms, count = peaks[peaks > limit], sum(int((one > limit).sum()) for one in scores)
    if not count:
        return scores, 0
    if count <= ATTACKED_SHARE * sum(map(len, scores)):
        begin, heights = heights_of(np.sort(np.concatenate([peaks_of(one) for one in calm])).astype(np.float64))
        # Test the higher half of the alarms: their height is as telling as their number.
        middle = float(np.median(alarms))
        above = int((alarms >= middle).sum())
        scale = base._tail()[1]
        probability = exceedance_probability(heights, base.shape, scale, limit - begin, middle - begin, above)
        if probability < ATTACKED_PROBABILITY:
            return calm, count
    return [scores_of(one, base, np.inf, kinds) for one in streams], 0


def _prior_scale(streams: Sequence[F32], kinds: Mapping[str, Evidence]) -> F32:
    """Return the median over streams of the scale (E,) of each kind of evidence; 1 where none has any spread."""
    zeros = np.zeros(len(kinds), np.float32)
    scales = []
    for stream in streams:
        past = Past(zeros, kinds)
        for evidence in stream[-MEMORY_SWEEPS:]:
            past.add(evidence)
        scales.append(past.reference().scale)
    by_stream = np.array(scales)
    by_stream[by_stream <= 0.0] = np.nan
    known = np.isfinite(by_stream).any(axis=0)
    return np.where(known, np.nanmedian(np.where(known, by_stream, 1.0), axis=0), 1.0).astype(np.float32)


def alarms_allowed(scenes: int, rate: float, *, unit: str = "scenes") -> int:
    """Return how many of ``scenes`` benign scores may lie above the limit of an alarm with this false-alarm rate.

    Args:
        scenes: number of benign scores.
        rate: expected false-alarm rate, in (0, 1).
        unit: noun for the scores in the error message.

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
    """Return the limit that a further benign score exceeds with probability ``rate`` at most.

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
    """Return the ID of a set of evidence: a hash of names, versions and grains in order, and of the sectors."""
    rows = [[name, kind.version, kind.grain, kind.two_sided, kind.of_place] for name, kind in kinds.items()]
    return hashlib.sha256(
        json.dumps([SECTORS, EARLIER_SWEEPS, ONSET_SWEEPS, NEIGHBOR_SECTORS, rows]).encode()
    ).hexdigest()[:16]


EVIDENCE_ID = evidence_id(EVIDENCE)
"""ID of this version's evidence. Changed evidence invalidates a calibration; a new release alone does not."""

NAME, FORMAT_VERSION = "stream", 8

SHIPPED = Path(__file__).parent / "monitors" / "simulated.npz"
"""The shipped calibration."""

_MAX_BYTES = 1 << 24
"""Largest array of a file, unpacked."""


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration to ``path`` (compressed NPZ), atomically; equal calibrations give equal bytes.

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
    """Read a calibration that :func:`save_calibration` wrote; nothing is unpickled.

    Raises:
        ValueError: the file is no calibration, of other evidence, or damaged.
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
    """Return the header of a monitor file, after checking that it is monitor ``name`` in format ``version``.

    Raises:
        DAMAGED: it is not; a ValueError says what the file is.
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
    """Return the shipped calibration, fitted on simulated streams; docs/monitor.md gives its measured rates."""
    return load_calibration(SHIPPED)


def kind_of_monitor(path: str | Path) -> str:
    """Return the name of the monitor that wrote a file; empty if it is no monitor file.

    Raises:
        OSError: it cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        return str(json.loads(read_arrays(raw, _MAX_BYTES, ("about",))["about"].tobytes())["monitor"])
    except DAMAGED:
        return ""


def checked_scores(name: str, values: ArrayLike) -> F64:
    """Return the scores (N,) as float64; raise a ValueError that begins with ``name`` if there are none or any NaN."""
    scores = np.asarray(values, np.float64)
    if scores.ndim != 1 or not scores.size or np.isnan(scores).any():
        raise ValueError(f"{name} must be one or more scores, none of them NaN, got shape {scores.shape}")
    return scores
