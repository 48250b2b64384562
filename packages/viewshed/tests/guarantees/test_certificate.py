"""Certificates hold under attacks that obey their threat; and what happens to them when an assumption is broken."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.guarantees import toy

from viewshed import _core
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR
from viewshed.geometry import rotation_from_quaternion
from viewshed.grid import BevGrid
from viewshed.guarantees.certificate import certify
from viewshed.guarantees.envelope import Envelope, Given, Threat
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sensors import LidarModel

EVERYTHING = FovEstimate(
    toy.GRID, np.ones(toy.GRID.shape, np.float32), np.full(toy.GRID.shape, CellState.FREE, np.uint8), target=CAR
)  # fmt: skip


def attack_within(threat: Threat, rng: np.random.Generator, depth: NDArray[Any]) -> NDArray[Any]:
    """Return beams (K, 2) that a threat lets replace."""
    if threat.kind == "wedge":
        wide = int(threat.amount / 360 * 90)
        columns = (rng.integers(0, 90) + np.arange(wide)) % 90
        return np.stack(np.meshgrid(columns, np.arange(8), indexing="ij"), axis=-1).reshape(-1, 2)
    if threat.kind == "added":
        return np.zeros((0, 2), np.intp)
    count = int(threat.amount)
    beams = rng.choice(720, count, replace=False)
    return np.column_stack([beams // 8, beams % 8])


@settings(max_examples=120, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(
        [Threat(), Threat("replaced", 3), Threat("replaced", 30), Threat("window", 4), Threat("wedge", 24)]
    ),
)
def test_what_is_certified_was_visible_without_the_attack(seed: int, threat: Threat) -> None:
    rng = np.random.default_rng(seed)
    depth = toy.scene(rng)
    clean = toy.envelope(toy.sweep_of(depth))
    sweep = toy.attacked(rng, depth, attack_within(threat, rng, depth))
    one = toy.leveled(sweep)
    certificate = certify(one, EVERYTHING, threat, Given.of(one, grade=0.0))
    reference = clean.reference(threat)
    assert not (certificate.certified_visible & ~reference).any()
    opened_m2 = (certificate.claim & ~reference).sum() * toy.GRID.cell_area_m2
    assert opened_m2 <= certificate.over_claim_m2
    assert opened_m2 <= clean.changeable(threat, ~reference, opens=True)[0]


def certified_after(depth: NDArray[Any], threat: Threat) -> NDArray[np.bool_]:
    one = toy.leveled(toy.sweep_of(depth))
    return certify(one, EVERYTHING, threat, Given.of(one, grade=0.0)).certified_visible


def test_an_attack_that_is_set_on_one_cell() -> None:
    # A cell lacks one beam. An attacker with so many opens it, and no more; with more of its beams it is not certified.
    depth = toy.scene(np.random.default_rng(5))
    clean = toy.envelope(toy.sweep_of(depth))
    one = np.zeros(toy.GRID.shape, bool)
    one[tuple(np.argwhere(clean.margins == CAR.min_returns - 1)[0])] = True
    assert clean.changeable(Threat("replaced", 1), one, opens=True)[0] == toy.GRID.cell_area_m2
    blocking = []
    for beam in np.argwhere(np.isfinite(depth)):
        nearest_m = clean.nearest_m.copy()
        nearest_m[beam[1], beam[0] :: 90] = np.inf
        if Envelope.within(toy.GRID, CAR, clean.sent, nearest_m).margins[one] > clean.margins[one]:
            blocking.append(beam)
    for count in range(1, len(blocking) + 1):
        after = depth.copy()
        after[tuple(np.transpose(blocking[:count]))] = np.inf
        assert toy.envelope(toy.sweep_of(after)).open()[one]
        for kind in ("replaced", "window", "dropped"):
            assert not certified_after(after, Threat(kind, count))[one]
    assert len(blocking) >= 2


def test_one_beam_opens_a_gap_that_had_beams_to_spare() -> None:
    # So what is certified against other threats than added points lies in the open cells, not in the envelope's claim.
    depth, gaps = toy.scene(np.random.default_rng(5)), 0
    clean, threat = toy.envelope(toy.sweep_of(depth)), Threat("replaced", 1)
    for beam in np.argwhere(np.isfinite(depth))[::4]:
        after = depth.copy()
        after[tuple(beam)] = np.inf
        certified = certified_after(after, threat)
        assert not (certified & ~clean.reference(threat)).any()
        gaps += int((certified & ~clean.claim).sum())
    assert gaps > 0


def test_a_wedge_anywhere() -> None:
    # Six columns wide, it touches seven wherever it does not begin with one.
    for seed in range(3):
        depth = toy.scene(np.random.default_rng(seed))
        reference = toy.envelope(toy.sweep_of(depth)).open()
        for start in range(90):
            after = depth.copy()
            after[(start + np.arange(7)) % 90] = np.inf
            assert not (certified_after(after, Threat("wedge", 24.0)) & ~reference).any()


def leveled(**known: Any) -> LeveledSweep:
    return toy.leveled(toy.sweep_of(toy.scene(np.random.default_rng(2)), **known))


def test_an_inferred_height_certifies_nothing_unless_trusted() -> None:
    one = leveled(sensor_height_m=None)
    certificate = certify(one, EVERYTHING)
    assert certificate.inferred == ("mounting height",)
    assert certificate.claim.any()
    assert not certificate.certified_visible.any()
    assert "nothing certified: mounting height" in certificate.line
    assert certify(one, EVERYTHING, trust_inferred=True).certified_visible.any()


def test_what_certifies_nothing_says_so() -> None:
    nothing = certify(leveled(), EVERYTHING, Threat("replaced", 700))
    assert nothing.line.startswith("nothing certified against 700 replaced")
    with pytest.raises(ValueError, match="needs the sensor's beam table"):
        certify(leveled(model=None, infer_sensor=False), EVERYTHING)


def test_rows_without_a_return_are_none() -> None:
    depth, holes = toy.scene(np.random.default_rng(2)), np.full((50, 3), np.nan)
    assert (toy.envelope(toy.sweep_of(depth, holes)).margins == toy.envelope(toy.sweep_of(depth)).margins).all()


def test_withdrawn_cells_are_unknown() -> None:
    certificate = certify(leveled(), EVERYTHING, Threat("replaced", 5))
    kept = certificate.withdraw(EVERYTHING)
    assert (kept.visible() == certificate.certified_visible).all()
    assert (kept.state[~certificate.certified_visible] == CellState.UNKNOWN).all()


def false_share(given: Given | None = None, dark: int = 0) -> float:
    """Return what share of the certified cells a car behind walls would not have shown in, over some scenes.

    Args:
        given: what is taken for granted; None for what is right.
        dark: columns in which nothing sends light back.
    """
    wrong = total = 0
    for seed in range(12):
        depth = toy.scene(np.random.default_rng(seed))
        depth = np.where(np.isfinite(depth), depth, 60.0)
        right = toy.envelope(toy.sweep_of(depth)).claim
        depth[:dark] = np.inf
        one = toy.leveled(toy.sweep_of(depth))
        certified = certify(one, EVERYTHING, Threat(), given or Given.of(one, grade=0.0)).certified_visible
        wrong, total = wrong + int((certified & ~right).sum()), total + int(certified.sum())
    return wrong / total


def test_broken_assumptions_one_by_one() -> None:
    tilted = rotation_from_quaternion([np.cos(np.deg2rad(0.5)), 0.0, np.sin(np.deg2rad(0.5)), 0.0])
    shifted, *dense = (
        LidarModel("wrong", toy.TOY.elevation + turn, 90 * factor) for turn, factor in ((0.0175, 1), (0.0, 2), (0.0, 8))
    )
    right = Given(toy.TOY, np.eye(3), toy.HEIGHT_M, grade=0.0)
    assert false_share() == false_share(right) == 0.0
    assert 0.0 < false_share(replace(right, height_m=toy.HEIGHT_M + 0.3)) < 0.25
    assert 0.0 < false_share(replace(right, model=shifted)) < 0.35
    assert 0.0 < false_share(replace(right, rotation=tilted)) < 0.35
    assert 0.0 < false_share(replace(right, ground=HeightMap.flat(12.0, 0.3))) < 0.35
    assert 0.0 < false_share(dark=20) < 0.35
    # Too many columns: beams are counted that the sensor never sends. Gaps that are closed forgive that up to a factor.
    assert false_share(replace(right, model=dense[0])) < 0.2
    assert false_share(replace(right, model=dense[1])) > 0.2
    # The attacker drops every return, and certified is against three.
    depth = toy.scene(np.random.default_rng(1))
    clean, one = toy.envelope(toy.sweep_of(depth)), toy.leveled(toy.sweep_of(np.full_like(depth, np.inf)))
    certificate = certify(one, EVERYTHING, Threat("dropped", 3), Given.of(one, grade=0.0))
    assert (certificate.certified_visible & ~clean.open()).any()
    assert (certificate.claim & ~clean.open()).sum() * toy.GRID.cell_area_m2 > certificate.over_claim_m2


def test_one_thread_and_two_alike() -> None:
    before, found = _core.threads(), []
    scene, grid = toy.leveled(toy.sweep_of(toy.scene(np.random.default_rng(4)))), BevGrid(128, 16.0)  # in four parts
    try:
        for count in (1, 2):
            _core.set_threads(count)
            one = Envelope.of(scene, Given.of(scene), grid, CAR)
            for threat in (Threat("replaced", 9), Threat("wedge", 30)):
                area_m2, changes = one.changeable(threat, ~one.open(), opens=True)
                found.append((one.margins.tobytes(), one.claim.tobytes(), area_m2, changes.tobytes()))
    finally:
        _core.set_threads(before)
    assert found[:2] == found[2:]
