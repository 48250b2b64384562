"""The plans of the studies: they survive their plain values, and a wrong one is one line that names the key."""

import pytest

from viewshed_lab._config import preset_names
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.plan import Plan
from viewshed_lab.studies.robustness.plan import RobustnessPlan
from viewshed_lab.threats.attacks import ATTACKS

PLANS: list[type[Plan]] = [PaperPlan, RobustnessPlan]

REFUSED: dict[type[Plan], list[tuple[dict[str, object], str]]] = {
    PaperPlan: [
        ({"domains": ["moon", "ugv", "carla"]}, "domains must be among .*, got 'moon'"),
        ({"train_scenes": [1, 2]}, r"train_scenes must be a positive number for each domain, got \[1, 2\]"),
        ({"test_seed": 1}, "test_seed must not be the seed that is trained on, got 1 for both"),
        ({"cells": 30}, "cells must divide by 2 to the power of the depth 2, got 30"),
        (
            {"pair_frames": [3, 13, 3]},
            "pair_frames and strict_frames must be at most 12, the frames of nuscenes with an earlier one",
        ),
        ({"monitor_frames": 4}, "monitor_frames must be at most 3, a third of the held-out scenes"),
        ({"monitor_false_alarms": 0.2}, r"monitor_false_alarms must lie in \[1 / \(monitor_frames \+ 1\), 1\), got 0"),
        ({"trained_attacks": list(ATTACKS)}, "trained_attacks must name some attacks and leave others unseen"),
        ({"monitor_severity": 6}, "severity must be a whole number from 1 to 5, got 6"),
        ({"dropout": "much"}, "dropout must be float, got 'much'"),
    ],
    RobustnessPlan: [
        ({"attacks": ["nonsense"]}, "attacks must be among uniform, .*, got 'nonsense'"),
        ({"severities": [6]}, "severities must be among 1, 2, 3, 4, 5, got 6"),
        ({"budgets": ["half"]}, "budgets must be whole numbers or full, got 'half'"),
        ({"samples": [1, 2]}, r"samples must be a positive number for each of \['ugv'\], got \(1, 2\)"),
        ({"domains": ["moon"]}, "domains must be among .*, got 'moon'"),
        ({"domains": "ugv"}, "domains must be a list, got 'ugv'"),
        ({"domains": ["ugv", "ugv"], "samples": [1, 1]}, r"domains must be different names, got \['ugv', 'ugv'\]"),
        ({"paper_points": [-1]}, "paper_points must not be negative"),
        ({"adaptive": ["far_wall"]}, "adaptive must be among adaptive_over_claim, .*, got 'far_wall'"),
        ({"adaptive_samples": [3]}, r"adaptive_samples must be 0 to \[2\], one a domain, got \[3\]"),
        ({"adaptive_budget": 0}, r"adaptive_budget must lie in \[1, 1000000\], got 0"),
    ],
}
OF_EVERY_PLAN: list[tuple[dict[str, object], str]] = [
    ({"seed": -1}, r"seed must lie in \[0, 4294967295\], got -1"),
    ({"seed": True}, "seed must be int, got True"),
    ({"extra": 1}, "missing or unknown: extra"),
]


@pytest.mark.parametrize("kind", PLANS)
def test_a_plan_survives_its_plain_values(kind: type[Plan]) -> None:
    plans = [kind.load(name) for name in preset_names(kind.FOLDER)]
    assert len(plans) > 1
    for plan in plans:
        assert kind.from_json(plan.to_json()) == plan
        assert len(set(plan.job_keys())) == len(plan.job_keys()) > 0


@pytest.mark.parametrize(
    ("kind", "change", "complaint"),
    [(kind, change, complaint) for kind in PLANS for change, complaint in REFUSED[kind] + OF_EVERY_PLAN],
)
def test_a_wrong_plan_is_one_clear_line(kind: type[Plan], change: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint) as refused:
        kind.from_json(kind.load("tiny").to_json() | change)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", PLANS)
def test_an_unknown_plan_is_refused_with_those_that_there_are(kind: type[Plan]) -> None:
    with pytest.raises(ValueError, match=f"preset must be one of {', '.join(preset_names(kind.FOLDER))}, got 'huge'"):
        kind.load("huge")
