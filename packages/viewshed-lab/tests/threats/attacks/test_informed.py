"""Attackers who keep to a monitor's rules: objects that vanish and appear on flat ground, and on simulated sweeps."""

import numpy as np
import pytest
from tests.threats.attacks.conftest import MODEL, SENSOR_M, FlatScene
from tests.threats.attacks.drawn import generator, same
from tests.threats.attacks.oracle import Scene, broken_on_beams

from viewshed import Sweep
from viewshed_lab.threats.attacks import INFORMED, Knowledge
from viewshed_lab.threats.attacks.informed import CopiedObject, VanishedObject


def _pixels(sweep: Sweep) -> dict[tuple[int, int], np.ndarray]:
    assert sweep.ring is not None
    azimuth = np.arctan2(sweep.points[:, 1], sweep.points[:, 0])
    column = np.rint((azimuth + np.pi) / MODEL.azimuth_step - 0.5).astype(int) % 720
    return {(int(ring), int(at)): point for ring, at, point in zip(sweep.ring, column, sweep.points, strict=True)}


def test_a_wall_vanishes_and_leaves_flat_ground(flat_scene: FlatScene) -> None:
    """What is left is the scene without the wall, beam by beam."""
    attack = VanishedObject(sector_deg=60.0)
    tampered = attack.apply(flat_scene(12.0), generator(1))
    now, without = _pixels(tampered.sweep), _pixels(flat_scene())
    assert tampered.removed.sum() > 900
    assert set(now) == set(without)
    off_m = np.array([np.abs(now[beam] - without[beam]).max() for beam in without])
    assert off_m.max() < 0.3  # at 51 m, where 1 cm of height is 30 cm along the beam
    made = tampered.sweep.points[tampered.added]
    assert np.abs(made[:, 2] + SENSOR_M).max() < 0.012


def test_noise_behind_what_vanishes_is_that_beside_it(flat_scene: FlatScene) -> None:
    """A sensor with 2 cm on the ground: so has the ground that is made."""
    clean = flat_scene(12.0)
    depth_m = np.linalg.norm(clean.points, axis=1, keepdims=True)
    noisy = clean.replace(
        points=(clean.points * (1 + 0.02 * generator(5).normal(size=depth_m.shape) / depth_m)).astype("f4")
    )
    tampered = VanishedObject(sector_deg=60.0).apply(noisy, generator(1))
    without = _pixels(flat_scene())
    made = tampered.sweep.select(np.flatnonzero(tampered.added))
    off_m = [np.linalg.norm(point) - np.linalg.norm(without[beam]) for beam, point in _pixels(made).items()]
    near = [off for off, point in zip(off_m, made.points, strict=True) if np.linalg.norm(point) < 20.0]
    assert len(near) > 200
    assert np.std(near) == pytest.approx(0.02, rel=0.3)


def test_a_copy_is_the_wall_turned(flat_scene: FlatScene) -> None:
    clean = flat_scene(12.0)
    tampered = CopiedObject(sector_deg=60.0).apply(clean, generator(2))
    wall = clean.points[clean.points[:, 2] > 0.3 - SENSOR_M]
    made = tampered.sweep.points[tampered.added]
    assert tampered.wedge is not None
    high = made[made[:, 2] > 0.3 - SENSOR_M]
    assert len(high) == len(wall)
    assert np.sort(np.linalg.norm(high, axis=1)) == pytest.approx(np.sort(np.linalg.norm(wall, axis=1)), abs=0.003)
    # Nothing of what was behind the copy is left.
    columns = {at for _, at in _pixels(tampered.sweep.select(np.flatnonzero(tampered.added)))}
    behind = [point for (_, at), point in _pixels(tampered.sweep).items() if at in columns]
    assert np.linalg.norm(np.array(behind)[:, :2], axis=1).max() < 13.6


@pytest.mark.parametrize("name", sorted(INFORMED))
def test_informed_attacks_keep_the_rules(name: str, simulated: list[Scene]) -> None:
    effective = 0
    for seed, scene in enumerate(simulated):
        for budget in (None, 40):
            attack = INFORMED[name](budget, Knowledge(half_extent_m=scene.half_extent_m))
            before = scene.sweep.points.tobytes()
            tampered = attack.apply(scene.sweep, generator(seed))
            assert before == scene.sweep.points.tobytes()
            assert same(tampered, attack.apply(scene.again(), generator(seed)))
            assert broken_on_beams(scene, tampered, budget) == [], scene.name
            effective += bool(tampered.added.any())
    assert effective >= 6
