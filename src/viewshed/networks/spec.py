"""What a network is: its shape, its dropout masks, and the card that travels with its weights. Needs numpy alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.level import NULL_RANGE_M, level_sweep
from viewshed.sweep import Sweep
from viewshed.visible import TARGETS

FORMAT_VERSION = 2
"""Version of the card; files of another one are refused."""
TRUTHS = ("probe", "paper_label")
"""What a network was taught: the exact truth of placed probes, or the label of arXiv 2503.07375."""
COUNTS = ("linear", "log")
"""How the returns of a cell are shown: count / divisor, as published, or its logarithm."""
_LAYOUT = "viewshed network"


@dataclass(frozen=True, slots=True)
class UNetShape:
    """Shape of the U-Net of arXiv 2503.07375 : ``width · 2^i`` channels after i poolings.

    Attributes:
        width: channels of the first stage, 1 to 256.
        depth: poolings, 1 to 8.
        dropout: share of channels that a mask sets to zero, in [0, 1).
        channels: channels of the input.

    >>> UNetShape().parameters, sum(UNetShape().masked_channels)
    (486409, 352)
    """

    width: int = 8
    depth: int = 4
    dropout: float = 0.1
    channels: int = 1

    def __post_init__(self) -> None:
        for name, low, high in (("width", 1, 256), ("depth", 1, 8), ("channels", 1, 64)):
            value = getattr(self, name)
            if not (isinstance(value, int) and low <= value <= high):
                raise ValueError(f"{name} must be a whole number in [{low}, {high}], got {value!r}")
        if not 0.0 <= self.dropout < 1.0:
            raise ValueError(f"dropout must lie in [0, 1), got {self.dropout}")

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of the encoder's stages and, last, of the bottleneck."""
        return tuple(self.width << i for i in range(self.depth + 1))

    @property
    def masked_channels(self) -> tuple[int, ...]:
        """Channels of each masked stage in the order of a mask: encoder from stage 2, bottleneck, decoder but its last.

        >>> UNetShape(8, 4).masked_channels
        (16, 32, 64, 128, 64, 32, 16)
        """
        return (*self.widths[1:], *self.widths[-2:0:-1])

    def masks(self, passes: int, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return masks (passes, M) for Monte Carlo dropout: 0 with probability ``dropout``, else 1 / (1 - dropout)."""
        if passes < 1:
            raise ValueError(f"passes must be at least 1, got {passes}")
        kept = rng.random((passes, sum(self.masked_channels)), dtype=np.float32) >= np.float32(self.dropout)
        return kept.astype(np.float32) * np.float32(1.0 / (1.0 - self.dropout))

    def no_masks(self, count: int) -> NDArray[np.float32]:
        """Return masks (count, M) that change nothing: dropout off."""
        return np.ones((count, sum(self.masked_channels)), np.float32)

    @property
    def parameters(self) -> int:
        """Number of trained numbers: convolutions, batch normalization (2 a channel), biases where none follows."""
        total = self.width + 1
        for inner, outer in self._stages():
            total += 9 * inner * outer + 9 * outer * outer + 4 * outer
        return total + sum(4 * 2 * w * w + w for w in self.widths[:-1])

    def flops(self, cells: int) -> int:
        """Return the multiplications and additions in convolutions of one pass over (cells, cells)."""
        stages = [9 * (inner + outer) * outer for inner, outer in self._stages()]
        macs = sum(each * (cells >> i) ** 2 for each, i in zip(stages, self._levels(), strict=True))
        macs += sum(2 * w * w * (cells >> i) ** 2 for i, w in enumerate(self.widths[:-1]))
        return 2 * (macs + self.width * cells**2)

    def _stages(self) -> list[tuple[int, int]]:
        """Channels in and out of each stage, encoder, bottleneck, decoder from deep to shallow."""
        down = list(zip((self.channels, *self.widths[:-1]), self.widths, strict=True))
        return down + [(2 * w, w) for w in self.widths[-2::-1]]

    def _levels(self) -> list[int]:
        return [*range(self.depth + 1), *range(self.depth - 1, -1, -1)]


@dataclass(frozen=True, slots=True)
class NetworkCard:
    """What must be known to use a network's weights; travels inside the file.

    Attributes:
        name: name of the weights.
        shape: of the network.
        grid: on which it was trained; its cells must divide by ``2^depth``.
        target: name of what would have to be seen.
        truth: what it was taught, one of ``TRUTHS``.
        max_range_m: horizontal range up to which returns count; nothing is claimed beyond.
        heights_m: lowest and highest z from the SENSOR, in its level attitude, between which returns count.
        clip: returns of a cell above which counting stops.
        divisor: counts are divided by it, where they are shown ``linear``.
        counts: how they are shown, one of ``COUNTS``; ``log`` is log(1 + count) / log(1 + clip).
        threshold: probability from which a cell counts as visible.
        trained: facts of the training, by name.

    Raises:
        ValueError: a value lies outside its range; the message says which.
    """

    name: str
    shape: UNetShape = field(default_factory=UNetShape)
    grid: BevGrid = field(default_factory=BevGrid)
    target: str = "car"
    truth: str = "probe"
    max_range_m: float = 100.0
    heights_m: tuple[float, float] = (-3.0, 3.0)
    clip: int = 255
    divisor: float = 1000.0
    counts: str = "linear"
    threshold: float = 0.5
    trained: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.grid.cells % (1 << self.shape.depth):
            raise ValueError(
                f"cells must divide by {1 << self.shape.depth} for depth {self.shape.depth}, got {self.grid.cells}"
            )
        for name, known in (("target", tuple(TARGETS)), ("truth", TRUTHS), ("counts", COUNTS)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        for name in ("max_range_m", "clip", "divisor"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not self.heights_m[0] < self.heights_m[1]:
            raise ValueError(f"heights_m must be (low, high) with low < high, got {self.heights_m}")
        if not 0.0 < self.threshold <= 1.0:
            raise ValueError(f"threshold must lie in (0, 1], got {self.threshold}")

    def input_of(self, sweep: Sweep) -> NDArray[np.float32]:
        """Return the network's input (1, cells, cells) of ``sweep``: returns of each cell, clipped and scaled.

        The sweep is turned level by its attitude (estimated where it has none) and cropped about the sensor. Null
        returns, nearer than 0.5 m, are left out; the vehicle's own roof counts, as in the published code.
        """
        return self.shown(self.counts_of(sweep))

    def input_of_points(self, points: NDArray[np.float32], rotation: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the network's input (1, cells, cells) of points (N, 3), turned level by ``rotation`` (3, 3)."""
        return self.shown(self._clipped(points, rotation))

    def counts_of(self, sweep: Sweep) -> NDArray[np.int32]:
        """Return the returns of ``sweep`` in each cell (cells, cells), clipped; see :meth:`input_of`."""
        attitude = sweep.known_attitude
        if attitude is None:
            rotation = level_sweep(sweep, self.grid).level_from_sensor.rotation
        else:
            rotation = rotation_from_quaternion(attitude)
        return self._clipped(sweep.points, rotation)

    def shown(self, counts: NDArray[np.integer]) -> NDArray[np.float32]:
        """Return the network's input (1, cells, cells) of clipped counts (cells, cells)."""
        each = np.arange(self.clip + 1)
        if self.counts == "log":
            scaled: NDArray[np.float32] = (np.log1p(each) / np.log1p(self.clip)).astype(np.float32)
        else:
            scaled = each.astype(np.float32) / np.float32(self.divisor)
        shown: NDArray[np.float32] = scaled[counts][None]
        return shown

    def _clipped(self, points: NDArray[np.float32], rotation: NDArray[np.float64]) -> NDArray[np.int32]:
        counts = self._counts(points, rotation)
        near = np.flatnonzero((np.abs(points[:, 0]) < NULL_RANGE_M) & (np.abs(points[:, 1]) < NULL_RANGE_M))
        null = near[np.square(points[near]).sum(axis=1) < NULL_RANGE_M**2]
        if len(null):
            counts = counts - self._counts(points[null], rotation)
        return np.minimum(counts, self.clip)

    def _counts(self, points: NDArray[np.float32], rotation: NDArray[np.float64]) -> NDArray[np.int32]:
        level = Rigid(rotation, np.zeros(3))
        return self.grid.count(points, level, max_range_m=self.max_range_m, height_m=self.heights_m)

    def require(self, grid: BevGrid, target: str) -> None:
        """Raise a ValueError unless the network was trained for this grid and for the target of this name."""
        if grid != self.grid:
            raise ValueError(
                f"grid must be {_words(self.grid)} for the network {self.name}, got {_words(grid)}; ask for that"
                " grid, or train a network for yours"
            )
        if target != self.target:
            raise ValueError(
                f"target must be {self.target} for the network {self.name}, got {target}; train a network for yours"
            )

    def to_json(self) -> str:
        """Return the card as JSON."""
        content = {"layout": _LAYOUT, "version": FORMAT_VERSION, **asdict(self), "trained": dict(self.trained)}
        return json.dumps(content, allow_nan=False, ensure_ascii=False, indent=1)

    @classmethod
    def from_json(cls, text: str) -> NetworkCard:
        """Return the card that :meth:`to_json` wrote.

        Raises:
            ValueError: it is no card, or one of another version.
        """
        try:
            content: Any = json.loads(text)
        except json.JSONDecodeError as error:
            raise ValueError(f"card must be JSON, got {text[:40]!r} ({error.msg})") from error
        if not isinstance(content, dict) or content.pop("layout", None) != _LAYOUT:
            raise ValueError("card must be a viewshed network's; export the network with viewshed train")
        version = content.pop("version", None)
        if version != FORMAT_VERSION:
            raise ValueError(
                f"network must have format version {FORMAT_VERSION}, got {version}; train it again with this version"
                " of viewshed, or use the version that wrote it"
            )
        return _card_of(content)


def _words(grid: BevGrid) -> str:
    offset = "" if grid.offset_m == (0.0, 0.0) else f" about {grid.offset_m[0]:g},{grid.offset_m[1]:g} m"
    return f"{grid.cells}x{grid.half_extent_m:g}{offset}"


def _card_of(content: dict[str, Any]) -> NetworkCard:
    names = {each.name for each in fields(NetworkCard)}
    if set(content) != names:
        raise ValueError(f"card must have the fields {', '.join(sorted(names))}, got {', '.join(sorted(content))}")
    try:
        low, high = content.pop("heights_m")
        grid = content.pop("grid")
        x, y = grid["offset_m"]
        return NetworkCard(
            shape=UNetShape(**content.pop("shape")),
            grid=BevGrid(grid["cells"], grid["half_extent_m"], (x, y)),
            heights_m=(low, high),
            **content,
        )
    except (TypeError, KeyError) as error:
        raise ValueError(f"card must be whole, got one that is damaged ({error}); export the network again") from error


class Runner(Protocol):
    """Anything that runs a network: torch while training, an engine without torch afterwards."""

    @property
    def card(self) -> NetworkCard:
        """What the network is."""
        ...

    def run(self, inputs: NDArray[np.float32], masks: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return probabilities (N, cells, cells) of inputs (N, channels, cells, cells) under masks (N, M).

        One input with N masks is as good as N copies of it, and faster: what no mask touches is computed once.
        """
        ...
