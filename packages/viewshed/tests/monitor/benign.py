"""Benign evidence drawn at random, and a score of it that can be computed by hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed.monitor.calibration import Group
from viewshed.monitor.evidence import SECTORS, Evidence, MonitoredSweep
from viewshed.monitor.score import SWEEP_FEATURES, EvidenceScore, SurpriseScale, features_of
from viewshed.monitor.sweep_monitor import BenignSweep


def _first(monitored: MonitoredSweep) -> NDArray[np.float32]:
    """Return the share of all returns by sector: evidence that any sweep gives."""
    count = np.histogram(monitored.leveled.azimuth, SECTORS, (-np.pi, np.pi))[0]
    return np.asarray(count / max(count.sum(), 1), np.float32)


def _over_time(monitored: MonitoredSweep) -> NDArray[np.float32]:
    """Return the change of that share since the sweep before; abstains without one."""
    if not monitored.earlier:
        return np.full(SECTORS, np.nan, np.float32)
    return np.asarray(np.abs(_first(monitored) - _first(MonitoredSweep(monitored.earlier[-1]))), np.float32)


KINDS = {
    "crowd": Evidence("crowd", _first, "{value:.2f} of the returns lie at {degrees:.0f}°"),
    "change": Evidence("change", _over_time, "the returns at {degrees:.0f}° change by {value:.2f}"),
    "third": Evidence("third", _first, "a third at {degrees:.0f}°"),
}
NAMES = tuple(KINDS)
VLP, HDL = Group("VLP-16", "none"), Group("HDL-32E", "none")


def evidence_of(rng: np.random.Generator, scale: float = 1.0) -> NDArray[np.float32]:
    """Return evidence (E, SECTORS), exponential; scenes differ by a factor that all their sectors share."""
    shared = scale * rng.lognormal(0.0, 0.3)
    return np.asarray(shared * rng.exponential(1.0, (len(NAMES), SECTORS)), np.float32)


def score_by_hand(benign: NDArray[np.float32] | None = None) -> EvidenceScore:
    """Return a score whose sectors say the sum of their surprises (inconsistent) or of the medians (degraded).

    Args:
        benign: (N, E, SECTORS) evidence by which numbers are surprising; drawn by :func:`evidence_of` if none is given.
    """
    rng, kinds = np.random.default_rng(77), len(NAMES)
    scale = SurpriseScale.fit(np.stack([evidence_of(rng) for _ in range(200)]) if benign is None else benign)
    count = features_of(kinds)
    weights, outputs = np.zeros((count, 2), np.float32), np.eye(2, dtype=np.float32)
    weights[:kinds, 0] = 1.0
    weights[count - SWEEP_FEATURES * kinds : count - (SWEEP_FEATURES - 1) * kinds, 1] = 1.0
    zeros, ones = np.zeros(count, np.float32), np.ones(count, np.float32)
    none = np.zeros(2, np.float32)
    return EvidenceScore(NAMES, scale, zeros, ones, weights, none, outputs, none)


def benign_sweeps(count: int, seed: int, group: Group = VLP, *, each: int = 2, scale: float = 1.0) -> list[BenignSweep]:
    """Return ``each`` sweeps of so many scenes; the sweeps of a scene are alike."""
    rng, found = np.random.default_rng(seed), list[BenignSweep]()
    for scene in range(count):
        first = evidence_of(rng, scale)
        found += [
            BenignSweep(f"{group.sensor} {seed} {scene}", group, first * np.float32(1 + 0.01 * number))
            for number in range(each)
        ]
    return found


def check_refusals(path: Path, load: Callable[[Path], object], step: int, flips: int) -> float:
    """Cut a file of a monitor and change its bytes; return the share that is refused, each in one line."""
    whole, rng, told = path.read_bytes(), np.random.default_rng(0), list[str]()
    damaged = [whole[:k] for k in range(0, len(whole), step)] + [b"", b"monitor"]
    places = rng.integers(0, len(whole), flips)
    damaged += [whole[:k] + bytes([whole[k] ^ int(rng.integers(1, 256))]) + whole[k + 1 :] for k in places]
    for content in damaged:
        path.write_bytes(content)
        try:
            load(path)
        except ValueError as error:
            told.append(str(error))
    assert all(line.startswith(f"{path} must be a whole monitor file") and "\n" not in line for line in told)
    return len(told) / len(damaged)
