"""One score from all evidence: on a common scale, by networks that were trained on attacks and by what is rare.

A sweep is measured as a matrix (E, SECTORS), one line for each kind of evidence. Three steps say where doubt lies:

1. Each number becomes its surprise, -log10 of the share of benign sectors that are as suspicious: 2 means one in a
   hundred. So meters, shares and counts compare, and evidence that abstained says nothing.
2. A sector is described by its own surprises, those of its neighbors up to 60° away, and the median, the maximum and
   the share of raised sectors of the whole sweep: rain raises all sectors, a spoofer some.
3. A network of one hidden layer gives each sector a number: where doubt comes from.

Statistics of the whole sweep (:class:`WholeSweep`) report how much doubt there is, on a scale of benign *sweeps*:
of each evidence its largest sector, the means of the 3 and of the 9 largest and of all, and the median. Two networks
learn from attacks what matters in them, one of them in the context of the medians, which say what honest causes raise.
And the rarest of them count by themselves, so that evidence which no attack in training needed finds one that was never
seen. Each of the three becomes its surprise on benign sweeps, and these are summed. A third network says what is
degraded.

Scores are larger where there is more doubt. They have no unit: what is rare is for a calibration to say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.monitor.evidence import EVIDENCE, SECTORS, Evidence, MonitoredSweep

HELD_SWEEPS = 5
"""Number of sweeps over which evidence over time is carried over."""

RAISED = 2.0
"""Surprise from which a sector counts as raised: one benign sector in a hundred."""

NEIGHBORS = ((1,), (2, 3), (4, 5, 6), (7, 8, 9, 10, 11, 12))
"""Distances, in sectors to both sides, of the neighbors whose mean surprises describe a sector: a wedge is of many."""

SECTOR_FEATURES = 1 + len(NEIGHBORS)
"""Numbers of each evidence that differ from sector to sector: its own surprise, the means of its neighbors'."""

SWEEP_FEATURES = 3
"""Numbers of each evidence that are the same for all sectors: median, maximum, share of raised sectors."""

STATISTICS = 5
"""Numbers of each evidence for a whole sweep: largest sector, mean of the 3 and of the 9 largest and of all, median."""

RAREST_SHARE = 0.5
"""Exponent of the tail odds in sums of surprises: 1 is their log-sum, 0 all alike; chosen within training drives."""

_LARGEST_SURPRISE = 6.0

_SURPRISES = np.concatenate([np.linspace(0.0, 2.0, 21), np.linspace(2.25, 5.0, 12)])


def measure_all(monitored: MonitoredSweep, evidence: Mapping[str, Evidence] = EVIDENCE) -> F32:
    """Return what every evidence measures (E, SECTORS), in the order of ``evidence``; NaN where it abstains."""
    return np.array([one.measure(monitored) for one in evidence.values()], np.float32).reshape(-1, SECTORS)


