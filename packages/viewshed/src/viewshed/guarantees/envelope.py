"""The envelope: cells through which enough beams are sent that no return blocks; an added return can only shrink it.

For a target in a cell, *sent* are the beams that beam table, attitude, mounting height and ground send through it;
*blocked* are those of them with a return nearer than the target by more than one cell. The margin is their difference,
ring by ring: the cells whose margin is ``min_returns`` or more are *open*. A beam without a return counts as unblocked:
no cell needs a return, so that the margin falls, cell by cell, with every return that is added, and changes by at most
one with every beam that is replaced. The envelope claims the cells that stay open where gaps of a few beams between two
nearer returns of a ring are closed: an obstacle hides what is behind it even where it swallows light. That, too, only
falls with added returns.

What is sent must come from what is given, never from returns of the sweep: :class:`Given` says what it was. The ground
is known only so far: a beam that meets the target anywhere between the lowest and the highest ground counts as sent.
"""

from __future__ import annotations

import atexit
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32, F64, Mask
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.leveling import NULL_RANGE_M, LeveledSweep
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

LEVEL_TILT = np.deg2rad(6.0)
"""Up to this tilt the core takes a sweep without attitude for level (level_sweep.cpp)."""

MOST_TILT = np.deg2rad(15.0)
"""Beams of a sensor tilted further are not those that its table spreads over the ground."""

MOST_STEEP = np.deg2rad(89.9)
"""Beams that a tilted sensor sends up beyond the vertical go as if below it: over any target."""

SECTORS = 128
"""Sectors of azimuth in which the slopes of a tilted sensor's rings are computed."""

FOOT_M = -0.02
"""Lowest height above the ground at which a beam meets a target: as the exact truth counts."""

GRADE = 0.01
"""Slope by which the ground may leave what is given, beyond LEVEL_M: less bounds the false area more tightly, more
leaves more of the claims on hills standing."""

LEVEL_M = 5.0

PLANE_M = 20.0
"""Up to here the ground that carries the sensor is its plane; beyond, its height stays."""

MOST_BEAMS = 10_000_000
"""More beams than any sensor fires in a sweep."""

_ROUNDING = 1e-6

Kind = Literal["added", "replaced", "window", "wedge", "dropped"]

_WORDS: dict[str, str] = {
    "added": "any number of added points",
    "replaced": "{:.10g} replaced beams anywhere, and any added points",
    "window": "{:.10g} replaced beams in the window of any target, and any added points",
    "wedge": "one wedge of {:g}° wholly controlled, and any added points",
    "dropped": "{:.10g} dropped beams anywhere",
}


