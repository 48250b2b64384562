"""Labels against the exact truth of an asymmetric drive."""

import numpy as np
import pytest
from tests.data.labeling.scene import GRID, Shot

from viewshed.fov.truth import Truth
from viewshed.grid import polar_of_cells
from viewshed.metrics import ConfusionCounts
from viewshed.sweep import Sweep
from viewshed_lab.data.labeling import LabeledDrive, LabelRules, label_sweep
from viewshed_lab.data.labeling.beam_image import AT_REST
from viewshed_lab.data.labeling.labeler import lows_of_sweep

RULES = LabelRules(GRID)


def _label(drive: list[Shot], rules: LabelRules = RULES) -> tuple[Truth, np.ndarray]:
    track = LabeledDrive.of(lambda place: drive[place].sweep, range(9), rules)
    return track.label(4)


def _f1(truth: Truth, shot: Shot, among: np.ndarray, target: str = "car") -> float:
    return ConfusionCounts.of(truth.visible(target), shot.truth.visible(target), among & shot.known, 1.0).f1


def test_the_label_is_the_truth_where_it_is_known(drive: list[Shot]) -> None:
    truth, known = _label(drive)
    assert known.mean() > 0.85
    assert _f1(truth, drive[4], known) > 0.97
    assert _f1(truth, drive[4], np.ones_like(known)) > 0.95
    assert _f1(truth, drive[4], known, "pedestrian") > 0.95
    for turned in (np.rot90(truth.visible("car")), truth.visible("car")[:, ::-1], truth.visible("car").T):
        assert ConfusionCounts.of(turned, drive[4].truth.visible("car"), drive[4].known, 1.0).f1 < 0.9  # not symmetric


def test_neighbors_in_time_help(drive: list[Shot]) -> None:
    truth, known = _label(drive)
    alone, alone_known = _label(drive, LabelRules(GRID, neighbors=0))
    every = np.ones_like(known)
    assert _f1(truth, drive[4], every) > _f1(alone, drive[4], every)
    assert known.mean() > alone_known.mean()


def test_farthest_holds_every_return_and_the_ground_that_was_too_far_to_answer(drive: list[Shot]) -> None:
    shot = drive[4]
    truth, known = _label(drive, LabelRules(GRID, "farthest"))
    x, y, _ = shot.sweep.points.T
    farthest = np.zeros(720)
    np.maximum.at(farthest, _bins(np.arctan2(y, x)), np.hypot(x, y))
    range_m, azimuth = polar_of_cells(GRID)
    by_returns = range_m <= farthest[_bins(azimuth)]
    found, true = truth.definitions["farthest"], shot.truth.definitions["farthest"]
    assert (by_returns & ~found).mean() < 0.01
    assert ConfusionCounts.of(by_returns, true, shot.known, 1.0).recall < 0.6  # of what could give light back
    assert ConfusionCounts.of(found, true, shot.known, 1.0).f1 > 0.9
    assert not (truth.definitions["first_blocker"] & ~found).any()
    first = ConfusionCounts.of(
        truth.definitions["first_blocker"], shot.truth.definitions["first_blocker"], shot.known & known, 1.0
    )
    assert first.f1 > 0.9
    assert first.over < 0.08 * (first.both + first.over)


def test_weak_far_returns_that_were_lost_do_not_bring_the_farthest_nearer(drive: list[Shot]) -> None:
    """As a sensor in dirt or fog: nothing beyond 12 m from the ground comes back. What stands there still does."""
    shot = drive[4]
    x, y, z = shot.sweep.points.T
    lost = (np.hypot(x, y) > 12.0) & (z < 0.3 - (shot.sweep.sensor_height_m or 0.0))
    assert lost.sum() > 300
    dim = shot.sweep.select(~lost)
    around = [lows_of_sweep(drive[k].sweep, RULES) for k in (2, 3, 5, 6)]
    truth, known = label_sweep(dim, AT_REST, around, LabelRules(GRID, "farthest"))
    for name in ("farthest", "first_blocker"):
        wanted = shot.truth.definitions[name]
        assert ConfusionCounts.of(truth.definitions[name], wanted, shot.known, 1.0).f1 > 0.85, name
    _, azimuth = polar_of_cells(GRID)
    assert not known[~np.isin(_bins(azimuth), _bins(np.arctan2(dim.points[:, 1], dim.points[:, 0])))].any()


def _bins(azimuth: np.ndarray) -> np.ndarray:
    return ((azimuth + np.pi) * (720 / (2 * np.pi))).astype(int) % 720


def test_a_lost_sector_is_not_known(drive: list[Shot]) -> None:
    sweep = drive[4].sweep
    azimuth = np.arctan2(sweep.points[:, 1], sweep.points[:, 0])
    cut = sweep.select((azimuth < 0.5) | (azimuth > 1.5))
    _, known = label_sweep(cut, AT_REST, [], RULES)
    range_m, cell_azimuth = polar_of_cells(GRID)
    inside = (cell_azimuth > 0.75) & (cell_azimuth < 1.25) & (range_m > 6) & (range_m < 25)
    assert known[inside].mean() < 0.02
    assert known[:, ::-1][inside].mean() > 0.6
    _, farthest_known = label_sweep(cut, AT_REST, [], LabelRules(GRID, "farthest"))
    assert not farthest_known[inside].any()


def test_an_empty_sweep_knows_nothing_visible() -> None:
    truth, known = label_sweep(Sweep(np.zeros((0, 3), np.float32)), AT_REST, [], RULES)
    assert not truth.visible("car").any()
    assert known.shape == GRID.shape


def test_a_neighbor_without_pose_or_damaged_is_left_out(drive: list[Shot]) -> None:
    def read(place: int) -> Sweep:
        if place == 3:
            raise ValueError("sweep 3 is damaged")
        return drive[place].sweep.replace(world_from_sensor=None) if place == 5 else drive[place].sweep

    track = LabeledDrive.of(read, range(9), RULES)
    assert sorted(track.lows) == [0, 1, 2, 4, 6, 7, 8]
    truth, known = track.label(4)
    assert _f1(truth, drive[4], known) > 0.97
    with pytest.raises(ValueError, match="sweep 3 is damaged"):
        track.label(3)
