"""Transform buffer like tf: transforms between named frames over time, chained and interpolated."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid, quaternion_from_rotation

WORLDS = ("map", "odom", "world", "earth")
"""Frames that can be the world; the first ancestor of the sensor in this order is used."""

MAX_GAP_NS = 2_000_000_000
"""Poses that are farther apart than this are not interpolated."""

_PARALLEL = 0.9995


def slerp(first: NDArray[np.float64], second: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Interpolate unit quaternions (4,) at ``share`` in [0, 1] along the shorter arc.

    Source: K. Shoemake, Animating rotation with quaternion curves, 1985.

    >>> slerp(np.array([1.0, 0, 0, 0]), np.array([0.0, 0, 0, 1]), 0.5).round(4).tolist()
    [0.7071, 0.0, 0.0, 0.7071]
    """
    cosine = float(np.dot(first, second))
    target = second if cosine >= 0 else -second
    if abs(cosine) > _PARALLEL:
        mixed = (1 - share) * first + share * target
    else:
        angle = np.arccos(abs(cosine))
        mixed = (np.sin((1 - share) * angle) * first + np.sin(share * angle) * target) / np.sin(angle)
    return np.asarray(mixed / np.linalg.norm(mixed), np.float64)


def between(before: Rigid, after: Rigid, share: float) -> Rigid:
    """Interpolate transforms at ``share`` in [0, 1], with constant linear and angular velocity.

    >>> between(Rigid.identity(), Rigid.from_yaw(1.0, (4.0, 0.0, 0.0)), 0.25).translation.tolist()
    [1.0, 0.0, 0.0]
    """
    first, second = quaternion_from_rotation(before.rotation), quaternion_from_rotation(after.rotation)
    translation = (1 - share) * before.translation + share * after.translation
    return Rigid.from_quaternion(slerp(first, second, share), translation)


def nearest(times_ns: Sequence[int] | NDArray[np.int64], t_ns: int) -> int:
    """Return the index of the ascending time nearest to ``t_ns``; ties give the earlier one.

    >>> nearest([10, 20, 30], 24), nearest([10, 20, 30], 25), nearest([10, 20, 30], 99)
    (1, 1, 2)
    """
    late = min(bisect_left(times_ns, t_ns), len(times_ns) - 1)
    return late - 1 if late and t_ns - times_ns[late - 1] <= times_ns[late] - t_ns else late


@dataclass(slots=True, eq=False)
class _Edge:
    """Transforms of one frame to its parent: time → (x, y, z, qw, qx, qy, qz); ``times`` is sorted on lookup."""

    parent: str
    static: bool
    rows: dict[int, tuple[float, ...]] = field(default_factory=dict)
    times: list[int] = field(default_factory=list)

    def at(self, t_ns: int) -> Rigid | None:
        """Return ``parent_from_child`` at a time, or None before the first, after the last one, or in a gap.

        Across a gap an equal transform holds: it was published again.
        """
        if self.static:
            return _rigid(np.array(next(reversed(self.rows.values()))))
        if len(self.times) != len(self.rows):
            self.times = sorted(self.rows)
        late = bisect_left(self.times, t_ns)
        if late == len(self.times) or (late == 0 and self.times[0] != t_ns):
            return None
        after = np.array(self.rows[self.times[late]])
        if self.times[late] == t_ns:
            return _rigid(after)
        start = self.times[late - 1]
        if self.times[late] - start > MAX_GAP_NS and self.rows[start] != self.rows[self.times[late]]:
            return None
        before, share = np.array(self.rows[start]), (t_ns - start) / (self.times[late] - start)
        translation = (1 - share) * before[:3] + share * after[:3]
        return _rigid(np.concatenate([translation, slerp(before[3:], after[3:], share)]))


def _rigid(row: NDArray[np.float64]) -> Rigid:
    return Rigid.from_quaternion(row[3:], row[:3])