@dataclass(frozen=True, slots=True)
class Threat:
    """What an attacker may do to a sweep. A beam is a ring in a column of azimuth.

    Attributes:
        kind: ``added`` (any number of points), ``replaced`` (beams anywhere), ``window`` (beams in the window of any
            target), ``wedge`` (all beams of one wedge), ``dropped`` (beams that lose their returns).
        amount: number of beams, or degrees of the wedge; none for ``added``.

    Raises:
        ValueError: the kind is not known, or the amount does not fit it.
    """

    kind: Kind = "added"
    amount: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in _WORDS:
            raise ValueError(f"threat must be one of {', '.join(_WORDS)}, got {self.kind!r}")
        whole = float(self.amount).is_integer() and 1 <= self.amount <= MOST_BEAMS
        if self.kind == "added" and self.amount != 0:
            raise ValueError(f"added counts no beams, got {self.amount:g}; leave the number out")
        if self.kind == "wedge" and not 0.0 < self.amount <= 179.0:
            raise ValueError(f"a wedge must be wider than 0° and at most 179° wide, got {self.amount:g}")
        if self.kind in ("replaced", "window", "dropped") and not whole:
            raise ValueError(f"{self.kind} beams must be a whole number from 1 to {MOST_BEAMS}, got {self.amount:.10g}")

    @classmethod
    def parse(cls, words: str) -> Threat:
        """Return the threat of a word such as ``added``, ``replaced:5`` or ``wedge:10``.

        >>> Threat.parse("wedge:10").words
        'one wedge of 10° wholly controlled, and any added points'
        """
        kind, colon, amount = words.partition(":")
        try:
            return cls(kind, float(amount) if colon else 0.0)  # type: ignore[arg-type]
        except ValueError as error:
            raise ValueError(f"{error}; write added, replaced:5, window:5, wedge:10 or dropped:5") from error

    @property
    def words(self) -> str:
        """The threat in words."""
        return _WORDS[self.kind].format(self.amount)


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What an envelope takes for granted.

    Attributes:
        model: the beam table.
        rotation: (3, 3) from the sensor's frame to the level one.
        height_m: of the sensor above the ground below it.
        ground: heights of the ground in the level frame; None for the plane on which a sensor stands upright, as a
            vehicle does, up to 20 m (level ground if the sensor is tilted by more than 6°).
        grade: slope by which the ground may leave that, beyond 5 m.
        inferred: what of these came from this sweep's own returns, which an attacker may own; empty where nothing did.

    Raises:
        ValueError: the sensor does not fire every ring in every column, is tilted by more than 15°, or a number is out
            of range.
    """

    model: LidarModel
    rotation: F64
    height_m: float
    ground: HeightMap | None = None
    grade: float = GRADE
    inferred: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.model.fires_rings or self.model.shots is not None:
            raise ValueError(
                f"a certificate needs a sensor that fires every ring in every column, got {self.model.name}: where its"
                " beams go in a sweep is not known beforehand"
            )
        if self.tilt > MOST_TILT:
            raise ValueError(
                f"attitude must lie within {np.rad2deg(MOST_TILT):.0f}° of level for a certificate, got"
                f" {np.rad2deg(self.tilt):.1f}°"
            )
        if not (self.height_m > 0.0 and 0.0 <= self.grade <= 1.0):
            raise ValueError(
                f"height_m must be positive and grade lie in [0, 1], got {self.height_m:g} and {self.grade:g}"
            )

    @classmethod
    def of(cls, leveled: LeveledSweep, ground: HeightMap | None = None, grade: float = GRADE) -> Given:
        """Return what a leveled sweep gives.

        Args:
            leveled: the sweep. Its own estimates of sensor, attitude and height stand in where it does not say them.
            ground: heights of the ground that were known before this sweep, if any were.
            grade: as above.

        Raises:
            ValueError: its sensor is not known, or as above.
        """
        sweep, inferred = leveled.sweep, []
        model = sweep.model
        if model is None:
            model = leveled.sensor_id.model
            inferred.append("beam table")
        if model is None:
            raise ValueError("a certificate needs the sensor's beam table, got none and none fits; name the sensor")
        if sweep.known_attitude is None:
            inferred.append("attitude")
        if sweep.sensor_height_m is None and (leveled.held is None or not leveled.held.is_height_held):
            inferred.append("mounting height")
        rotation, height_m = leveled.level_from_sensor.rotation, leveled.sensor_height_m
        return cls(model, rotation, height_m, ground, grade, tuple(inferred))

    @property
    def tilt(self) -> float:
        """Angle in radians between the sensor's axis and the vertical."""
        return float(np.arccos(np.clip(self.rotation[2, 2], -1.0, 1.0)))

    def slopes(self) -> F32:
        """Return the slopes (SECTORS, rings) of the beams in the level frame, by azimuth there.

        With n the level frame's image of the sensor's axis, a direction (cos a, sin a, tan φ) has elevation e where
        n · (cos φ cos a, cos φ sin a, sin φ) = sin e.
        """
        azimuth = (np.arange(SECTORS) + 0.5) * (2 * np.pi / SECTORS) - np.pi
        normal = self.rotation[:, 2]
        level, up = normal[0] * np.cos(azimuth) + normal[1] * np.sin(azimuth), normal[2]
        angle = np.sin(self.model.elevation) / np.hypot(level, up)[:, None]
        elevation = np.arcsin(np.clip(angle, -1.0, 1.0)) - np.arctan2(level, up)[:, None]
        slope = np.tan(np.clip(elevation, -MOST_STEEP, MOST_STEEP))
        return np.ascontiguousarray(slope, np.float32)

    def heights(self, grid: BevGrid) -> F32:
        """Return the height (cells, cells) of the ground that is given, in the level frame."""
        if self.ground is not None:
            return self.ground.at(grid.centers)
        if self.tilt > LEVEL_TILT:
            return np.zeros(grid.shape, np.float32)
        # The plane normal to the sensor's axis, up to PLANE_M; beyond, as high as there.
        share = PLANE_M / np.maximum(polar_of_cells(grid)[0], np.float32(PLANE_M))
        x_slope, y_slope = -self.rotation[:2, 2] / self.rotation[2, 2]
        height_m: F64 = np.add.outer(grid.centers[:, 0, 0] * x_slope, grid.centers[0, :, 1] * y_slope) * share
        return height_m.astype(np.float32)

    def sent(self, grid: BevGrid, target: Target) -> _core.SentBeams:
        """Return the beams that are sent through a target in each cell; kept while what is given stays."""
        if self.ground is not None:
            return self._sent(grid, target)
        return _sent(
            grid, target, self.model, np.asarray(self.rotation, np.float64).tobytes(), self.height_m, self.grade
        )

    def _sent(self, grid: BevGrid, target: Target) -> _core.SentBeams:
        height = self.heights(grid)
        spread = np.float32(self.grade) * np.maximum(polar_of_cells(grid)[0] - np.float32(LEVEL_M), np.float32(0.0))
        start_m = self.height_m + self.rotation[2, 2] * self.model.origin_m
        return _core.SentBeams(
            _columns(grid, target.width_m, self.model), height - spread + np.float32(FOOT_M),
            height + spread + np.float32(target.height_m), self.slopes(), start_m.astype(np.float32),
        )  # fmt: skip

    def nearest_returns(self, sweep: Sweep) -> F32:
        """Return the horizontal range (rings, 2 · columns) of the nearest return of each beam; +inf for none.

        A beam is a ring in a column of azimuth; the circle stands twice. All returns of the sweep count, as it
        was measured, but null returns.
        """
        model = self.model
        ring = sweep.ring if sweep.model is not None else None
        return _core.nearest_returns(
            sweep.points, ring, self.rotation.astype(np.float32), np.tan(model.elevation).astype(np.float32),
            model.origin_m.astype(np.float32), model.azimuth_columns, max(NULL_RANGE_M, model.min_range_m),
            model.max_range_m,
        )  # fmt: skip


