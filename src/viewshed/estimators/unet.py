"""The paper's network as an estimator: one pass (maximum likelihood) or several under dropout masks (Monte Carlo)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import keep_freed_memory
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import PastEstimator
from viewshed.fov.estimate import CellState, FovEstimate, FovEstimator
from viewshed.fov.visibility import TARGETS, Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.networks.card import NetworkCard, Runner
from viewshed.networks.features import EVIDENCE_BINS, FeatureContext, feature_maps
from viewshed.networks.mc_dropout import mean_and_deviation
from viewshed.networks.runtime import IN_BYTES, OnnxRunner, load_runner
from viewshed.networks.weights import default_name, float32_name
from viewshed.preprocess.azimuth_bins import Crop, bins_of_cells, reach_of
from viewshed.preprocess.history import History, history_of
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep

PASSES = 20
"""Passes of Monte Carlo dropout where none are asked for."""

EVEN = 0.5
"""Probability that says nothing: to be as sure as that is to tell everything."""

_MAX_PASSES = 1000

_UNKNOWN, _FREE, _SURFACE, _HIDDEN = (
    int(CellState.UNKNOWN), int(CellState.FREE), int(CellState.SURFACE), int(CellState.HIDDEN),
)  # fmt: skip


NetworkOutput = tuple[NDArray[np.float32], NDArray[np.float32] | None]
"""Probability and deviation (cells, cells) by the network; None for a deviation that nothing tells."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkInput:
    """What a network is asked about one sweep.

    Attributes:
        seen: what its channels are made of.
        inputs: one input, of the shape that the card says; None where no return counts, and nothing is asked.
    """

    seen: FeatureContext
    inputs: NDArray[Any] | None


