"""The two protocols: grid, truth, threshold and attacks of each domain; the models that are trained in each."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viewshed.datasets.presets import preset_named
from viewshed.estimators import ESTIMATORS, PAPER_ESTIMATORS, PAPER_INDOOR_ESTIMATORS, PAPER_THRESHOLD, EstimatorFactory
from viewshed.fov.estimate import THRESHOLD
from viewshed.grid import BevGrid
from viewshed.networks.card import NetworkCard
from viewshed.studies.paper.plan import StudyPlan
from viewshed.studies.suite import LABEL, ROOM_M
from viewshed.threats.attacks import ATTACKS, PAPER_ATTACK, PAPER_INDOOR_ATTACK, Attack, Knowledge

PROTOCOLS = ("paper", "strict")
"""The paper's label as truth on its grids, and exact truth on ours."""

VARIANTS = ("mle", "mcd")
"""One pass with dropout off; the mean of several with dropout on."""

MIXTURES = ("benign", "adversarial")
"""What a model is trained on, and what it is tested on."""

TOUCHING = tuple(name for name in ATTACKS if name != "pose_spoof")
"""Attacks that touch returns; a spoofed pose only moves the estimate in the map."""

PAPER_EXTENT_M, PAPER_INDOOR_EXTENT_M = 80.0, 18.0


@dataclass(frozen=True, slots=True)
class Setting:
    """What a network is given and held against in one domain.

    Attributes:
        protocol: of ``PROTOCOLS``.
        domain: a preset's name.
        grid: of input and truth.
        truth: ``paper_label`` or ``probe``.
        threshold: probability from which a cell is claimed.
        max_range_m: farther returns are left out.
        heights_m: lowest and highest return, from the sensor's own height.
    """

    protocol: str
    domain: str
    grid: BevGrid
    truth: str
    threshold: float
    max_range_m: float
    heights_m: tuple[float, float]

    @property
    def indoor(self) -> bool:
        """Whether the paper's indoor settings apply."""
        return self.grid.half_extent_m < ROOM_M

    def card(self, trained: NetworkCard) -> NetworkCard:
        """Return the card of a network as it is used here, wherever it was trained."""
        return replace(
            trained, name="tested", grid=self.grid, truth=self.truth, max_range_m=self.max_range_m,
            heights_m=self.heights_m, threshold=self.threshold,
        )  # fmt: skip

    def classical(self) -> dict[str, EstimatorFactory]:
        """Return the classical estimators by name; in the paper's protocol its own first, but its label."""
        if self.protocol == "strict":
            return dict(ESTIMATORS)
        papers = PAPER_INDOOR_ESTIMATORS if self.indoor else PAPER_ESTIMATORS
        return {name: make for name, make in papers.items() if name != LABEL} | ESTIMATORS

    def attack(self, number: int, knowledge: Knowledge) -> tuple[str, Attack]:
        """Return the attack that the test sweep ``number`` faces, and its name.

        In the paper's protocol its mixture; in the strict one all that touch returns in turn, with default budgets.
        """
        if self.protocol == "paper":
            return "paper", PAPER_INDOOR_ATTACK if self.indoor else PAPER_ATTACK
        name = TOUCHING[number % len(TOUCHING)]
        return name, ATTACKS[name](None, knowledge)


def setting_of(plan: StudyPlan, protocol: str, domain: str) -> Setting:
    """Return the setting of a protocol in a domain."""
    half_extent_m = preset_named(domain).grid_half_extent_m
    if protocol == "strict":
        grid = BevGrid(plan.cells, half_extent_m)
        return Setting(protocol, domain, grid, "probe", THRESHOLD, 100.0, (-10.0, 3.0))
    indoor = half_extent_m < ROOM_M
    grid = BevGrid(plan.cells, PAPER_INDOOR_EXTENT_M if indoor else PAPER_EXTENT_M)
    return Setting(protocol, domain, grid, LABEL, PAPER_THRESHOLD, 20.0 if indoor else 100.0, (-3.0, 3.0))


@dataclass(frozen=True, slots=True, order=True)
class Model:
    """One of the twelve models of a protocol.

    Attributes:
        protocol: of ``PROTOCOLS``.
        variant: of ``VARIANTS``.
        mixture: of ``MIXTURES``, what it is trained on.
        domain: that it is trained in.
    """

    protocol: str
    variant: str
    mixture: str
    domain: str

    @property
    def name(self) -> str:
        """Its name within the protocol."""
        return f"{self.variant}-{self.mixture}-{self.domain}"


def models_of(plan: StudyPlan, protocols: Sequence[str] = PROTOCOLS) -> list[Model]:
    """Return the models of some protocols: 2 variants × 2 mixtures × the domains, in each."""
    return [
        Model(protocol, variant, mixture, domain)
        for protocol in protocols
        for variant in VARIANTS
        for mixture in MIXTURES
        for domain in plan.domains
    ]


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """Return a generator of its own for what the names say."""
    words = [zlib.crc32(str(name).encode()) for name in names]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))
