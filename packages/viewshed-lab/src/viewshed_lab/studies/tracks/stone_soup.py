"""Stone Soup's tracker on the same detections: the baseline of a good tracker without a field of view."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from viewshed._extras import needed_for
from viewshed.arrays import F64
from viewshed.detections import Detections
from viewshed.objects.tracker import MOTION

COAST_S, CONFIRM_UPDATES, GATE = 1.0, 3, 3.7
"""Coasting time of a track, number of detections that confirm it, and gate in standard deviations, which excludes one
in a thousand like ours."""

_START = datetime(2026, 1, 1)


def stone_soup_centers(sweeps: Sequence[tuple[float, Detections]], coast_s: float = COAST_S) -> list[F64]:
    """Return the centers (N, 2) of Stone Soup's tracks after each sweep: nearest neighbors, constant velocities.

    Errors of centers and of motion are those of our tracker (``MOTION``).

    Args:
        sweeps: time in seconds (ascending) and detections of each sweep.
        coast_s: a track ends after this time without a matched detection.

    Raises:
        ImportError: Stone Soup is not installed.
    """
    with needed_for("comparing with Stone Soup"):
        from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
        from stonesoup.deleter.time import UpdateTimeDeleter
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.initiator.simple import MultiMeasurementInitiator
        from stonesoup.measures import Mahalanobis
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.tracker.simple import MultiTargetTracker
        from stonesoup.types.detection import Detection
        from stonesoup.types.state import GaussianState
        from stonesoup.updater.kalman import KalmanUpdater
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(MOTION.acceleration_density)] * 2)
    measured = LinearGaussian(4, (0, 2), MOTION.center_std_m**2 * np.eye(2))
    updater = KalmanUpdater(measured)
    hypotheses = DistanceHypothesiser(KalmanPredictor(motion), updater, Mahalanobis(), missed_distance=GATE)
    associator, deleter = GNNWith2DAssignment(hypotheses), UpdateTimeDeleter(timedelta(seconds=coast_s))
    prior = GaussianState(np.zeros((4, 1)), np.diag([MOTION.center_std_m, MOTION.velocity_std_mps] * 2) ** 2)
    initiator = MultiMeasurementInitiator(
        prior, deleter, associator, updater, measurement_model=measured, min_points=CONFIRM_UPDATES
    )
    timed = []
    for t_s, detections in sweeps:
        now = _START + timedelta(seconds=t_s)
        timed.append((now, {Detection(xy[:, None], timestamp=now) for xy in detections.boxes[:, :2]}))
    tracker = MultiTargetTracker(initiator, deleter, timed, associator, updater)
    return [np.array([track.state_vector[[0, 2], 0] for track in tracks], np.float64).reshape(-1, 2)
            for _, tracks in tracker]  # fmt: skip
