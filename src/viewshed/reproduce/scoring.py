"""What is kept of contestants on held-out sweeps: counts of each sweep, and all their probabilities together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.metrics import Scores
from viewshed.reproduce.data import TestSweep
from viewshed.reproduce.protocols import MIXTURES
from viewshed.sweep import Sweep
from viewshed.vulnerability.scoring import average_precision, counts

Said = tuple[NDArray[np.float32], NDArray[np.float32] | None]
"""(cells, cells) probability of visible, and its deviation or None."""
Predict = Callable[[Sweep], Said]
DECIMALS = 5


@dataclass(slots=True, eq=False)
class Measured:
    """What one contestant says of one set of sweeps.

    Attributes:
        frames: for each sweep both, only claimed, only true, neither, and average precision (NaN where none).
        scores: the cells of all of them.
    """

    frames: list[list[float]] = field(default_factory=list)
    scores: Scores = field(default_factory=Scores)

    def add(self, said: Said, threshold: float, visible: NDArray[np.bool_], known: NDArray[np.bool_]) -> None:
        """Count one sweep over the cells whose truth is ``known``."""
        prob, true = said[0][known], visible[known]
        self.scores.add(prob, true, None if said[1] is None else said[1][known])
        self.frames.append([*counts(prob >= np.float32(threshold), true), average_precision(prob, true)])

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        frames = [[*map(int, row[:4]), None if np.isnan(row[4]) else round(row[4], DECIMALS)] for row in self.frames]
        return {"frames": frames, "scores": self.scores.to_json()}

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Measured:
        """Return what :meth:`to_json` told.

        Raises:
            ValueError: it is damaged or of another version.
        """
        frames = [[float("nan") if value is None else float(value) for value in row] for row in told["frames"]]
        return cls(frames, Scores.from_json(told["scores"]))

    @property
    def counts(self) -> NDArray[np.float64]:
        """(sweeps, 4) cells of each sweep: both, only claimed, only true, neither."""
        return np.array(self.frames, np.float64).reshape(-1, 5)[:, :4]

    @property
    def areas(self) -> NDArray[np.float64]:
        """(sweeps,) average precision of each sweep."""
        return np.array(self.frames, np.float64).reshape(-1, 5)[:, 4]


def score_contestants(
    sweeps: Iterable[TestSweep], contestants: Mapping[str, Predict], threshold: float
) -> dict[str, Any]:
    """Return what every contestant says of the sweeps, benign and attacked, as plain values.

    Args:
        sweeps: held-out ones.
        contestants: by name.
        threshold: probability from which a cell is claimed.
    """
    found = {name: {mixture: Measured() for mixture in MIXTURES} for name in contestants}
    scenes, attacks = [], []
    for test in sweeps:
        scenes.append(test.scene)
        attacks.append(test.attack)
        for name, predict in contestants.items():
            for mixture, sweep in zip(MIXTURES, (test.benign, test.attacked), strict=True):
                found[name][mixture].add(predict(sweep), threshold, test.visible, test.known)
    scores = {name: {mixture: each.to_json() for mixture, each in both.items()} for name, both in found.items()}
    return {"scenes": scenes, "attacks": attacks, "scores": scores}
