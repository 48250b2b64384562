"""What fusion keeps of tracks from sweep to sweep: arrays with a row for each."""

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
    """What is kept of N tracks."""

    wealth: F64  # (N, 3) e-values against each
    birth: F64  # (N,) ratio of where its surface came from
    log_mean: F64  # (N,) log of the mean ratio of what its boxes held
    looked_s: F64  # (N,) for how long they were looked at
    offset: F64  # (N, 2) meters by which it jumped, if it is believed to be moved
    bare_s: F64  # (N,) for how long no surface has been where it should be
    hits: F64  # (N,) sweeps with a detection
    looks: F64  # (N,) sweeps with a view of it
    looks_at_hit: F64  # (N,) sweeps with a view of it until its last detection
    sightings: Sightings  # its last detections

    @classmethod
    def begun(cls, count: int) -> Self:
        """Return the memory of ``count`` new tracks."""
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
        """Return these tracks and others after them."""
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in _ARRAYS
        }
        return type(self)(**arrays, sightings=self.sightings.joined(others.sightings))

    def note(self, tracks: Rows, visible: F64, matched: Mask, t_s: float, places: F64) -> None:
        """Take note of a sweep.

        Args:
            tracks: (K,) numbers of those that were looked for.
            visible: (K,) probability that each could be seen.
            matched: (K,) which were detected.
            t_s: time of the sweep.
            places: (M, 2) of the detections.
        """
        self.looks[tracks] += visible >= 0.5
        hit = tracks[matched]
        self.hits[hit] += 1
        self.looks_at_hit[hit] = np.maximum(self.looks[hit], self.hits[hit])
        self.sightings = self.sightings.after(hit, t_s, places)

    @property
    def usually_found(self) -> F64:
        """How often each was detected while it was: short tracks are often false detections that go again."""
        return (self.hits + 1.0) / (self.looks_at_hit + 3.0)


_ARRAYS = tuple(each.name for each in fields(Memory) if each.name != "sightings")


def rows_of(ids: NDArray[np.int64], known: NDArray[np.int64]) -> Rows:
    """Return the row (N,) of each id among the known ones (M,), -1 where it is new.

    >>> rows_of(np.array([7, 3, 5]), np.array([3, 7])).tolist()
    [1, 0, -1]
    """
    if not len(known):
        return np.full(len(ids), -1, np.intp)
    order = np.argsort(known)
    place = np.minimum(np.searchsorted(known, ids, sorter=order), len(known) - 1)
    return np.where(known[order[place]] == ids, order[place], -1)


def aligned(memory: Memory, known: NDArray[np.int64], ids: NDArray[np.int64]) -> Memory:
    """Return the memory of tracks ``ids`` (N,), of which ``known`` (M,) have rows; the others are new."""
    rows = rows_of(ids, known)
    new = np.flatnonzero(rows < 0)
    both = memory.joined(Memory.begun(len(new)))
    rows[new] = len(known) + np.arange(len(new))
    return both.take(rows)
