"""One clear line for what cannot be attacked, or with what."""

from typing import Any

import numpy as np
import pytest
from tests.threats.attacks.conftest import FlatScene
from tests.threats.attacks.drawn import MOVE_RETURNS

from viewshed import Sweep, lidar_model
from viewshed_lab.threats.attacks import ATTACKS, FREE_FORM, FULL_WEDGE, Knowledge
from viewshed_lab.threats.attacks.replay import CoherentPhantom, Replay


@pytest.mark.parametrize("name", sorted(set(ATTACKS) - {"pose_spoof"}))
def test_a_cloud_without_beams(name: str) -> None:
    """Attacks that must know empty beams say so; those that only move returns, or add free points, work."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-30, -20, -1.8], [30, 25, 1.5], (4000, 3)).astype(np.float32)
    cloud = Sweep(points, sensor_height_m=1.8)
    attack = ATTACKS[name](30, Knowledge((cloud,)))
    if name in FREE_FORM | MOVE_RETURNS:
        tampered = attack.apply(cloud, rng)
        assert tampered.added.any() or tampered.removed.any()
        return
    with pytest.raises(ValueError, match="beams of this sweep must be known, got 4000 points without rings; name"):
        attack.apply(cloud, rng)


@pytest.mark.parametrize("budget", [-1, 2.5, True, FULL_WEDGE + 1])
@pytest.mark.parametrize("name", sorted(set(ATTACKS) - {"pose_spoof", "replay"}))
def test_budgets_that_are_none(name: str, budget: Any) -> None:
    with pytest.raises(ValueError, match=r"budget must be a whole number of returns in \[0, 1000000000\], got"):
        ATTACKS[name](budget)


def test_what_lasts_needs_the_past(flat_scene: FlatScene, rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="replay needs an earlier sweep, got none"):
        ATTACKS["replay"]()
    clean = flat_scene()
    other = Sweep(clean.points[:200], ring=(np.arange(200) % 16).astype(np.int16), model=lidar_model("vlp16"))
    with pytest.raises(ValueError, match="earlier sweep must be of the same sensor with 28 rings, got 16"):
        Replay(other).apply(clean, rng)
    pose = clean.world_from_sensor
    with pytest.raises(ValueError, match="a sweep must have a pose for a ghost that stays in the world"):
        CoherentPhantom(pose).apply(clean.replace(world_from_sensor=None), rng)
    with pytest.raises(ValueError, match="a sweep must have a time for a ghost that moves"):
        CoherentPhantom(pose, 0, velocity_mps=(1.0, 0.0)).apply(clean.replace(t_ns=None), rng)
