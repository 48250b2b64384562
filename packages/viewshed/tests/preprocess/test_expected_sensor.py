"""The sensor of the sweep before is looked at first, which changes nothing; rings without a table are counted alike."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.preprocess.test_sensor_identification import SCENE, ring_by_ring

from viewshed import BevGrid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.io import read_index, read_indexed, read_sweeps
from viewshed.preprocess import leveling
from viewshed.preprocess.sensor_identification import UNIDENTIFIED, SensorId, identify_sensor
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim import cast

GRID = BevGrid(64, 32.0)


def sweep_of(name: str, seed: int = 0) -> Sweep:
    """A sweep whose rings are known, and whose sensor is not said."""
    return cast(lidar_model(name), SCENE, 1.8, rng=np.random.default_rng(seed)).replace(model=None, azimuth=None)


def in_order(sweep: Sweep) -> Sweep:
    return ring_by_ring(sweep).replace(ring=None)


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
    assert_same(identify_sensor(moved, SensorId(None, expected)), identify_sensor(moved))


@pytest.mark.slow
def test_real_sweeps_have_the_same_sensor_after_any_other(real_data: object) -> None:
    expected = dict[LidarModel | None, None]()
    for number, entry in enumerate(read_index(f"{real_data}/index.json")):
        if entry.points is None:
            continue
        sweep = read_indexed(entry).replace(model=None)
        alone = identify_sensor(sweep)
        expected[alone.model] = None
        for model in [*expected][number % 3 :: 3]:  # each after a third of those seen so far
            assert_same(identify_sensor(sweep, SensorId(None, model)), alone)


@pytest.mark.parametrize("history", [0, 2])
def test_a_stream_of_two_sensors_is_seen_as_sweep_by_sweep(history: int, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["hdl32e", "hdl32e", "vlp16", "hdl32e", "vlp16", "vlp16"]
    sweeps = [sweep_of(name, seed).replace(t_ns=seed * 1_000_000_000) for seed, name in enumerate(names)]
    alone = ShadowMap(GRID)
    single = [alone.estimate(sweep) for sweep in sweeps]
    asked = []

    def watched(sweep: Sweep, before: SensorId = UNIDENTIFIED) -> SensorId:
        asked.append(before.model)
        return identify_sensor(sweep, before)

    monkeypatch.setattr(leveling, "identify_sensor", watched)
    for one, other in zip(single, alone.stream(iter(sweeps), history), strict=True):
        np.testing.assert_array_equal(one.state, other.state)
        # A sensor at rest keeps its ground: its beams are counted over slightly other heights.
        np.testing.assert_allclose(one.visible_prob, other.visible_prob, atol=0.01)
    assert asked == [None, *(lidar_model(name) for name in names[:-1])]


def unknown_sensor(rings: int) -> LidarModel:
    """A sensor with uneven beams that no table has."""
    elevation = np.deg2rad(np.linspace(-24.0, 9.0, rings) + 0.4 * np.sin(np.arange(rings)))
    return LidarModel("unknown", elevation, 900)


def stream_of(rings: int, count: int, seed: int = 0) -> list[tuple[Sweep, NDArray[np.int16]]]:
    """Bare sweeps in the order of their rings, and these; every third one has lost its lowest ring."""
    sweeps = []
    for number in range(count):
        sweep = ring_by_ring(cast(unknown_sensor(rings), SCENE, 1.8, rng=np.random.default_rng(seed + number)))
        sweep = sweep.select(np.flatnonzero(sweep.ring >= (number % 3 == 2)))
        sweeps.append((sweep.replace(ring=None, model=None, azimuth=None), sweep.ring))
    return sweeps


def followed(sweeps: list[Sweep]) -> list[SensorId]:
    found = [UNIDENTIFIED]
    for sweep in sweeps:
        found.append(identify_sensor(sweep, found[-1]))
    return found[1:]


def test_rings_that_no_table_explains_are_counted_alike_through_a_stream() -> None:
    sweeps = stream_of(20, 9)
    for found, (_, ring) in zip(followed([sweep for sweep, _ in sweeps]), sweeps, strict=True):
        assert found.model is None
        np.testing.assert_array_equal(found.ring, ring)
    [alone] = followed([sweeps[2][0]])
    assert alone.ring.max() == 18, "one sweep cannot know of a ring that it has not"


def test_a_count_of_rings_is_that_of_most_sweeps_and_the_same_from_the_middle_of_a_stream() -> None:
    sweeps = [sweep for sweep, _ in stream_of(20, 12)]
    # The stream begins with a sweep that has lost a ring.
    whole, middle = followed(sweeps[2:]), followed(sweeps[6:])
    assert whole[0].ring.max() == 18
    for one, other in zip(whole[4:], middle, strict=True):
        np.testing.assert_array_equal(one.ring, other.ring)
    assert len(whole[-1].layout.elevation) == 20


def test_another_sensor_begins_the_count_anew() -> None:
    found = followed([stream_of(20, 1)[0][0], stream_of(14, 1)[0][0], stream_of(20, 1)[0][0]])
    assert [len(one.layout.elevation) for one in found if one.layout is not None] == [20, 14, 20]
    assert [len(one.layout.ring_counts) for one in found if one.layout is not None] == [1, 1, 1]
    known = identify_sensor(in_order(sweep_of("vlp16")), found[-1])
    assert known.model is lidar_model("vlp16")
    assert known.layout is None


def test_rings_of_points_in_no_order_hold_while_the_returns_gather_at_them() -> None:
    sweeps = []
    for number, (sweep, ring) in enumerate(stream_of(16, 5)):
        rows = np.random.default_rng(number).permutation(len(sweep))
        sweeps.append((sweep.select(rows), ring[rows]))
    for found, (_, ring) in zip(followed([sweep for sweep, _ in sweeps]), sweeps, strict=True):
        placed = found.ring >= 0
        assert placed.mean() > 0.97
        assert (found.ring == ring)[placed].mean() > 0.99


def test_real_sweeps_of_a_sensor_without_a_table_have_one_count(real_data: Path) -> None:
    sweeps = list(read_sweeps(real_data / "vlp16_packets" / "einride_recording.bin"))[:12]
    rng = np.random.default_rng(0)
    bare = []
    for sweep in sweeps:
        # A VLP-16 whose elevations no table has, its returns in no order.
        points = sweep.points[rng.permutation(len(sweep))] * np.array([1.0, 1.0, 1.09], np.float32)
        bare.append(Sweep(points))
    found = followed(bare)
    assert all(one.model is None for one in found)
    counts = [None if one.layout is None else len(one.layout.elevation) for one in found]
    assert len(set(counts)) == 1, counts
