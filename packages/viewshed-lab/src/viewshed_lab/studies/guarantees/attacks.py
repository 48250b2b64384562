"""Attacks on certificates: random, by evolution, along the gradient of the bound, and exhaustive on a toy sensor.

Every attack stays within its threat: it changes only the beams that the threat allows, and adds points. An attacked
sweep is then processed like any other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed.guarantees.certificate import certify
from viewshed.guarantees.envelope import Envelope, Given, Threat
from viewshed.preprocess.leveling import level
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

TRIED = ("added", "replaced:5", "replaced:20", "replaced:50", "replaced:150", "window:5", "wedge:10", "dropped:20")

TRIED_TOY = ("added", "replaced:5", "replaced:20", "window:5", "wedge:60", "dropped:5")

HOW = ("random", "gradient", "evolution")

NEAR_GRID = BevGrid(128, 32.0)

TOY = LidarModel("toy", np.deg2rad([-20.0, -12.0, -7.0, -3.0]), 24)

_DEEPEST = 60
"""Maximum number of beams that a cell may lack to count for the gradient of a wedge."""

_CHECKED = 40
"""Every Nth attack is also certified from its points, as a victim would."""


@dataclass(slots=True)
class Tally:
    """Results of the attacks of one kind and threat."""

    tried: int = 0  # number of attacks
    violations: int = 0  # attacks that get a cell certified, or open an area, against the certificate
    best_m2: float = 0.0  # largest area that an attack opened
    bound_m2: float = 0.0  # bound on that area


@dataclass(slots=True, eq=False)
class Victim:
    """A sweep without an attack, its envelope, and the returns of each of its beams."""

    sweep: Sweep  # without an attack
    given: Given  # assumptions of the envelope
    envelope: Envelope  # of the sweep
    beam: NDArray[np.intp] = field(init=False)  # (N,) beam of each return: ring · columns + column

    def __post_init__(self) -> None:
        # The beam of each return as the envelope assigns it, vectorized by ring and azimuth.
        columns, model = self.given.model.azimuth_columns, self.given.model
        level_xyz = self.sweep.points @ self.given.rotation.T.astype(np.float32)
        turn = (np.arctan2(level_xyz[:, 1], level_xyz[:, 0]) + np.pi) / (2 * np.pi)
        column = np.minimum((turn * columns).astype(np.intp), columns - 1)
        if self.sweep.ring is not None:
            ring = self.sweep.ring.astype(np.intp)
        else:
            x, y, z = self.sweep.points.T
            slope = (z / np.hypot(x, y))[:, None]
            ring = np.abs(slope - np.tan(model.elevation)[None]).argmin(axis=1)
        self.beam = ring * columns + column

    def attacked(self, beams: NDArray[np.intp], range_m: F32, added: F32) -> Sweep:
        """Return the sweep with ``beams`` returning at ``range_m`` (+inf: not at all), and with points ``added``."""
        keep = ~np.isin(self.beam, beams)
        model = self.given.model
        moved = np.isfinite(range_m)
        ring, column = np.divmod(beams[moved], model.azimuth_columns)
        azimuth = (column + 0.5) / model.azimuth_columns * 2 * np.pi - np.pi
        elevation = model.elevation[ring]
        rays = np.column_stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        replaced = (rays * range_m[moved, None]).astype(np.float32)
        points = np.concatenate([self.sweep.points[keep], replaced, added])
        rings = None
        if self.sweep.ring is not None:
            added_ring = (np.arange(len(added)) * 7) % model.rings
            rings = np.concatenate([self.sweep.ring[keep], ring, added_ring]).astype(np.int16)
        return self.sweep.replace(points=points, ring=rings, intensity=None, azimuth=None, time_s=None)

    def envelope_of(self, sweep: Sweep) -> Envelope:
        """Return the envelope of an attacked sweep."""
        own = self.envelope
        return Envelope.within(own.grid, own.target, own.sent, self.given.nearest_returns(sweep))


def own_victim(sweep: Sweep, grid: BevGrid) -> Victim:
    """Return the victim of a sweep of the study's scenes."""
    leveled = level(sweep, grid)
    given = Given.of(leveled, grade=0.0)
    return Victim(sweep, given, Envelope.of(leveled, given, grid, CAR))


