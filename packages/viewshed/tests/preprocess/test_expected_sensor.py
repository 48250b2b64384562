"""The sensor of the sweep before is looked at first; what comes out is the same as without, whatever was expected."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.io import read_index, read_indexed
from viewshed.preprocess import leveling
from viewshed.preprocess.sensor_identification import SensorId, identify_sensor
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim import Box, Scene, cast

SCENE = Scene((Box(14, 6, 1, 20, 8), Box(-20, -3, 1, 60, 9), Box(6, -9, 4.2, 1.8, 1.5)))
GRID = BevGrid(64, 32.0)


def sweep_of(name: str, seed: int = 0) -> Sweep:
    """A sweep whose rings are known, and whose sensor is not said."""
    return cast(lidar_model(name), SCENE, 1.8, rng=np.random.default_rng(seed)).replace(model=None, azimuth=None)


def in_order(sweep: Sweep) -> Sweep:
    assert sweep.ring is not None
    rows = np.lexsort((np.arctan2(sweep.points[:, 1], sweep.points[:, 0]), sweep.ring))
    return sweep.select(rows).replace(ring=None)


def assert_same(one: SensorId, other: SensorId) -> None:
    assert one.model is other.model
    np.testing.assert_equal(one.ring, other.ring)


def looked_at_first(count: int) -> NDArray[np.intp]:
    """Rows by which an expected sensor is confirmed."""
    return np.unique(np.random.default_rng(0).integers(count, size=2048))


@pytest.mark.parametrize("as_read", [lambda sweep: sweep, in_order])
@pytest.mark.parametrize("share", [0.1, 0.6])
@pytest.mark.parametrize("where", ["the returns that are looked at first", "all others"])
def test_an_attack_on_the_sample_or_beside_it_changes_nothing(
    where: str, share: float, as_read: Callable[[Sweep], Sweep]
) -> None:
    sweep, expected = as_read(sweep_of("hdl32e")), lidar_model("hdl32e")
    assert len(sweep) > 16_384
    rng = np.random.default_rng(5)
    attacked = np.zeros(len(sweep), np.bool_)
    attacked[looked_at_first(len(sweep))] = True
    attacked = (attacked if where.startswith("the returns") else ~attacked) & (rng.random(len(sweep)) < share)
    points = sweep.points.copy()
    points[attacked, 2] += rng.uniform(0.3, 6.0, int(attacked.sum()))
    moved = sweep.replace(points=points)
    assert_same(identify_sensor(moved, expected), identify_sensor(moved))


@pytest.mark.slow
def test_real_sweeps_have_the_same_sensor_after_any_other(real_data: object) -> None:
    expected = set[LidarModel | None]()
    for entry in read_index(f"{real_data}/index.json"):
        if entry.points is None:
            continue
        sweep = read_indexed(entry).replace(model=None)
        alone = identify_sensor(sweep)
        expected.add(alone.model)
        for model in expected:
            assert_same(identify_sensor(sweep, model), alone)


@pytest.mark.parametrize("history", [0, 2])
def test_a_stream_of_two_sensors_is_seen_as_sweep_by_sweep(history: int, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["hdl32e", "hdl32e", "vlp16", "hdl32e", "vlp16", "vlp16"]
    sweeps = [sweep_of(name, seed).replace(t_ns=seed * 1_000_000_000) for seed, name in enumerate(names)]
    alone = ShadowMap(GRID)
    single = [alone.estimate(sweep) for sweep in sweeps]
    asked = []

    def watched(sweep: Sweep, expected: LidarModel | None = None) -> SensorId:
        asked.append(expected)
        return identify_sensor(sweep, expected)

    monkeypatch.setattr(leveling, "identify_sensor", watched)
    for one, other in zip(single, alone.stream(iter(sweeps), history), strict=True):
        np.testing.assert_array_equal(one.state, other.state)
        np.testing.assert_array_equal(one.visible_prob, other.visible_prob)
    assert asked == [None, *(lidar_model(name) for name in names[:-1])]
