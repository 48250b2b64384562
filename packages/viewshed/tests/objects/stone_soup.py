"""One scenario, tracked by our tracker and by Stone Soup with the same model, noise and assignment costs."""

import datetime
from typing import Any

import numpy as np
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

from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind
from viewshed.objects.kalman import Motion
from viewshed.objects.tracker import ExistenceRules, Measured, Tracker, TrackTable
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import SeesAll

START = datetime.datetime(2026, 1, 1)
XVYV = [0, 2, 1, 3]  # Stone Soup's order of x, velocity of x, y, velocity of y in ours
DENSITY, CENTER_STD_M, VELOCITY_STD_MPS = 1.7, 0.4, 6.0


class LikelihoodDistance(SquaredMahalanobis):  # type: ignore[misc]
    """Twice the negative log-likelihood of a detection, up to a constant: the cost of our assignment."""

    def __call__(self, predicted: Any, measured: Any) -> float:
        return float(super().__call__(predicted, measured) + np.log(np.linalg.det(predicted.covar)))


class EqualRules(ExistenceRules):
    """All tracks stay equally likely, so that only distances decide."""

    def judge(self, tracks: TrackTable, measured: Measured, matched: NDArray[np.int32]) -> None:
        pass


RULES = EqualRules(
    motion=Motion(
        acceleration_density=DENSITY, center_std_m=CENTER_STD_M, velocity_std_mps=VELOCITY_STD_MPS,
        heading_from_mps=np.inf,
    ),
    gate=np.inf, seen_share=1.0, lasting_share=0.0, lifetime_s=np.inf, lost_m=np.inf, doubt_s=0.0,
)  # fmt: skip


def scenario(
    rng: np.random.Generator, *, targets: int = 8, half_extent_m: float = 15.0, sweeps: int = 25
) -> list[tuple[float, F64]]:
    """Return times and centers (K, 2): objects that cross, some missed, and false detections; uneven time steps."""
    place, velocity = rng.uniform(-half_extent_m, half_extent_m, (targets, 2)), rng.uniform(-6, 6, (targets, 2))
    times = np.cumsum(rng.choice([0.1, 0.2, 0.5], sweeps))
    recording = []
    for t_s in times:
        centers = place + velocity * t_s + rng.normal(0.0, CENTER_STD_M, (targets, 2))
        false = rng.uniform(-2 * half_extent_m, 2 * half_extent_m, (rng.poisson(1.0), 2))
        centers = np.concatenate([centers[rng.random(targets) < 0.85], false])
        recording.append((float(t_s), rng.permutation(centers)))
    return recording


def ours(sweeps: list[tuple[float, F64]], rules: ExistenceRules) -> list[Tracks]:
    tracker = Tracker(rules)
    found = []
    for t_s, centers in sweeps:
        boxes = np.zeros((len(centers), 7))
        boxes[:, :2], boxes[:, 3:6] = centers, 0.001
        kinds = np.full(len(centers), ObjectKind.CAR)
        given = Detections(boxes, kinds.astype(np.uint8), np.zeros(len(centers), np.int32))
        found.append(tracker.step(t_s, given, SeesAll(t_s, detectable=1.0)))
    return found


UNSEEN_PER_M2, CLUTTER_PER_M2 = RULES.objects_per_m2 * RULES.unseen_share, RULES.objects_per_m2 * RULES.false_odds

MISSED = 2.0 * np.log(
    RULES.most_found
    * UNSEEN_PER_M2
    / (UNSEEN_PER_M2 * (1.0 - RULES.most_found) + CLUTTER_PER_M2)
    / (2.0 * np.pi * CLUTTER_PER_M2)
)
"""Cost of no detection: above it, our tracker leaves a track and a detection unmatched."""


def theirs(sweeps: list[tuple[float, F64]]) -> list[dict[int, tuple[int, Any]]]:
    """Return for each sweep, by track number, the index of its detection (-1 for none) and its state."""
    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(DENSITY), ConstantVelocity(DENSITY)])
    measured = LinearGaussian(4, (0, 2), CENTER_STD_M**2 * np.eye(2))
    predictor, updater = KalmanPredictor(model), KalmanUpdater(measured)
    measure = LikelihoodDistance()
    associator = GNNWith2DAssignment(DistanceHypothesiser(predictor, updater, measure, MISSED))
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
                of = next(k for k, one in enumerate(detections) if one is hypothesis.measurement)
                left.remove(of)
                track.append(updater.update(hypothesis))
            else:
                track.append(predictor.predict(track, timestamp=now))
            states[number] = (of, track.state)
        # Start new tracks in the order of our tracker: by x, then y.
        for k in sorted(left, key=lambda k: tuple(centers[k])):
            place = np.array([centers[k][0], 0.0, centers[k][1], 0.0])
            spread = np.diag([CENTER_STD_M, VELOCITY_STD_MPS] * 2) ** 2
            number = len(tracks)
            tracks[number] = Track([GaussianState(place[:, None], spread, timestamp=now)])
            states[number] = (k, tracks[number].state)
        found.append(states)
    return found
