"""The same scenario by Stone Soup: predictions, updates and assignments are the same."""

import datetime
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.measures import SquaredMahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

from viewshed.objects import Detections, ObjectKind
from viewshed.tracking.kalman import Motion
from viewshed.tracking.tracker import ExistenceRules, Tracker, TrackTable
from viewshed.tracking.tracks import Tracks
from viewshed.tracking.views import SeesAll

Floats = NDArray[np.float64]

START = datetime.datetime(2026, 1, 1)
XVYV = [0, 2, 1, 3]  # Stone Soup's order of x, velocity of x, y, velocity of y in ours
DENSITY, CENTER_STD_M, VELOCITY_STD_MPS = 1.7, 0.4, 6.0


class LikelihoodDistance(SquaredMahalanobis):  # type: ignore[misc]
    """Twice the negative log-likelihood of a detection, but for a constant: what our assignment adds up."""

    def __call__(self, predicted: Any, measured: Any) -> float:
        return float(super().__call__(predicted, measured) + np.log(np.linalg.det(predicted.covar)))


class EqualRules(ExistenceRules):
    """All tracks are equally likely for ever, so that only their distances decide."""

    def judge(self, tracks: TrackTable, boxes: Floats, noise: Floats, matched: NDArray[np.int32]) -> None:
        pass


RULES = EqualRules(
    motion=Motion(
        acceleration_density=DENSITY, center_std_m=CENTER_STD_M, velocity_std_mps=VELOCITY_STD_MPS,
        heading_from_mps=np.inf,
    ),
    gate=np.inf, seen_share=1.0, lifetime_s=np.inf, lost_m=np.inf, doubt_s=0.0,
)  # fmt: skip


def scenario(rng: np.random.Generator) -> list[tuple[float, Floats]]:
    """Return times and centers (K, 2): eight objects that cross, some missed, and false ones; uneven steps."""
    place, velocity = rng.uniform(-15, 15, (8, 2)), rng.uniform(-6, 6, (8, 2))
    times = np.cumsum(rng.choice([0.1, 0.2, 0.5], 40))
    sweeps = []
    for t_s in times:
        centers = place + velocity * t_s + rng.normal(0.0, CENTER_STD_M, (8, 2))
        false = rng.uniform(-30, 30, (rng.poisson(1.0), 2))
        centers = np.concatenate([centers[rng.random(8) < 0.85], false])
        sweeps.append((float(t_s), rng.permutation(centers)))
    return sweeps


def ours(sweeps: list[tuple[float, Floats]], rules: ExistenceRules) -> list[Tracks]:
    tracker = Tracker(rules)
    found = []
    for t_s, centers in sweeps:
        boxes = np.zeros((len(centers), 7))
        boxes[:, :2], boxes[:, 3:6] = centers, 0.001
        kinds = np.full(len(centers), ObjectKind.CAR)
        given = Detections(boxes, kinds.astype(np.uint8), np.zeros(len(centers), np.int32))
        found.append(tracker.step(t_s, given, SeesAll(t_s, detectable=1.0)))
    return found


def theirs(sweeps: list[tuple[float, Floats]], missed_distance: float) -> list[dict[int, tuple[int, Any]]]:
    """Return the detection, -1 for none, and the state of each track by the sweep and detection that it began with."""
    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(DENSITY), ConstantVelocity(DENSITY)])
    measured = LinearGaussian(4, (0, 2), CENTER_STD_M**2 * np.eye(2))
    predictor, updater = KalmanPredictor(model), KalmanUpdater(measured)
    measure = LikelihoodDistance()
    associator = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, measure, missed_distance))
    tracks: dict[int, Any] = {}
    found = []
    for t_s, centers in sweeps:
        now = START + datetime.timedelta(seconds=t_s)
        detections = [Detection(center[:, None], timestamp=now, measurement_model=measured) for center in centers]
        left = set(range(len(detections)))
        states = {}
        matches = associator.associate(set(tracks.values()), detections, now) if detections and tracks else {}
        for number, track in tracks.items():
            hypothesis = matches.get(track)
            of = -1
            if hypothesis:
                of = next(k for k, each in enumerate(detections) if each is hypothesis.measurement)
                left.remove(of)
                track.append(updater.update(hypothesis))
            else:
                track.append(predictor.predict(track, timestamp=now))
            states[number] = (of, track.state)
        # New ones in the order of ours: by x, then y.
        for k in sorted(left, key=lambda k: tuple(centers[k])):
            place = np.array([centers[k][0], 0.0, centers[k][1], 0.0])
            spread = np.diag([CENTER_STD_M, VELOCITY_STD_MPS] * 2) ** 2
            number = len(tracks)
            tracks[number] = Track([GaussianState(place[:, None], spread, timestamp=now)])
            states[number] = (k, tracks[number].state)
        found.append(states)
    return found


@pytest.mark.parametrize("seed", range(4))
def test_states_covariances_and_assignments_are_those_of_stone_soup(seed: int) -> None:
    sweeps = scenario(np.random.default_rng(seed))
    real = RULES.most_found * RULES.unseen_per_m2 / (RULES.unseen_per_m2 + RULES.clutter_per_m2)
    missed = 2.0 * np.log(real / (1.0 - real) / (2.0 * np.pi * RULES.clutter_per_m2))
    for mine, other in zip(ours(sweeps, RULES), theirs(sweeps, missed), strict=True):
        assert mine.ids.tolist() == list(other)
        for k, (of, state) in enumerate(other.values()):
            assert mine.detection[k] == of
            np.testing.assert_allclose(mine.states[k], np.array(state.state_vector)[XVYV, 0], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(mine.covariances[k], state.covar[np.ix_(XVYV, XVYV)], rtol=1e-9, atol=1e-9)
