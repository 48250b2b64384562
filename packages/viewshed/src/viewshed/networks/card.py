"""The card that travels with a network's weights: what must be known to use them. Needs no torch."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.visibility import TARGETS
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.networks.features import FEATURES, HISTORY_FEATURES, Bytes, FeatureContext, feature_maps, fold_maps
from viewshed.preprocess.history import History, history_of
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

_LAYOUT = "viewshed network"

_RENAMED_FEATURES = {"confirmed": "measured", "unexplained": "unresolved", "supported": "confirmations"}
"""Features by the names that files of version 0.3 have for them, and their names now."""


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
    # names of ``FEATURES``, what the network is shown; as many as the shape's channels
    inputs: tuple[str, ...] = ("counts",)
    trained: Mapping[str, str] = field(default_factory=dict)  # facts of the training, by name

    def __post_init__(self) -> None:
        self._check_shape()
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

    def _check_shape(self) -> None:
        if self.grid.cells % self.shape.divisor:
            raise ValueError(
                f"cells must divide by {self.shape.divisor} for depth {self.shape.depth} and fold {self.shape.fold}, "
                f"got {self.grid.cells}"
            )
        if len(set(self.inputs) & set(FEATURES)) != len(self.inputs) or len(self.inputs) != self.shape.channels:
            raise ValueError(
                f"inputs must be {self.shape.channels} different ones of {', '.join(FEATURES)}, got {list(self.inputs)}"
            )

    def input_of(self, sweep: Sweep) -> NDArray[Any]:
        """Return the network's input of ``sweep``; see :meth:`shown`.

        The sweep is turned level by its attitude (estimated where it has none) and cropped about the sensor. Of the
        ``counts`` null returns, nearer than 0.5 m, are left out; the vehicle's own roof counts, as in the published
        code.
        """
        return self.shown(self.maps_of(sweep))

    def seen(self, leveled: LeveledSweep, past: History | None = None) -> FeatureContext:
        """Return the context of a leveled sweep from which :func:`feature_maps` computes the features."""
        points, rotation = leveled.sweep.points, leveled.level_from_sensor.rotation
        counts = self._clipped(points, rotation) if "counts" in self.inputs else None
        return FeatureContext(leveled, self.grid, TARGETS[self.target], counts, past)

    @property
    def kind(self) -> str:
        """Kind of network: ``unet`` where it is shown counts alone, as published, else ``viewnet``."""
        return "unet" if self.inputs == ("counts",) else "viewnet"

    @property
    def uses_history(self) -> bool:
        """Whether earlier sweeps change what the network is shown."""
        return not set(HISTORY_FEATURES).isdisjoint(self.inputs)

    def maps_of(self, sweep: Sweep, earlier: Sequence[Sweep] = ()) -> Bytes:
        """Return what the network is shown of ``sweep`` as bytes (channels, cells, cells); see :meth:`shown`.

        ``earlier`` sweeps of the same sensor tell of the past.

        Raises:
            ValueError: there are earlier sweeps, and one of all has no pose.
        """
        attitude = sweep.known_attitude
        if attitude is None or self.inputs != ("counts",):
            leveled = level(sweep, self.grid)
            past = history_of(leveled, earlier, self.grid) if self.uses_history else None
            return feature_maps(self.inputs, self.seen(leveled, past))
        return self._clipped(sweep.points, rotation_from_quaternion(attitude))[None]

    @property
    def precision(self) -> str:
        """What the network multiplies: ``f32``, or ``int8`` for one in bytes."""
        return INT8 if self.trained.get("precision") == INT8 else "f32"

    @property
    def input_shape(self) -> tuple[int, int, int]:
        """Shape of one input: (channels, cells, cells), or for a network in bytes folded and with channels last."""
        if self.precision != INT8:
            return self.shape.channels, *self.grid.shape
        side = self.grid.cells // self.shape.fold
        return side, side, self.shape.channels * self.shape.fold**2

    def shown(self, maps: Bytes) -> NDArray[Any]:
        """Return the network's input of what :meth:`maps_of` returns, of :attr:`input_shape`: float32, or bytes."""
        if self.precision == INT8:
            return self._folded(maps)
        found = np.empty(maps.shape, np.float32)
        for name, codes, out in zip(self.inputs, maps, found, strict=True):
            if name == "counts":
                np.take(self._of_counts(), codes, out=out, mode="clip")
            else:
                np.multiply(codes, np.float32(1.0 / 255.0), out=out, dtype=np.float32)
        return found

    @property
    def most_shown(self) -> NDArray[np.float32]:
        """Value (channels,) that byte 255 stands for in the input of a network in bytes."""
        linear = np.float32(255.0 / self.divisor if self.counts == "linear" else 1.0)
        return np.array([linear if name == "counts" else 1.0 for name in self.inputs], np.float32)

    def input_of_context(self, context: FeatureContext) -> NDArray[Any]:
        """Return the network's input, of :attr:`input_shape`, from what its features are computed from."""
        if self.precision == INT8 and "counts" not in self.inputs:
            return feature_maps(self.inputs, context, self.shape.fold)
        return self.shown(feature_maps(self.inputs, context))

    def _folded(self, maps: Bytes) -> Bytes:
        if "counts" in self.inputs and self.counts == "log":
            codes, maps = np.round(self._of_counts() * np.float32(255.0)).astype(np.uint8), maps.copy()
            counts = maps[self.inputs.index("counts")]
            counts[:] = codes[counts]
        return fold_maps(maps, self.shape.fold)

    def _of_counts(self) -> NDArray[np.float32]:
        """Return (256,) as what each number of returns is shown."""
        each = np.arange(256)
        shown = np.log1p(each) / np.log1p(self.clip) if self.counts == "log" else each / self.divisor
        return shown.astype(np.float32)

    def _clipped(self, points: NDArray[np.float32], rotation: NDArray[np.float64]) -> Bytes:
        counts = self.grid.count(
            points,
            Rigid(rotation, np.zeros(3)),
            max_range_m=self.max_range_m,
            height_m=self.heights_m,
            null_range_m=NULL_RANGE_M,
        )
        return np.minimum(counts, self.clip, out=counts).astype(np.uint8)

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
        shape = {**content.pop("shape")}
        shape.pop("doubt", None)  # older files: whether there is a second head, which is not read
        low, high = content.pop("heights_m")
        grid, inputs = content.pop("grid"), tuple(_RENAMED_FEATURES.get(name, name) for name in content.pop("inputs"))
        x, y = grid["offset_m"]
        return NetworkCard(
            shape=UNetShape(**shape),
            grid=BevGrid(grid["cells"], grid["half_extent_m"], (x, y)),
            heights_m=(low, high),
            inputs=inputs,
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

    def run(self, inputs: NDArray[Any], masks: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return probabilities (N, cells, cells) of inputs (N, channels, cells, cells), dropout off or by masks (N, M).

        A network in bytes takes its inputs as :meth:`NetworkCard.shown` gives them.

        One input with N masks is as good as N copies of it, and faster: what no mask touches is computed once.
        """
        ...

    def single_threaded(self) -> Runner | None:
        """Return a runner of the same network that runs in the calling thread alone; None if there is none."""
        ...