def toy_victim(rng: np.random.Generator) -> Victim:
    """Return a toy sensor of 96 beams in front of a wall."""
    azimuth = (np.arange(24) + 0.5) / 24 * 2 * np.pi - np.pi
    a, e = (part.ravel() for part in np.meshgrid(azimuth, TOY.elevation))
    rays = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    depth = np.minimum(-1.5 / np.minimum(rays[:, 2], -1e-9), 25.0)
    center, half, range_m = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 0.8), rng.uniform(2.0, 5.0)
    behind = np.abs((a - center + np.pi) % (2 * np.pi) - np.pi) < half
    depth = np.where(behind & (depth > range_m), range_m, depth)
    sweep = Sweep((rays * depth[:, None]).astype(np.float32), model=TOY, sensor_height_m=1.5, attitude=np.eye(4)[0])
    return own_victim(sweep, BevGrid(20, 8.0))


def beams_within(
    threat: Threat, victim: Victim, rng: np.random.Generator, weight: NDArray[np.float64] | None
) -> NDArray[np.intp]:
    """Return beams that a threat allows to change: random ones, or those of the largest weight."""
    rings, columns = victim.given.model.rings, victim.given.model.azimuth_columns
    amount = int(threat.amount)
    if threat.kind == "added":
        return np.zeros(0, np.intp)
    score = rng.random(rings * columns) if weight is None else weight.ravel() + 1e-9 * rng.random(rings * columns)
    if threat.kind == "wedge":
        wide = int(np.floor(threat.amount / 360 * columns))
        by_column = score.reshape(rings, columns).sum(axis=0)
        start = int(np.convolve(np.tile(by_column, 2), np.ones(wide), "valid")[:columns].argmax())
        return (np.arange(rings)[:, None] * columns + (start + np.arange(wide)) % columns).ravel()
    if threat.kind == "window":
        # ``amount`` beams in either half of the revolution, separated by gaps larger than the window.
        stretch = columns // 2
        picked = [
            first + np.argsort(part)[-amount:]
            for first in (0, stretch)
            for part in (score.reshape(rings, columns)[:, first : first + stretch // 3].max(axis=0),)
        ]
        column = np.concatenate(picked)
        ring: NDArray[np.intp] = score.reshape(rings, columns)[:, column].argmax(axis=0)
        return ring * columns + column
    return np.argpartition(score, -amount)[-amount:]


def weights_of(clean: Envelope, threat: Threat) -> NDArray[np.float64]:
    """Return the weight of each beam (rings, columns) for opening cells: the gradient of the bound."""
    max_lacking = _DEEPEST if threat.kind == "wedge" else max(int(threat.amount), 1)
    return _core.cells_of_beams(
        clean.sent, clean.nearest_m, clean.margins, ~clean.open(), clean.target.min_returns, max_lacking, True
    )


def try_attacks(victim: Victim, words: str, how: str, count: int, rng: np.random.Generator, tally: Tally) -> None:
    """Try ``count`` attacks of one kind on a victim, and add the results to the tally.

    ``random`` draws beams, ranges and points; ``gradient`` takes the beams of the largest (from the second attack on,
    randomly scaled) weights of the bound; ``evolution`` also changes a few beams of the best attack so far.
    """
    threat, clean = Threat.parse(words), victim.envelope
    among = ~clean.reference(threat)
    bound_m2 = clean.changeable(threat, among, opens=True)[0]
    weight = None if how == "random" or threat.kind == "added" else weights_of(clean, threat)
    best: NDArray[np.intp] | None = None
    best_m2 = -1.0
    for number in range(count):
        chosen = None if weight is None else weight * rng.uniform(0.3, 1.0, weight.shape) ** (0 if number == 0 else 1)
        beams = beams_within(threat, victim, rng, chosen)
        if how == "evolution" and best is not None and threat.kind in ("replaced", "dropped"):
            new = rng.choice(victim.given.model.rings * victim.given.model.azimuth_columns, max(len(best) // 8, 1))
            beams = np.unique(np.concatenate([rng.permutation(best)[: len(best) - len(new)], new]))
        far = np.full(len(beams), np.inf, np.float32)
        if threat.kind != "dropped":
            near = rng.random(len(beams)) < (0.3 if how == "random" else 0.0)
            far = np.where(near, rng.uniform(0.6, 60.0, len(beams)), np.inf).astype(np.float32)
        spread = rng.integers(0, 200) if threat.kind == "added" or how == "random" else 0
        added = rng.normal(0.0, rng.uniform(1.0, 25.0), (0 if threat.kind == "dropped" else spread, 3))
        after = victim.envelope_of(victim.attacked(beams, far, added.astype(np.float32)))
        opened_m2 = float((after.claim & among).sum()) * clean.grid.cell_area_m2
        tally.tried += 1
        tally.violations += int(opened_m2 > bound_m2 or _certifies_wrongly(after, clean, threat))
        if number % _CHECKED == 0:
            tally.violations += int(_claims_wrongly(victim, beams, far, added, threat, opened_m2))
        if opened_m2 > best_m2:
            best, best_m2 = beams, opened_m2
    tally.best_m2 += max(best_m2, 0.0)
    tally.bound_m2 += bound_m2


def _certifies_wrongly(after: Envelope, clean: Envelope, threat: Threat) -> bool:
    """Return whether the certified part of an attacked envelope has a cell that the clean one does not claim."""
    if threat.kind == "wedge":
        _, changes = after.changeable(threat, after.claim, opens=False)
        certified = after.claim & ~changes
    else:
        certified = after.claim & after.open(int(threat.amount))
    return bool((certified & ~clean.reference(threat)).any())


def _claims_wrongly(
    victim: Victim, beams: NDArray[np.intp], far: F32, added: Any, threat: Threat, opened_m2: float
) -> bool:
    """Return whether the certificate of an attacked sweep, computed from its points, is violated."""
    grid = victim.envelope.grid
    leveled = level(victim.attacked(beams, far, added.astype(np.float32)), grid)
    all_free = FovEstimate(grid, np.ones(grid.shape, np.float32), np.full(grid.shape, CellState.FREE, np.uint8))
    certificate = certify(leveled, all_free, threat, victim.given)
    clean = victim.envelope.reference(threat)
    opened = float((certificate.claim & ~clean).sum()) * grid.cell_area_m2
    return bool((certificate.certified_visible & ~clean).any()) or opened > certificate.over_claim_m2


def try_all(victim: Victim, beams_at_once: int, limit: int, tally: Tally) -> None:
    """Drop every set of ``beams_at_once`` beams of a toy sensor, up to ``limit`` sets."""
    threat, clean = Threat("dropped", beams_at_once), victim.envelope
    among = ~clean.reference(threat)
    bound_m2, best_m2 = clean.changeable(threat, among, opens=True)[0], 0.0
    for beams in islice(combinations(np.unique(victim.beam), beams_at_once), limit):
        sweep = victim.attacked(np.array(beams), np.full(len(beams), np.inf, np.float32), np.zeros((0, 3), np.float32))
        after = victim.envelope_of(sweep)
        opened_m2 = float((after.claim & among).sum()) * clean.grid.cell_area_m2
        best_m2 = max(best_m2, opened_m2)
        tally.tried += 1
        tally.violations += int(opened_m2 > bound_m2 or _certifies_wrongly(after, clean, threat))
    tally.best_m2 += best_m2
    tally.bound_m2 += bound_m2
