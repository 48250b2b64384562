"""State of each track that fusion keeps from sweep to sweep: arrays with one row per track."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.objects.explained import FABRICATED
from viewshed.objects.jumps import Sightings

Rows = NDArray[np.intp]


@dataclass(slots=True, eq=False)
class Memory:
    """State of N tracks."""

    wealth: F64  # (N, 3) e-value of each suspicion
    birth: F64  # (N,) likelihood ratio of the origin of its surface
    log_mean: F64  # (N,) log of the geometric mean ratio of its boxes' cells
    looked_s: F64  # (N,) seconds over which that mean was taken
    offset: F64  # (N, 2) largest suspicious jump in meters
    bare_s: F64  # (N,) seconds without a surface where it should be
    hits: F64  # (N,) number of sweeps with a detection
    looks: F64  # (N,) number of sweeps in which it was visible
    looks_at_hit: F64  # (N,) the same up to its last detection
    sightings: Sightings  # its last detections

    @classmethod
    def begun(cls, count: int) -> Self:
        """Return the state of ``count`` new tracks."""
        wealth, birth = np.zeros((count, 3)), np.ones(count)
        wealth[:, FABRICATED] = 1.0
        log_mean, looked_s, bare_s, hits, looks, looks_at_hit = np.zeros((6, count))
        offset, sightings = np.zeros((count, 2)), Sightings.none(count)
        return cls(wealth, birth, log_mean, looked_s, offset, bare_s, hits, looks, looks_at_hit, sightings)

    def take(self, rows: Rows | Mask) -> Self:
        """Return some of the tracks, as a copy."""
        arrays: dict[str, Any] = {name: getattr(self, name)[rows] for name in _ARRAYS}
        return type(self)(**arrays, sightings=self.sightings.take(rows))

    def joined(self, others: Self) -> Self:
        """Return these tracks followed by others."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in _ARRAYS
        }
        return type(self)(**arrays, sightings=self.sightings.joined(others.sightings))

    def note(self, tracks: Rows, visible: F64, matched: Mask, t_s: float, places: F64) -> None:
        """Update counts and sightings by a sweep.

        Args:
            tracks: (K,) indices of the tracks looked for.
            visible: (K,) probability that each could be seen.
            matched: (K,) bool, which were detected.
            t_s: time of the sweep.
            places: (M, 2) centers of the detections.
        """
        self.looks[tracks] += visible >= 0.5
        hit = tracks[matched]
        self.hits[hit] += 1
        self.looks_at_hit[hit] = np.maximum(self.looks[hit], self.hits[hit])
        self.sightings = self.sightings.after(hit, t_s, places)

    @property
    def usually_found(self) -> F64:
        """(N,) detection rate up to the last detection; short tracks often are false detections that vanish again."""
        return (self.hits + 1.0) / (self.looks_at_hit + 3.0)


_ARRAYS = tuple(each.name for each in fields(Memory) if each.name != "sightings")


def rows_of(ids: NDArray[np.int64], known: NDArray[np.int64]) -> Rows:
    """Return the index (N,) of each id among the known ones (M,), -1 where it is new.

    >>> rows_of(np.array([7, 3, 5]), np.array([3, 7])).tolist()
    [1, 0, -1]
    """
    if not len(known):
        return np.full(len(ids), -1, np.intp)
    order = np.argsort(known)
    index = np.minimum(np.searchsorted(known, ids, sorter=order), len(known) - 1)
    return np.where(known[order[index]] == ids, order[index], -1)


def aligned(memory: Memory, known: NDArray[np.int64], ids: NDArray[np.int64]) -> Memory:
    """Return the state of tracks ``ids`` (N,), given that of ``known`` (M,) ids; others are new."""
    rows = rows_of(ids, known)
    new = np.flatnonzero(rows < 0)
    both = memory.joined(Memory.begun(len(new)))
    rows[new] = len(known) + np.arange(len(new))
    return both.take(rows)
