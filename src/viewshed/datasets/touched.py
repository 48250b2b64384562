"""Touched: the record of what an attacker did to a stored sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets import packing


@dataclass(frozen=True, slots=True, eq=False)
class Touched:
    """What an attacker did to the sweep of a frame, as :class:`viewshed.attacks.Tampered` says it.

    Attributes:
        added: (N,) bool, rows of the stored sweep that the attacker made.
        removed: (M,) bool, rows of the clean sweep that are gone.
        wedge: azimuth of its middle and width, radians, sensor frame; None if the attacker works anywhere.
    """

    added: NDArray[np.bool_]
    removed: NDArray[np.bool_]
    wedge: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("added", "removed"):
            mask = np.array(getattr(self, name), np.bool_).reshape(-1)
            mask.setflags(write=False)
            object.__setattr__(self, name, mask)

    def about(self) -> dict[str, Any]:
        """Return what is no mask, as plain values."""
        wedge = None if self.wedge is None else [float(value) for value in self.wedge]
        return {"added": len(self.added), "removed": len(self.removed), "wedge": wedge}

    def packed(self) -> bytes:
        """Return both masks, eight rows in each byte."""
        return packing.pack_masks(np.concatenate([self.added, self.removed])[None])

    @classmethod
    def unpacked(cls, about: dict[str, Any], raw: packing.Buffer) -> Touched:
        """Return the record of :meth:`about` and :meth:`packed`.

        Raises:
            ValueError: they do not fit each other.
        """
        rows, wedge = int(about["added"]), about["wedge"]
        masks = packing.unpack_masks(raw, (1, 1, rows + int(about["removed"])))[0, 0]
        return cls(masks[:rows], masks[rows:], None if wedge is None else (float(wedge[0]), float(wedge[1])))
