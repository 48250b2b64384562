"""What the benchmarks of many agents share: truth as a view with a pose, shares with intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viewshed.arrays import Mask
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid

DRAWS = 1000


def as_view(truth: Truth, known: Mask, world_from_sensor: Rigid, agent: str, target: str = "car") -> FovEstimate:
    """Return exact truth as a view with a pose: what is seen is FREE, what is not HIDDEN, what is not known UNKNOWN."""
    seen = truth.visible(target)
    state = np.where(known, np.where(seen, CellState.FREE, CellState.HIDDEN), CellState.UNKNOWN).astype(np.uint8)
    pose = Rigid.from_yaw(world_from_sensor.yaw, world_from_sensor.translation)
    return FovEstimate(
        truth.grid, (seen & known).astype(np.float32), state, method="exact truth", world_from_level=pose, agent=agent
    )


def share(part: Sequence[float], whole: Sequence[float], digits: int = 3) -> str:
    """Return the share of sums over S scenes with its 95 % interval by a bootstrap over scenes, in words."""
    parts, wholes = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    if not wholes.sum() > 0:
        return "–"
    rng = np.random.default_rng(len(parts))
    weights = rng.multinomial(len(parts), np.full(len(parts), 1.0 / len(parts)), DRAWS)
    drawn = (weights @ parts) / np.maximum(weights @ wholes, 1e-9)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return f"{parts.sum() / wholes.sum():.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
