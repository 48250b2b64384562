"""The two protocols: grid, truth, threshold and attacks of each domain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from viewshed.estimators import CLASSICAL, PAPER_THRESHOLD, Estimator, EstimatorFactory, paper_estimators_on
from viewshed.fov.estimate import THRESHOLD
from viewshed.grid import BevGrid
from viewshed.networks.card import NetworkCard
from viewshed_lab.data.presets import preset_named
from viewshed_lab.studies.cases import DEFAULT, MIXTURE, ROOM_M, TOUCHING
from viewshed_lab.studies.fixed_views import FIXED_VIEWS
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.records import PAPER, STRICT, Case
from viewshed_lab.studies.suite import LABEL, EstimatorSuite

PAPER_EXTENT_M, PAPER_INDOOR_EXTENT_M = 80.0, 18.0


@dataclass(frozen=True, slots=True)
class ProtocolSetting:
    """Input and truth of networks in one protocol and domain."""

    protocol: str  # of ``PROTOCOLS``
    domain: str  # a preset's name
    grid: BevGrid  # of input and truth
    truth: str  # ``paper_label`` or ``probe``
    threshold: float  # minimum probability of a claimed cell
    max_range_m: float  # maximum range of the used returns
    heights_m: tuple[float, float]  # minimum and maximum height of the used returns, relative to the sensor

    @property
    def indoor(self) -> bool:
        """Whether the paper's indoor settings apply."""
        return self.grid.half_extent_m < ROOM_M

    def card(self, trained: NetworkCard) -> NetworkCard:
        """Return the card of a network for this setting, regardless of the domain of its training."""
        return replace(
            trained, name="tested", grid=self.grid, truth=self.truth, max_range_m=self.max_range_m,
            heights_m=self.heights_m, threshold=self.threshold,
        )  # fmt: skip

    def classical(self) -> dict[str, EstimatorFactory]:
        """Return the classical estimators and the fixed views by name.

        In the paper's protocol the paper's own come first, without its label, which is the truth there.
        """
        if self.protocol == STRICT:
            return CLASSICAL | FIXED_VIEWS
        papers = paper_estimators_on(self.grid)
        return {name: make for name, make in papers.items() if name != LABEL} | CLASSICAL | FIXED_VIEWS

    def attack(self, number: int) -> Case:
        """Return the attack on held-out sweep ``number``.

        In the paper's protocol its mixture; in the strict one all that change returns in turn, with default budgets.
        """
        return MIXTURE if self.protocol == PAPER else Case("attack", TOUCHING[number % len(TOUCHING)], DEFAULT)

    def suite(self, estimators: Mapping[str, Estimator]) -> EstimatorSuite:
        """Return a suite of estimators on this grid and threshold."""
        return EstimatorSuite(self.grid, self.threshold, estimators)


def setting_of(plan: PaperPlan, protocol: str, domain: str) -> ProtocolSetting:
    """Return the setting of a protocol in a domain."""
    half_extent_m = preset_named(domain).grid_half_extent_m
    if protocol == STRICT:
        grid = BevGrid(plan.cells, half_extent_m)
        return ProtocolSetting(protocol, domain, grid, "probe", THRESHOLD, 100.0, (-10.0, 3.0))
    indoor = half_extent_m < ROOM_M
    grid = BevGrid(plan.cells, PAPER_INDOOR_EXTENT_M if indoor else PAPER_EXTENT_M)
    return ProtocolSetting(protocol, domain, grid, LABEL, PAPER_THRESHOLD, 20.0 if indoor else 100.0, (-3.0, 3.0))
