"""Classify candidates by shape: a small network with two hidden layers, trained in simulated worlds."""

from __future__ import annotations

import io
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from viewshed import _core
from viewshed._files import write_atomic
from viewshed.arrays import F32
from viewshed.detections import ObjectKind
from viewshed.objects.candidates import SHAPES

SHIPPED = Path(__file__).with_name("shapes.npz")
"""Shipped classifier."""


class SeenAs(IntEnum):
    """Class of a candidate; for vehicles, whether its long side is the vehicle's side or only an end."""

    OTHER = 0
    PEDESTRIAN = 1
    CYCLIST = 2
    CAR_SIDE = 3
    CAR_END = 4
    TRUCK_SIDE = 5
    TRUCK_END = 6
    NOTHING = 7


KIND_SEEN_AS = np.array(
    [
        ObjectKind.OTHER, ObjectKind.PEDESTRIAN, ObjectKind.CYCLIST, ObjectKind.CAR, ObjectKind.CAR,
        ObjectKind.TRUCK, ObjectKind.TRUCK,
    ],
    np.uint8,
)  # fmt: skip
"""Kind of each member of :class:`SeenAs` but ``NOTHING``."""

ENDS = (SeenAs.CAR_END, SeenAs.TRUCK_END)
"""Members whose long side is the vehicle's width."""


@dataclass(frozen=True, slots=True, eq=False)
class ShapeClassifier:
    """Network over standardized shape features: linear, ReLU, linear, ReLU, linear, softmax.

    Standardized features are clipped to six standard deviations.

    Raises:
        ValueError: the shapes of the arrays are inconsistent, or a number is not finite.
    """

    mean: F32  # (S,) mean of each feature
    scale: F32  # (S,) factor on the deviation from the mean
    weights: tuple[F32, ...]  # matrices (S, H), (H, G) and (G, 8)
    biases: tuple[F32, ...]  # (H,), (G,) and (8,)

    def __post_init__(self) -> None:
        sizes = [len(SHAPES), *(bias.size for bias in self.biases)]
        arrays = (self.mean, self.scale, *self.weights, *self.biases)
        fits = [weight.shape for weight in self.weights] == list(pairwise(sizes)) and sizes[-1] == len(SeenAs)
        if not fits or self.mean.shape != (len(SHAPES),) or self.scale.shape != (len(SHAPES),):
            raise ValueError(
                f"the classifier must take {len(SHAPES)} shapes and give {len(SeenAs)} classes; fit it again"
            )
        if not all(np.isfinite(array).all() for array in arrays):
            raise ValueError("the classifier must be finite; fit it again")

    def probabilities(self, shapes: F32) -> F32:
        """Return the probability (C, 8) of each member of :class:`SeenAs` for candidates with features (C, S)."""
        layers = (array for pair in zip(self.weights, self.biases, strict=True) for array in pair)
        return _core.shape_probabilities(shapes, self.mean, self.scale, *layers)

    def save(self, path: Path) -> None:
        """Write the classifier as an NPZ file."""
        buffer = io.BytesIO()
        layers = {f"weight_{k}": weight for k, weight in enumerate(self.weights)}
        layers |= {f"bias_{k}": bias for k, bias in enumerate(self.biases)}
        np.savez(buffer, allow_pickle=False, mean=self.mean, scale=self.scale, **layers)
        write_atomic(path, buffer.getvalue())

    @classmethod
    def load(cls, path: Path) -> ShapeClassifier:
        """Return the classifier in a file that :meth:`save` wrote."""
        with np.load(path, allow_pickle=False) as file:
            layers = sum(name.startswith("weight_") for name in file.files)
            weights = tuple(file[f"weight_{k}"] for k in range(layers))
            return cls(file["mean"], file["scale"], weights, tuple(file[f"bias_{k}"] for k in range(layers)))


@lru_cache(maxsize=1)
def shipped_classifier() -> ShapeClassifier:
    """Return the shipped classifier; it is read once."""
    return ShapeClassifier.load(SHIPPED)
