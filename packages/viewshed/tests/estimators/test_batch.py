"""Many sweeps at once say what each says by itself, in order, with bounded memory, and fail where they would."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.networks.made import card, drawn

from viewshed import BevGrid, Sweep
from viewshed.arrays import F32
from viewshed.estimators import CLASSICAL
from viewshed.estimators.batch import estimate_all
from viewshed.estimators.classical import ClassicalEstimator
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import TemporalEstimator
from viewshed.estimators.unet import UnetEstimator
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import CAR, Target
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.networks.runtime import OnnxRunner
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab.training.onnx_export import export_onnx

GRID = BevGrid(32, 16.0)
SHAPE = UNetShape(4, 2, 0.3)


def sweep_of(number: int) -> Sweep:
    """Ground about the sensor and a wall of 2300 returns and ``number`` more; every fourth sweep is empty."""
    rng = np.random.default_rng(number)
    ground = np.column_stack([rng.uniform(-15, 15, (2000 + number, 2)), np.full(2000 + number, -1.8)])
    wall = np.column_stack([np.full(300, rng.uniform(4, 12)), rng.uniform(-3, 3, 300), rng.uniform(-1.6, 0.2, 300)])
    points = np.concatenate([ground, wall])[: 0 if number % 4 == 3 else None]
    return Sweep(points.astype(np.float32), sensor_height_m=1.8, t_ns=number)


SWEEPS = [sweep_of(number) for number in range(10)]


def same(found: FovEstimate, expected: FovEstimate, atol: float = 0.0) -> None:
    assert (found.t_ns, found.method, found.grid) == (expected.t_ns, expected.method, expected.grid)
    np.testing.assert_allclose(found.visible_prob, expected.visible_prob, rtol=0, atol=atol)
    np.testing.assert_allclose(found.std, expected.std, rtol=0, atol=atol, equal_nan=True)
    assert np.array_equal(found.state, expected.state)


@pytest.mark.parametrize("batch", [1, 3, 16])
@pytest.mark.parametrize("passes", [1, 4])
def test_a_batch_says_what_its_sweeps_say_one_by_one(passes: int, batch: int, tmp_path: Path) -> None:
    """To rounding: an engine may add up a batch in another order."""
    export_onnx(tmp_path / "net.onnx", card(SHAPE, GRID), drawn(SHAPE))
    estimator = UnetEstimator(OnnxRunner(tmp_path / "net.onnx", 1), passes)
    found = list(estimate_all(estimator, SWEEPS, batch, threads=3))
    assert len(found) == len(SWEEPS)
    for each, sweep in zip(found, SWEEPS, strict=True):
        same(each, estimator.estimate(sweep), atol=1e-6)
    assert np.ptp([each.visible_prob.mean() for each in found]) > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CLASSICAL))
def test_without_a_network_it_is_the_same_to_the_bit(name: str) -> None:
    estimator = CLASSICAL[name](GRID)
    for each, sweep in zip(estimate_all(estimator, SWEEPS, 4, threads=3), SWEEPS, strict=True):
        same(each, estimator.estimate(sweep))


@dataclass(slots=True)
class CountingRunner:
    """A network that remembers how many inputs it was given, and says NaN of one with ``unknown`` returns."""

    card: NetworkCard = field(default_factory=lambda: card(SHAPE, GRID))
    inputs: list[int] = field(default_factory=list)
    unknown: int = -1

    def single_threaded(self) -> None:
        return

    def run(self, inputs: NDArray[Any], masks: F32 | None = None) -> F32:
        self.inputs.append(len(inputs))
        count = len(inputs if masks is None else masks)
        prob = np.full((count, *GRID.shape), 0.5, np.float32)
        if len(inputs) == count:
            prob[np.round(1000 * inputs.sum(axis=(1, 2, 3))) == self.unknown] = np.nan
        return prob


def test_a_network_is_run_once_for_a_batch_and_for_no_sweep_without_returns() -> None:
    network = CountingRunner()
    assert len(list(estimate_all(UnetEstimator(network), SWEEPS, 4))) == 10
    assert network.inputs == [3, 3, 2]
    several = CountingRunner()
    assert len(list(estimate_all(UnetEstimator(several, passes=3), SWEEPS, 4))) == 10
    assert several.inputs == [1] * 8
    nothing = CountingRunner()
    assert len(list(estimate_all(UnetEstimator(nothing), [SWEEPS[3]] * 5, 4))) == 5
    assert nothing.inputs == []
    assert list(estimate_all(UnetEstimator(nothing), [])) == []


def test_sweeps_are_taken_as_they_are_needed() -> None:
    taken = 0

    def endless() -> Iterator[Sweep]:
        nonlocal taken
        for taken in count(1):
            yield SWEEPS[taken % 3]

    found = estimate_all(UnetEstimator(CountingRunner()), endless(), batch=4)
    assert taken == 0
    for number in range(20):
        next(found)
        assert taken <= number + 2 * 4
    found.close()  # type: ignore[attr-defined]
    assert not [each.name for each in threading.enumerate() if each.name.startswith("viewshed")]


@dataclass(frozen=True, slots=True)
class Picky(ClassicalEstimator):
    """An estimator that cannot take some sweeps."""

    bad: tuple[int, ...]
    grid: BevGrid = GRID
    target: Target = CAR
    name: str = "picky"

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> F32:
        if leveled.sweep.t_ns in self.bad:
            raise ValueError(f"no sweep {leveled.sweep.t_ns}")
        return np.zeros(GRID.shape, np.float32)


@pytest.mark.parametrize("batch", [1, 4, 16])
def test_a_sweep_that_fails_does_so_where_its_estimate_would_have_come(batch: int) -> None:
    found = estimate_all(Picky((5, 7)), SWEEPS, batch)
    assert [next(found).t_ns for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(ValueError, match="no sweep 5"):
        next(found)
    assert list(found) == []
    told: list[str] = []
    rest = estimate_all(Picky((5, 7)), SWEEPS, batch, on_error=lambda error: told.append(str(error)))
    before = [(each.t_ns, len(told)) for each in rest]
    assert before == [(0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (6, 1), (8, 2), (9, 2)]
    assert told == ["no sweep 5", "no sweep 7"]


def test_what_a_network_says_of_one_sweep_does_not_spoil_the_others() -> None:
    told: list[Exception] = []
    found = estimate_all(UnetEstimator(CountingRunner(unknown=2305)), SWEEPS, 8, on_error=told.append)
    assert [each.t_ns for each in found] == [0, 1, 2, 3, 4, 6, 7, 8, 9]
    assert [str(each) for each in told] == ["visible_prob must lie in [0, 1] and not be NaN"]


@pytest.mark.parametrize("batch", [1, 4, 16])
def test_sweeps_that_cannot_be_read_further_are_estimated_so_far(batch: int) -> None:
    def breaking() -> Iterator[Sweep]:
        yield from SWEEPS[:6]
        raise OSError("the disk is gone")

    found = estimate_all(ShadowMap(GRID), breaking(), batch)
    assert [next(found).t_ns for _ in range(6)] == [0, 1, 2, 3, 4, 5]
    with pytest.raises(OSError, match="the disk is gone"):
        next(found)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"batch": 0}, r"batch must lie in \[1, 1024\], got 0"),
        ({"batch": 1025}, r"batch must lie in \[1, 1024\], got 1025"),
        ({"threads": 0}, "threads must be at least 1, got 0"),
        (
            {"estimator": TemporalEstimator(ShadowMap(GRID))},
            "an estimator with its own history takes sweeps one after the other",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_before_a_sweep_is_taken(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        estimate_all(**{"estimator": ShadowMap(GRID), "sweeps": SWEEPS, **settings})
