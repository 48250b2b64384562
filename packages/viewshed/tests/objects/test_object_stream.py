"""Objects of a stream: tracks of each agent by itself, honest ones left alone, forged ones named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from viewshed import load_estimator
from viewshed.fov.estimate import FovEstimate
from viewshed.monitor.evidence.base import SECTORS
from viewshed.monitor.report import IntegrityReport
from viewshed.objects.explained import FABRICATED
from viewshed.objects.object_stream import ObjectStream, SeenObjects
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.recordings.write.moment import DriveTruth
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named
from viewshed_lab.threats.adversary import Adversary

Step = tuple[LeveledSweep, FovEstimate, DriveTruth]


@cache
def drive() -> list[Step]:
    """Return 2.5 s of a street, seen from a car that drives."""
    plan = drive_plan(preset_named("drives"), seconds=2.5, hz=10.0, agents=1, world="street", seed=5)
    estimator, out = load_estimator("shadow_map"), list[Step]()
    for sweep, truth in drive_sweeps(plan):
        leveled = level(sweep, estimator.grid)
        out.append((leveled, estimator.estimate(leveled), truth))
    return out


def followed(objects: ObjectStream) -> list[SeenObjects]:
    return [objects.follow(leveled, estimate) for leveled, estimate, _ in drive()]


def test_honest_tracks_are_where_objects_are_and_are_left_alone() -> None:
    seen = followed(ObjectStream())
    last, truth = seen[-1], drive()[-1][2]
    at = last.explained.tracks.boxes[last.shown, :2]
    places = np.array([each.world_from_box.translation[:2] for each in truth.objects])
    assert len(at) >= 8
    assert (np.linalg.norm(at[:, None] - places[None], axis=2).min(axis=1) < 2.0).mean() > 0.8
    accused = {int(n) for each in seen for n in each.explained.tracks.ids[each.shown & each.explained.accused]}
    tracks = {int(n) for each in seen for n in each.explained.tracks.ids[each.shown]}
    assert len(accused) <= 0.1 * len(tracks)


def test_a_late_sweep_changes_nothing_and_is_told() -> None:
    objects, steps = ObjectStream(), drive()[:6]
    seen = [objects.follow(leveled, estimate) for leveled, estimate, _ in steps]
    again = objects.follow(*steps[3][:2])
    assert again.explained.tracks.notes == ("a sweep 0.200 s late: its detections are left out",)
    np.testing.assert_array_equal(again.explained.tracks.boxes, seen[-1].explained.tracks.boxes)
    np.testing.assert_array_equal(again.explained.explanations, seen[-1].explained.explanations)


def test_a_ghost_in_the_middle_of_the_street_is_named() -> None:
    adversary = Adversary("fabricate_static", start_s=1.0, count=1, seed=37)
    seen = followed(ObjectStream(tamper=adversary.detections))
    explained, [*_, ghost] = seen[-1].explained, seen[-1].detections.moved(seen[-1].tracks_from_level).boxes
    near = np.hypot(*(explained.tracks.boxes[:, :2] - ghost[:2]).T) < 2.0
    assert near.sum() == 1
    assert (explained.accused & (explained.suspicions == FABRICATED))[near].all()
    assert not seen[9].explained.accused.any()


def test_two_agents_have_tracks_of_their_own() -> None:
    objects, first, second = ObjectStream(), ObjectStream(), None
    for leveled, estimate, _ in drive()[:6]:
        alone = first.follow(leveled, estimate)
        both = objects.follow(leveled, estimate)
        other = replace(leveled, sweep=leveled.sweep.replace(agent="other"))
        second = objects.follow(other, estimate)
        np.testing.assert_array_equal(both.explained.tracks.ids, alone.explained.tracks.ids)
    np.testing.assert_array_equal(second.explained.tracks.ids, alone.explained.tracks.ids)


def test_without_poses_and_times_tracks_are_in_level() -> None:
    objects = ObjectStream()
    for leveled, estimate, _ in drive()[:3]:
        plain = replace(leveled, sweep=leveled.sweep.replace(world_from_sensor=None, t_ns=None))
        seen = objects.follow(plain, replace(estimate, world_from_level=None))
    tracks = seen.explained.tracks
    assert not tracks.in_world
    assert tracks.t_s == pytest.approx(0.2)
    assert len(tracks) >= len(seen.detections) * 0.5
    np.testing.assert_array_equal(seen.tracks_from_level.as_matrix(), np.eye(4))


def test_where_the_view_is_under_alarm_nothing_is_said() -> None:
    objects = ObjectStream()
    report = IntegrityReport("by hand", 2.0, 1.0, suspect=np.ones(SECTORS, np.bool_))
    for leveled, estimate, _ in drive()[:5]:
        seen = objects.follow(leveled, estimate, report)
    assert not seen.explained.accused.any()
    assert set(seen.explained.reasons) == {"the field of view is under alarm there"}
