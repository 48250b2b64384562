"""What one job finds, against the same steps taken one by one."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from viewshed import BevGrid, Sweep
from viewshed.estimators import ESTIMATORS
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.studies.cases import Case, apply, attack_of, generator, visible_with
from viewshed.studies.robustness.jobs import Bench, do_job
from viewshed.studies.robustness.plan import Job, study_named
from viewshed.studies.suite import Subject, subject_of
from viewshed.threats.attacks import Wedge
from viewshed.threats.attacks.adaptive import BlackBox, OverClaim
from viewshed.threats.attacks.replay import Replay
from viewshed.threats.defenses import DEFENSES, TemporalConsistency

STUDY = replace(
    study_named("tiny"), samples=(1,), attacks=("uniform", "replay"), corruptions=("fog",), severities=(3,),
    defenses=("radius", "temporal"), defended=("quantized",),
)  # fmt: skip
UNIFORM = Case("attack", "uniform", "150")


@pytest.fixture(scope="module")
def subject() -> Subject:
    return subject_of("ugv", 0, 1, STUDY.seed)


def _entries(part: str) -> dict[tuple[str, ...], dict[str, Any]]:
    return {tuple(entry["case"]): entry for entry in do_job(Job(STUDY, 0, 0, part))["cases"]}


def test_a_defended_estimate_is_one_of_what_the_defense_leaves(subject: Subject) -> None:
    entry = _entries("defenses")["attack", "uniform", "150", "radius"]
    trial = apply(UNIFORM, subject, generator(STUDY.seed, "ugv", 0, UNIFORM))
    defended = DEFENSES["radius"]().apply(trial.sweep)
    assert trial.added is not None
    by_hand = [0, 0, 0, 0, 0]
    for dropped, added in zip(defended.dropped, trial.added, strict=True):
        by_hand[1 if added else 3] += int(dropped)
        by_hand[2 if added else 4] += 1
    assert entry["defense"] == [None, *by_hand[1:]]
    assert by_hand[1] != by_hand[3]
    claimed = ESTIMATORS["quantized"](subject.sample.truth.grid).estimate(defended.sweep).visible()
    true, known = subject.sample.truth.visible(), subject.sample.known
    expected = [(claimed & true & known).sum(), (claimed & ~true & known).sum(), (~claimed & true & known).sum()]
    assert entry["scores"]["quantized"][:3] == expected


def test_an_attack_with_nothing_to_spend_scores_as_none() -> None:
    entries = _entries("attacks")
    clean = entries["benign", "", "", ""]["scores"]
    assert list(clean)[7:] == ["shadow_map", "shadow_map_unknown", "majority_vote"]
    assert set(clean) == {*ESTIMATORS, "shadow_map_unknown"}
    for name, values in entries["attack", "uniform", "0", ""]["scores"].items():
        assert values == clean[name]
    assert entries["attack", "uniform", "150", ""]["scores"]["quantized"] != clean["quantized"]


def test_the_attacker_replays_two_seconds_and_the_defense_recalls_half_a_second(subject: Subject) -> None:
    now_ns = subject.sample.sweep.t_ns
    replay = attack_of(Case("attack", "replay", "full"), subject)
    assert isinstance(replay, Replay)
    temporal = Bench.of(Job(STUDY, 0, 0, "defenses")).defenses["temporal"]
    assert isinstance(temporal, TemporalConsistency)
    assert now_ns is not None
    before = [now_ns - sweep.t_ns for sweep in (replay.earlier, *temporal.earlier) if sweep.t_ns is not None]
    assert before == pytest.approx([2e9, 0.5e9])


ASKING = replace(STUDY, adaptive=("adaptive_over_claim",), adaptive_queries=6, adaptive_defended=("quantized",))


@pytest.fixture(scope="module")
def asked() -> dict[tuple[str, ...], dict[str, Any]]:
    return {tuple(entry["case"]): entry for entry in do_job(Job(ASKING, 0, 0, "adaptive"))["cases"]}


@dataclass(frozen=True)
class _Filtered:
    """A victim behind the radius filter."""

    victim: FovEstimator

    @property
    def grid(self) -> BevGrid:
        return self.victim.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        return self.victim.estimate(DEFENSES["radius"]().apply(sweep).sweep)


def _by_hand(subject: Subject, victim: FovEstimator) -> tuple[Sweep, Wedge]:
    """The attack that asks ``victim``, where the far wall would be."""
    far_wall = Case("attack", "far_wall", "0")
    wedge = apply(far_wall, subject, generator(STUDY.seed, "ugv", 0, far_wall)).wedge
    assert wedge is not None
    attack = BlackBox(OverClaim(victim), 150, 6, np.rad2deg(wedge.width), wedge.azimuth, 25.0 * 16 / 64)
    rng = generator(STUDY.seed, "ugv", 0, Case("adaptive", "adaptive_over_claim", "150"))
    return attack.apply(subject.sample.sweep, rng).sweep, wedge


def _counted(subject: Subject, victim: str, sweep: Sweep, wedge: Wedge) -> list[int]:
    grid = subject.sample.truth.grid
    claimed = ESTIMATORS[victim](grid).estimate(sweep).visible()
    true, known = subject.sample.truth.visible(), subject.sample.known
    x, y = np.moveaxis(grid.centers, -1, 0)
    inside = known & wedge.holds(np.arctan2(y, x))
    return [int((mask & cells).sum()) for cells in (known, inside)
            for mask in (claimed & true, claimed & ~true, ~claimed & true, ~claimed & ~true)]  # fmt: skip


@pytest.mark.parametrize("victim", ["quantized", "first_blocker"])
def test_each_victim_meets_the_attack_that_asked_it(
    victim: str, subject: Subject, asked: dict[tuple[str, ...], dict[str, Any]]
) -> None:
    sweep, wedge = _by_hand(subject, ESTIMATORS[victim](subject.sample.truth.grid))
    attacked = asked["adaptive", "adaptive_over_claim", "150", ""]["scores"]
    assert attacked[victim][:8] == _counted(subject, victim, sweep, wedge)
    calm = asked["adaptive", "adaptive_over_claim", "0", ""]["scores"]
    assert calm[victim][:8] == _counted(subject, victim, subject.sample.sweep, wedge)
    assert attacked[victim][5] > calm[victim][5]
    assert set(attacked) == {*ESTIMATORS, "shadow_map_unknown"}


def test_who_knows_the_defense_asks_behind_it(subject: Subject, asked: dict[tuple[str, ...], dict[str, Any]]) -> None:
    victim, radius = ESTIMATORS["quantized"](subject.sample.truth.grid), DEFENSES["radius"]()
    for kind, asks in (("unaware", victim), ("adaptive", _Filtered(victim))):
        sweep, wedge = _by_hand(subject, asks)
        found = asked[kind, "adaptive_over_claim", "150", "radius"]["scores"]
        assert list(found) == ["quantized"]
        assert found["quantized"][:8] == _counted(subject, "quantized", radius.apply(sweep).sweep, wedge)
    calm = asked["adaptive", "adaptive_over_claim", "0", "radius"]["scores"]["quantized"]
    assert calm[:8] == _counted(subject, "quantized", radius.apply(subject.sample.sweep).sweep, wedge)


def test_a_truth_for_fewer_beams_counts_in_every_part(subject: Subject) -> None:
    study = replace(STUDY, corruptions=("fewer_beams",), defenses=("radius",), defended_severity=3)
    case = Case("corruption", "fewer_beams", "3")
    visible = visible_with(case, subject, generator(STUDY.seed, "ugv", 0, case))
    assert visible is not None
    for part, defense in (("corruptions", ""), ("defenses", "radius")):
        found = {tuple(entry["case"]): entry for entry in do_job(Job(study, 0, 0, part))["cases"]}
        both, _, under, _ = found["corruption", "fewer_beams", "3", defense]["scores"]["quantized"][:4]
        assert both + under == (visible & subject.sample.known).sum()


def test_a_case_that_cannot_be_made_is_told_and_the_rest_goes_on(subject: Subject) -> None:
    alone = Bench.of(Job(STUDY, 0, 0, "attacks"))
    alone = replace(alone, subject=Subject(subject.sample))
    refused = dict(alone.line(Case("attack", "replay", "full")))
    assert refused["refused"].startswith("replay needs an earlier sweep, got none")
    assert "scores" not in refused
    assert "scores" in dict(alone.line(UNIFORM))


def test_a_job_tells_nothing_of_the_machine() -> None:
    line = do_job(Job(STUDY, 0, 0, "corruptions"))
    assert line["job"] == ["ugv", 0, "corruptions"]
    assert set(line["about"]) == {"scene", "returns", "cell_m2", "commits"}
    assert line["about"]["cell_m2"] == pytest.approx((32 / 256) ** 2)
    fog = {tuple(entry["case"]): entry for entry in line["cases"]}["corruption", "fog", "3", ""]["scores"]
    assert all(np.sum(values[:4]) == np.sum(fog["majority_vote"][:4]) for values in fog.values())
