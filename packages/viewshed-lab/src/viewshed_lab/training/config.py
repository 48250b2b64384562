"""TrainConfig: all that decides what a trained network is, one flat TOML each. Needs no torch."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import COUNTS, TRUTHS, NetworkCard
from viewshed_lab import _config as flat
from viewshed_lab._config import Between, one_of
from viewshed_lab.data.presets import MAX_SEED, preset_named, preset_names
from viewshed_lab.threats.attacks import ATTACKS

PAPER = "paper"
"""Name of the mixture of arXiv 2503.07375, beside those of ``ATTACKS``."""

ROOM_M = 20.0
"""Grids up to this half extent are rooms: the paper's indoor label and attack."""

CHOICES: dict[str, tuple[str, ...]] = {
    "truth": TRUTHS, "variant": ("mle", "mcd"), "loss": ("bce", "bce_dice"), "schedule": ("constant", "cosine"),
    "precision": ("32", "bf16"), "counts": COUNTS,
}  # fmt: skip
"""What the keys that name one of a few may be."""

_LIMITS: dict[str, tuple[float, float]] = {
    "validation_share": (0.0, 0.9), "attack_share": (0.0, 1.0),
    "learning_rate": (1e-9, 10.0), "batch": (1, 4096), "epochs": (1, 100_000), "patience": (1, 100_000),
    "frames_per_epoch": (0, 10**9), "versions": (0, 1000),
    "workers": (0, 256), "threshold": (1e-6, 1.0), "seed": (0, MAX_SEED),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """How a network is trained. The same config gives the same weights on the same machine.

    Raises:
        ValueError: a name is not known or a number is out of range.
    """

    name: str  # of the weights
    about: str  # one line for people
    data: tuple[str, ...]  # names of presets, which are simulated, or places of archives; not both
    train_split: str  # the split that is used; a part of its scenes is for validation, other splits are never read
    validation_share: float  # share of the scenes that validate, at least one of each place
    cells: int  # cells a side of the network's grid
    half_extent_m: float  # half the side of that grid
    target: str  # what would have to be seen
    truth: str  # ``probe``, the exact truth, or ``paper_label``, the label of arXiv 2503.07375 of the clean sweep
    variant: str  # ``mcd`` trains with dropout, ``mle`` without
    # names of ``ATTACKS``, one of which is drawn for a frame, or ``paper``; none is benign training
    attacks: tuple[str, ...]
    attack_share: float  # share of the frames that are attacked (the paper's mixture leaves some of those alone)
    width: int  # channels of the first stage
    depth: int  # poolings
    dropout: float  # share of the channels that are dropped, for ``mcd``
    loss: str  # ``bce``, cross-entropy over the cells whose truth is known, or ``bce_dice``, with the Dice loss added
    learning_rate: float  # of Adam
    schedule: str  # of the learning rate: ``constant``, or ``cosine`` down to a hundredth at the last epoch
    batch: int  # frames of one step in each process
    epochs: int  # at most
    patience: int  # epochs without a lower validation loss after which training ends
    frames_per_epoch: int  # frames drawn for an epoch; 0 is all
    # 0 makes each frame whenever it is shown; n makes n versions of it, each attacked anew, once and for all, and shows
    # one of them in each epoch. They are kept beside the labels, and cost no time while training.
    versions: int
    mirrored: bool  # whether frames are turned by quarter turns and mirrored at random, which alters no truth
    precision: str  # ``32``, or ``bf16`` for the network's convolutions
    workers: int  # processes that prepare frames beside the one that trains
    threshold: float  # probability from which a cell counts as visible, in the scores and in the weights' card
    seed: int  # of everything random
    counts: str  # how the returns of a cell are shown: ``linear``, as published, or ``log``
    max_range_m: float  # returns up to this horizontal range count
    heights_m: tuple[float, float]  # lowest and highest z from the sensor at which returns count

    def __post_init__(self) -> None:
        for key, names in CHOICES.items():
            one_of(key, getattr(self, key), names)
        for key, (low, high) in _LIMITS.items():
            Between(low, high).check(key, getattr(self, key))
        for attack in self.attacks:
            if attack != PAPER and attack not in ATTACKS:
                raise ValueError(f"attacks must be among {PAPER}, {', '.join(ATTACKS)}, got {attack!r}")
        if (self.attack_share > 0) != bool(self.attacks):
            raise ValueError(
                f"attacks and attack_share must both be given or both be empty, got {list(self.attacks)} and "
                f"{self.attack_share:g}; benign training has attacks = [] and attack_share = 0"
            )
        simulated = [place for place in self.data if place in preset_names()]
        if not self.data or len(set(self.data)) != len(self.data):
            raise ValueError(f"data must name different presets or archives, got {list(self.data)}")
        if simulated and len(simulated) != len(self.data):
            raise ValueError(f"data must be presets or archives, not both, got {list(self.data)}")
        for place in simulated:
            if self.train_split not in preset_named(place).splits:
                known = ", ".join(preset_named(place).splits)
                raise ValueError(f"train_split must be one of {known} of {place}, got {self.train_split!r}")
        _ = self.card()

    @property
    def simulated(self) -> bool:
        """Whether the data are presets."""
        return self.data[0] in preset_names()

    @property
    def indoor(self) -> bool:
        """Whether the grid is a room's."""
        return self.half_extent_m <= ROOM_M

    @property
    def grid(self) -> BevGrid:
        """The network's grid."""
        return BevGrid(self.cells, self.half_extent_m)

    @property
    def shape(self) -> UNetShape:
        """The network's shape; without dropout where it is trained without."""
        dropout = self.dropout if self.variant == "mcd" else 0.0
        return UNetShape(self.width, self.depth, dropout)

    def card(self, **trained: str) -> NetworkCard:
        """Return the card of the network, with facts of its training."""
        return NetworkCard(
            self.name, self.shape, self.grid, self.target, self.truth, self.max_range_m, self.heights_m,
            counts=self.counts, threshold=self.threshold, trained=trained,
        )  # fmt: skip

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> TrainConfig:
        """Return the config in plain values: keys as the attributes, lists for tuples."""
        return cls(**flat.from_dict(cls, current_keys(table), "training config"))

    def to_json(self) -> dict[str, Any]:
        """Return the config as plain values."""
        return flat.to_dict(self)


_GONE = {"fresh": False, "inputs": ["counts"], "fold": 1, "ringless_share": 0.0, "past_share": 0.0}
"""Keys of version 0.3, and their only values that this version trains."""


def current_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a config in plain values without what those of version 0.3 have.

    Raises:
        ValueError: it has a value that is not trained any more.
    """
    for key, value in _GONE.items():
        if table.get(key, value) != value:
            raise ValueError(f"{key} must be {value}, or left out, as a network is trained now, got {table[key]}")
    return {key: value for key, value in table.items() if key not in {*_GONE, "doubt_frames"}}


def differing_keys(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return the keys in which two tables of plain values differ, sorted, with commas."""
    return ", ".join(sorted(key for key in {*before, *now} if before.get(key) != now.get(key)))


def config_names() -> tuple[str, ...]:
    """Return the names of the shipped configs, in alphabetical order."""
    return tuple(sorted(path.stem for path in _configs_folder().glob("*.toml")))


def read_config(place: str | Path) -> TrainConfig:
    """Return the config of a TOML file, or a shipped one by its name. The file's name is the config's.

    Raises:
        ValueError: there is no such file or name, or it is no training config.
        OSError: the file cannot be read.
    """
    path = Path(place)
    if str(place) in config_names():
        path = _configs_folder() / f"{place}.toml"
    elif not path.is_file():
        raise ValueError(f"config must be a TOML file or one of {', '.join(config_names())}, got {str(place)!r}")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        return TrainConfig.from_json({"name": path.stem} | table)
    except ValueError as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        raise ValueError(f"{path}: {error}") from error


def _configs_folder() -> Path:
    """Return the folder of the shipped configs."""
    return Path(__file__).with_name("configs")
