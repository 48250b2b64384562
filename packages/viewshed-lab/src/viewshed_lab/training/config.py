"""TrainConfig: all settings that determine a trained network, one flat TOML file each. Needs no torch."""

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
"""Name of the attack mixture of arXiv 2503.07375; allowed in ``attacks`` beside the names of ``ATTACKS``."""

ROOM_M = 20.0
"""Largest half extent of an indoor grid; indoor grids use the paper's indoor label and attack."""

CHOICES: dict[str, tuple[str, ...]] = {
    "truth": TRUTHS, "variant": ("mle", "mcd"), "loss": ("bce", "bce_dice"), "schedule": ("constant", "cosine"),
    "precision": ("32", "bf16"), "counts": COUNTS,
}  # fmt: skip
"""Allowed values of the keys that are one of a few words."""

_LIMITS: dict[str, tuple[float, float]] = {
    "validation_share": (0.0, 0.9), "attack_share": (0.0, 1.0),
    "learning_rate": (1e-9, 10.0), "batch": (1, 4096), "epochs": (1, 100_000), "patience": (1, 100_000),
    "frames_per_epoch": (0, 10**9), "versions": (0, 1000),
    "workers": (0, 256), "threshold": (1e-6, 1.0), "seed": (0, MAX_SEED),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """Settings of a training. The same config gives the same weights on the same machine with as many threads.

    Raises:
        ValueError: a name is unknown or a number is out of range.
    """

    name: str  # of the weights
    about: str  # one-line description
    data: tuple[str, ...]  # preset names (simulated), or paths of archives; not both
    train_split: str  # split to train on; some of its scenes validate, other splits are never read
    validation_share: float  # share of the scenes that validate, at least one scene of each entry of ``data``
    cells: int  # cells per side of the network's grid
    half_extent_m: float  # half the side length of that grid
    target: str  # object type whose visibility is estimated
    truth: str  # ``probe``: exact truth; ``paper_label``: label of arXiv 2503.07375, computed from the clean sweep
    variant: str  # ``mcd`` trains with dropout, ``mle`` without
    # names of ``ATTACKS`` or ``paper``, one sampled per attacked frame; empty is benign training
    attacks: tuple[str, ...]
    attack_share: float  # share of the frames that are attacked (the paper's mixture leaves some of them unchanged)
    width: int  # channels of the first stage
    depth: int  # number of pooling steps
    dropout: float  # share of the channels that are dropped, for ``mcd``
    loss: str  # ``bce``: cross-entropy over the cells with known truth; ``bce_dice``: the same plus the Dice loss
    learning_rate: float  # of Adam
    schedule: str  # of the learning rate: ``constant``, or ``cosine`` down to a hundredth at the last epoch
    batch: int  # frames per step in each process
    epochs: int  # maximum
    patience: int  # training stops after this many epochs without a lower validation loss
    frames_per_epoch: int  # frames sampled per epoch; 0 is all
    # 0 builds each frame whenever it is used. n builds n versions of each frame before training, each with a new
    # attack, caches them beside the labels, and uses one version per epoch.
    versions: int
    mirrored: bool  # random quarter turns and mirroring, which change no truth
    precision: str  # ``32``, or ``bf16`` for the network's convolutions
    workers: int  # loader processes beside the training process
    threshold: float  # minimum probability of a visible cell, in the scores and in the network's card
    seed: int  # of all random numbers
    counts: str  # encoding of the returns per cell: ``linear``, as published, or ``log``
    max_range_m: float  # returns beyond this horizontal range are ignored
    heights_m: tuple[float, float]  # lowest and highest z from the sensor; returns outside are ignored

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
        """Whether ``data`` names presets."""
        return self.data[0] in preset_names()

    @property
    def indoor(self) -> bool:
        """Whether the grid is an indoor one: half extent at most ``ROOM_M``."""
        return self.half_extent_m <= ROOM_M

    @property
    def grid(self) -> BevGrid:
        """The network's grid."""
        return BevGrid(self.cells, self.half_extent_m)

    @property
    def shape(self) -> UNetShape:
        """The network's shape; dropout is 0 unless the variant is ``mcd``."""
        dropout = self.dropout if self.variant == "mcd" else 0.0
        return UNetShape(self.width, self.depth, dropout)

    def card(self, **trained: str) -> NetworkCard:
        """Return the card of the network; ``trained`` are facts of its training."""
        return NetworkCard(
            self.name, self.shape, self.grid, self.target, self.truth, self.max_range_m, self.heights_m,
            counts=self.counts, threshold=self.threshold, trained=trained,
        )  # fmt: skip

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> TrainConfig:
        """Return the config of a table of plain values: the keys are the attributes, tuples are lists."""
        return cls(**flat.from_dict(cls, current_keys(table), "training config"))

    def to_json(self) -> dict[str, Any]:
        """Return the config as a table of plain values."""
        return flat.to_dict(self)


_REMOVED_KEYS = {"fresh": False, "inputs": ["counts"], "fold": 1, "ringless_share": 0.0, "past_share": 0.0}
"""Keys of version 0.3 that were removed, with the only value that is still accepted."""


def current_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a config table without the removed keys of version 0.3.

    Raises:
        ValueError: a removed key has a value that is no longer supported.
    """
    for key, value in _REMOVED_KEYS.items():
        if table.get(key, value) != value:
            raise ValueError(
                f"{key} must be {value} or omitted, as other values are no longer supported, got {table[key]}"
            )
    return {key: value for key, value in table.items() if key not in {*_REMOVED_KEYS, "doubt_frames"}}


def differing_keys(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return the sorted, comma-separated keys in which two tables differ."""
    return ", ".join(sorted(key for key in {*before, *now} if before.get(key) != now.get(key)))


def config_names() -> tuple[str, ...]:
    """Return the names of the shipped configs, sorted."""
    return tuple(sorted(path.stem for path in _configs_folder().glob("*.toml")))


def read_config(place: str | Path) -> TrainConfig:
    """Return the config of a TOML file or of a shipped name. The file's stem is the config's name.

    Raises:
        ValueError: there is no such file or name, or the file is no training config.
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
