"""Null attacks leave a benign sweep in number, order, noise and steps, with other noise where they aim."""

import numpy as np
import pytest
from scipy.stats import ks_2samp
from tests.threats.attacks.drawn import broken_by_null, drawn, generator, same
from tests.threats.attacks.oracle import Scene, beams_of, columns_of

from viewshed import Sweep
from viewshed_lab.threats.attacks import ATTACKS, EARLIER, FULL_WEDGE, INFORMED, NULL, Knowledge, Tampered

NAMES = sorted(set(NULL) - {"pose_spoof"})


def _apply(name: str, scene: Scene, seed: int, budget: int | None = None) -> Tampered:
    knowledge = Knowledge((scene.earlier,), None, scene.half_extent_m, scene.remeasured)
    return NULL[name](budget, knowledge).apply(scene.sweep, generator(seed))


@pytest.mark.parametrize("name", NAMES)
def test_rows_keep_their_number_and_order(name: str, simulated: list[Scene]) -> None:
    touched = 0
    for number in range(20):
        scene = simulated[number % len(simulated)]
        attack, _ = drawn(name, scene, generator(11, number))
        assert broken_by_null(name, scene, attack, number) == [], (scene.name, attack)
        touched += bool(_apply(name, scene, number).added.any())
    assert touched >= 10


@pytest.mark.parametrize("name", NAMES)
def test_the_beams_are_those_of_the_attack(name: str, simulated: list[Scene]) -> None:
    """Of those that it would touch, all that returned in both measurements and that the attack won."""
    scene = simulated[2]
    knowledge = Knowledge((scene.earlier,), None, scene.half_extent_m, scene.remeasured)
    attack, null = (ATTACKS | INFORMED)[name](None, knowledge), NULL[name](None, knowledge)
    wedge = attack.apply(scene.sweep, generator(4)).wedge
    null_wedge = null.apply(scene.sweep, generator(4)).wedge
    assert wedge is None or wedge == null_wedge


def test_removal_and_its_null_touch_the_same_rows(simulated: list[Scene]) -> None:
    for seed, scene in enumerate(simulated):
        knowledge = Knowledge((), None, scene.half_extent_m, scene.remeasured)
        gone = ATTACKS["removal"](None, knowledge).apply(scene.sweep, generator(seed)).removed
        redrawn = NULL["removal"](None, knowledge).apply(scene.sweep, generator(seed)).removed
        assert not (redrawn & ~gone).any()
        assert redrawn.sum() >= gone.sum() - 2  # a beam at the edge of the wedge, seen from a start beside the sensor


def test_noise_and_steps_are_those_of_benign_returns(simulated: list[Scene]) -> None:
    """Over all sweeps, by Kolmogorov and Smirnov's test against the clean returns of the same rows."""
    clean_m, redrawn_m, unequal = [], [], []
    for seed, scene in enumerate(simulated):
        tampered = _apply("jamming", scene, seed, FULL_WEDGE)
        column, ring, _, depth_m, _ = beams_of(scene, tampered)
        steps = depth_m / scene.image.step_m
        assert np.abs(steps - np.rint(steps)).max() < 0.1, scene.name  # whole steps but for float32
        exact_m = scene.exact_m[column, ring].astype(np.float64)
        clean_m.append(scene.image.steps[column, ring] * scene.image.step_m - exact_m)
        redrawn_m.append(np.rint(steps) * scene.image.step_m - exact_m)
        unequal.append(np.rint(steps) != scene.image.steps[column, ring])
    before, after = np.concatenate(clean_m), np.concatenate(redrawn_m)
    assert len(before) > 5_000
    assert ks_2samp(before, after).pvalue > 0.01
    assert after.std() == pytest.approx(before.std(), rel=0.1)
    assert np.mean(np.concatenate(unequal)) > 0.7  # the noise is drawn anew
    # Some are the old ones: weak returns, with the largest noise, may be missing in the second measurement.
    assert abs(np.corrcoef(before, after)[0, 1]) < 0.25


def test_each_return_is_that_of_the_second_measurement(simulated: list[Scene]) -> None:
    """To a tenth of a millimeter, where it returned in both: the forger's own arithmetic leaves no trace."""
    for seed, scene in enumerate(simulated):
        tampered = _apply("replay", scene, seed)
        was, again = _by_beam(scene, scene.sweep), _by_beam(scene, scene.remeasured)
        now = _by_beam(scene, tampered.sweep)
        made = {beam for beam, row in now.items() if tampered.added[row]}
        both = [beam for beam in made if beam in again]
        assert len(both) > 0.3 * len(was), scene.name  # a spoofer wins 44 % of the beams of an OS1-32
        rows, wanted = [now[beam] for beam in both], [again[beam] for beam in both]
        assert np.abs(tampered.sweep.points[rows] - scene.remeasured.points[wanted]).max() < 1e-4, scene.name
        alone = [now[beam] for beam in made if beam not in again]
        assert np.abs(tampered.sweep.points[alone] - scene.sweep.points[alone]).max(initial=0.0) < 1e-4, scene.name


def _by_beam(scene: Scene, sweep: Sweep) -> dict[tuple[int, int], int]:
    """Return the row of each beam (ring, column)."""
    assert sweep.time_s is not None
    columns = columns_of(scene.image, sweep.points.astype(np.float64), sweep.ring.astype(np.intp), sweep.time_s)
    return {(int(ring), int(column)): row for row, (ring, column) in enumerate(zip(sweep.ring, columns, strict=True))}


def test_a_pose_is_spoofed_by_nothing(simulated: list[Scene]) -> None:
    tampered = _apply("pose_spoof", simulated[0], 1)
    pose, clean = tampered.sweep.world_from_sensor, simulated[0].sweep.world_from_sensor
    assert (pose.as_matrix() == clean.as_matrix()).all()


def test_same_seed_same_bytes(simulated: list[Scene]) -> None:
    assert same(_apply("far_wall", simulated[1], 3), _apply("far_wall", simulated[1], 3))


def test_null_attacks_need_the_instant_once_more(simulated: list[Scene]) -> None:
    with pytest.raises(ValueError, match="a null attack needs the same instant measured once more, got none"):
        NULL["far_wall"]()
    assert EARLIER <= set(NULL) == set(ATTACKS | INFORMED)
