"""Lies of agents in a scene: about objects or views, alone or in collusion, or to get an honest agent expelled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.report import AgentReport
from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind
from viewshed_lab.threats.view_attacks import VIEW_LIES, ViewLie, with_objects, without_objects

FORGED = 3
"""Number of objects that are fabricated, removed or moved at a time."""

WITHIN_M = 40.0
"""Maximum distance of forged objects from the liar."""

APART_M = 4.0
"""Minimum distance of fabricated objects from all others."""

MOVED_M = (2.0, 4.0)
"""Minimum and maximum shift of moved objects."""

STEALTHY_M = (0.6, 1.0)
"""Minimum and maximum shift of stealthily moved objects (arXiv 2605.01301)."""

FABRICATED_SIZE_M = (4.4, 1.8, 1.5)

CHANGED = 0.1
"""Cells whose probabilities differ by more count as changed."""

FOLLOW_M = 8.0
"""A forged object is matched to the nearest detection within this distance at the next time."""


@dataclass(slots=True)
class Liars:
    """The liars of a scene and their state; :meth:`forge` is called at each time."""

    lie: Lie  # one of ``LIES``
    numbers: tuple[int, ...]  # of the lying agents; they tell the same lie
    victim: int  # agent that ``flip`` tries to get expelled, or -1
    rng: np.random.Generator  # of their choices
    # per time: number of changed objects, or changed share of the area that the first liar saw
    touched: list[float] = field(default_factory=list)
    # (J, 2 or more) places in the world of the objects that they lie about; None before they are chosen
    places: F64 | None = None
    _shifts: F64 | None = None
    _honest: list[list[AgentReport]] = field(default_factory=list)
    _view: ViewLie | None = None

    def forge(self, reports: list[AgentReport]) -> list[AgentReport]:
        """Return the reports of all agents, with those of the liars forged."""
        self._honest.append(reports)
        return self.lie.forge(self, reports)

    def look(self, reports: list[AgentReport]) -> list[AgentReport]:
        """Record the honest reports of a time before the onset; return them unchanged."""
        self._honest.append(reports)
        return reports


Forge = Callable[[Liars, list[AgentReport]], list[AgentReport]]


@dataclass(frozen=True, slots=True)
class Lie:
    """One kind of lie."""

    about: str  # objects, view, pose or others: heading under which it is reported
    liars: int  # number of colluding liars
    forge: Forge  # turns honest reports into forged ones
    flips: bool = False  # whether it targets an honest agent


def _fabricate(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
    """Report the same fabricated cars at each time, around the first liar."""
    first = reports[liars.numbers[0]]
    if liars.places is None:
        liars.places = _free_places(liars.rng, first, reports)
    boxes = np.column_stack([
        liars.places[:, :2], np.full(len(liars.places), first.world_from_level.translation[2] + 0.75),
        np.tile(FABRICATED_SIZE_M, (len(liars.places), 1)), liars.places[:, 2],
    ])  # fmt: skip
    out = list(reports)
    for number in liars.numbers:
        ghosts = boxes.copy()
        ghosts[:, :2] += liars.rng.normal(0.0, 0.15, (len(boxes), 2))
        forged = Detections(ghosts, np.full(len(boxes), ObjectKind.CAR, np.uint8), np.full(len(boxes), 60, np.int32))
        out[number] = _with_more(reports[number], forged.moved(reports[number].world_from_level.inverse()))
    liars.touched.append(float(len(boxes)))
    return out


def _remove(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
    """Stop reporting some objects."""
    out, touched = list(reports), 0
    chosen = _chosen(liars, reports)
    for number in liars.numbers:
        gone = _nearest(reports[number], chosen)
        keep = np.ones(len(reports[number].detections), np.bool_)
        keep[gone[gone >= 0]] = False
        touched += int((~keep).sum())
        out[number] = replace(reports[number], detections=reports[number].detections.take(keep))
    liars.touched.append(float(touched))
    return out


def _with_views(forge: Forge) -> Forge:
    """Return a lie about objects with consistent views, as if the liars' sensors were spoofed as well."""

    def forge_both(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
        out = forge(liars, reports)
        for number in liars.numbers:
            before, after = reports[number].detections.boxes, out[number].detections.boxes
            gone, new = _not_in(before, after), _not_in(after, before)
            estimate = with_objects(without_objects(reports[number].estimate, gone), new)
            out[number] = replace(out[number], estimate=estimate)
        return out

    return forge_both


def _not_in(boxes: F64, others: F64) -> F64:
    """Return the boxes (K, 7) that are not among ``others``."""
    same: NDArray[np.bool_] = (boxes[:, None] == others[None]).all(axis=2).any(axis=1)
    return boxes[~same]


def _translate(range_m: tuple[float, float]) -> Forge:
    def forge(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
        """Report some objects at false places, the same for all liars."""
        out, touched = list(reports), 0
        chosen = _chosen(liars, reports)
        if liars._shifts is None:
            angle, by_m = liars.rng.uniform(0, 2 * np.pi, FORGED), liars.rng.uniform(*range_m, FORGED)
            liars._shifts = np.column_stack([by_m * np.cos(angle), by_m * np.sin(angle)])
        for number in liars.numbers:
            report = reports[number]
            moved = _nearest(report, chosen)
            boxes = np.array(report.detections.boxes)
            turn = report.world_from_level.rotation[:2, :2]
            boxes[moved[moved >= 0], :2] += liars._shifts[: len(moved)][moved >= 0] @ turn
            touched += int((moved >= 0).sum())
            detections = Detections(boxes, report.detections.kinds, report.detections.returns)
            out[number] = replace(report, detections=detections)
        liars.touched.append(float(touched))
        return out

    return forge


def _lie_about_view(name: str) -> Forge:
    def forge(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
        """Claim another field of view; detections stay honest."""
        lie, amount = VIEW_LIES[name]
        if liars._view is None:
            liars._view = ViewLie(float(liars.rng.uniform(-np.pi, np.pi)), amount)
        out = list(reports)
        for number in liars.numbers:
            views = [before[number].estimate for before in liars._honest]
            out[number] = replace(reports[number], estimate=lie(views, liars._view))
        honest, claimed = reports[liars.numbers[0]].estimate, out[liars.numbers[0]].estimate
        area = max(int(honest.visible().sum()), 1)
        changed = (honest.state != claimed.state) | (np.abs(honest.visible_prob - claimed.visible_prob) > CHANGED)
        share = changed.sum() / area + (honest.world_from_level is not claimed.world_from_level)
        liars.touched.append(float(share))
        return out

    return forge


def _flip(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
    """Contradict a single honest agent (after TrustFlip, arXiv 2605.22122).

    The liars deny objects that the victim and the fewest others report, and report objects where the victim sees free
    ground, so that the victim's reports are the ones that differ.
    """
    victim = reports[liars.victim]
    if liars.places is None:
        liars.places = _free_places(liars.rng, victim, reports)
    out = _fabricate(liars, reports)
    own = victim.in_world.boxes
    seen_by = np.zeros(len(own))
    for number, report in enumerate(reports):
        if number not in (*liars.numbers, liars.victim) and len(report.in_world):
            distance_m = np.linalg.norm(own[:, None, :2] - report.in_world.boxes[None, :, :2], axis=2)
            seen_by += distance_m.min(axis=1) < APART_M / 2
    order = np.argsort(seen_by, kind="stable")[:FORGED]
    for number in liars.numbers:
        gone = _nearest(reports[number], own[order, :2])
        keep = np.ones(len(out[number].detections), np.bool_)
        keep[gone[gone >= 0]] = False
        out[number] = replace(out[number], detections=out[number].detections.take(keep))
    return out


LIES: dict[str, Lie] = {
    "fabricate": Lie("objects", 1, _fabricate),
    "remove": Lie("objects", 1, _remove),
    "translate": Lie("objects", 1, _translate(MOVED_M)),
    "translate_stealthy": Lie("objects", 1, _translate(STEALTHY_M)),
    "fabricate_spoofed": Lie("objects and view", 1, _with_views(_fabricate)),
    "remove_spoofed": Lie("objects and view", 1, _with_views(_remove)),
    "translate_spoofed": Lie("objects and view", 1, _with_views(_translate(MOVED_M))),
    "fabricate_together": Lie("objects together", 2, _fabricate),
    "remove_together": Lie("objects together", 2, _remove),
    "translate_together": Lie("objects together", 2, _translate(MOVED_M)),
    **{name: Lie("view", 1, _lie_about_view(name)) for name in VIEW_LIES},
    "flip": Lie("others", 1, _flip, flips=True),
    "flip_together": Lie("others", 2, _flip, flips=True),
}
"""Every lie by name."""


def _free_places(rng: np.random.Generator, about: AgentReport, reports: Sequence[AgentReport]) -> F64:
    """Return x, y and yaw (FORGED, 3) of places in the world that the agent sees, away from all objects."""
    taken = np.concatenate([report.in_world.boxes[:, :2] for report in reports])
    out: list[list[float]] = []
    for _ in range(500):
        at = np.append(rng.normal(0.0, 15.0, 2), 0.0)
        range_m = float(np.hypot(at[0], at[1]))
        if not 4.0 < range_m < WITHIN_M or not about.estimate.at(at[:2]) >= about.estimate.threshold:
            continue
        xy = (about.world_from_level @ at)[:2]
        others = np.concatenate([taken, np.array(out)[:, :2].reshape(-1, 2) if out else np.zeros((0, 2))])
        if not len(others) or np.linalg.norm(others - xy, axis=1).min() > APART_M:
            out.append([*xy, rng.uniform(-np.pi, np.pi)])
        if len(out) == FORGED:
            break
    return np.array(out).reshape(-1, 3)


def _chosen(liars: Liars, reports: Sequence[AgentReport]) -> F64:
    """Return the places (J, 2) in the world of the objects near the first liar that the liars chose."""
    report = reports[liars.numbers[0]]
    xy = report.in_world.boxes[report.range_m(report.in_world.boxes) < WITHIN_M, :2]
    if liars.places is None:
        liars.places = liars.rng.permutation(xy)[:FORGED]
    elif len(xy) and len(liars.places):
        # Track each place to its nearest detection; without one it stays.
        distance_m = np.linalg.norm(liars.places[:, None] - xy[None], axis=2)
        nearest = distance_m.argmin(axis=1)
        close = distance_m.min(axis=1) < FOLLOW_M
        liars.places = np.where(close[:, None], xy[nearest], liars.places)
    return liars.places


def _nearest(report: AgentReport, places: F64) -> NDArray[np.intp]:
    """Return the index (J,) of the agent's detection at each place of the world, -1 for none within two meters."""
    xy = report.detections.moved(report.world_from_level).boxes[:, :2]
    if not len(xy) or not len(places):
        return np.full(len(places), -1, np.intp)
    distance_m = np.linalg.norm(places[:, None] - xy[None], axis=2)
    return np.where(distance_m.min(axis=1) < APART_M / 2, distance_m.argmin(axis=1), -1)


def _with_more(report: AgentReport, more: Detections) -> AgentReport:
    own = report.detections
    joined = Detections(
        np.concatenate([own.boxes, more.boxes]),
        np.concatenate([own.kinds, more.kinds]),
        np.concatenate([own.returns, more.returns]),
    )
    return replace(report, detections=joined)
