"""Rigid transforms and polar coordinates.

Frames (meters, radians): ``sensor`` is x forward, y left, z up with the sensor at the origin;
``level`` is gravity-aligned with the sensor's yaw and its origin on the ground below the sensor;
``world`` is the level frame of the map. ``world_from_sensor @ points`` maps points from ``sensor`` to ``world``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.floating[Any]]

_UNIT_TOLERANCE = 1e-3

_IDENTITY = np.eye(3)

_ORTHONORMAL_TOLERANCE = 1e-3 + 1e-5 * _IDENTITY


def pose_covariance_of(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return the checked (6, 6) covariance of a pose: x, y, z in meters, then rotations about them in radians.

    The tolerance is 1e-5 of the trace, because senders round covariances to float32.

    Raises:
        ValueError: it is not finite, not symmetric, or has a negative eigenvalue; the message begins with ``name``.
    """
    covariance = np.array(values, np.float64)
    if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        got = covariance[~np.isfinite(covariance)][0] if covariance.shape == (6, 6) else f"shape {covariance.shape}"
        raise ValueError(f"{name} must be (6, 6) finite numbers, got {got}; give none if unknown")
    tolerance = 1e-5 * float(np.abs(np.diag(covariance)).sum()) + 1e-9
    asymmetry = float(np.abs(covariance - covariance.T).max())
    if asymmetry > tolerance:
        raise ValueError(f"{name} must be symmetric, got numbers {asymmetry:g} apart; mirror the upper triangle")
    eigenvalue = float(np.linalg.eigvalsh((covariance + covariance.T) / 2.0)[0])
    if not eigenvalue >= -tolerance:
        raise ValueError(f"{name} must have no negative eigenvalue, got {eigenvalue:g}; give m² and rad², 0 if exact")
    return covariance


def rotation_from_quaternion(quaternion_wxyz: ArrayLike) -> NDArray[np.float64]:
    """Return the (3, 3) rotation matrix of a unit quaternion (w, x, y, z), Hamilton convention.

    Raises:
        ValueError: the quaternion is not four finite numbers of norm 1 (within 0.001).

    >>> rotation_from_quaternion([1, 0, 0, 0]).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    quaternion = np.asarray(quaternion_wxyz, dtype=np.float64)
    if quaternion.shape != (4,) or not np.isfinite(quaternion).all():
        raise ValueError(f"quaternion must be four finite numbers (w, x, y, z), got {quaternion.tolist()}")
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        raise ValueError(f"quaternion must have norm 1, got norm {norm:.6g}; divide it by its norm")
    w, x, y, z = quaternion / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: ArrayLike) -> NDArray[np.float64]:
    """Return the unit quaternion (w, x, y, z), w ≥ 0, of a (3, 3) rotation matrix.

    It is the eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix, stable for every angle.

    >>> quaternion_from_rotation(np.diag([1.0, -1.0, -1.0])).round(3).tolist()
    [0.0, 1.0, 0.0, 0.0]
    """
    m = np.asarray(rotation, dtype=np.float64)
    k = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [0.0, m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2]],
            [0.0, 0.0, m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2]],
            [0.0, 0.0, 0.0, m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    _, vectors = np.linalg.eigh(k, UPLO="U")
    quaternion: NDArray[np.float64] = vectors[:, -1]
    pivot = quaternion[np.argmax(np.abs(quaternion) > 1e-9)]
    return np.asarray(quaternion * np.sign(pivot) + 0.0, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """A rigid transform: ``rotation`` (3, 3) and ``translation`` (3,) in meters.

    >>> a = Rigid.from_yaw(np.pi / 2, (1.0, 0.0, 0.0))
    >>> (a @ np.array([[1.0, 0.0, 0.0]])).round(6).tolist()
    [[1.0, 1.0, 0.0]]
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def __post_init__(self) -> None:
        rotation = np.array(self.rotation, dtype=np.float64)
        translation = np.array(self.translation, dtype=np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError(f"a rigid transform must be (3, 3) and (3,), got {rotation.shape} and {translation.shape}")
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise ValueError("a rigid transform must be finite")
        error = np.abs(rotation @ rotation.T - _IDENTITY)
        if (error > _ORTHONORMAL_TOLERANCE).any() or _determinant(rotation.tolist()) < 0:
            raise ValueError("rotation must be orthonormal and right-handed (determinant +1)")
        rotation.setflags(write=False)
        translation.setflags(write=False)
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> Rigid:
        """Return the identity transform."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Rigid:
        """Return the transform of a homogeneous (4, 4) matrix."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4):
            raise ValueError(f"matrix must have shape (4, 4), got {m.shape}")
        if (np.abs(m[3] - (0.0, 0.0, 0.0, 1.0)) > _UNIT_TOLERANCE).any():
            raise ValueError(f"matrix must end in the row 0, 0, 0, 1, got {m[3].tolist()}; is it transposed?")
        return cls(m[:3, :3], m[:3, 3])

    @classmethod
    def from_quaternion(cls, quaternion_wxyz: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Rigid:
        """Return the transform of a unit quaternion (w, x, y, z) and a translation (3,)."""
        return cls(rotation_from_quaternion(quaternion_wxyz), np.asarray(translation, dtype=np.float64))

    @classmethod
    def from_yaw(cls, yaw: float, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Rigid:
        """Return a rotation by ``yaw`` radians about z (counter-clockwise from above), then a translation (3,)."""
        c, s = np.cos(yaw), np.sin(yaw)
        return cls(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.asarray(translation, dtype=np.float64))

    def inverse(self) -> Rigid:
        """Return the inverse transform."""
        return Rigid(self.rotation.T, -self.rotation.T @ self.translation)

    def as_matrix(self) -> NDArray[np.float64]:
        """Return the homogeneous (4, 4) matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    @property
    def yaw(self) -> float:
        """Heading of the transformed x axis about z, in radians."""
        return float(np.arctan2(self.rotation[1, 0], self.rotation[0, 0]))

    @overload
    def __matmul__(self, other: Rigid) -> Rigid: ...
    @overload
    def __matmul__(self, other: FloatArray) -> NDArray[np.float64]: ...
    def __matmul__(self, other: Rigid | FloatArray) -> Rigid | NDArray[np.float64]:
        """Compose with a transform, or apply to points (..., 3)."""
        if isinstance(other, Rigid):
            return Rigid(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)
        return np.asarray(other, dtype=np.float64) @ self.rotation.T + self.translation


def _determinant(rows: list[list[float]]) -> float:
    """Return the determinant of a (3, 3) matrix; plain Python is faster than NumPy at this size."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def attitude_of(rotation: ArrayLike) -> NDArray[np.float64]:
    """Return the quaternion (w, x, y, z) of ``level_from_sensor``: ``world_from_sensor`` (3, 3) without its yaw.

    >>> attitude_of(Rigid.from_yaw(1.0).rotation).round(6).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    m = np.asarray(rotation, dtype=np.float64)
    yaw = Rigid.from_yaw(float(np.arctan2(m[1, 0], m[0, 0])))
    return quaternion_from_rotation(yaw.rotation.T @ m)


def polar(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return range (…) in meters and azimuth (…) in [-π, π), counter-clockwise from x, of points (…, 2+).

    >>> range_m, azimuth = polar(np.array([[0.0, 2.0]]))
    >>> float(range_m[0]), round(float(azimuth[0]), 6)
    (2.0, 1.570796)
    """
    x, y = xy[..., 0], xy[..., 1]
    azimuth = np.arctan2(y, x)
    return np.hypot(x, y), np.where(azimuth >= np.pi, -np.pi, azimuth)
