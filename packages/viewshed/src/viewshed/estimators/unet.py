"""The networks as estimators: one pass (maximum likelihood), or several under dropout masks (Monte Carlo)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.base import BatchSteps, EarlierSweeps
from viewshed.estimators.classical import NEVER_ABSTAIN, checked_abstention, checked_history
from viewshed.estimators.temporal import stream
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import CAR, TARGETS, Target
from viewshed.grid import GRIDS, BevGrid
from viewshed.networks.card import NetworkCard, Runner
from viewshed.networks.mc_dropout import mean_and_deviation
from viewshed.networks.runtime import load_runner
from viewshed.networks.weights import default_name
from viewshed.preprocess.azimuth_bins import Crop
from viewshed.preprocess.basis import basis_of
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.leveling import LeveledSweep, level, leveled_on
from viewshed.sweep import Sweep

PASSES = 10
"""Passes of Monte Carlo dropout if not given: with balanced masks they say what 20 with independent ones do."""

DEVICES = {"cpu": "onnxruntime", "cuda": "cuda"}
"""Where a network may run, and the engine that runs it there."""

_MAX_PASSES = 1000


class NetworkOutput(NamedTuple):
    """What a network says of one sweep: probability and standard deviation (cells, cells); None for one pass."""

    prob: NDArray[np.float32]
    std: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True, eq=False)
class NetworkInput:
    """One sweep, prepared for the network."""

    leveled: LeveledSweep  # what the input was made of
    # the network's input, of the shape that the card says; None where no return counts, so that the network need not
    # run
    shown: NDArray[Any] | None


class UnetEstimator:
    """Probability of visible by the U-Net of arXiv 2503.07375, on the grid that it was trained for.

    With one pass dropout is off (maximum likelihood) and ``std`` is NaN. With more, ``visible_prob`` is the mean over
    passes under dropout masks and ``std`` their standard deviation. The masks depend on ``seed`` alone: the same
    sweep gives the same estimate.

    A cell is claimed if its probability reaches the card's threshold, and only where the beams support the claim: the
    network ranks and lowers claims within the evidence (:mod:`viewshed.preprocess.evidence`), which decides the states.
    Where it does not support a claim the probability is cut to just below the threshold, beyond the reach to 0. With
    ``abstain_below`` above one half, a cell is claimed from that probability on (or the card's threshold, if that is
    higher), denied up to ``1 - abstain_below``, and UNKNOWN between.

    Args:
        runner: the network.
        passes: 1, or how many passes of Monte Carlo dropout.
        seed: of the masks.
        name: goes into the estimate's ``method``; by default ``unet`` for one pass and ``mc_dropout`` for more.
        abstain_below: probability, of visible or of not visible, below which a cell is UNKNOWN; .5 never abstains.

    Raises:
        ValueError: ``passes`` lies outside [1, 1000], or is more than 1 for a network without dropout; or
            ``abstain_below`` lies outside [.5, 1].
    """

    def __init__(
        self, runner: Runner, passes: int = 1, seed: int = 0, name: str = "", abstain_below: float = NEVER_ABSTAIN
    ) -> None:
        if not 1 <= passes <= _MAX_PASSES:
            raise ValueError(f"passes must lie in [1, {_MAX_PASSES}], got {passes}")
        shape = runner.card.shape
        if passes > 1 and shape.dropout == 0.0:
            raise ValueError(f"passes must be 1 for {runner.card.name}, which has no dropout, got {passes}; use unet")
        _keep_freed_memory()
        self.runner, self.passes, self.seed = runner, passes, seed
        self.abstain_below = checked_abstention(abstain_below)
        self.name = name or ("unet" if passes == 1 else "mc_dropout")
        rng = np.random.Generator(np.random.PCG64(seed))
        self._masks = None if passes == 1 else shape.masks(passes, rng)

    def with_abstention(self, below: float) -> UnetEstimator:
        """Return the same estimator that abstains below another probability."""
        return UnetEstimator(self.runner, self.passes, self.seed, self.name, below)

    @property
    def threshold(self) -> float:
        """Probability from which a cell is FREE or SURFACE: the card's threshold, or ``abstain_below`` if higher."""
        abstains = self.abstain_below > NEVER_ABSTAIN
        return max(self.card.threshold, self.abstain_below) if abstains else self.card.threshold

    @property
    def uses_history(self) -> bool:
        """It looks at one sweep."""
        return False

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

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the field of view of one sweep; see :meth:`Estimator.estimate` and the class."""
        leveled = leveled_on(sweep, self.grid)
        checked_history(self, leveled, history)
        prepared = self.prepare(leveled)
        [output] = self.infer([prepared])
        return self.finish(prepared, output)

    def batch_steps(self) -> BatchSteps:
        """Return whole estimates where the network can run in each thread alone, else its three steps."""
        runner = self.runner.single_threaded()
        if runner is None:
            return BatchSteps(lambda sweep: self.prepare(level(sweep, self.grid)), self.infer, self.finish)
        alone = UnetEstimator(runner, self.passes, self.seed, self.name, self.abstain_below)
        return BatchSteps(alone.estimate, lambda estimates: estimates, lambda estimate, _: estimate)

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream; see :func:`viewshed.estimators.temporal.stream`."""
        return stream(self, sweeps, history, require_confirmation=require_confirmation)

    def prepare(self, leveled: LeveledSweep) -> NetworkInput:
        """Return the network's input for a leveled sweep; needs no network, and many threads may do it."""
        if not Crop(self.card.max_range_m, self.card.heights_m).any_on(leveled, self.grid):
            return NetworkInput(leveled, None)
        return NetworkInput(leveled, self.card.input_of(leveled))

    def infer(self, prepared: Sequence[NetworkInput]) -> list[NetworkOutput | None]:
        """Return the network's output for each sweep, None where it need not run.

        A network in one pass is run once for all of them, one of several passes once for each.
        """
        shown = [item.shown for item in prepared if item.shown is not None]
        outputs = iter(self._run(shown) if shown else ())
        return [None if item.shown is None else next(outputs) for item in prepared]

    def _run(self, shown: list[NDArray[Any]]) -> Sequence[NetworkOutput]:
        if self.passes > 1:
            return [NetworkOutput(*mean_and_deviation(self.runner.run(one[None], self._masks))) for one in shown]
        together = np.stack(shown) if len(shown) > 1 else shown[0][None]
        return [NetworkOutput(prob, None) for prob in self.runner.run(together)]

    def finish(self, prepared: NetworkInput, output: NetworkOutput | None) -> FovEstimate:
        """Return the estimate that the network's output gives; many threads may do it."""
        leveled = prepared.leveled
        evidence = beam_evidence(leveled, self.grid, self.target)
        prob, state = np.zeros(self.grid.shape, np.float32), np.full(self.grid.shape, CellState.UNKNOWN, np.uint8)
        if output is not None:
            prob = evidence.bounded(output.prob, self.threshold)
            abstains = self.abstain_below > NEVER_ABSTAIN
            denied = prob <= np.float32(1.0 - self.abstain_below) if abstains else prob < np.float32(self.threshold)
            obstacle = leveled.obstacle_cells(self.grid)
            state = evidence.states(prob >= np.float32(self.threshold), denied, obstacle)
        return FovEstimate(
            grid=self.grid,
            visible_prob=prob,
            std=None if output is None else output.std,
            state=state,
            method=self.name,
            target=self.target,
            threshold=self.threshold,
            world_from_level=leveled.world_from_level,
            t_ns=leveled.sweep.t_ns,
            agent=leveled.sweep.agent,
            basis=basis_of(leveled, evidence, state),
        )


