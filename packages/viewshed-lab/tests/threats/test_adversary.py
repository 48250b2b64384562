"""The adversary: what it forges, of whom, from when on; everything else passes as it is."""

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import Sweep, load_estimator, read_sweep
from viewshed.detections import Detections
from viewshed.geometry import Rigid
from viewshed.io.samples import junction_path
from viewshed.preprocess.leveling import level
from viewshed_lab.threats.adversary import Adversary

SWEEP = read_sweep(junction_path())


def test_sweeps_of_one_agent_are_forged_between_start_and_end_at_one_place() -> None:
    adversary = Adversary("far_wall", frozenset({"car"}), start_s=1.0, end_s=3.0, reset_s=10.0, seed=3)
    forged = {}
    for t_s in (5.0, 5.9, 6.0, 7.0, 8.0):
        for agent in ("car", "mast"):
            sent = SWEEP.replace(t_ns=round(1e9 * t_s), agent=agent)
            got = adversary.sweep(sent)
            assert (got.agent, got.t_ns) == (agent, sent.t_ns)
            forged[agent, t_s] = None if got is sent else got
    assert [key for key, got in forged.items() if got is not None] == [("car", 6.0), ("car", 7.0)]
    first, second = forged["car", 6.0], forged["car", 7.0]
    assert not np.array_equal(first.points, SWEEP.points)
    # Near beams that report a far wall are at one place, with new noise in each sweep.
    assert not np.array_equal(first.points, second.points)
    azimuths = [_azimuths(SWEEP, got) for got in (first, second)]
    assert np.abs(_turned(azimuths[0], azimuths[1])) < 0.02


def _azimuths(sent: Sweep, got: Sweep) -> NDArray[np.complex128]:
    """Return the directions (M,) of the returns that an attack took away."""
    gone = sent.points[~np.isin(sent.points[:, 0], got.points[:, 0])]
    return np.exp(1j * np.arctan2(gone[:, 1], gone[:, 0]))


def _turned(one: NDArray[np.complex128], other: NDArray[np.complex128]) -> float:
    """Return the angle between two means of directions."""
    return float(np.angle(other.mean() / one.mean()))


@pytest.mark.parametrize("attack", ["removal", "far_wall", "ghost_car"])
def test_an_attack_stays_at_its_azimuth_until_it_is_reset(attack: str) -> None:
    adversary, taken = Adversary(attack, start_s=0.0, reset_s=5.0, seed=1), []
    for t_s in (0.0, 1.0, 2.0, 6.0):
        # Each sweep has lost other returns, so that the same random number would pick another obstacle.
        kept = np.random.default_rng(round(t_s)).random(len(SWEEP)) < 0.8
        sent = SWEEP.select(kept).replace(t_ns=round(1e9 * t_s))
        taken.append(_azimuths(sent, adversary.sweep(sent)))
    assert min(map(len, taken)) > 20
    turns = [abs(_turned(taken[0], other)) for other in taken[1:]]
    assert max(turns[:2]) < 0.1 < turns[2]


def test_the_ranges_of_a_ghost_differ_between_sweeps_by_the_noise_of_the_spoofer() -> None:
    adversary, ranges_m = Adversary("ghost_car", start_s=0.0, seed=1), []
    for t_s in range(8):
        got = adversary.sweep(SWEEP.replace(t_ns=t_s * 10**9))
        added = got.points[~np.isin(got.points[:, 0], SWEEP.points[:, 0])]
        ranges_m.append(float(np.median(np.hypot(added[:, 0], added[:, 1]))))
    # .35 m for all returns of a sweep
    assert 0.1 < np.std(ranges_m) < 0.7


def test_forged_objects_stand_still_in_the_world_while_their_agent_drives() -> None:
    adversary = Adversary("fabricate_static", start_s=0.0, count=3)
    places = []
    for k in range(3):
        pose = Rigid.from_yaw(0.3 * k, (2.0 * k, 1.0, 1.8))
        leveled = level(SWEEP.replace(t_ns=k * 10**8, world_from_sensor=pose), load_estimator("shadow_map").grid)
        found = adversary.detections(leveled, Detections.none())
        assert leveled.world_from_level is not None
        places.append(found.moved(leveled.world_from_level).boxes[:, :2])
    assert places[0].shape == (3, 2)
    np.testing.assert_allclose(places[1], places[0], atol=1e-6)
    np.testing.assert_allclose(places[2], places[0], atol=1e-6)


def test_a_claimed_view_grows_and_the_objects_stay_honest() -> None:
    adversary = Adversary("over_claim", start_s=0.5)
    honest = load_estimator("shadow_map").estimate(SWEEP.replace(t_ns=0))
    assert adversary.view(honest) is honest
    later = load_estimator("shadow_map").estimate(SWEEP.replace(t_ns=10**9))
    assert adversary.view(later).area_m2() > 1.1 * later.area_m2()
    none = Detections.none()
    assert adversary.objects("ego", 1.0, none, np.zeros(3)) is none
    assert adversary.sweep(SWEEP) is SWEEP
