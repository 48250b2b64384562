"""NetworkCard: metadata in a network's file that is needed to use its weights. Imports no torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from operator import index
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.visibility import TARGETS
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.preprocess.leveling import NULL_RANGE_M, LeveledSweep, level
from viewshed.sweep import Sweep

FORMAT_VERSION = 3
"""Format version of the card; files of other versions are refused."""

TRUTHS = ("probe", "paper_label")
"""Training labels: the exact truth by placed probes, or the label of arXiv 2503.07375."""

COUNTS = ("linear", "log")
"""Encoding of the number of returns per cell: count / divisor, as published, or logarithmic."""

INT8 = "int8"
"""Value of ``trained["precision"]`` of a network with int8 input and arithmetic."""

Bytes = NDArray[np.uint8]

_LAYOUT = "viewshed network"

_PUBLISHED = {"channels": 1, "fold": 1}
"""Additional fields of ``shape`` in cards of version 0.3: input channels, cells per side of a folded block."""


@dataclass(frozen=True, slots=True)
class NetworkCard:
    """Metadata of a network: shape, grid, target, encoding of the input, threshold; stored in the network's file.

    Raises:
        ValueError: a value is out of range; the message names it.
    """

    name: str  # name of the weights
    shape: UNetShape = field(default_factory=UNetShape)  # shape of the network
    grid: BevGrid = field(default_factory=BevGrid)  # grid of the training; its cells must be a multiple of ``2^depth``
    target: str = "car"  # name of the target
    truth: str = "probe"  # labels of the training, one of ``TRUTHS``
    max_range_m: float = 100.0  # horizontal range up to which returns count; no cell beyond is claimed
    # lowest and highest z of a counted return, from the SENSOR, after leveling
    heights_m: tuple[float, float] = (-3.0, 3.0)
    clip: int = 255  # counts of a cell are clipped to this
    divisor: float = 1000.0  # divisor of counts in the encoding ``linear``
    counts: str = "linear"  # encoding of counts, one of ``COUNTS``; ``log`` is log(1 + count) / log(1 + clip)
    threshold: float = 0.5  # minimum probability of a visible cell
    trained: Mapping[str, str] = field(default_factory=dict)  # facts about the training, by name

    def __post_init__(self) -> None:
        if self.grid.cells % self.shape.divisor:
            raise ValueError(
                f"cells must divide by {self.shape.divisor} for depth {self.shape.depth}, got {self.grid.cells}"
            )
        for name, known in (("target", tuple(TARGETS)), ("truth", TRUTHS), ("counts", COUNTS)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        for name, high in (("max_range_m", np.inf), ("clip", 255), ("divisor", np.inf)):
            if not 0 < getattr(self, name) <= high:
                rule = "positive" if high == np.inf else f"in [1, {high}]"
                raise ValueError(f"{name} must be {rule}, got {getattr(self, name)}")
        if not self.heights_m[0] < self.heights_m[1]:
            raise ValueError(f"heights_m must be (low, high) with low < high, got {self.heights_m}")
        if not 0.0 < self.threshold <= 1.0:
            raise ValueError(f"threshold must lie in (0, 1], got {self.threshold}")

    def input_of(self, sweep: Sweep | LeveledSweep) -> NDArray[Any]:
        """Return the network's input for ``sweep``, encoded by :meth:`shown`.

        The sweep is leveled by its attitude (estimated if it has none) and cropped around the sensor. Null returns,
        nearer than 0.5 m, are dropped; returns from the vehicle's own roof count, as in the published code.
        """
        return self.shown(self.maps_of(sweep))

    def maps_of(self, sweep: Sweep | LeveledSweep) -> Bytes:
        """Return the number of returns in each cell, (1, cells, cells) uint8, clipped to ``clip``."""
        if isinstance(sweep, LeveledSweep):
            return self._count(sweep.sweep.points, sweep.level_from_sensor.rotation)
        attitude = sweep.known_attitude
        if attitude is None:
            return self.maps_of(level(sweep, self.grid))
        return self._count(sweep.points, rotation_from_quaternion(attitude))

    @property
    def precision(self) -> str:
        """Precision of the arithmetic: ``f32`` or ``int8``."""
        return INT8 if self.trained.get("precision") == INT8 else "f32"

    @property
    def input_shape(self) -> tuple[int, int, int]:
        """Shape of one input: (1, cells, cells), or (cells, cells, 1) for an int8 network."""
        return (1, *self.grid.shape) if self.precision != INT8 else (*self.grid.shape, 1)

    def shown(self, maps: Bytes) -> NDArray[Any]:
        """Encode the counts of :meth:`maps_of` as network input of :attr:`input_shape`: float32, or uint8 for int8."""
        if self.precision != INT8:
            return np.take(self._count_codes(), maps, mode="clip")
        if self.counts == "log":
            codes = np.round(self._count_codes() * np.float32(255.0)).astype(np.uint8)[maps]
        else:
            codes = np.minimum(maps, self.clip)
        return codes.reshape(self.input_shape)

    @property
    def max_input(self) -> np.float32:
        """Value that byte 255 represents in the input of an int8 network."""
        return np.float32(255.0 / self.divisor if self.counts == "linear" else 1.0)

    def _count_codes(self) -> NDArray[np.float32]:
        """Return the lookup table (256,) from a number of returns to its encoding."""
        counts = np.minimum(np.arange(256), self.clip)
        codes = np.log1p(counts) / np.log1p(self.clip) if self.counts == "log" else counts / self.divisor
        return codes.astype(np.float32)

    def _count(self, points: NDArray[np.float32], rotation: NDArray[np.float64]) -> Bytes:
        counts = self.grid.count(
            points,
            Rigid(rotation, np.zeros(3)),
            max_range_m=self.max_range_m,
            height_m=self.heights_m,
            null_range_m=NULL_RANGE_M,
        )
        return np.minimum(counts, self.clip, out=counts).astype(np.uint8)[None]

    def require(self, grid: BevGrid, target: str) -> None:
        """Raise ValueError unless the network was trained for this grid and target name."""
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
        """Return the card from the output of :meth:`to_json`.

        Raises:
            ValueError: ``text`` is no card, or a card of another version.
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
    names = {item.name for item in fields(NetworkCard)}
    inputs = content.pop("inputs", ["counts"])
    if set(content) != names:
        raise ValueError(f"card must have the fields {', '.join(sorted(names))}, got {', '.join(sorted(content))}")
    try:
        shape = {**content.pop("shape")}
        shape.pop("doubt", None)  # older files: whether there is a second head, which is ignored
        published = {name: shape.pop(name, value) for name, value in _PUBLISHED.items()}
        if inputs != ["counts"] or published != _PUBLISHED:
            raise ValueError(
                "network must take only counts as input, without a fold, for this version to run it, got inputs"
                f" {inputs} and fold {published['fold']}; use shadow_map"
            )
        low, high = (0.0 + height for height in content.pop("heights_m"))
        grid, trained, name = (content.pop(key) for key in ("grid", "trained", "name"))
        if not name.isprintable():
            raise TypeError("name")
        x, y = grid["offset_m"]
        return NetworkCard(
            name,
            UNetShape(**shape),
            BevGrid(index(grid["cells"]), grid["half_extent_m"], (x, y)),
            heights_m=(low, high),
            clip=index(content.pop("clip")),
            trained={key: str(value) for key, value in trained.items()},
            **content,
        )
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"card must be whole, got one that is damaged ({error}); export the network again") from error


class Runner(Protocol):
    """Protocol of inference: torch during training, ONNX Runtime afterwards."""

    @property
    def card(self) -> NetworkCard:
        """The network's card."""
        ...

    def run(self, inputs: NDArray[Any], masks: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return probabilities (N, cells, cells) of inputs (N, 1, cells, cells), without dropout or by masks (N, M).

        Inputs are encoded by :meth:`NetworkCard.shown`; an int8 network takes (N, cells, cells, 1) uint8.

        One input with N masks equals N copies of it, but is faster: layers before the first mask run once.
        """
        ...

    def single_threaded(self) -> Runner | None:
        """Return a runner of the same network that uses only the calling thread; None if there is none."""
        ...
