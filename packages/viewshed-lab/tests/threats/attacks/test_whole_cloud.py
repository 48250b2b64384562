"""Attacks on the whole cloud, mirrors and trojans: by hand, and their record of what they did."""

from typing import Any

import numpy as np
import pytest
from tests.threats.attacks.oracle import Scene

from viewshed import Sweep
from viewshed_lab.data.tampered import AttackPlan
from viewshed_lab.threats.attacks import ATTACKS, WHOLE_CLOUD, Knowledge
from viewshed_lab.threats.attacks.whole_cloud import (
    Blinding,
    Mirror,
    SensorNoise,
    ShiftedAxis,
    TrojanInjects,
    TrojanSuppresses,
)


@pytest.mark.parametrize("name", sorted(WHOLE_CLOUD))
def test_what_was_done_is_recorded_and_the_same_seed_does_it_again(name: str, simulated: list[Scene]) -> None:
    for number, scene in enumerate(simulated[:4]):
        attack = WHOLE_CLOUD[name](None, Knowledge((scene.earlier,), None, scene.half_extent_m))
        before = scene.sweep.points.copy()
        first, second = (attack.apply(scene.sweep, np.random.default_rng(number)) for _ in range(2))
        assert first.sweep.points.tobytes() == second.sweep.points.tobytes()
        assert (scene.sweep.points == before).all()
        # Rows that the attacker did not make are those of the clean sweep that are left.
        assert (first.sweep.points[~first.added] == scene.sweep.points[~first.removed]).all()
        assert first.sweep.intensity is None or len(first.sweep.intensity) == len(first.sweep)


@pytest.mark.parametrize("name", sorted(WHOLE_CLOUD))
def test_a_budget_is_refused_and_an_empty_sweep_gets_at_most_injected_points(name: str) -> None:
    with pytest.raises(ValueError, match=f"attack {name} must have no budget, got 50"):
        WHOLE_CLOUD[name](50)
    assert name not in ATTACKS
    tampered = WHOLE_CLOUD[name]().apply(Sweep(np.zeros((0, 3), np.float32)), np.random.default_rng(0))
    assert len(tampered.sweep) == (200 if name == "trojan_injects" else 0)
    assert AttackPlan(name).attack == name


def test_an_axis_is_shifted_and_noise_is_as_large_as_said() -> None:
    points = np.random.default_rng(1).uniform(5.0, 30.0, (4000, 3)).astype(np.float32)
    shifted = ShiftedAxis(1.0, "y").apply(Sweep(points), np.random.default_rng(0))
    np.testing.assert_allclose(shifted.sweep.points - points, np.broadcast_to([0.0, 1.0, 0.0], points.shape), atol=1e-5)
    assert shifted.added.all()
    noisy = SensorNoise(0.05).apply(Sweep(points), np.random.default_rng(0)).sweep.points - points
    assert noisy.std(axis=0) == pytest.approx([0.05] * 3, rel=0.05)
    assert not SensorNoise(0.0).apply(Sweep(points), np.random.default_rng(0)).added.any()


def test_a_blinded_sensor_loses_returns_and_gets_near_ones() -> None:
    points = np.random.default_rng(1).uniform(10.0, 30.0, (4000, 3)).astype(np.float32)
    tampered = Blinding(0.8, 0.25, 3.0).apply(Sweep(points), np.random.default_rng(0))
    range_m = np.linalg.norm(tampered.sweep.points, axis=1)
    assert tampered.removed.mean() == pytest.approx(0.8, abs=0.03)
    assert tampered.added.sum() == pytest.approx(0.2 * 4000, rel=0.15)
    assert (range_m[tampered.added] <= 3.0).all()
    assert (range_m[~tampered.added] > 10.0).all()


def _wall(x_m: float) -> Any:
    """Returns of a wall across x, and of the ground 1.8 m below the sensor."""
    y, z = np.meshgrid(np.arange(-6.0, 6.0, 0.05), np.arange(-1.7, 0.5, 0.05))
    wall = np.column_stack([np.full(y.size, x_m), y.ravel(), z.ravel()])
    gx, gy = np.meshgrid(np.arange(-14.0, 20.0, 0.25), np.arange(-14.0, 14.0, 0.25))
    return np.concatenate([wall, np.column_stack([gx.ravel(), gy.ravel(), np.full(gx.size, -1.8)])])


def test_a_mirror_at_right_angles_shows_what_stands_beside_it() -> None:
    """A mirror ahead at 5 m whose normal is turned by 45°: a post 6 m to its left appears 6 m behind it."""
    post = np.column_stack([np.full(40, 5.0), np.linspace(5.9, 6.1, 40), np.linspace(-1.6, -0.4, 40)])
    scene = np.concatenate([_wall(12.0), post])
    mirror = Mirror(range_m=5.0, azimuth=0.0, width_m=2.0, height_m=1.8, turn_deg=-45.0)
    tampered = mirror.apply(Sweep(scene), np.random.default_rng(0))
    added = tampered.sweep.points[tampered.added]
    shown = added[np.abs(np.hypot(added[:, 0], added[:, 1]) - 11.0) < 0.3]
    assert len(shown) > 5
    # Beams that meet the mirror and show nothing are lost: the wall behind it is gone there.
    lost = scene[tampered.removed]
    assert len(tampered.sweep) < len(scene)
    assert (np.abs(lost[:, 1] / lost[:, 0]) < 0.2 * 1.3).all()
    x, y, z = tampered.sweep.points[~tampered.added].T
    assert not ((x > 11.9) & (np.abs(y) < 0.5) & (z < -0.6)).any()


def test_trojans_write_a_car_without_a_shadow_and_take_one_out(simulated: list[Scene]) -> None:
    scene = _wall(16.0)
    injected = TrojanInjects(10.0, 0.0, 300).apply(Sweep(scene), np.random.default_rng(0))
    car = injected.sweep.points[injected.added]
    assert not injected.removed.any()
    assert len(car) == 300
    assert (car.min(axis=0) >= [9.9, -0.95, -1.95]).all()
    assert (car.max(axis=0) <= [14.3, 0.95, -0.15]).all()
    y, z = np.meshgrid(np.linspace(-0.9, 0.9, 30), np.linspace(-1.6, -0.3, 20))
    box = np.column_stack([np.full(y.size, 8.0), y.ravel(), z.ravel()])
    taken = TrojanSuppresses(4.0, 12.0).apply(Sweep(np.concatenate([_wall(40.0), box])), np.random.default_rng(0))
    assert not taken.added.any()
    assert taken.removed[-len(box) :].mean() > 0.9
    assert not taken.removed[: len(scene)][np.abs(_wall(40.0)[: len(scene), 2] + 1.8) < 0.01].any()


def test_a_mirror_that_is_tilted_up_shows_the_sky() -> None:
    scene = _wall(12.0)
    tampered = Mirror(5.0, 0.0, 2.0, 1.8, turn_deg=0.0, tilt_deg=45.0).apply(Sweep(scene), np.random.default_rng(0))
    assert not tampered.added.any()
    assert tampered.removed.any()
