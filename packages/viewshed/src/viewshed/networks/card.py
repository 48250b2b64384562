"""The card that travels with a network's weights: what must be known to use them. Needs no torch."""

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
"""Version of the card; files of another one are refused."""

TRUTHS = ("probe", "paper_label")
"""What a network was taught: the exact truth of placed probes, or the label of arXiv 2503.07375."""

COUNTS = ("linear", "log")
"""How the returns of a cell are shown: count / divisor, as published, or its logarithm."""

INT8 = "int8"
"""What the facts of a training say of the ``precision`` of a network that takes and multiplies bytes."""

Bytes = NDArray[np.uint8]

_LAYOUT = "viewshed network"

_PUBLISHED = {"channels": 1, "fold": 1}
"""What cards of version 0.3 say beside of a shape: how many maps are shown, and blocks of cells folded into one."""


@dataclass(frozen=True, slots=True)
class NetworkCard:
    """What must be known to use a network's weights; travels inside the file.

    Raises:
        ValueError: a value lies outside its range; the message says which.
    """

    name: str  # name of the weights
    shape: UNetShape = field(default_factory=UNetShape)  # of the network
    grid: BevGrid = field(default_factory=BevGrid)  # on which it was trained; its cells must divide by ``2^depth``
    target: str = "car"  # name of what would have to be seen
    truth: str = "probe"  # what it was taught, one of ``TRUTHS``
    max_range_m: float = 100.0  # horizontal range up to which returns count; nothing is claimed beyond
    # lowest and highest z from the SENSOR, in its level attitude, between which returns count
    heights_m: tuple[float, float] = (-3.0, 3.0)
    clip: int = 255  # returns of a cell above which counting stops
    divisor: float = 1000.0  # counts are divided by it, where they are shown ``linear``
    counts: str = "linear"  # how they are shown, one of ``COUNTS``; ``log`` is log(1 + count) / log(1 + clip)
    threshold: float = 0.5  # probability from which a cell counts as visible
    trained: Mapping[str, str] = field(default_factory=dict)  # facts of the training, by name

    def __post_init__(self) -> None:
        if self.grid.cells % self.shape.divisor:
            raise ValueError(
                f"cells must divide by {self.shape.divisor} for depth {self.shape.depth}, got {self.grid.cells}"
            )
        for name, known in (("target", tuple(TARGETS)), ("truth", TRUTHS), ("counts", COUNTS)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        for name, most in (("max_range_m", np.inf), ("clip", 255), ("divisor", np.inf)):
            if not 0 < getattr(self, name) <= most:
                rule = "positive" if most == np.inf else f"in [1, {most}]"
                raise ValueError(f"{name} must be {rule}, got {getattr(self, name)}")
        if not self.heights_m[0] < self.heights_m[1]:
            raise ValueError(f"heights_m must be (low, high) with low < high, got {self.heights_m}")
        if not 0.0 < self.threshold <= 1.0:
            raise ValueError(f"threshold must lie in (0, 1], got {self.threshold}")

    def input_of(self, sweep: Sweep | LeveledSweep) -> NDArray[Any]:
        """Return the network's input of ``sweep``; see :meth:`shown`.

        The sweep is turned level by its attitude (estimated where it has none) and cropped about the sensor. Null
        returns, nearer than 0.5 m, are left out; the vehicle's own roof counts, as in the published code.
        """
        return self.shown(self.maps_of(sweep))

    def maps_of(self, sweep: Sweep | LeveledSweep) -> Bytes:
        """Return what the network is shown of a sweep as bytes (1, cells, cells), its counts; see :meth:`shown`."""
        if isinstance(sweep, LeveledSweep):
            return self._counted(sweep.sweep.points, sweep.level_from_sensor.rotation)
        attitude = sweep.known_attitude
        if attitude is None:
            return self.maps_of(level(sweep, self.grid))
        return self._counted(sweep.points, rotation_from_quaternion(attitude))

    @property
    def precision(self) -> str:
        """What the network multiplies: ``f32``, or ``int8`` for one in bytes."""
        return INT8 if self.trained.get("precision") == INT8 else "f32"

    @property
    def input_shape(self) -> tuple[int, int, int]:
        """Shape of one input: (1, cells, cells), or for a network in bytes (cells, cells, 1)."""
        return (1, *self.grid.shape) if self.precision != INT8 else (*self.grid.shape, 1)

    def shown(self, maps: Bytes) -> NDArray[Any]:
        """Return the network's input of what :meth:`maps_of` returns, of :attr:`input_shape`: float32, or bytes."""
        if self.precision != INT8:
            return np.take(self._of_counts(), maps, mode="clip")
        if self.counts == "log":
            codes = np.round(self._of_counts() * np.float32(255.0)).astype(np.uint8)[maps]
        else:
            codes = np.minimum(maps, self.clip)
        return codes.reshape(self.input_shape)

    @property
    def most_shown(self) -> np.float32:
        """Value that byte 255 stands for in the input of a network in bytes."""
        return np.float32(255.0 / self.divisor if self.counts == "linear" else 1.0)

    def _of_counts(self) -> NDArray[np.float32]:
        """Return (256,) as what each number of returns is shown."""
        each = np.minimum(np.arange(256), self.clip)
        shown = np.log1p(each) / np.log1p(self.clip) if self.counts == "log" else each / self.divisor
        return shown.astype(np.float32)

    def _counted(self, points: NDArray[np.float32], rotation: NDArray[np.float64]) -> Bytes:
        counts = self.grid.count(
            points,
            Rigid(rotation, np.zeros(3)),
            max_range_m=self.max_range_m,
            height_m=self.heights_m,
            null_range_m=NULL_RANGE_M,
        )
        return np.minimum(counts, self.clip, out=counts).astype(np.uint8)[None]

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
    inputs = content.pop("inputs", ["counts"])
    if set(content) != names:
        raise ValueError(f"card must have the fields {', '.join(sorted(names))}, got {', '.join(sorted(content))}")
    try:
        shape = {**content.pop("shape")}
        shape.pop("doubt", None)  # older files: whether there is a second head, which is not read
        beside = {name: shape.pop(name, value) for name, value in _PUBLISHED.items()}
        if inputs != ["counts"] or beside != _PUBLISHED:
            raise ValueError(
                "network must be shown the counts alone, without a fold, as this version runs it, got one shown"
                f" {inputs} with fold {beside['fold']}; use shadow_map"
            )
        low, high = (0.0 + each for each in content.pop("heights_m"))
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
    """Anything that runs a network: torch while training, an engine without torch afterwards."""

    @property
    def card(self) -> NetworkCard:
        """What the network is."""
        ...

    def run(self, inputs: NDArray[Any], masks: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return probabilities (N, cells, cells) of inputs (N, 1, cells, cells), dropout off or by masks (N, M).

        A network in bytes takes its inputs as :meth:`NetworkCard.shown` gives them.

        One input with N masks is as good as N copies of it, and faster: what no mask touches is computed once.
        """
        ...

    def single_threaded(self) -> Runner | None:
        """Return a runner of the same network that runs in the calling thread alone; None if there is none."""
        ...
