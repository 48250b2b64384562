"""What every defense of the table promises; a new one is covered by its line in the table."""

from typing import Any

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim import cast, junction
from viewshed_lab.threats.defenses import DEFENSES, Defended, Defense, TemporalConsistency

NAMES = {"statistical", "radius", "clustering", "range", "one_return", "empty_sector", "temporal"}
COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")
NEED_RINGS = {"one_return"}


def _earlier() -> Sweep:
    sweep = cast(lidar_model("vlp16"), junction(), 1.8)
    return sweep.replace(world_from_sensor=Rigid.from_yaw(0.5, (10.0, 20.0, 1.8)))


EVERY: dict[str, Any] = {**DEFENSES, "temporal with a past": lambda: TemporalConsistency((_earlier(),))}


@pytest.fixture(params=EVERY, ids=str)
def defense(request: pytest.FixtureRequest) -> Defense:
    made: Defense = EVERY[request.param]()
    return made


@pytest.fixture(scope="session")
def attacked(street: Sweep) -> Sweep:
    """The junction with 150 points anywhere, some of them nearer or farther than the sensor can measure."""
    rng = np.random.default_rng(9)
    extra = rng.uniform(-1, 1, (150, 3)) * np.array([120.0, 90.0, 4.0])
    extra[:5] *= 0.002
    azimuth = np.arctan2(extra[:, 1], extra[:, 0])
    count = len(street) + 150
    assert street.ring is not None
    assert street.azimuth is not None
    order = rng.permutation(count)
    return street.replace(
        points=np.concatenate([street.points, extra.astype(np.float32)])[order],
        ring=np.concatenate([street.ring, rng.integers(0, 16, 150)])[order],
        azimuth=np.concatenate([street.azimuth, azimuth])[order],
        intensity=np.arange(count, dtype=np.float32), time_s=np.arange(count, dtype=np.float32) * 1e-5,
    )  # fmt: skip


def _told(defended: Defended) -> tuple[bytes, bool | None, float]:
    return defended.dropped.tobytes(), defended.alarm, defended.score


def test_kept_rows_are_those_of_the_sweep_with_all_their_columns(defense: Defense, attacked: Sweep) -> None:
    found = defense.apply(attacked)
    assert found.dropped.shape == (len(attacked),)
    assert found.dropped.dtype == np.bool_
    rows = np.flatnonzero(~found.dropped)
    for name in COLUMNS:
        assert np.array_equal(getattr(found.sweep, name), getattr(attacked, name)[rows])
    assert (found.sweep.t_ns, found.sweep.agent, found.sweep.model) == (7, "a", attacked.model)
    assert found.sweep.world_from_sensor is attacked.world_from_sensor
    assert 0 <= found.score <= 1
    assert isinstance(found.score, float)
    assert found.alarm in (None, False, True)


def test_the_sweep_is_left_as_it_was_and_the_answer_is_the_same_twice(defense: Defense, attacked: Sweep) -> None:
    before = [getattr(attacked, name).tobytes() for name in COLUMNS]
    assert not attacked.points.flags.writeable
    assert _told(defense.apply(attacked)) == _told(defense.apply(attacked))
    assert [getattr(attacked, name).tobytes() for name in COLUMNS] == before


def test_order_of_points_is_irrelevant(defense: Defense, attacked: Sweep) -> None:
    shuffle = np.random.default_rng(2).permutation(len(attacked))
    here, there = defense.apply(attacked), defense.apply(attacked.select(shuffle))
    assert np.array_equal(here.dropped[shuffle], there.dropped)
    assert (here.alarm, here.score) == (there.alarm, there.score)


def test_an_empty_sweep_stays_empty(defense: Defense, street: Sweep) -> None:
    nothing = np.zeros(len(street), np.bool_)
    for empty in (Sweep(np.zeros((0, 3), np.float32), world_from_sensor=Rigid.identity()), street.select(nothing)):
        found = defense.apply(empty)
        assert (len(found.sweep), found.dropped.shape) == (0, (0,))


@pytest.mark.parametrize("name", sorted(NAMES))
def test_without_rings_it_works_or_says_what_it_needs(name: str, attacked: Sweep) -> None:
    bare = Sweep(attacked.points)
    if name not in NEED_RINGS:
        assert len(DEFENSES[name]().apply(bare).sweep) <= len(bare)
        return
    aside = Sweep(attacked.points + np.array([0.4, 0.2, 0.0], np.float32))  # from elsewhere, elevations tell nothing
    with pytest.raises(ValueError, match=r"^the sweep must have rings, [^\n]+$"):
        DEFENSES[name]().apply(aside)