class UnetEstimator:
    """Probability of visible by the U-Net of arXiv 2503.07375, on the grid that it was trained for.

    With one pass dropout is off (maximum likelihood) and there is a deviation only if the network has a head that
    tells it. With more, ``visible_prob`` is the mean over passes under random dropout masks and ``std`` their standard
    deviation. The masks depend on ``seed`` alone: the same sweep gives the same estimate.

    A cell is FREE or SURFACE if its probability reaches the card's threshold. The network does not tell why it calls
    a cell not visible, so the returns must: HIDDEN behind the nearest obstacle of its azimuth, else UNKNOWN. Beyond
    the card's range nothing is claimed, nor where an azimuth and 1° to each side hold fewer returns than would show a
    target, and neither is anything for a sweep without a usable return. With ``sure``
    above one half, a cell is claimed from that probability on (or the card's threshold, if that is higher), denied as
    above up to ``1 - sure``, and UNKNOWN between; its probability stays what it is.

    Args:
        runner: the network.
        passes: 1, or how many passes of Monte Carlo dropout.
        seed: of the masks.
        name: goes into the estimate's ``method``; by default ``unet`` for one pass and ``mcd`` for more.
        sure: probability from which states are told, of visible or of not visible; .5 tells all of them.

    Raises:
        ValueError: ``passes`` lies outside [1, 1000], or is more than 1 for a network without dropout; or ``sure`` lies
            outside [.5, 1].
    """

    def __init__(self, runner: Runner, passes: int = 1, seed: int = 0, name: str = "", sure: float = EVEN) -> None:
        if not 1 <= passes <= _MAX_PASSES:
            raise ValueError(f"passes must lie in [1, {_MAX_PASSES}], got {passes}")
        shape = runner.card.shape
        if passes > 1 and shape.dropout == 0.0:
            raise ValueError(f"passes must be 1 for {runner.card.name}, which has no dropout, got {passes}; use unet")
        if not EVEN <= sure <= 1.0:
            raise ValueError(f"sure must lie in [0.5, 1], got {sure}")
        keep_freed_memory()
        self.runner, self.passes, self.seed, self.sure = runner, passes, seed, sure
        self.name = name or ("unet" if passes == 1 else "mcd")
        rng = np.random.Generator(np.random.PCG64(seed))
        self._masks = shape.no_masks(1) if passes == 1 else shape.masks(passes, rng)

    def with_abstention(self, sure: float) -> UnetEstimator:
        """Return the same estimator, which tells states from another probability on."""
        return UnetEstimator(self.runner, self.passes, self.seed, self.name, sure)

    def side_by_side(self) -> UnetEstimator | None:
        """Return the same estimator for several threads at once, each running the network alone; None if it cannot."""
        runner = self.runner.side_by_side() if isinstance(self.runner, OnnxRunner) else None
        return None if runner is None else UnetEstimator(runner, self.passes, self.seed, self.name, self.sure)

    @property
    def decision_threshold(self) -> float:
        """Probability from which a cell is FREE or SURFACE: the card's threshold, or ``sure`` if that is higher."""
        return self.card.threshold if self.sure == EVEN else max(self.card.threshold, self.sure)

    @property
    def card(self) -> NetworkCard:
        """What the network is."""
        return self.runner.card

    @property
    def grid(self) -> BevGrid:
        """The grid that the network was trained for."""
        return self.card.grid

    @property
    def target(self) -> Target:
        """The target that the network was trained for."""
        return TARGETS[self.card.target]

    def estimate(self, sweep: Sweep, earlier: Sequence[Sweep] = ()) -> FovEstimate:
        """Return the estimate for one sweep; see the class for what it means.

        Args:
            sweep: what the sensor measured.
            earlier: sweeps that it measured before, the oldest first, all with poses in the same map.

        Raises:
            ValueError: the network does not use earlier sweeps, or a pose is missing.
        """
        leveled = level(sweep, self.grid)
        return self.estimate_level(leveled, history_of(leveled, earlier, self.grid))

    def estimate_level(self, leveled: LeveledSweep, past: History | None = None) -> FovEstimate:
        """Return the estimate for a sweep that is already leveled, and what earlier ones tell of it."""
        asked = self.asked(leveled, past)
        [told] = self.told([asked])
        return self.answer(asked, told)

    def asked(self, leveled: LeveledSweep, past: History | None = None) -> NetworkInput:
        """Return what the network is asked about a leveled sweep; needs no network, and many threads may do it."""
        if past is not None and not self.card.uses_history:
            raise ValueError(f"earlier sweeps are of no use to the network {self.card.name}: it was trained without")
        seen = self.card.seen(leveled, past)
        if not Crop(self.card.max_range_m, self.card.heights_m).any_on(leveled, self.grid):
            return NetworkInput(seen, None)
        return NetworkInput(seen, self.card.shown(feature_maps(self.card.inputs, seen)))

    def told(self, asked: Sequence[NetworkInput]) -> list[NetworkOutput | None]:
        """Return what the network tells of each sweep, None where it is asked nothing.

        A network in one pass is run once for all of them, one of several passes once for each.
        """
        inputs = [each.inputs for each in asked if each.inputs is not None]
        told = iter(self._run(inputs) if inputs else ())
        return [None if each.inputs is None else next(told) for each in asked]

    def _run(self, inputs: list[NDArray[Any]]) -> Sequence[NetworkOutput]:
        if self.passes > 1:
            return [mean_and_deviation(self.runner.run(each[None], self._masks)) for each in inputs]
        together = np.stack(inputs) if len(inputs) > 1 else inputs[0][None]
        if self.card.shape.doubt:
            return list(zip(*self.runner.run_with_doubt(together), strict=True))
        prob = self.runner.run(together, np.repeat(self._masks, len(inputs), axis=0))
        return [(each, None) for each in prob]

    def answer(self, asked: NetworkInput, told: NetworkOutput | None) -> FovEstimate:
        """Return the estimate of what the network told of a sweep; many threads may do it."""
        prob, state = np.zeros(self.grid.shape, np.float32), np.full(self.grid.shape, CellState.UNKNOWN, np.uint8)
        if told is not None:
            self._claim(asked.seen, told[0], prob, state)
        leveled = asked.seen.leveled
        return FovEstimate(
            grid=self.grid,
            visible_prob=prob,
            std=None if told is None else told[1],
            state=state,
            method=self.name,
            target=self.target,
            world_from_level=leveled.world_from_level,
            t_ns=leveled.sweep.t_ns,
            agent=leveled.sweep.agent,
        )

    def _claim(
        self, seen: FeatureContext, told: NDArray[np.float32], prob: NDArray[np.float32], state: NDArray[np.uint8]
    ) -> None:
        """Fill in probability and state (cells, cells), both of nothing so far, from what the network ``told``."""
        reach_m = min(reach_of(seen.leveled), self.card.max_range_m)
        doubted_above = 1.0 - self.sure if self.sure > EVEN else 1.0
        limits = np.array([self.card.max_range_m, reach_m, self.decision_threshold, doubted_above], np.float32)
        found = seen.scan
        cells = polar_of_cells(self.grid)[0], found.obstacle
        bearings = bins_of_cells(self.grid, found.bins), bins_of_cells(self.grid, EVIDENCE_BINS)
        by_bearing = found.blocker_m, _evidence(found.returns, self.target)
        _claims(told, cells, (*bearings, *by_bearing), limits, prob, state)


