"""What every corruption of the table promises; a new one is covered by its line in the table."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.sweep import Sweep
from viewshed_lab.threats.corruptions import CORRUPTIONS, SEVERITIES, Corruption

COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")
NEED_RINGS = {"dead_rings", "fewer_beams"}
MEMBERS = [(name, severity) for name in CORRUPTIONS for severity in (1, 5)]


def rng(seed: int = 3) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


@pytest.fixture(params=MEMBERS, ids=lambda member: f"{member[0]}-{member[1]}")
def corruption(request: pytest.FixtureRequest) -> Corruption:
    name, severity = request.param
    return CORRUPTIONS[name](severity)


def _bytes(sweep: Sweep) -> list[Any]:
    arrays = [getattr(sweep, name) for name in COLUMNS]
    return [None if array is None else array.tobytes() for array in arrays]


def _beam(sweep: Sweep) -> NDArray[np.int64]:
    """A number for the beam of each row: no two rows of the clean sweep have the same."""
    return sweep.ring.astype(np.int64) * 1_000_000 + np.round(sweep.azimuth * 1e5).astype(np.int64)


@pytest.mark.parametrize("severity", [0, 6, -1, 2.5, True, "3"])
def test_severities_run_from_one_to_five(severity: Any) -> None:
    with pytest.raises(ValueError, match=r"^severity must be a whole number from 1 to 5, got [^\n]+$"):
        CORRUPTIONS["rain"](severity)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(corruption: Corruption, street: Sweep) -> None:
    once, again, other = (corruption.apply(street, rng(seed)) for seed in (3, 3, 4))
    assert _bytes(once) == _bytes(again)
    if corruption in SEVERITIES["fewer_beams"]:  # nothing about it is random
        assert _bytes(once) == _bytes(other)
    elif corruption not in SEVERITIES["attitude"]:  # which leaves the columns alone
        assert _bytes(once) != _bytes(other)


def test_rows_are_those_of_the_clean_sweep_with_their_own_columns(corruption: Corruption, street: Sweep) -> None:
    spoilt = corruption.apply(street, rng())
    rows = np.searchsorted(_beam(street), _beam(spoilt), sorter=np.argsort(_beam(street)))
    rows = np.argsort(_beam(street))[rows]
    assert (np.diff(rows) > 0).all()  # none twice, none added, and in their order
    for name in ("ring", "azimuth", "time_s"):
        assert np.array_equal(getattr(street, name)[rows], getattr(spoilt, name))
    assert spoilt.intensity.shape == (len(spoilt),)
    assert (spoilt.t_ns, spoilt.agent, spoilt.model) == (street.t_ns, street.agent, street.model)
    assert spoilt.dropped_points == 0


def test_an_empty_sweep_stays_empty(corruption: Corruption, street: Sweep) -> None:
    assert len(corruption.apply(Sweep(np.zeros((0, 3), np.float32)), rng())) == 0
    assert len(corruption.apply(street.select(np.zeros(len(street), np.bool_)), rng())) == 0


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_without_rings_it_works_or_says_what_it_needs(name: str, street: Sweep) -> None:
    points = street.points[np.random.default_rng(1).permutation(len(street))]
    bare = Sweep(points)
    if name not in NEED_RINGS:
        assert 0 < len(CORRUPTIONS[name](2).apply(bare, rng())) <= len(bare)
        return
    bare = Sweep(points + np.array([0.4, 0.2, 0.0], np.float32))  # from elsewhere, elevations tell nothing
    with pytest.raises(ValueError, match=r"^the sweep must have rings, [^\n]+$"):
        CORRUPTIONS[name](2).apply(bare, rng())


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_severity_five_does_more_than_severity_one(name: str, street: Sweep) -> None:
    def damage(severity: int, seed: int) -> float:
        spoilt = CORRUPTIONS[name](severity).apply(street, rng(seed))
        same = np.isin(_beam(street), _beam(spoilt))
        moved = np.linalg.norm(street.points[same] - spoilt.points, axis=1).sum()
        return float(10 * (~same).sum() + moved + 1e4 * np.linalg.norm(spoilt.attitude[1:3]))

    mild, severe = ([damage(severity, seed) for seed in range(5)] for severity in (1, 5))
    assert np.mean(severe) > 2 * np.mean(mild) > 0


@pytest.mark.parametrize("name", ["rain", "fog", "snow", "range_noise", "vegetation", "glass"])
def test_what_happens_along_the_ray_stays_on_it(name: str, street: Sweep) -> None:
    spoilt = CORRUPTIONS[name](5).apply(street, rng())
    before = street.points[np.isin(_beam(street), _beam(spoilt))]
    aside = np.linalg.norm(np.cross(before, spoilt.points), axis=1) / np.linalg.norm(before, axis=1)
    assert aside.max() < 1e-4
    assert (np.einsum("ij,ij->i", before, spoilt.points) > 0).all()
