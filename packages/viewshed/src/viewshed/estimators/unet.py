"""Networks as estimators: one pass without dropout, or several passes with dropout masks (Monte Carlo dropout)."""

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
"""Default number of passes of Monte Carlo dropout; with balanced masks as good as 20 with independent masks."""

DEVICES = {"cpu": "onnxruntime", "cuda": "cuda"}
"""Device → engine that runs networks on it."""

_MAX_PASSES = 1000


class NetworkOutput(NamedTuple):
    """Output for one sweep: probability, and standard deviation over passes (None for one pass), (cells, cells)."""

    prob: NDArray[np.float32]
    std: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True, eq=False)
class NetworkInput:
    """One sweep, prepared for the network."""

    leveled: LeveledSweep
    # input features, of the shape in the card; None if no return is within the card's crop, which skips the network
    features: NDArray[Any] | None


class UnetEstimator:
    """Probability of visible by the U-Net of arXiv 2503.07375, on the grid that it was trained for.

    With one pass, dropout is off (maximum likelihood) and ``std`` is NaN. With more, ``visible_prob`` is the mean and
    ``std`` the standard deviation over passes with dropout masks. The masks depend only on ``seed``, so estimates are
    deterministic.

    A cell is claimed if its probability reaches the card's threshold and the beams support the claim
    (:mod:`viewshed.preprocess.evidence`). Without support the probability is capped just below the threshold; beyond
    the sensor's reach it is 0. With ``abstain_below`` above one half, a cell is claimed from that probability on (or
    from the card's threshold, if higher), denied up to ``1 - abstain_below``, and UNKNOWN in between.

    Args:
        runner: the network.
        passes: 1, or the number of passes of Monte Carlo dropout.
        seed: seed of the dropout masks.
        name: becomes the estimate's ``method``; by default ``unet`` for one pass and ``mc_dropout`` for more.
        abstain_below: cells where neither visible nor not visible has this probability are UNKNOWN; .5 never abstains.

    Raises:
        ValueError: ``passes`` lies outside [1, 1000], or is above 1 for a network without dropout; or
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
        _raise_trim_threshold()
        self.runner, self.passes, self.seed = runner, passes, seed
        self.abstain_below = checked_abstention(abstain_below)
        self.name = name or ("unet" if passes == 1 else "mc_dropout")
        rng = np.random.Generator(np.random.PCG64(seed))
        self._masks = None if passes == 1 else shape.masks(passes, rng)

    def with_abstention(self, below: float) -> UnetEstimator:
        """Return a copy that abstains below another probability."""
        return UnetEstimator(self.runner, self.passes, self.seed, self.name, below)

    @property
    def threshold(self) -> float:
        """Minimum probability of a visible cell: the card's threshold, or ``abstain_below`` if higher."""
        abstains = self.abstain_below > NEVER_ABSTAIN
        return max(self.card.threshold, self.abstain_below) if abstains else self.card.threshold

    @property
    def uses_history(self) -> bool:
        """False: it uses one sweep."""
        return False

    @property
    def card(self) -> NetworkCard:
        """The network's card."""
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
        """Return the field of view of one sweep; see :meth:`Estimator.estimate`."""
        leveled = leveled_on(sweep, self.grid)
        checked_history(self, leveled, history)
        prepared = self.prepare(leveled)
        [output] = self.infer([prepared])
        return self.finish(prepared, output)

    def batch_steps(self) -> BatchSteps:
        """Return whole estimates as ``prepare`` if the network can run single-threaded, else the three steps."""
        runner = self.runner.single_threaded()
        if runner is None:
            return BatchSteps(lambda sweep: self.prepare(level(sweep, self.grid)), self.infer, self.finish)
        single_threaded = UnetEstimator(runner, self.passes, self.seed, self.name, self.abstain_below)
        return BatchSteps(single_threaded.estimate, lambda estimates: estimates, lambda estimate, _: estimate)

    def stream(
        self, sweeps: Iterable[Sweep], history: int = 0, *, require_confirmation: bool = False
    ) -> Iterator[FovEstimate]:
        """Yield the estimate of each sweep of a stream; see :func:`viewshed.estimators.temporal.stream`."""
        return stream(self, sweeps, history, require_confirmation=require_confirmation)

    def prepare(self, leveled: LeveledSweep) -> NetworkInput:
        """Return the network's input for a leveled sweep; thread-safe, does not run the network."""
        if not Crop(self.card.max_range_m, self.card.heights_m).any_on(leveled, self.grid):
            return NetworkInput(leveled, None)
        return NetworkInput(leveled, self.card.input_of(leveled))

    def infer(self, prepared: Sequence[NetworkInput]) -> list[NetworkOutput | None]:
        """Return the network's output for each sweep, None for sweeps without features.

        One-pass networks run once for all sweeps, Monte Carlo dropout once per sweep.
        """
        features = [item.features for item in prepared if item.features is not None]
        outputs = iter(self._run(features) if features else ())
        return [None if item.features is None else next(outputs) for item in prepared]

    def _run(self, features: list[NDArray[Any]]) -> Sequence[NetworkOutput]:
        if self.passes > 1:
            return [NetworkOutput(*mean_and_deviation(self.runner.run(one[None], self._masks))) for one in features]
        batch = np.stack(features) if len(features) > 1 else features[0][None]
        return [NetworkOutput(prob, None) for prob in self.runner.run(batch)]

    def finish(self, prepared: NetworkInput, output: NetworkOutput | None) -> FovEstimate:
        """Return the estimate from the network's output; thread-safe."""
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
        grid: must be the grid of the weights; None is that grid, or ``road`` without weights.
        target: must be the target of the weights; None is that target, or a car without weights.
        weights: path, or name of shipped weights; None takes the shipped ones for the grid and the target.
        passes: number of passes for ``mc_dropout``, at least 2; None is ``PASSES``.
        seed: seed of the dropout masks.
        device: one of :data:`DEVICES`.

    Raises:
        ValueError: no such method, weights or device; weights for another grid or target; or no GPU.
        ImportError: the runtime of networks on the device is not installed.
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


_MALLOC_BYTES = (32 << 20) - (64 << 10)
"""Just below 32 MiB, the largest freed block for which glibc raises its trim threshold (128 KiB) to twice the block."""


@lru_cache(maxsize=1)
def _raise_trim_threshold() -> None:
    """Raise malloc's trim threshold to 64 MiB by freeing one large array, which is never written.

    This saves about 1,500 page faults per sweep of 100,000 points or more. No effect with other allocators than glibc.
    """
    np.empty(_MALLOC_BYTES, np.uint8)


LEARNED: dict[str, Callable[..., UnetEstimator]] = {
    "unet": partial(load_network, "unet"),
    "mc_dropout": partial(load_network, "mc_dropout"),
}
"""Network estimators by name."""