@lru_cache(maxsize=4)
def _sent(
    grid: BevGrid, target: Target, model: LidarModel, rotation: bytes, height_m: float, grade: float
) -> _core.SentBeams:
    """Return the beams that are sent over the plane on which a sensor stands; ``rotation`` are its float64 bytes."""
    given = Given(model, np.frombuffer(rotation, np.float64).reshape(3, 3), height_m, None, grade)
    return given._sent(grid, target)


@lru_cache(maxsize=4)
def _columns(grid: BevGrid, width_m: float, model: LidarModel) -> _core.TargetColumns:
    """Return the columns that fall on a target in each cell; they are the same for every sweep."""
    range_m, azimuth = polar_of_cells(grid)
    return _core.TargetColumns(
        range_m, azimuth, model.rings, model.azimuth_columns, grid.cell_m, width_m, model.max_range_m
    )  # fmt: skip


# Whoever leaks a reference to this module (an extension of another package) would make nanobind report these as leaked.
atexit.register(_columns.cache_clear)
atexit.register(_sent.cache_clear)


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """The envelope of one sweep.

    Attributes:
        grid: of the cells.
        target: that the beams are sent through.
        sent: the beams that are.
        nearest_m: (rings, 2 · columns) float32, see :meth:`Given.nearest_returns`.
        margins: (cells, cells) int32 beams that are sent through a target in a cell and not blocked before it.
        claim: (cells, cells) bool where these are enough with gaps of up to four columns of a ring closed.
    """

    grid: BevGrid
    target: Target
    sent: _core.SentBeams
    nearest_m: F32
    margins: NDArray[np.int32]
    claim: Mask

    @classmethod
    def of(cls, leveled: LeveledSweep, given: Given, grid: BevGrid, target: Target) -> Envelope:
        """Return the envelope of a sweep."""
        return cls.within(grid, target, given.sent(grid, target), given.nearest_returns(leveled.delivered))

    @classmethod
    def within(cls, grid: BevGrid, target: Target, sent: _core.SentBeams, nearest_m: F32) -> Envelope:
        """Return the envelope of nearest ranges for beams that are sent."""
        margins, claim = _core.envelope_margins(sent, nearest_m, target.min_returns)
        return cls(grid, target, sent, nearest_m, margins, claim)

    def open(self, spare: int = 0) -> Mask:
        """Return the cells (cells, cells) with ``spare`` more unblocked beams than the target needs, gaps left open."""
        found: Mask = self.margins >= self.target.min_returns + spare
        return found

    def reference(self, threat: Threat) -> Mask:
        """Return the cells (cells, cells) of a sweep without attack in which all lies that an attack did not open.

        Added points leave the claim of the envelope alone; other attacks may also open gaps.
        """
        return self.claim if threat.kind == "added" else self.open()

    def changeable(self, threat: Threat, among: Mask, *, opens: bool) -> tuple[float, Mask]:
        """Return the area in m² that an attack can change at most, and which cells (cells, cells) it may change.

        Each cell that changes needs as many beams as its margin lies off the claim: at least n of the k beams are its
        own. So over all cells that change, the shares 1 / n of these beams add up to their number or more, which is
        therefore at most the sum of the k beams with the largest shares.

        Args:
            threat: what the attacker may do.
            among: (cells, cells) cells that count.
            opens: of a sweep without attack, the cells that an attack opens beyond :meth:`reference`; else of a sweep
                that may be attacked, the cells that it may have opened.
        """
        least, area_m2 = self.target.min_returns, self.grid.cell_area_m2
        if threat.kind == "wedge":
            columns = self.nearest_m.shape[1] // 2
            # A wedge touches one column more than fit into it.
            wide = math.ceil(np.deg2rad(threat.amount) / (2 * np.pi) * columns) + 1
            count, changes = _core.wedge_changes(self.sent, self.nearest_m, self.margins, among, least, wide, opens)
            return count * area_m2, changes
        beams = int(threat.amount)
        changes = among & (self.open(-beams) & ~self.open() if opens else self.open() & ~self.open(beams))
        most = int(changes.sum())
        if beams and threat.kind in ("replaced", "dropped"):
            share = _core.cells_of_beams(self.sent, self.nearest_m, self.margins, among, least, beams, opens)
            share = share[share > 0.0]
            largest = np.partition(share, -beams)[-beams:] if beams < share.size else share
            most = min(most, int(largest.sum() + _ROUNDING))
        return most * area_m2, changes
