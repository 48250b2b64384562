"""A simulated car goes behind a parked truck and comes out again: the published rule gives it a new track."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import ESTIMATORS, BevGrid
from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind
from viewshed.geometry import Rigid
from viewshed.objects.metrics import IdSwitches, MatchedObjects, match_objects
from viewshed.objects.tracker import Rules, Tracker
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import BeamView, GridView, PolygonView, View
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast
from viewshed_lab.studies.tracks.published import PublishedRules

MODEL = LidarModel("test", np.deg2rad(np.linspace(-20, 6, 40)), azimuth_columns=1200, max_range_m=100.0)

GRID = BevGrid(256, 64.0)

SENSOR = Rigid.from_yaw(0.4, (100.0, -50.0, 1.84))
"""Not where the world begins, and turned: frames that are mixed up show."""

DT_S, SWEEPS, SPEED_MPS = 0.2, 40, 7.0

CAR, PARKED = 7, 8
"""Numbers of the true objects."""


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One sweep with its objects in the world, of which those with five returns are detected."""

    leveled: LeveledSweep
    detections: Detections
    truths: F64
    returns: NDArray[np.int64]


@cache
def drive() -> list[Moment]:
    rng = np.random.default_rng(3)
    world_from_level = Rigid(SENSOR.rotation, SENSOR.translation - [0.0, 0.0, 1.84])
    moments = []
    for k in range(SWEEPS):
        x_m = -6.0 + SPEED_MPS * DT_S * k
        boxes = np.array([[x_m, 14.0, 0.75, 4.3, 1.8, 1.5, 0.0], [9.0, -8.0, 0.75, 4.3, 1.8, 1.5, 0.0]])
        cars = (Box(x_m, 14.0, 4.3, 1.8, 1.5), Box(9.0, -8.0, 4.3, 1.8, 1.5))
        around = (Box(14.0, 7.0, 9.0, 2.5, 3.6), Box(30, -25, 20, 10, 8), Box(20, 32, 60, 10, 8))
        sweep = cast(MODEL, Scene(boxes=(*cars, *around)), 1.84, rng=rng)
        leveled = level(sweep.replace(world_from_sensor=SENSOR, t_ns=round(k * DT_S * 1e9)), GRID)
        off = np.abs(sweep.points[None] + [0.0, 0.0, 1.84] - boxes[:, None, :3])
        returns = (off < boxes[:, None, 3:6] / 2 + [0.1, 0.1, -0.1]).all(axis=-1).sum(axis=1)
        truths = Detections(boxes, np.full(2, ObjectKind.CAR), returns.astype(np.int32)).moved(world_from_level)
        noisy = truths.boxes + rng.normal(0.0, 1.0, (2, 7)) * [0.15, 0.15, 0.05, 0.2, 0.1, 0.05, 0.03]
        detections = Detections(noisy, truths.kinds, truths.returns).take(returns >= 5)
        moments.append(Moment(leveled, detections, truths.boxes, returns))
    return moments


def published_view(moment: Moment, t_s: float) -> View:
    return PolygonView.of(ESTIMATORS["concave_hull"](GRID).estimate(moment.leveled.sweep), t_s)


VIEWS: dict[str, Callable[[Moment, float], View]] = {
    "beams": lambda moment, t_s: BeamView(moment.leveled, t_s),
    "shadow map": lambda moment, t_s: GridView(ESTIMATORS["shadow_map"](GRID).estimate(moment.leveled.sweep), t_s),
}


def follow(rules: Rules | None, view: Callable[[Moment, float], View]) -> tuple[list[Tracks], list[MatchedObjects]]:
    """Return the tracks of the drive, and what the confirmed ones are of."""
    tracker = Tracker(rules)
    drove, matched = [], []
    for k, moment in enumerate(drive()):
        tracks = tracker.step(DT_S * k, moment.detections, view(moment, DT_S * k))
        shown = tracks.confirmed
        matched.append(match_objects(tracks.states[shown], tracks.ids[shown], moment.truths, np.array([CAR, PARKED])))
        drove.append(tracks)
    return drove, matched


def hidden_sweeps() -> NDArray[np.bool_]:
    return np.array([moment.returns[0] < 5 for moment in drive()])


@pytest.mark.parametrize("name", sorted(VIEWS))
def test_a_tracker_that_asks_the_view_keeps_the_car(name: str) -> None:
    drove, matched = follow(None, VIEWS[name])
    assert IdSwitches().add(*matched) == 0
    assert len(set(np.concatenate([tracks.ids for tracks in drove]).tolist())) == 2
    for tracks, is_hidden in zip(drove, hidden_sweeps(), strict=True):
        if is_hidden:
            assert tracks.existence.min() > 0.6
    assert drove[-1].confirmed.all()


def test_the_published_rule_deletes_the_car_and_makes_it_anew() -> None:
    drove, matched = follow(PublishedRules(cost="center", coast_s=3.0), published_view)
    assert IdSwitches().add(*matched) == 1
    ids = [set(tracks.ids.tolist()) for tracks in drove]
    assert min(map(len, ids)) == 1
    assert len(set.union(*ids)) == 3
