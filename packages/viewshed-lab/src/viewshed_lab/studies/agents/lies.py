"""How agents of a scene lie: about objects, about what they see, alone or together, or to have another one expelled."""

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
"""Objects that are fabricated, removed or moved at a time."""

WITHIN_M = 40.0
"""Objects farther from the liar are left alone."""

APART_M = 4.0
"""Fabricated objects keep so far from all others."""

MOVED_M = (2.0, 4.0)
"""By how far objects are moved."""

STEALTHY_M = (0.6, 1.0)
"""By how far stealthily (arXiv 2605.01301)."""

FABRICATED_SIZE_M = (4.4, 1.8, 1.5)

CHANGED = 0.1
"""Probabilities that differ by more are changed."""

FOLLOW_M = 8.0
"""An object chosen to be forged is followed to the nearest detection within this distance at the next time."""


@dataclass(slots=True)
class Liars:
    """The liars of a scene and what they have chosen; :meth:`forge` is called time after time."""

    lie: Lie  # one of ``LIES``
    numbers: tuple[int, ...]  # of the agents that lie; they agree on what
    victim: int  # agent that is to be expelled, for ``flip``, or -1
    rng: np.random.Generator  # of their choices
    # objects, or shares of the area that the first one saw, that they changed, of each time
    touched: list[float] = field(default_factory=list)
    # (J, 2 or more) where the objects are, in the world, that they lie about; None before they chose
    places: F64 | None = None
    _shifts: F64 | None = None
    _honest: list[list[AgentReport]] = field(default_factory=list)
    _view: ViewLie | None = None

    def forge(self, reports: list[AgentReport]) -> list[AgentReport]:
        """Return what all agents say, some of it lies."""
        self._honest.append(reports)
        return self.lie.forge(self, reports)

    def look(self, reports: list[AgentReport]) -> list[AgentReport]:
        """Remember a time before the onset."""
        self._honest.append(reports)
        return reports


Forge = Callable[[Liars, list[AgentReport]], list[AgentReport]]


@dataclass(frozen=True, slots=True)
class Lie:
    """One way to lie."""

    about: str  # objects, view, pose or others: under which heading it is reported
    liars: int  # how many lie together
    forge: Forge  # what they make of honest reports
    flips: bool = False  # whether it is aimed at an honest agent


def _fabricate(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
    """Report the same invented cars again and again, about the first liar."""
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
    """Do not report some objects any more."""
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
    """Return a lie about objects whose views agree with it, as if the liars' sensors were spoofed as well."""

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
    """Return those boxes (K, 7) that are not among others."""
    same: NDArray[np.bool_] = (boxes[:, None] == others[None]).all(axis=2).any(axis=1)
    return boxes[~same]


def _translate(range_m: tuple[float, float]) -> Forge:
    def forge(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
        """Report some objects where they are not, all liars at the same false places."""
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
            found = Detections(boxes, report.detections.kinds, report.detections.returns)
            out[number] = replace(report, detections=found)
        liars.touched.append(float(touched))
        return out

    return forge


def _lie_about_view(name: str) -> Forge:
    def forge(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
        """Claim another field of view; objects are reported as they are."""
        lie, amount = VIEW_LIES[name]
        if liars._view is None:
            liars._view = ViewLie(float(liars.rng.uniform(-np.pi, np.pi)), amount)
        out = list(reports)
        for number in liars.numbers:
            views = [before[number].estimate for before in liars._honest]
            out[number] = replace(reports[number], estimate=lie(views, liars._view))
        now, claimed = reports[liars.numbers[0]].estimate, out[liars.numbers[0]].estimate
        area = max(int(now.visible().sum()), 1)
        other = (now.state != claimed.state) | (np.abs(now.visible_prob - claimed.visible_prob) > CHANGED)
        changed = other.sum() / area + (now.world_from_level is not claimed.world_from_level)
        liars.touched.append(float(changed))
        return out

    return forge


def _flip(liars: Liars, reports: list[AgentReport]) -> list[AgentReport]:
    """Contradict one honest agent only (after TrustFlip, arXiv 2605.22122).

    The liars deny the objects that the victim sees and fewest others see, and report objects where it claims to see
    none, so that the victim is the one whose reports differ.
    """
    victim = reports[liars.victim]
    if liars.places is None:
        liars.places = _free_places(liars.rng, victim, reports)
    out = _fabricate(liars, reports)
    own = victim.in_world.boxes
    seen_by = np.zeros(len(own))
    for number, report in enumerate(reports):
        if number not in (*liars.numbers, liars.victim) and len(report.in_world):
            away = np.linalg.norm(own[:, None, :2] - report.in_world.boxes[None, :, :2], axis=2)
            seen_by += away.min(axis=1) < APART_M / 2
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
    """Return x, y and yaw (FORGED, 3) of places in the world that the agent claims to see, away from all objects."""
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
    """Return where the objects are (J, 2), in the world, that the liars chose of those near the first one."""
    report = reports[liars.numbers[0]]
    xy = report.in_world.boxes[report.range_m(report.in_world.boxes) < WITHIN_M, :2]
    if liars.places is None:
        liars.places = liars.rng.permutation(xy)[:FORGED]
    elif len(xy) and len(liars.places):
        # Each is followed from time to time, to the nearest detection; one that is gone stays where it was.
        away = np.linalg.norm(liars.places[:, None] - xy[None], axis=2)
        nearest = away.argmin(axis=1)
        close = away.min(axis=1) < FOLLOW_M
        liars.places = np.where(close[:, None], xy[nearest], liars.places)
    return liars.places


def _nearest(report: AgentReport, places: F64) -> NDArray[np.intp]:
    """Return the number (J,) of the agent's detection at each place of the world, -1 for none within two meters."""
    found = report.detections.moved(report.world_from_level).boxes[:, :2]
    if not len(found) or not len(places):
        return np.full(len(places), -1, np.intp)
    away = np.linalg.norm(places[:, None] - found[None], axis=2)
    return np.where(away.min(axis=1) < APART_M / 2, away.argmin(axis=1), -1)


def _with_more(report: AgentReport, more: Detections) -> AgentReport:
    own = report.detections
    joined = Detections(
        np.concatenate([own.boxes, more.boxes]),
        np.concatenate([own.kinds, more.kinds]),
        np.concatenate([own.returns, more.returns]),
    )
    return replace(report, detections=joined)
