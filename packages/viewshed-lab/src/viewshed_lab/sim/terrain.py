"""Terrain: a triangulated height field over unevenly spaced lines in x and y, so that curbs can be steep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from viewshed.geometry import FloatArray, Rigid
from viewshed_lab.sim.assets.shapes import material_index

_LOOKUP_M = 0.125


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground heights on a rectilinear lattice in the world frame, two triangles per quad; constant beyond its edge.

    The diagonal of quad (i, j) runs from node (i, j) to node (i + 1, j + 1). A curb is two lines a few
    centimeters apart.

    Raises:
        ValueError: a shape does not fit, or a line does not ascend.
    """

    x_m: NDArray[np.float64]  # (nx,) ascending lines
    y_m: NDArray[np.float64]  # (ny,) ascending lines
    heights_m: NDArray[np.float64]  # (nx, ny) z of the nodes
    # (nx - 1, ny - 1) uint8 rows of ``MATERIALS``, one per quad; asphalt by default
    material: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m"):
            lines = np.array(getattr(self, name), np.float64)
            if lines.ndim != 1 or len(lines) < 2 or not np.isfinite(lines).all() or (np.diff(lines) <= 0).any():
                raise ValueError(f"{name} must be two or more finite ascending numbers")
            object.__setattr__(self, name, _frozen(lines))
        heights = np.array(self.heights_m, np.float64)
        if heights.shape != (len(self.x_m), len(self.y_m)) or not np.isfinite(heights).all():
            raise ValueError(f"heights_m must be finite {len(self.x_m), len(self.y_m)}, got {heights.shape}")
        object.__setattr__(self, "heights_m", _frozen(heights))
        quads = (len(self.x_m) - 1, len(self.y_m) - 1)
        material = np.full(quads, material_index("asphalt"), np.uint8) if not self.material.size else self.material
        if material.shape != quads:
            raise ValueError(f"material must have shape {quads}, got {material.shape}")
        object.__setattr__(self, "material", _frozen(np.array(material, np.uint8)))

    @classmethod
    def plane(cls, half_extent_m: float, slope: tuple[float, float] = (0.0, 0.0), material: str = "asphalt") -> Terrain:
        """Return a plane of one quad with ``slope`` (a, b), rise per meter of x and y; its height at the origin is 0.

        >>> float(Terrain.plane(50.0, (0.1, 0.0)).at([[20.0, 3.0]])[0])
        2.0
        """
        lines = np.array([-half_extent_m, half_extent_m])
        heights = slope[0] * lines[:, None] + slope[1] * lines[None, :]
        return cls(lines, lines, heights, np.full((1, 1), material_index(material), np.uint8))

    @classmethod
    def of(
        cls,
        x_m: ArrayLike,
        y_m: ArrayLike,
        height: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
        material: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.uint8]] | None = None,
    ) -> Terrain:
        """Return the terrain with heights ``height(x, y)`` of nodes and ``material(x, y)`` at the centers of quads."""
        x, y = np.unique(np.asarray(x_m, np.float64)), np.unique(np.asarray(y_m, np.float64))
        heights = height(*np.meshgrid(x, y, indexing="ij"))
        if material is None:
            return cls(x, y, heights)
        centers = np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2, indexing="ij")
        return cls(x, y, heights, material(*centers))

    def at(self, xy: FloatArray | ArrayLike) -> NDArray[np.float64]:
        """Return ground z (…,) in meters at points (…, 2+) of the world, exact on the triangles."""
        points = np.asarray(xy, dtype=np.float64)
        out = np.empty(points.shape[:-1])
        flat = np.ascontiguousarray(points.reshape(-1, points.shape[-1]))
        _heights(self.x_m, self.y_m, self.heights_m, self._lookups, flat, out.reshape(-1))
        return out

    def about(
        self, pose: Rigid, forward_m: NDArray[np.float64], left_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return ground z (n, m) above the origin of a pose, and whether the point is on the terrain.

        Args:
            pose: in the world; only its yaw turns the points.
            forward_m: (n,) of the points along that yaw, from the pose's origin.
            left_m: (m,) of the points across it.
        """
        shape = (len(forward_m), len(left_m))
        heights, inside = np.empty(shape, np.float32), np.empty(shape, np.bool_)
        frame = (np.cos(pose.yaw), np.sin(pose.yaw), *pose.translation)
        _heights_about((self.x_m, self.y_m, self.heights_m), forward_m, left_m, frame, heights, inside)
        return heights, inside

    def normals_at(self, xy: FloatArray | ArrayLike, over_m: float = 1.0) -> NDArray[np.float64]:
        """Return unit normals (…, 3) of the ground around points (…, 2+), by differences over ``over_m`` meters."""
        steps = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * over_m / 2
        z = self.at(np.asarray(xy, np.float64)[..., None, :2] + steps)
        normals = np.stack([z[..., 1] - z[..., 0], z[..., 3] - z[..., 2], np.full(z.shape[:-1], over_m)], axis=-1)
        return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))

    @cached_property
    def _lookups(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return the index of the line at or before each step of 1/8 meter, along x and y."""
        return _lookup(self.x_m), _lookup(self.y_m)


def _lookup(lines: NDArray[np.float64]) -> NDArray[np.int32]:
    steps = np.arange(int(np.ceil((lines[-1] - lines[0]) / _LOOKUP_M)) + 1) * _LOOKUP_M + lines[0]
    before = np.clip(np.searchsorted(lines, steps, side="right") - 1, 0, len(lines) - 2)
    return np.asarray(before, np.int32)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


@njit(cache=True, nogil=True, error_model="numpy")
def _line(lines: Any, lookup: Any, value: Any) -> Any:
    step = min(max(int((value - lines[0]) / _LOOKUP_M), 0), lookup.shape[0] - 1)
    i = lookup[step]
    while i < lines.shape[0] - 2 and value >= lines[i + 1]:
        i += 1
    return i


@njit(cache=True, nogil=True, error_model="numpy")
def _quad(xs: Any, ys: Any, z: Any, i: Any, j: Any) -> Any:
    """Return corner, side lengths and the heights of the four nodes of a quad."""
    return xs[i], ys[j], xs[i + 1] - xs[i], ys[j + 1] - ys[j], z[i, j], z[i + 1, j], z[i, j + 1], z[i + 1, j + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _height(quad: Any, x: Any, y: Any) -> Any:
    """Return z at a point of a quad."""
    x0, y0, wide, deep, a, b, c, d = quad
    u, v = (x - x0) / wide, (y - y0) / deep
    right, left = a + u * (b - a) + v * (d - b), a + v * (c - a) + u * (d - c)
    return right if u >= v else left


@njit(cache=True, nogil=True, error_model="numpy")
def _heights(xs: Any, ys: Any, z: Any, lookups: Any, points: Any, out: Any) -> None:
    for k in range(points.shape[0]):
        x = min(max(points[k, 0], xs[0]), xs[-1])
        y = min(max(points[k, 1], ys[0]), ys[-1])
        out[k] = _height(_quad(xs, ys, z, _line(xs, lookups[0], x), _line(ys, lookups[1], y)), x, y)


@njit(cache=True, nogil=True, error_model="numpy")
def _heights_about(terrain: Any, forward: Any, left: Any, pose: Any, heights: Any, inside: Any) -> None:
    """Fill z (n, m) above a pose's origin and whether the point is on the terrain, walking from quad to quad."""
    (xs, ys, z), (c, s, x0, y0, z0) = terrain, pose
    i, j, quad = 0, 0, _quad(xs, ys, z, 0, 0)
    for row in range(forward.shape[0]):
        for k in range(left.shape[0]):
            east, north = c * forward[row] - s * left[k] + x0, s * forward[row] + c * left[k] + y0
            x, y = min(max(east, xs[0]), xs[-1]), min(max(north, ys[0]), ys[-1])
            inside[row, k] = x == east and y == north
            if x < xs[i] or x >= xs[i + 1] or y < ys[j] or y >= ys[j + 1]:
                i, j = _walk(xs, i, x), _walk(ys, j, y)
                quad = _quad(xs, ys, z, i, j)
            heights[row, k] = _height(quad, x, y) - z0


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(lines: Any, i: Any, value: Any) -> Any:
    """Return the index of the line at or before a value (never the last line), searching from guess ``i``."""
    while i > 0 and value < lines[i]:
        i -= 1
    while i < lines.shape[0] - 2 and value >= lines[i + 1]:
        i += 1
    return i