LEARNED: dict[str, Callable[[Runner], UnetEstimator]] = {
    "unet": UnetEstimator,
    "mcd": partial(UnetEstimator, passes=PASSES),
    "viewnet": partial(UnetEstimator, name="viewnet"),
}
"""The learned estimators by name; each is made of a network, which brings its grid and its target."""


def uses_history(estimator: FovEstimator) -> TypeGuard[PastEstimator]:
    """Return whether earlier sweeps help an estimator: the shadow map, and networks that were shown them."""
    return isinstance(estimator, ShadowMap) or (isinstance(estimator, UnetEstimator) and estimator.card.uses_history)


def learned(
    method: str,
    grid: BevGrid,
    target: str = "car",
    weights: str | Path | None = None,
    passes: int | None = None,
    seed: int = 0,
    *,
    engine: str = "onnxruntime",
) -> UnetEstimator:
    """Return the estimator ``method`` on ``grid`` for the target of this name.

    Args:
        method: ``unet`` (one pass, dropout off), ``mcd``, or ``viewnet``, our own network in one pass.
        grid: must be the one that the weights were trained for.
        target: must be the one that the weights were trained for.
        weights: a file, or a name of shipped weights; None takes those shipped for the grid and the target, in float32
            where the engine runs no networks in bytes.
        passes: of ``mcd``, at least 2; None is ``PASSES``.
        seed: of the dropout masks.
        engine: one of :data:`viewshed.networks.runtime.ENGINES`.

    Raises:
        ValueError: no such method, weights or engine, weights for another grid or target, or no graphics card.
        ImportError: the engine is not installed.
    """
    if method not in LEARNED:
        raise ValueError(f"method must be one of {', '.join(LEARNED)}, got {method!r}")
    if passes is not None and (passes < 2) != (method != "mcd"):
        rule = "at least 2 for mcd; use unet for one pass" if method == "mcd" else f"1 for {method}; use mcd"
        raise ValueError(f"passes must be {rule}, got {passes}")
    if weights is None:
        weights = default_name(method, grid, target)
        weights = weights if engine == IN_BYTES else float32_name(weights)
    runner = load_runner(weights, engine=engine)
    runner.card.require(grid, target)
    return UnetEstimator(runner, passes or PASSES if method == "mcd" else 1, seed, method)


def _evidence(returns: NDArray[np.int32], target: Target) -> NDArray[np.bool_]:
    """Return the azimuth bins around which there are at least as many returns as would show a target."""
    around = np.concatenate([returns[-1:], returns, returns[:1]])
    evidence: NDArray[np.bool_] = around[:-2] + around[1:-1] + around[2:] >= target.min_returns
    return evidence


@njit(cache=True, nogil=True, error_model="numpy")
def _claims(told: Any, cells: Any, bearings: Any, limits: Any, prob: Any, state: Any) -> None:  # pragma: no cover
    """Row by row: what is looked up first, then what vectorizes."""
    range_m, obstacle = cells
    bins, bearing, blocker_m, evidence = bearings
    most, reach, claimed_from, doubted_above = limits
    known, beyond_m = np.empty(state.shape[1], np.bool_), np.empty(state.shape[1], np.float32)
    for i in range(state.shape[0]):
        for j in range(state.shape[1]):
            known[j] = evidence[np.uint32(bearing[i, j])]
            beyond_m[j] = blocker_m[np.uint32(bins[i, j])]
        for j in range(state.shape[1]):
            r = range_m[i, j]
            p = told[i, j] if (r <= most) & known[j] else np.float32(0.0)
            hidden = (r > beyond_m[j]) & (r <= reach) & (p <= doubted_above) & known[j]
            visible = _SURFACE if obstacle[i, j] else _FREE
            prob[i, j] = p
            state[i, j] = visible if p >= claimed_from else (_HIDDEN if hidden else _UNKNOWN)
