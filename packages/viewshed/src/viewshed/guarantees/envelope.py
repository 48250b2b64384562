"""The envelope: cells that enough unblocked beams pass through; an added return can only shrink it.

For a target in a cell, *sent* beams are those that pass through it by beam table, attitude, mounting height and ground.
*Blocked* beams are sent beams with a return nearer than the target by more than one cell. The margin is their
difference, ring by ring; cells whose margin is at least ``min_returns`` are *open*. A beam without a return counts as
unblocked, so no cell needs a return: every added return can only lower the margin of a cell, and every replaced beam
changes it by one at most. The envelope claims the cells that stay open after closing gaps of a few beams between two
nearer returns of a ring, because an obstacle hides what is behind it even where it absorbs light. Closing, too, only
shrinks the envelope as returns are added.

Sent beams must follow from given data, never from returns of the sweep; :class:`Given` records their origin. The ground
is uncertain: a beam that meets the target anywhere between the lowest and the highest ground counts as sent.
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
"""Up to this tilt the core assumes that a sweep without attitude is level (level_sweep.cpp)."""

MAX_TILT = np.deg2rad(15.0)
"""Maximum tilt of a sensor: beyond, the table no longer tells how its beams spread over the ground."""

MAX_ELEVATION = np.deg2rad(89.9)
"""Elevations in the level frame are clipped to this; such beams pass over any target."""

SECTORS = 128
"""Sectors of azimuth in which the slopes of a tilted sensor's rings are computed."""

FOOT_M = -0.02
"""Lowest height above the ground at which a beam meets a target, the same as in the exact truth."""

GRADE = 0.01
"""Slope by which the ground may deviate from the given one beyond LEVEL_M. A smaller slope bounds the false area more
tightly; a larger one keeps more claims on hills."""

LEVEL_M = 5.0

PLANE_M = 20.0
"""Up to this range the ground is the plane under the sensor; beyond, its height is constant."""