def load_network(
    method: str,
    grid: BevGrid | None = None,
    target: Target | None = None,
    *,
    weights: str | Path | None = None,
    passes: int | None = None,
    seed: int = 0,
    device: str = "cpu",
) -> UnetEstimator:
    """Return the network ``method`` on ``grid`` for ``target``.

    Args:
        method: ``unet`` (one pass, dropout off) or ``mc_dropout``.
        grid: must be the one that the weights were trained for; None is that one, and without weights ``road``.
        target: must be the one that the weights were trained for; None is that one, and without weights a car.
        weights: a file, or a name of shipped weights; None takes those shipped for the grid and the target.
        passes: of ``mc_dropout``, at least 2; None is ``PASSES``.
        seed: of the dropout masks.
        device: one of :data:`DEVICES`.

    Raises:
        ValueError: no such method, weights or device; weights for another grid or target; or no graphics card.
        ImportError: what runs networks on the device is not installed.
    """
    if method not in LEARNED:
        raise ValueError(f"method must be one of {', '.join(LEARNED)}, got {method!r}")
    if device not in DEVICES:
        raise ValueError(f"device must be one of {', '.join(DEVICES)}, got {device!r}")
    several = method == "mc_dropout"
    if passes is not None and (passes < 2) == several:
        rule = "at least 2 for mc_dropout; use unet for one pass" if several else "1 for unet; use mc_dropout"
        raise ValueError(f"passes must be {rule}, got {passes}")
    if weights is None:
        weights = default_name(method, grid or GRIDS["road"], (target or CAR).name)
    runner = load_runner(weights, engine=DEVICES[device])
    runner.card.require(grid or runner.card.grid, runner.card.target if target is None else target.name)
    return UnetEstimator(runner, passes or PASSES if several else 1, seed, method)


_LARGEST = (32 << 20) - (64 << 10)
"""The GNU allocator keeps up to twice what one array of at most 32 MiB gave back; it begins with 128 KiB."""


@lru_cache(maxsize=1)
def _keep_freed_memory() -> None:
    """Raise what the allocator keeps of freed memory to 64 MiB: one large array comes and goes, untouched.

    Without it each sweep of 100,000 points and more pays for about 1,500 fresh pages. Other allocators do not care.
    """
    np.empty(_LARGEST, np.uint8)


LEARNED: dict[str, Callable[..., UnetEstimator]] = {
    "unet": partial(load_network, "unet"),
    "mc_dropout": partial(load_network, "mc_dropout"),
}
"""The estimators that are networks, by name."""