@dataclass(slots=True, eq=False)
class TransformBuffer:
    """All transforms of a recording; add all, then look up.

    >>> buffer = TransformBuffer()
    >>> buffer.add("map", "lidar", 0, (1.0, 2.0, 0.0), (1.0, 0.0, 0.0, 0.0), static=True)
    >>> buffer.lookup("map", "lidar", 5).translation.tolist()
    [1.0, 2.0, 0.0]
    """

    _edges: dict[str, _Edge] = field(default_factory=dict)

    def add(
        self,
        parent: str,
        child: str,
        t_ns: int,
        translation_m: Iterable[float],
        quaternion_wxyz: Iterable[float],
        *,
        static: bool = False,
    ) -> None:
        """Add one transform ``parent_from_child``; a child keeps its first parent.

        Raises:
            ValueError: it is not finite, its quaternion is zero, or the child has another parent.
        """
        row = np.array([*translation_m, *quaternion_wxyz], np.float64)
        length = float(np.linalg.norm(row[3:]))
        if row.shape != (7,) or not np.isfinite(row).all() or length < 1e-6:
            raise ValueError(f"the transform of {child!r} must be finite with a rotation, got {row.tolist()}")
        row[3:] /= length
        parent, child = parent.lstrip("/"), child.lstrip("/")
        edge = self._edges.setdefault(child, _Edge(parent, static))
        if edge.parent != parent or parent == child:
            raise ValueError(f"frame {child!r} must have one parent, {edge.parent!r}, got {parent!r}")
        edge.rows[t_ns] = tuple(row.tolist())

    def has_parent(self, frame: str) -> bool:
        """Return whether a frame has a parent."""
        return frame.lstrip("/") in self._edges

    def frames(self) -> tuple[str, ...]:
        """Return the names of all frames, in alphabetical order."""
        return tuple(sorted(self._edges.keys() | {edge.parent for edge in self._edges.values()}))

    def lookup(self, target: str, source: str, t_ns: int) -> Rigid | None:
        """Return ``target_from_source`` at a time, or None if a transform of the chain does not cover that time.

        Raises:
            ValueError: the frames are not connected; the message lists all frames.
        """
        ups, downs = self.chain(source.lstrip("/")), self.chain(target.lstrip("/"))
        common = next((frame for frame in ups if frame in downs), None)
        if common is None:
            frames = ", ".join(self.frames()) or "none"
            raise ValueError(f"no transform leads from frame {source!r} to {target!r}; frames that exist: {frames}")
        from_source = self._up(ups[: ups.index(common)], t_ns)
        from_target = self._up(downs[: downs.index(common)], t_ns)
        return None if from_source is None or from_target is None else from_target.inverse() @ from_source

    def world_of(self, frame: str, worlds: Iterable[str] = WORLDS) -> str:
        """Return the first of ``worlds`` that is an ancestor of ``frame``.

        Raises:
            ValueError: there is none; the message lists all frames.
        """
        chain = self.chain(frame.lstrip("/"))
        worlds = tuple(worlds)
        first = next((world for world in worlds if world in chain), None)
        if first is None:
            frames = ", ".join(self.frames()) or "none"
            raise ValueError(
                f"frame {frame!r} is not connected to any of {', '.join(worlds)}; frames that exist: {frames}"
            )
        return first

    def tilt_rad(self, frame: str, times_ns: Iterable[int]) -> float:
        """Return the maximum tilt of a frame's z axis between the first of these times and the others, in radians.

        >>> buffer = TransformBuffer()
        >>> for t_ns, y in enumerate((0.0, 0.7071)):
        ...     buffer.add("mount", "laser", t_ns, (0.0, 0.0, 0.0), (1.0 - y, 0.0, y, 0.0))
        >>> round(buffer.tilt_rad("laser", (0, 1)), 1)
        2.4
        """
        chain = self.chain(frame.lstrip("/"))
        poses = (self._up(chain[:-1], t_ns) for t_ns in times_ns)
        axes = np.array([pose.rotation[:, 2] for pose in poses if pose is not None])
        return float(np.arccos(np.clip(axes @ axes[0], -1.0, 1.0)).max()) if len(axes) else 0.0

    def _up(self, frames: list[str], t_ns: int) -> Rigid | None:
        """Return the transform from the first of these frames to the parent of the last."""
        total = Rigid.identity()
        for frame in frames:
            step = self._edges[frame].at(t_ns)
            if step is None:
                return None
            total = step @ total
        return total

    def chain(self, frame: str) -> list[str]:
        """Return a frame and its ancestors; stop where a loop closes."""
        chain = [frame]
        while chain[-1] in self._edges:
            parent = self._edges[chain[-1]].parent
            if parent in chain:
                break
            chain.append(parent)
        return chain