MAX_BEAMS = 10_000_000
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
    """Capability of an attacker on one sweep. A beam is a ring in a column of azimuth.

    Attributes:
        kind: ``added`` (any number of points), ``replaced`` (beams anywhere), ``window`` (beams in the window of any
            target), ``wedge`` (all beams of one wedge), ``dropped`` (beams that lose their returns).
        amount: number of beams, or width of the wedge in degrees; 0 for ``added``.

    Raises:
        ValueError: the kind is not known, or the amount is out of range for it.
    """

    kind: Kind = "added"
    amount: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in _WORDS:
            raise ValueError(f"threat must be one of {', '.join(_WORDS)}, got {self.kind!r}")
        is_count = float(self.amount).is_integer() and 1 <= self.amount <= MAX_BEAMS
        if self.kind == "added" and self.amount != 0:
            raise ValueError(f"added takes no number of beams, got {self.amount:g}; leave the number out")
        if self.kind == "wedge" and not 0.0 < self.amount <= 179.0:
            raise ValueError(f"a wedge must be wider than 0° and at most 179° wide, got {self.amount:g}")
        if self.kind in ("replaced", "window", "dropped") and not is_count:
            raise ValueError(f"{self.kind} beams must be a whole number from 1 to {MAX_BEAMS}, got {self.amount:.10g}")

    @classmethod
    def parse(cls, words: str) -> Threat:
        """Return the threat written as ``added``, ``replaced:5`` or ``wedge:10``, for example.

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
    """Inputs that an envelope takes for granted.

    Attributes:
        model: the beam table.
        rotation: (3, 3) from the sensor frame to the level frame.
        height_m: of the sensor above the ground below it.
        ground: heights of the ground in the level frame; None for the plane normal to the sensor's axis, as under a
            vehicle, up to 20 m (level ground if the sensor is tilted by more than 6°).
        grade: slope by which the ground may deviate from that, beyond 5 m.
        inferred: names of the inputs that were inferred from this sweep's own returns, which an attacker may control.

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
        if self.tilt > MAX_TILT:
            raise ValueError(
                f"attitude must lie within {np.rad2deg(MAX_TILT):.0f}° of level for a certificate, got"
                f" {np.rad2deg(self.tilt):.1f}°"
            )
        if not (self.height_m > 0.0 and 0.0 <= self.grade <= 1.0):
            raise ValueError(
                f"height_m must be positive and grade lie in [0, 1], got {self.height_m:g} and {self.grade:g}"
            )

    @classmethod
    def of(cls, leveled: LeveledSweep, ground: HeightMap | None = None, grade: float = GRADE) -> Given:
        """Return the inputs that a leveled sweep gives.

        Args:
            leveled: the sweep. Sensor, attitude and height that it does not state are inferred from it.
            ground: heights of the ground known before this sweep, if any.
            grade: see :class:`Given`.

        Raises:
            ValueError: its sensor is not known, or as for :class:`Given`.
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
        """Return the slopes (SECTORS, rings) of the beams in the level frame, by azimuth in that frame.

        With n the sensor's axis in the level frame, a direction of azimuth a and elevation φ there has the elevation e
        in the sensor frame with sin e = n · (cos φ cos a, cos φ sin a, sin φ).
        """
        azimuth = (np.arange(SECTORS) + 0.5) * (2 * np.pi / SECTORS) - np.pi
        normal = self.rotation[:, 2]
        level, up = normal[0] * np.cos(azimuth) + normal[1] * np.sin(azimuth), normal[2]
        angle = np.sin(self.model.elevation) / np.hypot(level, up)[:, None]
        elevation = np.arcsin(np.clip(angle, -1.0, 1.0)) - np.arctan2(level, up)[:, None]
        slope = np.tan(np.clip(elevation, -MAX_ELEVATION, MAX_ELEVATION))
        return np.ascontiguousarray(slope, np.float32)

    def heights(self, grid: BevGrid) -> F32:
        """Return the height (cells, cells) of the given ground in the level frame."""
        if self.ground is not None:
            return self.ground.at(grid.centers)
        if self.tilt > LEVEL_TILT:
            return np.zeros(grid.shape, np.float32)
        # The plane normal to the sensor's axis up to PLANE_M, and its height there beyond.
        share = PLANE_M / np.maximum(polar_of_cells(grid)[0], np.float32(PLANE_M))
        x_slope, y_slope = -self.rotation[:2, 2] / self.rotation[2, 2]
        height_m: F64 = np.add.outer(grid.centers[:, 0, 0] * x_slope, grid.centers[0, :, 1] * y_slope) * share
        return height_m.astype(np.float32)

    def sent(self, grid: BevGrid, target: Target) -> _core.SentBeams:
        """Return the beams sent through a target in each cell; cached by the given inputs unless ``ground`` is set."""
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

        A beam is a ring in a column of azimuth; the columns are repeated once. All measured returns of the sweep count,
        except null returns.
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
    """Return the beams sent over the plane under a sensor; ``rotation`` is given as float64 bytes, to be hashable."""
    given = Given(model, np.frombuffer(rotation, np.float64).reshape(3, 3), height_m, None, grade)
    return given._sent(grid, target)


@lru_cache(maxsize=4)
def _columns(grid: BevGrid, width_m: float, model: LidarModel) -> _core.TargetColumns:
    """Return the columns that cover a target in each cell; they are the same for every sweep."""
    range_m, azimuth = polar_of_cells(grid)
    return _core.TargetColumns(
        range_m, azimuth, model.rings, model.azimuth_columns, grid.cell_m, width_m, model.max_range_m
    )  # fmt: skip


# Otherwise nanobind reports these as leaked if an extension of another package leaks a reference to this module.
atexit.register(_columns.cache_clear)
atexit.register(_sent.cache_clear)


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """The envelope of one sweep.

    Attributes:
        grid: of the cells.
        target: that may stand in a cell.
        sent: beams sent through a target in each cell.
        nearest_m: (rings, 2 · columns) float32, see :meth:`Given.nearest_returns`.
        margins: (cells, cells) int32 number of sent beams that are not blocked.
        claim: (cells, cells) bool, enough of them after closing gaps of up to four columns of a ring.
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
        """Return the envelope of sent beams and nearest returns."""
        margins, claim = _core.envelope_margins(sent, nearest_m, target.min_returns)
        return cls(grid, target, sent, nearest_m, margins, claim)

    def open(self, spare: int = 0) -> Mask:
        """Return the cells (cells, cells) with ``spare`` more unblocked beams than needed, without closing gaps."""
        mask: Mask = self.margins >= self.target.min_returns + spare
        return mask

    def reference(self, threat: Threat) -> Mask:
        """Return the cells (cells, cells) of a sweep without attack beyond which a cell was opened by an attack.

        Added points cannot open closed gaps, so the claim serves for them; other attacks may open gaps too.
        """
        return self.claim if threat.kind == "added" else self.open()

    def changeable(self, threat: Threat, among: Mask, *, opens: bool) -> tuple[float, Mask]:
        """Return an upper bound of the area in m² that an attack can change, and the cells (cells, cells) it may reach.

        To change a cell, an attack needs at least n of its k beams to pass through that cell, n being the distance of
        the margin from the limit. So each changed cell receives shares of 1 / n from at least n beams, which sum to 1
        or more, and the number of changed cells is at most the sum of the k largest total shares of a beam.

        Args:
            threat: the assumed attack.
            among: (cells, cells) cells that count.
            opens: True: the sweep is without attack; count cells that an attack can open beyond :meth:`reference`.
                False: the sweep may be attacked; count cells that the attack may have opened.
        """
        min_returns, area_m2 = self.target.min_returns, self.grid.cell_area_m2
        if threat.kind == "wedge":
            columns = self.nearest_m.shape[1] // 2
            # A wedge touches one more column than fits into it.
            wide = math.ceil(np.deg2rad(threat.amount) / (2 * np.pi) * columns) + 1
            state = self.sent, self.nearest_m, self.margins
            count, changes = _core.wedge_changes(*state, among, min_returns, wide, opens)
            return count * area_m2, changes
        beams = int(threat.amount)
        changes = among & (self.open(-beams) & ~self.open() if opens else self.open() & ~self.open(beams))
        count = int(changes.sum())
        if beams and threat.kind in ("replaced", "dropped"):
            share = _core.cells_of_beams(self.sent, self.nearest_m, self.margins, among, min_returns, beams, opens)
            share = share[share > 0.0]
            largest = np.partition(share, -beams)[-beams:] if beams < share.size else share
            count = min(count, int(largest.sum() + _ROUNDING))
        return count * area_m2, changes
