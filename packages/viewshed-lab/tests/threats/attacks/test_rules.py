"""Every attack of the table keeps the beam model's rules, whatever its parameters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.threats.attacks.drawn import broken, drawn
from tests.threats.attacks.oracle import Scene

from viewshed import Sweep, lidar_model
from viewshed.geometry import Rigid
from viewshed_lab.threats.attacks import (
    ATTACKS,
    BUDGETS,
    FAMILY,
    FREE_FORM,
    FULL_WEDGE,
    INFORMED,
    PAPER_ATTACK,
    SEVERITIES,
    WHOLE_CLOUD,
    Knowledge,
    at_severity,
)

NAMES = sorted(ATTACKS)


@pytest.mark.parametrize("name", NAMES)
def test_draws_at_random_keep_the_rules(name: str, simulated: list[Scene]) -> None:
    effective = 0
    for number in range(20):
        rng = np.random.Generator(np.random.PCG64([7, number]))
        scene = simulated[number % len(simulated)]
        attack, budget = drawn(name, scene, rng)
        rules, tampered = broken(name, scene, attack, budget, number)
        assert rules == [], (scene.name, attack)
        effective += bool(tampered.added.any() or tampered.removed.any())
    assert effective >= 8 or name == "pose_spoof"


@pytest.mark.slow
@settings(max_examples=60)
@given(st.sampled_from(NAMES), st.integers(0, 9), st.integers(0, 2**63 - 1))
def test_any_seed_keeps_the_rules(simulated: list[Scene], name: str, scene: int, seed: int) -> None:
    rng = np.random.Generator(np.random.PCG64(seed))
    attack, budget = drawn(name, simulated[scene], rng)
    assert broken(name, simulated[scene], attack, budget, seed)[0] == []


@pytest.mark.parametrize("name", NAMES)
def test_a_budget_of_nothing_does_nothing(name: str, simulated: list[Scene], rng: np.random.Generator) -> None:
    scene = simulated[0]
    tampered = ATTACKS[name](0, Knowledge((scene.earlier,))).apply(scene.sweep, rng)
    assert not tampered.added.any()
    assert not tampered.removed.any()
    assert tampered.sweep.points.tobytes() == scene.sweep.points.tobytes()
    assert (tampered.sweep.world_from_sensor.as_matrix() == scene.sweep.world_from_sensor.as_matrix()).all()


@pytest.mark.parametrize("name", NAMES)
def test_an_empty_sweep_stays_as_it_is_or_gets_free_points(name: str, rng: np.random.Generator) -> None:
    none = np.zeros(0, np.float32)
    empty = Sweep(
        np.zeros((0, 3), np.float32), none, np.zeros(0, np.int16), none, none,
        t_ns=0, world_from_sensor=Rigid.identity(), model=lidar_model("vlp16"),
    )  # fmt: skip
    tampered = ATTACKS[name](50, Knowledge((empty,))).apply(empty, rng)
    free = name in FREE_FORM and name != "frustum_free"
    assert len(tampered.sweep) == int(tampered.added.sum()) == (50 if free else 0)
    assert tampered.removed.shape == (0,)


def test_the_tables_fit_together() -> None:
    assert set(BUDGETS) == set(ATTACKS)
    assert set(FAMILY) == set(ATTACKS | INFORMED | WHOLE_CLOUD)
    assert {FAMILY[name] for name in ATTACKS} == {*range(1, 15), 17}
    assert FREE_FORM | set(SEVERITIES) <= set(ATTACKS)
    for name, budgets in BUDGETS.items():
        assert budgets[0] == 0
        assert (FULL_WEDGE in budgets) == (name not in FREE_FORM and name != "pose_spoof")
    for name, levels in SEVERITIES.items():
        for attribute, value in levels:
            assert getattr(at_severity(name, attribute, value), attribute) == value


def test_the_papers_mixture(simulated: list[Scene]) -> None:
    """Sizes and places by the description in the paper's code, shares within four standard deviations."""
    scene, counts = simulated[2], []
    for seed in range(300):
        tampered = PAPER_ATTACK.apply(scene.sweep, np.random.Generator(np.random.PCG64(seed)))
        points = tampered.sweep.points[tampered.added]
        pose = scene.sweep.world_from_sensor
        level = points @ (Rigid.from_yaw(-pose.yaw).rotation @ pose.rotation).T
        counts.append(len(points))
        if len(points) == 0:
            continue
        spread = np.ptp(level[:, :2], axis=0).max()
        assert np.abs(level[:, 2]).max() < 0.02
        if spread > 10.0:
            counts[-1] = -len(points)
            assert 80 <= len(points) <= 119
            assert np.hypot(level[:, 0], level[:, 1]).max() <= 80 * np.sqrt(2) + 0.1
        else:
            assert 10 <= len(points) <= 159
            assert spread <= 6.0
            assert 52.0 <= np.hypot(*level[:, :2].mean(axis=0)) <= 101.0
    found = np.array(counts)
    assert abs((found < 0).mean() - 0.6) < 0.12
    assert abs((found > 0).mean() - 0.2) < 0.1
    assert abs((found == 0).mean() - 0.2) < 0.1