def held(recent: Sequence[F32] | NDArray[np.floating[Any]], over_time: Sequence[bool] | NDArray[np.bool_]) -> F32:
    """Return the evidence (E, SECTORS) of the last of K sweeps, what it says over time carried over all of them.

    What appears or vanishes without cause does so once: one sweep later it is part of the history. So of evidence over
    time the strongest of each sector counts; of all other that of the last sweep.

    Args:
        recent: (K, E, SECTORS) of sweeps in a row, the last of them last; at most ``HELD_SWEEPS``.
        over_time: (E,) which evidence compares with earlier sweeps.
    """
    evidence = np.array(recent[-1], np.float32)
    evidence[over_time] = np.fmax.reduce(np.asarray(recent, np.float32)[:, over_time], axis=0)
    return evidence


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Two numbers for a sweep, and where the first comes from; larger is more doubtful.

    Attributes:
        inconsistent: that the sweep is impossible, or contradicted by time.
        degraded: that it shows less or worse than usual, whatever the cause.
        sectors: (SECTORS,) what each sector says for ``inconsistent``.
    """

    inconsistent: float
    degraded: float
    sectors: F32


@dataclass(frozen=True, slots=True, eq=False)
class SurpriseScale:
    """How rare a number is on benign sweeps, for each evidence.

    Between knots the surprise is linear; beyond the largest, where there were no benign numbers, it goes on as the tail
    begins, ever more slowly, so that one huge number does not outweigh all others.

    Attributes:
        values: (E, K) ascending numbers.
        surprises: (E, K) -log10 of the share of benign numbers that are at least as large.

    Raises:
        ValueError: the shapes differ, or the values do not ascend.
    """

    values: F32
    surprises: F32

    def __post_init__(self) -> None:
        if self.values.shape != self.surprises.shape or self.values.ndim != 2 or self.values.shape[1] < 2:
            raise ValueError(
                f"values and surprises must be (E, K) alike, got {self.values.shape} and {self.surprises.shape}"
            )
        if not (np.diff(self.values) >= 0).all() or not np.isfinite(self.surprises).all():
            raise ValueError("values must ascend and surprises be finite, got others; fit the scale again")

    @classmethod
    def fit(cls, benign: NDArray[np.floating[Any]]) -> Self:
        """Return the scale of benign evidence (N, E, SECTORS); one that always abstained stays at a surprise of 0."""
        # Of evidence that never spoke no number is known to be rare: all lie below the first knot.
        values = np.full((benign.shape[1], len(_SURPRISES)), np.finfo(np.float32).max, np.float32)
        surprises = np.zeros_like(values)
        for number, of_one in enumerate(np.moveaxis(benign, 1, 0)):
            known = np.sort(of_one[np.isfinite(of_one)].astype(np.float32))
            if known.size:
                rank = np.ceil((1.0 - 10.0**-_SURPRISES) * (known.size - 1)).astype(np.intp)
                values[number] = known[rank]
                # Equal numbers share the surprise of the first: a sector at a common value is no surprise at all.
                reached = known.size - np.searchsorted(known, values[number], "left")
                surprises[number] = -np.log10(reached / known.size)
        return cls(values, surprises)

    def __call__(self, evidence: NDArray[np.floating[Any]]) -> F32:
        """Return the surprises (N, E, SECTORS) of evidence (N, E, SECTORS); NaN where it abstains."""
        numbers = np.asarray(evidence, np.float32)
        surprises = np.empty(numbers.shape, np.float32)
        for number, (values, known) in enumerate(zip(self.values, self.surprises, strict=True)):
            surprises[:, number] = np.interp(numbers[:, number], values, known)
        return surprises + self._beyond(numbers)

    def _beyond(self, numbers: F32) -> F32:
        """Return what numbers beyond the largest benign one add; 0 for all others."""
        last = self.values[:, -1:]
        steps = np.diff(self.surprises[:, [_ONE_IN_A_HUNDRED, -1]])
        width = np.maximum(last - self.values[:, [_ONE_IN_A_HUNDRED]], 1e-3 * np.maximum(np.abs(last), 1e-3))
        with np.errstate(invalid="ignore", over="ignore"):
            excess = np.clip((numbers - last) / width, 0.0, 1e6)
        more: F32 = np.maximum(steps, 1.0) * np.log1p(excess)
        return more


_ONE_IN_A_HUNDRED = int(np.searchsorted(_SURPRISES, RAISED - 1e-9))


def statistics(evidence: NDArray[np.floating[Any]]) -> F32:
    """Return the statistics (N, STATISTICS E) of sweeps' evidence (N, E, SECTORS); NaN where it abstains."""
    numbers = np.asarray(evidence, np.float32)
    count = np.isfinite(numbers).sum(axis=2)
    # NaN sorts last: descending, the sectors that are known come first.
    descending = -np.sort(-numbers, axis=2)
    known = np.where(np.isfinite(descending), descending, 0.0)
    means = [known[..., :most].sum(axis=2) / np.maximum(np.minimum(count, most), 1) for most in (1, 3, 9, SECTORS)]
    middle = np.take_along_axis(known, (np.maximum(count - 1, 0) - np.maximum(count - 1, 0) // 2)[..., None], axis=2)
    found = np.stack([*means, middle[..., 0]], axis=1)
    return np.where(count[:, None] > 0, found, np.nan).reshape(len(numbers), -1).astype(np.float32)


def sum_of_odds(surprises: NDArray[np.floating[Any]]) -> F32:
    """Return the sum (N,) of surprises (N, K) by their tail odds, so that the rarest count most.

    The log of the sum of 10^(s RAREST_SHARE), over RAREST_SHARE.
    """
    odds = 10.0 ** (RAREST_SHARE * np.minimum(surprises, 16.0).astype(np.float64))
    return np.asarray(np.log10(odds.sum(axis=1)) / RAREST_SHARE, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class StatisticsNetwork:
    """Two hidden layers over a sweep's statistics, in surprises; the second and the output see these as well.

    A third of the units of each layer is rectified below 0, a third above 1, a third at -1 and 1: with weights of at
    least 0 they make any function that does not fall (Runje and Shankaranarayana, 2023).

    Attributes:
        first: (F, H) weights from statistics to the first layer.
        second: (H + F, G) from the first layer and statistics to the second.
        outputs: (G + F,) from the second layer and statistics to the output.
        offsets: (H + G + 1,) of both layers and the output.

    Raises:
        ValueError: the shapes do not fit.
    """

    first: F32
    second: F32
    outputs: F32
    offsets: F32

    def __post_init__(self) -> None:
        (inputs, units), seconds = self.first.shape, self.second.shape[1]
        found = (self.second.shape, self.outputs.shape, self.offsets.shape)
        shapes = ((units + inputs, seconds), (seconds + inputs,), (units + seconds + 1,))
        if found != shapes or units % 3 or seconds % 3:
            raise ValueError(f"layers must have shapes {shapes} in thirds, got {found}; train the score again")

    def __call__(self, surprises: F32) -> F32:
        """Return the output (N,) for surprises (N, F) without NaN."""
        units, seconds = self.first.shape[1], self.second.shape[1]
        hidden = rectified(surprises @ self.first + self.offsets[:units])
        deeper = rectified(
            hidden @ self.second[:units] + surprises @ self.second[units:] + self.offsets[units : units + seconds]
        )
        result: F32 = deeper @ self.outputs[:seconds] + surprises @ self.outputs[seconds:] + self.offsets[-1]
        return result

    def arrays(self, prefix: str) -> dict[str, NDArray[Any]]:
        """Return its arrays by name."""
        return {f"{prefix}.{name}": getattr(self, name) for name in _LAYERS}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], prefix: str) -> Self:
        """Return the network in arrays of :meth:`arrays`."""
        return cls(**{name: np.asarray(arrays[f"{prefix}.{name}"], np.float32) for name in _LAYERS})


_LAYERS = ("first", "second", "outputs", "offsets")


def rectified(values: F32) -> F32:
    """Return units (N, H) of a layer: max(x, 0), min(x, 1) and x clipped to [-1, 1], a third each."""
    third = values.shape[1] // 3
    return np.concatenate(
        [
            np.maximum(values[:, :third], 0.0),
            np.minimum(values[:, third : 2 * third], 1.0),
            np.clip(values[:, 2 * third :], -1.0, 1.0),
        ],
        axis=1,
    )


@dataclass(frozen=True, slots=True, eq=False)
class WholeSweep:
    """Judges the statistics of a whole sweep.

    Attributes:
        scale: of the statistics (STATISTICS E, K) on benign sweeps.
        in_context: network of all statistics; may fall where medians rise.
        by_itself: network of all but the medians.
        degraded: network of all statistics, free to rise and fall.
        parts: scale (3, K) of both networks and the rarest statistics on benign sweeps.
    """

    scale: SurpriseScale
    in_context: StatisticsNetwork
    by_itself: StatisticsNetwork
    degraded: StatisticsNetwork
    parts: SurpriseScale

    def __call__(self, evidence: NDArray[np.floating[Any]]) -> F32:
        """Return the scores (N, 2) of evidence (N, E, SECTORS)."""
        return self.of_statistics(statistics(evidence))

    def of_statistics(self, numbers: F32) -> F32:
        """Return the scores (N, 2) of :func:`statistics` (N, STATISTICS E)."""
        surprises = surprises_of_statistics(self.scale, numbers)
        parts = parts_of(surprises, self.in_context, self.by_itself)
        inconsistent = sum_of_odds(self.parts(parts[..., None])[..., 0])
        return np.stack([inconsistent, self.degraded(surprises)], axis=1)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all of it as arrays by name."""
        scales = {
            f"whole.{name}.{part}": getattr(getattr(self, name), part)
            for name in ("scale", "parts")
            for part in ("values", "surprises")
        }
        networks = (getattr(self, name).arrays(f"whole.{name}") for name in _NETWORKS)
        return scales | {name: array for network in networks for name, array in network.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Return what is in arrays of :meth:`arrays`."""
        scale, parts = (
            SurpriseScale(*(np.asarray(arrays[f"whole.{name}.{part}"], np.float32) for part in ("values", "surprises")))
            for name in ("scale", "parts")
        )
        networks = {name: StatisticsNetwork.from_arrays(arrays, f"whole.{name}") for name in _NETWORKS}
        return cls(scale, parts=parts, **networks)


_NETWORKS = ("in_context", "by_itself", "degraded")


def surprises_of_statistics(scale: SurpriseScale, numbers: F32) -> F32:
    """Return the surprises (N, F) of statistics (N, F): 0 where evidence abstains, never beyond 6."""
    found = np.nan_to_num(scale(numbers[..., None])[..., 0])
    return np.clip(found, 0.0, _LARGEST_SURPRISE).astype(np.float32)


def parts_of(surprises: F32, in_context: StatisticsNetwork, by_itself: StatisticsNetwork) -> F32:
    """Return the parts (N, 3) of what is inconsistent: both networks, the rarest statistics.

    Args:
        surprises: (N, F) of statistics, the medians last.
        in_context: network of all of them.
        by_itself: network of all but the medians.
    """
    rarest = sum_of_odds(surprises[:, : -surprises.shape[1] // STATISTICS])
    return np.stack([in_context(surprises), by_itself(surprises), rarest], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class EvidenceScore:
    """Scores a sweep by its evidence; plain arrays, which a monitor's file holds.

    Attributes:
        names: (E,) of the evidence, in the order of its lines.
        scale: on which they are compared.
        mean: (F,) of the features of benign sectors.
        spread: (F,) their standard deviation.
        weights: (F, H) from features to hidden units.
        offsets: (H,) of the hidden units.
        outputs: (H, 2) from hidden units to what is inconsistent and what is degraded.
        output_offsets: (2,) of both.
        whole: judges the statistics of the sweep; None for what the sectors say together.

    Raises:
        ValueError: the shapes do not fit.
    """

    names: tuple[str, ...]
    scale: SurpriseScale
    mean: F32
    spread: F32
    weights: F32
    offsets: F32
    outputs: F32
    output_offsets: F32
    whole: WholeSweep | None = None

    def __post_init__(self) -> None:
        count, hidden = features_of(len(self.names)), len(self.offsets)
        shapes = {
            "mean": (count,), "spread": (count,), "weights": (count, hidden), "offsets": (hidden,),
            "outputs": (hidden, 2), "output_offsets": (2,),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"{name} must have shape {shape} for {len(self.names)} kinds of evidence, got"
                    f" {getattr(self, name).shape}; train the score again"
                )
        if len(self.scale.values) != len(self.names):
            raise ValueError(
                f"scale must be of {len(self.names)} kinds of evidence, got {len(self.scale.values)}; train the score"
                " again"
            )
        if self.whole is not None and len(self.whole.scale.values) != STATISTICS * len(self.names):
            raise ValueError(
                f"whole must be of {STATISTICS * len(self.names)} statistics, got {len(self.whole.scale.values)}; train"
                " the score again"
            )

    def __call__(self, evidence: NDArray[np.floating[Any]]) -> Scores:
        """Return the scores of one sweep's evidence (E, SECTORS).

        Raises:
            ValueError: there is other evidence than the score was trained on.
        """
        several = np.asarray(evidence)[None]
        sectors = self.logits(several)[0, :, 0]
        inconsistent, degraded = self.of_sweeps(several)[0]
        return Scores(float(inconsistent), float(degraded), sectors)

    def of_sweeps(self, evidence: NDArray[np.floating[Any]]) -> F32:
        """Return the scores (N, 2) of evidence (N, E, SECTORS), without those of sectors.

        Raises:
            ValueError: there is other evidence than the score was trained on.
        """
        self._require(evidence)
        return pooled(self.logits(evidence)) if self.whole is None else self.whole(evidence)

    def logits(self, evidence: NDArray[np.floating[Any]]) -> F32:
        """Return what the network says of each sector (N, SECTORS, 2) of evidence (N, E, SECTORS).

        Raises:
            ValueError: there is other evidence than the score was trained on.
        """
        self._require(evidence)
        of_sectors, of_sweep = features(self.scale(evidence))
        split = of_sectors.shape[-1]
        of_sectors = _standardized(of_sectors, self.mean[:split], self.spread[:split])
        of_sweep = _standardized(of_sweep, self.mean[split:], self.spread[split:])
        # What is the same for all sectors goes through its part of the weights once.
        hidden = of_sectors @ self.weights[:split] + (of_sweep @ self.weights[split:] + self.offsets)[:, None]
        result: F32 = np.maximum(hidden, 0.0) @ self.outputs + self.output_offsets
        return result

    def _require(self, evidence: NDArray[np.floating[Any]]) -> None:
        if evidence.ndim != 3 or evidence.shape[1:] != (len(self.names), SECTORS):
            raise ValueError(
                f"evidence must be {len(self.names)} lines of {SECTORS} sectors ({', '.join(self.names)}), got shape"
                f" {evidence.shape}; use the monitor of this version"
            )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all of it as arrays by name, as :meth:`from_arrays` takes them."""
        scale = {"values": self.scale.values, "surprises": self.scale.surprises}
        whole = {} if self.whole is None else self.whole.arrays()
        return scale | {name: np.asarray(getattr(self, name)) for name in ("names", *_ARRAYS)} | whole

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Return the score in arrays of :meth:`arrays`.

        Raises:
            KeyError: one is missing.
            ValueError: they do not fit.
        """
        names = tuple(str(name) for name in arrays["names"])
        scale = SurpriseScale(np.asarray(arrays["values"], np.float32), np.asarray(arrays["surprises"], np.float32))
        whole = WholeSweep.from_arrays(arrays) if any(name.startswith("whole.") for name in arrays) else None
        return cls(names, scale, **{name: np.asarray(arrays[name], np.float32) for name in _ARRAYS}, whole=whole)


_ARRAYS = ("mean", "spread", "weights", "offsets", "outputs", "output_offsets")


def features_of(evidence: int) -> int:
    """Return how many features a sector has with this number of kinds of evidence."""
    return evidence * (SECTOR_FEATURES + SWEEP_FEATURES)


def features(surprises: F32) -> tuple[F32, F32]:
    """Return the features of sectors (N, SECTORS, SECTOR_FEATURES E) and of sweeps (N, SWEEP_FEATURES E).

    Those of a sector are 0 where its evidence abstains, those of a sweep NaN where it abstains in all sectors.

    Args:
        surprises: (N, E, SECTORS), NaN where evidence abstains.
    """
    known_or_none = np.nan_to_num(np.minimum(surprises, _LARGEST_SURPRISE))
    around = [
        sum(np.roll(known_or_none, step, axis=2) for far in distances for step in (far, -far)) / (2 * len(distances))
        for distances in NEIGHBORS
    ]
    of_sectors = np.concatenate([known_or_none, *around], axis=1).transpose(0, 2, 1)
    # NaN sorts last: the sectors that are known come first, and the last of them is the maximum.
    surprises = np.minimum(surprises, _LARGEST_SURPRISE)
    ordered, known = np.sort(surprises, axis=2), np.isfinite(surprises).sum(axis=2)
    middle = np.take_along_axis(ordered, np.maximum(known - 1, 0)[..., None] // 2, axis=2)[..., 0]
    largest = np.take_along_axis(ordered, known[..., None] - 1, axis=2)[..., 0]
    raised = np.where(known > 0, (surprises >= RAISED).sum(axis=2) / np.maximum(known, 1), np.nan)
    return of_sectors, np.concatenate([middle, largest, raised], axis=1).astype(np.float32)


def pooled(logits: F32) -> F32:
    """Return what sectors (N, SECTORS, 2) say together (N, 2): log of the mean of exp of what each says."""
    highest = logits.max(axis=1, keepdims=True)
    mean = np.exp(logits - highest).mean(axis=1)
    result: F32 = np.log(mean) + highest[:, 0]
    return result


def _standardized(values: F32, mean: F32, spread: F32) -> F32:
    """Return features less their benign mean, over their spread; those of evidence that abstains are 0."""
    standardized: F32 = (values - mean) / spread
    standardized[np.isnan(standardized)] = 0.0
    return standardized
