"""Constant-velocity Kalman filters of all tracks at once (Bar-Shalom, Li and Kirubarajan, 2001, chapters 5 and 6).

The state is x, y and their velocities; the measurement is the center of a box. Height, size and heading of the box are
filtered separately, as slowly drifting values.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from viewshed.arrays import F64


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of objects, measurement noise of a detector, and prior of a new track."""

    acceleration_density: float = 1.0  # spectral density of white acceleration along x and y, m²/s³
    # additional standard deviation of x, y and the velocities, per second
    state_drift: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    velocity_std_mps: float = 8.0  # of a new track, whose mean velocity is 0
    position_std_m: float | None = None  # of a new track; None takes that of its detection
    center_std_m: float = 0.6  # of a detection's center along x and y, if the detector gives no covariance
    # standard deviation of z, length, width, height (meters) and yaw (radians) per root of a second
    box_drift: tuple[float, float, float, float, float] = (0.2, 0.1, 0.1, 0.05, 0.3)
    box_std: tuple[float, float, float, float, float] = (0.2, 0.5, 0.3, 0.2, 0.2)  # of the same values of a detection
    # of the same values of a new track; None takes ``box_std``
    new_box_std: tuple[float, float, float, float, float] | None = None
    heading_from_mps: float = 2.0  # from this speed on the heading is the quarter turn nearest to the velocity
    standing_share: float = 0.0  # prior share of standing objects, to judge missed tracks by; 0 disables it
    outlier_share: float = 0.0  # share of detections whose box was completed wrongly; 0 disables outliers
    outlier_std_m: float = 1.2  # additional standard deviation of an outlier's center

    def __post_init__(self) -> None:
        for name in ("acceleration_density", "velocity_std_mps", "center_std_m", "heading_from_mps"):
            value = getattr(self, name)
            if not 0.0 <= value <= inf:
                raise ValueError(f"{name} must not be negative, got {value}")
        if self.center_std_m == 0.0:
            raise ValueError("center_std_m must be positive, got 0.0")
        for name in ("standing_share", "outlier_share"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise ValueError(f"{name} must lie in [0, 1), got {getattr(self, name)}")

    def process_noise(self, dt_s: float) -> F64:
        """Return the covariance (4, 4) that a state gains in ``dt_s`` seconds.

        >>> Motion(acceleration_density=3.0).process_noise(1.0)[0].tolist()
        [1.0, 0.0, 1.5, 0.0]
        """
        place, both, velocity = dt_s**3 / 3.0, dt_s**2 / 2.0, dt_s
        white = np.array([[place, 0, both, 0], [0, place, 0, both], [both, 0, velocity, 0], [0, both, 0, velocity]])
        return self.acceleration_density * white + np.diag((np.array(self.state_drift) * dt_s) ** 2)

    def center_noise(self, count: int) -> F64:
        """Return default covariances (count, 2, 2) of centers, for a detector that gives none."""
        return np.broadcast_to(self.center_std_m**2 * np.eye(2), (count, 2, 2))

    def outlier_noise(self, noise: F64) -> F64:
        """Return the covariances (K, 2, 2) of centers with covariances ``noise`` if they are outliers."""
        return noise + self.outlier_std_m**2 * np.eye(2)

    def new_covariances(self, noise: F64) -> F64:
        """Return the covariances (K, 4, 4) of tracks that start at detections with center covariances (K, 2, 2)."""
        covariances = np.zeros((len(noise), 4, 4))
        covariances[:, :2, :2] = noise if self.position_std_m is None else self.position_std_m**2 * np.eye(2)
        covariances[:, 2:, 2:] = self.velocity_std_mps**2 * np.eye(2)
        return covariances


def predict(states: F64, covariances: F64, dt_s: float, process_noise: F64) -> tuple[F64, F64]:
    """Return states (N, 4) and covariances (N, 4, 4) ``dt_s`` seconds later."""
    transition = np.eye(4)
    transition[0, 2] = transition[1, 3] = dt_s
    return states @ transition.T, transition @ covariances @ transition.T + process_noise


def standing_probability(states: F64, covariances: F64, motion: Motion) -> F64:
    """Return the probability (N,) that tracks stand still, by their velocities.

    An object stands, or its velocity has the prior of a new track. The ratio of both is that of the posterior to the
    prior density at velocity 0 (Savage-Dickey; Dickey, 1971), which the Kalman filter gives.

    >>> motion = Motion(velocity_std_mps=8.0, standing_share=0.5)
    >>> covariances = np.tile(np.eye(4), (2, 1, 1))
    >>> standing_probability(np.array([[0, 0, 0.0, 0], [0, 0, 9.0, 0]]), covariances, motion).round(3).tolist()
    [0.985, 0.0]
    """
    inverses, determinants = inverse(covariances[:, 2:, 2:])
    velocity = states[:, 2:]
    squared = (velocity[:, None, :] @ inverses @ velocity[:, :, None])[:, 0, 0]
    prior = motion.standing_share / (1.0 - motion.standing_share)
    odds = prior * motion.velocity_std_mps**2 / np.sqrt(determinants) * np.exp(-0.5 * squared)
    return np.asarray(odds / (1.0 + odds))


def settle(states: F64, covariances: F64, standing: F64) -> tuple[F64, F64]:
    """Return states (N, 4) and covariances (N, 4, 4) of tracks that stand still with probability ``standing`` (N,).

    Mean and covariance are those of the mixture of *stands still* and *moves on*.
    """
    moving = 1.0 - standing
    settled, spread = states.copy(), covariances.copy()
    settled[:, 2:] *= moving[:, None]
    spread[:, :, 2:] *= moving[:, None, None]
    spread[:, 2:, :2] *= moving[:, None, None]
    velocity = states[:, 2:]
    spread[:, 2:, 2:] += (moving * standing)[:, None, None] * velocity[:, :, None] * velocity[:, None, :]
    return settled, spread


def squared_distances(states: F64, covariances: F64, centers: F64, noise: F64) -> tuple[F64, F64]:
    """Return squared Mahalanobis distances (N, K) of centers (K, 2), and determinants (N, K) of their covariances.

    The covariance of a difference is that of the track's position plus ``noise`` (K, 2, 2) of the detection.
    """
    dx = centers[None, :, 0] - states[:, 0, None]
    dy = centers[None, :, 1] - states[:, 1, None]
    xx = covariances[:, 0, 0, None] + noise[None, :, 0, 0]
    xy = covariances[:, 0, 1, None] + noise[None, :, 0, 1]
    yy = covariances[:, 1, 1, None] + noise[None, :, 1, 1]
    determinants = xx * yy - xy * xy
    return (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinants, determinants


def center_log_density(squared: F64, determinants: F64) -> F64:
    """Return log-densities of centers from squared Mahalanobis distances and determinants of the same shape."""
    return np.asarray(-0.5 * (squared + np.log(determinants)) - np.log(2.0 * np.pi))


def update(states: F64, covariances: F64, centers: F64, noise: F64) -> tuple[F64, F64]:
    """Return states (M, 4) and covariances (M, 4, 4) updated by the matched detections.

    Args:
        states: predicted, (M, 4).
        covariances: of the states, (M, 4, 4).
        centers: of the detections, (M, 2).
        noise: covariances of the centers, (M, 2, 2).
    """
    innovation = centers - states[:, :2]
    spread = covariances[:, :2, :2] + noise
    gain = covariances[:, :, :2] @ inverse(spread)[0]
    updated = covariances - gain @ spread @ gain.transpose(0, 2, 1)
    updated = 0.5 * (updated + updated.transpose(0, 2, 1))  # rounding would make it asymmetric over hours
    return states + (gain @ innovation[:, :, None])[:, :, 0], updated


def inverse(matrices: F64) -> tuple[F64, F64]:
    """Return inverses (M, 2, 2) and determinants (M,) of matrices (M, 2, 2), five times as fast as LAPACK."""
    determinants = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
    adjugates = matrices[:, ::-1, ::-1].transpose(0, 2, 1) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return adjugates / determinants[:, None, None], determinants


def update_boxes(boxes: F64, variances: F64, measured: F64, noise_std: F64) -> tuple[F64, F64]:
    """Return z, sizes and yaw (M, 5) and their variances, updated by detections (M, 5) up to quarter turns.

    A detector that sees two sides of a box cannot tell which one is the front. A box with length and width exchanged
    and a quarter turn of yaw is the same box, so the nearest turn of each detection is used.
    """
    turns = np.round((boxes[:, 4] - measured[:, 4]) / (np.pi / 2))
    measured = quarter_turned(measured, turns)
    gain = variances / (variances + noise_std**2)
    after = boxes + gain * (measured - boxes)
    after[:, 4] = wrapped(after[:, 4])
    return after, (1.0 - gain) * variances


def quarter_turned(extents: F64, turns: F64) -> F64:
    """Return the same boxes (z, length, width, height, yaw; (M, 5)) with headings turned by quarter turns (M,).

    >>> quarter_turned(np.array([[0.0, 4.0, 2.0, 1.5, 0.0]]), np.array([1.0])).round(3).tolist()
    [[0.0, 2.0, 4.0, 1.5, 1.571]]
    """
    turned = extents.copy()
    odd = turns % 2 == 1
    turned[odd, 1], turned[odd, 2] = extents[odd, 2], extents[odd, 1]
    turned[:, 4] += turns * (np.pi / 2)
    return turned


def wrapped(angle: F64) -> F64:
    """Return angles wrapped to [-π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
