"""What a study runs: plans, cases and their order of strength."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from viewshed_lab.studies import samples
from viewshed_lab.studies.cases import apply, case_generator
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.studies.robustness.plan import PARTS, RobustnessPlan
from viewshed_lab.studies.samples import sample_of
from viewshed_lab.threats.attacks import ATTACKS
from viewshed_lab.threats.corruptions import CORRUPTIONS
from viewshed_lab.threats.defenses import DEFENSES

TINY = RobustnessPlan.load("tiny")


def test_the_small_study_has_every_member_of_every_table() -> None:
    study = RobustnessPlan.load("small")
    cases = {part: study.cases(part) for part in PARTS}
    assert {case.name for case in cases["attacks"] if case.name} == set(ATTACKS)
    assert {(c.name, c.level) for c in cases["corruptions"]} == {(n, str(s)) for n in CORRUPTIONS for s in range(1, 6)}
    assert {case.defense for case in cases["defenses"]} == set(DEFENSES)
    levels = {case.level for case in cases["attacks"] if case.name == "ghost_wall" and case.kind == "attack"}
    assert levels == {"0", "50", "100", "150", "200", "1000", "full"}
    assert all(len(set(each)) == len(each) for each in cases.values())
    asked = sum(study.adaptive_samples)
    assert len(study.job_keys()) == sum(study.samples) * (len(PARTS) - 1) + asked == len(set(study.job_keys()))
    assert {(c.name, c.defense) for c in cases["adaptive"] if c.level == "150"} >= {
        ("adaptive_under_claim", ""), *(("adaptive_over_claim", defense) for defense in DEFENSES)
    }  # fmt: skip


@pytest.mark.parametrize("name", list(ATTACKS))
def test_every_attack_has_a_strongest_case_that_is_run(name: str) -> None:
    study = RobustnessPlan.load("small")
    case = study.strongest(name)
    free = name in {"uniform", "cluster", "wedge_cluster_free", "frustum_free"}
    assert case.level == ("yaw_deg 5" if name == "pose_spoof" else "1000" if free else "full")
    assert case in study.cases("attacks")
    assert replace(case, defense="radius") in study.cases("defenses")
    assert TINY.strongest("uniform").level == "150"


def test_a_case_touches_what_its_budget_says_and_its_seed_is_its_own() -> None:
    sample = sample_of("ugv", 1, 3, 7)
    clean = sample.sweep
    few = apply(Case("attack", "uniform", "50"), sample, case_generator(1, "ugv", 1, Case("attack", "uniform", "50")))
    assert (int(few.added.sum()), len(few.sweep)) == (50, len(clean) + 50)
    again = apply(
        Case("attack", "uniform", "50"), sample, case_generator(1, "ugv", 1, Case("attack", "uniform", "100"))
    )
    assert np.array_equal(few.sweep.points, again.sweep.points)
    other = apply(Case("attack", "uniform", "50"), sample, case_generator(1, "ugv", 2, Case("attack", "uniform", "50")))
    assert not np.array_equal(few.sweep.points, other.sweep.points)
    assert apply(BENIGN, sample, case_generator(1, "ugv", 1, BENIGN)).sweep is clean


def test_wedges_are_the_same_for_every_budget_so_that_none_is_the_reference() -> None:
    sample = sample_of("nuscenes", 0, 2, 7)
    for name in ("ghost_wall", "far_wall", "removal", "wedge_cluster", "high_frequency_removal"):
        cases = [Case("attack", name, level) for level in ("0", "100", "full")]
        trials = [apply(case, sample, case_generator(3, "nuscenes", 0, case)) for case in cases]
        assert trials[0].wedge is not None
        assert {(trial.wedge.azimuth, trial.wedge.width) for trial in trials if trial.wedge} == {
            (trials[0].wedge.azimuth, trials[0].wedge.width)
        }
        assert not trials[0].added.any()
        assert len(trials[0].sweep) == len(sample.sweep)


def test_earlier_sweeps_are_of_the_same_sensor_and_before() -> None:
    for domain, agents in (("carla", 10), ("ugv", 1)):
        sample = sample_of(domain, 7, 8, 7)
        assert sample.sweep.agent.endswith(f"_{7 % agents - 5 if agents == 10 else 0}")
        now_ns = sample.sweep.t_ns
        assert now_ns is not None
        befores = [now_ns - earlier.t_ns for earlier in sample.earlier if earlier.t_ns is not None]
        assert befores == pytest.approx([2e9, 0.5e9])
        assert {earlier.agent for earlier in sample.earlier} == {sample.sweep.agent}


def test_each_kind_of_world_is_sampled_over_its_whole_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "simulate_frame", Mock())
    shares: dict[str, list[float]] = {}
    for number in range(200):
        scene, frame = samples.sample_of("nuscenes", number, 200, 7).frame or pytest.fail("a sample is simulated")
        shares.setdefault(scene.world_kind, []).append(frame / scene.frames)
    assert len(shares) > 1
    for kind, of in shares.items():
        # The first two seconds of 20 s are left for the earlier sweeps.
        assert np.histogram(of, 4, (0.1, 1.0))[0].min() >= 0.15 * len(of), kind


def test_few_samples_meet_attackers_who_ask_and_they_are_spread_evenly() -> None:
    study = replace(TINY, samples=(12,), adaptive_samples=(3,))
    assert [number for part, _, number in study.job_keys() if part == "adaptive"] == ["0", "4", "8"]
    none = replace(TINY, adaptive_samples=(0,))
    assert {part for part, _, _ in none.job_keys()} == set(PARTS) - {"adaptive"}
