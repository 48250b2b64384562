"""Truth: the exact visibility of each cell of a grid to one sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import frozen
from viewshed.fov.visibility import CAR, TARGETS, Target
from viewshed.grid import BevGrid

OTHER_DEFINITIONS = ("farthest", "first_blocker", "line_of_sight")
"""Other definitions of visible in the literature (docs/conventions.md)."""

MAX_COUNT = 255


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The exact field of view of one sweep, or a label of one, on a grid in the ``level`` frame.

    Attributes:
        grid: grid of the cells.
        expected_returns: target name → (cells, cells) uint8 number of returns from a target there, up to 255.
        state: target name → (cells, cells) uint8 of ``CellState``.
        definitions: name in ``OTHER_DEFINITIONS`` → (cells, cells) bool mask of visible cells.

    Raises:
        ValueError: the shape or dtype of an array is wrong, or a target or definition is unknown.
    """

    grid: BevGrid
    expected_returns: Mapping[str, NDArray[np.uint8]]
    state: Mapping[str, NDArray[np.uint8]]
    definitions: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if set(self.expected_returns) != set(self.state):
            raise ValueError(f"state must have the targets {sorted(self.expected_returns)}, got {sorted(self.state)}")
        unknown = set(self.definitions) - set(OTHER_DEFINITIONS)
        if unknown:
            raise ValueError(f"definitions must be among {', '.join(OTHER_DEFINITIONS)}, got {sorted(unknown)}")
        for name, values in (("expected_returns", self.expected_returns), ("state", self.state)):
            object.__setattr__(self, name, {key: self._fit(name, value, np.uint8) for key, value in values.items()})
        masks = {key: self._fit(key, value, np.bool_) for key, value in self.definitions.items()}
        object.__setattr__(self, "definitions", masks)

    def _fit(self, name: str, value: Any, dtype: type[np.generic]) -> NDArray[Any]:
        array = np.asarray(value)
        if array.shape != self.grid.shape or array.dtype != dtype:
            raise ValueError(f"{name} must be {dtype.__name__} {self.grid.shape}, got {array.dtype} {array.shape}")
        return frozen(array)

    def visible(self, target: Target | str = CAR) -> NDArray[np.bool_]:
        """Return the mask (cells, cells) of cells where ``target`` would have given ``min_returns`` or more returns.

        Raises:
            ValueError: the truth has no expected returns of this target.
        """
        known = TARGETS.get(target) if isinstance(target, str) else target
        if known is None or known.name not in self.expected_returns:
            raise ValueError(f"target must be a Target named {' or '.join(self.expected_returns)}, got {target!r}")
        mask: NDArray[np.bool_] = self.expected_returns[known.name] >= min(known.min_returns, MAX_COUNT)
        return mask
