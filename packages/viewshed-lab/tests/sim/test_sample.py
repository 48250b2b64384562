"""The embedded sample is what its tool makes, small, and a scene in which left and right differ."""

from dataclasses import replace

import numpy as np

from viewshed import Sweep, lidar_model, read_sweep
from viewshed.io.samples import junction_path
from viewshed_lab.sim import cast, junction


def test_the_sample_is_small_and_made_from_its_seed() -> None:
    assert junction_path().stat().st_size <= 600_000
    sweep = read_sweep(junction_path())
    model = lidar_model("hdl32e")
    between_columns = replace(model, azimuth_offset=model.azimuth_offset + model.azimuth_step / 2)
    made = cast(between_columns, junction(), 1.84, rng=np.random.default_rng(20))
    assert len(sweep) == len(made)
    assert sweep.ring is not None
    assert made.ring is not None
    assert (sweep.ring == made.ring).all()
    assert np.abs(sweep.points - made.points).max() < 0.001


def test_the_bus_stands_ahead_at_the_left() -> None:
    """Its near side lies at x = 22.5 - 2.55 / 2, between y = 7 and 19, and nothing like it at the right."""
    sweep = read_sweep(junction_path())
    assert _on_side(sweep, 1.0) > 100
    assert _on_side(sweep, -1.0) == 0


def _on_side(sweep: Sweep, side: float) -> int:
    x, y, z = sweep.points.T
    wall = (np.abs(x - (22.5 - 1.275)) < 0.1) & (side * y > 7.0) & (side * y < 19.0) & (z > -1.0)
    return int(wall.sum())
