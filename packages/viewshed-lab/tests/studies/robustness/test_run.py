"""What one job finds, against the same steps taken one by one; a study that is stopped and goes on."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from viewshed import BevGrid, Sweep
from viewshed.estimators import CLASSICAL
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.metrics import ConfusionCounts
from viewshed_lab._jobs import engine_named
from viewshed_lab.studies.cases import apply, attack_of, case_generator
from viewshed_lab.studies.records import WEDGE, Case, Domain, Results, Series
from viewshed_lab.studies.robustness import jobs
from viewshed_lab.studies.robustness.jobs import do_job, evaluation_of, run_study
from viewshed_lab.studies.robustness.plan import RobustnessPlan
from viewshed_lab.studies.runner import Job
from viewshed_lab.studies.samples import StudySample, sample_of
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.threats.attacks import Wedge
from viewshed_lab.threats.attacks.adaptive import BlackBox, OverClaim
from viewshed_lab.threats.attacks.replay import Replay
from viewshed_lab.threats.defenses import DEFENSES, TemporalConsistency

pytestmark = pytest.mark.slow

PLAN = replace(
    RobustnessPlan.load("tiny"), samples=(1,), attacks=("uniform", "replay"), corruptions=("fog",), severities=(3,),
    defenses=("radius", "temporal"), defended=("quantized",),
)  # fmt: skip
UNIFORM = Case("attack", "uniform", "150")
rng_of = partial(case_generator, PLAN.seed, "ugv", 0)


@pytest.fixture(scope="module")
def sample() -> StudySample:
    return sample_of("ugv", 0, 1, PLAN.seed)


def _job(part: str, plan: RobustnessPlan = PLAN) -> Job[RobustnessPlan]:
    return Job(plan, Path(), (part, "ugv", "0"))


def _results(part: str, plan: RobustnessPlan = PLAN) -> Results[RobustnessPlan]:
    return Results.of(plan, do_job(_job(part, plan)).rows)


def _counted(sample: StudySample, method: str, sweep: Sweep, wedge: Wedge | None = None) -> ConfusionCounts:
    """Counts by hand, in the view or in a wedge."""
    grid = sample.truth.grid
    claimed, true, cells = CLASSICAL[method](grid).estimate(sweep).visible(), sample.truth.visible(), sample.known
    x, y = np.moveaxis(grid.centers, -1, 0)
    cells = cells if wedge is None else cells & wedge.holds(np.arctan2(y, x))
    masks = (claimed & true, claimed & ~true, ~claimed & true, ~claimed & ~true)
    both, over, under, neither = (int((mask & cells).sum()) for mask in masks)
    return ConfusionCounts(both, over, under, neither, int(cells.sum()) * grid.cell_area_m2)


def test_a_defended_estimate_is_one_of_what_the_defense_leaves(sample: StudySample) -> None:
    results, case = _results("defenses"), replace(UNIFORM, defense="radius")
    tampered = apply(UNIFORM, sample, rng_of(UNIFORM))
    defended = DEFENSES["radius"]().apply(tampered.sweep)
    by_hand = {"caught": 0, "added": 0, "lost": 0, "others": 0}
    for dropped, added in zip(defended.dropped, tampered.added, strict=True):
        by_hand["caught" if added else "lost"] += int(dropped)
        by_hand["added" if added else "others"] += 1
    judged = Series("ugv", "", case)
    assert {name: results.numbers(judged, name).tolist() for name in by_hand} == {n: [k] for n, k in by_hand.items()}
    assert results.numbers(judged, "alarm").size == 0
    assert by_hand["caught"] != by_hand["lost"]
    assert results.counts(Series("ugv", "quantized", case)) == _counted(sample, "quantized", defended.sweep)


def test_the_attacker_replays_two_seconds_and_the_defense_recalls_half_a_second(sample: StudySample) -> None:
    now_ns = sample.sweep.t_ns
    replay = attack_of(Case("attack", "replay", "full"), sample)
    assert isinstance(replay, Replay)
    temporal = evaluation_of(_job("defenses")).defenses["temporal"]
    assert isinstance(temporal, TemporalConsistency)
    assert now_ns is not None
    before = [now_ns - sweep.t_ns for sweep in (replay.earlier, *temporal.earlier) if sweep.t_ns is not None]
    assert before == pytest.approx([2e9, 0.5e9])


ASKING = replace(PLAN, adaptive=("adaptive_over_claim",), adaptive_queries=6, adaptive_defended=("quantized",))


@pytest.fixture(scope="module")
def adaptive_results() -> Results[RobustnessPlan]:
    return _results("adaptive", ASKING)


@dataclass(frozen=True)
class _Filtered:
    """A victim behind the radius filter."""

    victim: FovEstimator

    @property
    def grid(self) -> BevGrid:
        return self.victim.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        return self.victim.estimate(DEFENSES["radius"]().apply(sweep).sweep)


def _by_hand(sample: StudySample, victim: FovEstimator) -> tuple[Sweep, Wedge]:
    """The attack that asks ``victim``, where the far wall would be."""
    far_wall = Case("attack", "far_wall", "0")
    wedge = apply(far_wall, sample, rng_of(far_wall)).wedge
    assert wedge is not None
    attack = BlackBox(OverClaim(victim), 150, 6, np.rad2deg(wedge.width), wedge.azimuth, 25.0 * 16 / 64)
    return attack.apply(sample.sweep, rng_of(Case("adaptive", "adaptive_over_claim", "150"))).sweep, wedge


@pytest.mark.parametrize("victim", ["quantized", "first_blocker"])
def test_each_victim_meets_the_attack_that_queried_it(
    victim: str, sample: StudySample, adaptive_results: Results[RobustnessPlan]
) -> None:
    sweep, wedge = _by_hand(sample, CLASSICAL[victim](sample.truth.grid))
    attacked, calm = (Series("ugv", victim, Case("adaptive", "adaptive_over_claim", level)) for level in ("150", "0"))
    assert adaptive_results.counts(attacked) == _counted(sample, victim, sweep)
    assert adaptive_results.counts(attacked.of(WEDGE)) == _counted(sample, victim, sweep, wedge)
    assert adaptive_results.counts(calm.of(WEDGE)) == _counted(sample, victim, sample.sweep, wedge)
    assert adaptive_results.counts(attacked.of(WEDGE)).over > adaptive_results.counts(calm.of(WEDGE)).over
    assert set(Domain(adaptive_results, "ugv").methods) == {*CLASSICAL, "shadow_map_unknown"}


def test_who_knows_the_defense_queries_behind_it(
    sample: StudySample, adaptive_results: Results[RobustnessPlan]
) -> None:
    victim, radius = CLASSICAL["quantized"](sample.truth.grid), DEFENSES["radius"]()
    for kind, asks in (("unaware", victim), ("adaptive", _Filtered(victim))):
        sweep, wedge = _by_hand(sample, asks)
        case = Case(kind, "adaptive_over_claim", "150", "radius")
        assert {s.method for s in adaptive_results.series() if s.case == case} == {"quantized"}
        expected = _counted(sample, "quantized", radius.apply(sweep).sweep, wedge)
        assert adaptive_results.counts(Series("ugv", "quantized", case, WEDGE)) == expected
    calm = Series("ugv", "quantized", Case("adaptive", "adaptive_over_claim", "0", "radius"), WEDGE)
    assert adaptive_results.counts(calm) == _counted(sample, "quantized", radius.apply(sample.sweep).sweep, wedge)


SMALLEST = replace(
    RobustnessPlan.load("tiny"), attacks=("uniform", "far_wall"), budgets=("0", "150"), corruptions=("fog",),
    severities=(2,), defenses=("radius",), defended=("quantized",), adaptive=("adaptive_over_claim",),
    adaptive_queries=4,
)  # fmt: skip


def test_a_job_that_fails_is_named_and_the_rest_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def only_rooms(domain: str, *of: int) -> StudySample:
        if domain == "ugv":
            return sample_of(domain, *of)
        raise ValueError(f"no sweep of {domain}")

    monkeypatch.setattr(jobs, "_sample", only_rooms)
    plan = replace(SMALLEST, domains=("ugv", "carla"), samples=(1, 1), adaptive_samples=(1, 0))
    failed = list(run_study(ResultStore.open(tmp_path, plan), engine_named("local", 1)))
    assert len(failed) == 4
    assert all("carla 0: no sweep of carla" in line for line in failed)
    assert len(ResultStore.open(tmp_path, plan).keys()) == 5
