"""Architecture of the U-Net and its dropout masks. Imports only numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class UNetShape:
    """Shape of the U-Net of arXiv 2503.07375 with one input channel: ``width · 2^i`` channels after i poolings.

    >>> UNetShape().parameters, sum(UNetShape().masked_channels)
    (486409, 352)
    """

    width: int = 8  # channels of the first stage, 1 to 256
    depth: int = 4  # poolings, 1 to 8
    dropout: float = 0.1  # probability that a mask sets a channel to zero, in [0, 1)

    def __post_init__(self) -> None:
        for name, high in (("width", 256), ("depth", 8)):
            value = getattr(self, name)
            if not (isinstance(value, int) and 1 <= value <= high):
                raise ValueError(f"{name} must be a whole number in [1, {high}], got {value!r}")
        if not 0.0 <= self.dropout < 1.0:
            raise ValueError(f"dropout must lie in [0, 1), got {self.dropout}")

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of each encoder stage and, last, of the bottleneck."""
        return tuple(self.width << i for i in range(self.depth + 1))

    @property
    def masked_channels(self) -> tuple[int, ...]:
        """Channels of each masked stage, in mask order: encoder from stage 2, bottleneck, decoder without its last.

        >>> UNetShape(8, 4).masked_channels
        (16, 32, 64, 128, 64, 32, 16)
        """
        return (*self.widths[1:], *self.widths[-2:0:-1])

    def masks(self, passes: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return masks (passes, M) for Monte Carlo dropout: 0 with probability ``dropout``, else 1 / (1 - dropout).

        The masks are balanced by Latin hypercube sampling (McKay, Beckman and Conover 1979): each channel is dropped in
        a share ``dropout`` of the passes, up to rounding. The mean over 10 balanced masks is nearer to the limit of
        many passes than the mean over 20 independent ones.
        """
        if passes < 1:
            raise ValueError(f"passes must be at least 1, got {passes}")
        uniform = rng.random((passes, sum(self.masked_channels)), dtype=np.float32)
        # Stratify each channel: one sample in each of `passes` equal strata of [0, 1), in random order.
        stratum = rng.permuted(np.broadcast_to(np.arange(passes)[:, None], uniform.shape), axis=0).astype(np.float32)
        keep = (stratum + uniform) / np.float32(passes) >= np.float32(self.dropout)
        return keep.astype(np.float32) * np.float32(1.0 / (1.0 - self.dropout))

    def no_masks(self, count: int) -> NDArray[np.float32]:
        """Return masks (count, M) of ones: dropout off."""
        return np.ones((count, sum(self.masked_channels)), np.float32)

    @property
    def parameters(self) -> int:
        """Number of parameters: convolutions, batch normalization (2 per channel), biases where none follows."""
        total = self.width + 1
        for inner, outer in self._stages():
            total += 9 * inner * outer + 9 * outer * outer + 4 * outer
        return total + sum(4 * 2 * w * w + w for w in self.widths[:-1])

    def flops(self, cells: int) -> int:
        """Return the multiplications and additions in convolutions of one pass over (cells, cells)."""
        stages = [9 * (inner + outer) * outer for inner, outer in self._stages()]
        macs = sum(products * (cells >> i) ** 2 for products, i in zip(stages, self._levels(), strict=True))
        macs += sum(2 * w * w * (cells >> i) ** 2 for i, w in enumerate(self.widths[:-1]))
        return 2 * (macs + self.width * cells**2)

    @property
    def divisor(self) -> int:
        """Divisor of the number of cells per side: 2^depth."""
        return 1 << self.depth

    def _stages(self) -> list[tuple[int, int]]:
        """Return (input, output) channels of each stage: encoder, bottleneck, decoder from deep to shallow."""
        down = list(zip((1, *self.widths[:-1]), self.widths, strict=True))
        return down + [(2 * w, w) for w in self.widths[-2::-1]]

    def _levels(self) -> list[int]:
        return [*range(self.depth + 1), *range(self.depth - 1, -1, -1)]
