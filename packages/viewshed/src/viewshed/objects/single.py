"""Single-agent, security-aware fusion: each track explained by what its own sensors could have seen, or suspected.

A track that is not detected may be hidden, out of view, or too far for enough returns; or it is *missing though
visible*. One that is detected may be where beams pass (*seen through*) or where nothing can be seen, may have begun in
the middle of cells that were seen free, or may have jumped as nothing moves. Nothing is detected again in the points:
fusion uses the field of view and the past.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.detections import Detections
from viewshed.objects.before import FOLLOWED_AFTER, SeenBefore, surface_shares
from viewshed.objects.cells import BoxCells
from viewshed.objects.evidence import (
    BLIND,
    CAP,
    EvidenceModel,
    birth_bins,
    cell_bins,
    cell_ratios,
    jump_bins,
    mean_after,
    ratios_of,
    view_bins,
    wealth_after,
)
from viewshed.objects.explained import (
    FABRICATED,
    MOVED,
    REMOVED,
    ExplainedTracks,
    Explanation,
)
from viewshed.objects.memory import Memory, aligned, rows_of
from viewshed.objects.sensor_view import SensorView, check_views
from viewshed.objects.tracks import Tracks

MEMORY_S = 10.0
"""How long a track is remembered that the tracker has given up."""


class SingleFusion:
    """Explains the tracks of one agent, sweep after sweep, by the fields of view of its sensors.

    Attributes:
        model: what evidence is worth.
    """

    def __init__(self, model: EvidenceModel | None = None) -> None:
        """Begin without a past; without a model take the shipped one."""
        self.model = shipped_model() if model is None else model
        self.reset()

    def reset(self) -> None:
        """Forget all tracks."""
        self._last: Tracks | None = None
        self._memory = Memory.begun(0)
        self._before = SeenBefore()

    def explain(self, tracks: Tracks, detections: Detections, views: Sequence[SensorView]) -> ExplainedTracks:
        """Return the tracks of a sweep explained.

        Args:
            tracks: after the sweep.
            detections: that they were made of, in the same frame.
            views: of the sensor of that sweep first, then of the agent's others.

        Raises:
            ValueError: there is no view or one of another time, two have one name, or there are too many tracks.
        """
        check_views(tracks, views)
        if self._last is not None and (tracks.t_s < self._last.t_s or tracks.in_world != self._last.in_world):
            self.reset()
        dt_s = 0.1 if self._last is None else max(tracks.t_s - self._last.t_s, 0.0)
        model = self.model

        # The tracker's tracks, and those that it gave up.
        both, memory = self._remembered(tracks, detections, views[0], dt_s)
        count, is_matched = len(both), both.detection >= 0

        # What is looked at: the detection where there is one, else where the track should be.
        boxes = both.boxes.copy()
        boxes[is_matched] = detections.boxes[both.detection[is_matched]]
        look = _look(boxes, both.kinds, views, model)
        alarmed = np.any([view.alarmed(boxes) for view in views], axis=0)
        found = np.clip(both.visible * both.detectable, 0.0, 1.0 - model.still_found)
        found = np.where(is_matched, found, np.minimum(found, memory.usually_found))

        ratios = np.ones((count, 3))
        ratios[is_matched, FABRICATED] = look.ratio[is_matched]
        # Removed: nothing is detected where the object still stands. Else it was missed, or it is gone.
        still = self._still_there(both, look, is_matched, views)
        missed = 1.0 / ((1.0 - model.gone) * (1.0 - found) + model.gone * still)
        ratios[:, REMOVED] = np.where(is_matched, model.still_found / np.maximum(found, model.still_found), missed)
        deviations, vectors = memory.sightings.jumps()
        # Without poses whatever the vehicle itself does looks like a move of theirs.
        can_jump = is_matched & both.in_world
        jumped = np.where(can_jump, ratios_of(model.jump, jump_bins(deviations)), 1.0)
        ratios[is_matched, MOVED] = 1.0 - model.jump_share + model.jump_share * jumped[is_matched]
        larger = (jumped > 1.0) & (np.hypot(*vectors.T) > np.hypot(*memory.offset.T))
        memory.offset[larger] = vectors[larger]
        ratios = np.clip(ratios, 1.0 / CAP, CAP)
        # What was seen only briefly is often a false detection: nobody need have removed it.
        ratios[~is_matched & ((memory.hits < _KNOWN_HITS) | ~both.confirmed), REMOVED] = 1.0

        # Evidence over time, of those that are under no alarm.
        seen, quiet = np.flatnonzero(is_matched & ~alarmed), np.flatnonzero(~alarmed)
        memory.looked_s[seen] += dt_s
        memory.log_mean[seen] = mean_after(
            memory.log_mean[seen], ratios[seen, FABRICATED], dt_s, memory.looked_s[seen], model.window_s
        )
        # Cells betray a forged detection, and where its surface came from a ghost made in the sweep: half each.
        followed = is_matched & ~alarmed & np.isin(memory.hits, FOLLOWED_AFTER)
        surface = np.zeros(count)
        surface[followed] = surface_shares(views[0].cells, both.boxes[followed])
        birth = birth_bins(self._before.free_shares(both, surface, followed))
        memory.birth = np.where(birth == BLIND, memory.birth, ratios_of(model.birth, birth))
        memory.wealth[seen, FABRICATED] = 0.5 * (np.exp(memory.log_mean[seen]) + memory.birth[seen])
        for suspicion, block_s in zip((REMOVED, MOVED), model.block_s, strict=True):
            after = wealth_after(memory.wealth[quiet, suspicion], ratios[quiet, suspicion], dt_s, block_s)
            memory.wealth[quiet, suspicion] = np.minimum(after, _MOST_WEALTH)
        is_bare = (look.surface == 0) & ~is_matched
        memory.bare_s = np.where(alarmed, memory.bare_s, np.where(is_bare, memory.bare_s + dt_s, 0.0))

        # Verdicts.
        e_values = memory.wealth.mean(axis=1)
        over = memory.wealth / np.array(model.limits)
        accused = (over >= 1.0).any(axis=1) & ~alarmed
        suspicions = over.argmax(axis=1).astype(np.uint8)
        moved = accused & (suspicions == MOVED)
        explanations = _explanations(both, memory.birth, look, suspicions, accused, alarmed)
        reasons = tuple(
            _sentence(both, k, Explanation(why), look, float(e_values[k]), memory.offset[k])
            for k, why in enumerate(explanations.tolist())
        )
        self._last, self._memory = both, memory
        self._before.add(tracks.t_s, views[0].cells)
        return ExplainedTracks(
            both, explanations, e_values, memory.wealth.copy(), suspicions, accused,
            np.where(moved[:, None], memory.offset, 0.0), np.arange(count) >= len(tracks), reasons,
            () if both.in_world else (_NO_POSES,),
        )  # fmt: skip

    def _remembered(
        self, tracks: Tracks, detections: Detections, view: SensorView, dt_s: float
    ) -> tuple[Tracks, Memory]:
        """Return the tracks and, after them, those that the tracker has given up, with what is known of each."""
        last = tracks.take(np.zeros(0, np.intp)) if self._last is None else self._last
        memory = aligned(self._memory, last.ids, tracks.ids)
        is_matched = tracks.detection >= 0
        places = detections.boxes[tracks.detection[is_matched], :2]
        memory.note(np.arange(len(tracks)), tracks.visible, is_matched, tracks.t_s, places)
        given_up = rows_of(last.ids, tracks.ids) < 0
        given_up &= (
            tracks.in_world & last.confirmed & (tracks.t_s - last.seen_s <= MEMORY_S) & (self._memory.bare_s <= _BARE_S)
        )
        # One that is detected again under another id is found.
        honest = tracks.boxes[is_matched & (memory.wealth[:, FABRICATED] < self.model.limits[FABRICATED])]
        apart = np.hypot(*(last.boxes[:, None, :2] - honest[None, :, :2]).transpose(2, 0, 1))
        given_up &= (apart >= _SAME_M).all(axis=1)
        if not given_up.any():
            return tracks, memory
        carried_over = _predicted(last.take(given_up), tracks.t_s, dt_s, view)
        return tracks.joined(carried_over), memory.joined(self._memory.take(given_up))

    def _still_there(self, tracks: Tracks, look: _Look, is_matched: Mask, views: Sequence[SensorView]) -> F64:
        """Return gone : still there (N,) by the cells at the track, or at the nearest surface if these fit better."""
        ratio = look.ratio.copy()
        lost, cells = np.flatnonzero(~is_matched), views[0].cells
        if cells is not None and len(lost):
            boxes = tracks.boxes[lost].copy()
            boxes[:, :2] += cells.shifts(boxes)
            ratio[lost] = np.minimum(ratio[lost], _look(boxes, tracks.kinds[lost], views, self.model).ratio)
        return ratio


def _explanations(
    tracks: Tracks, birth: F64, look: _Look, suspicions: NDArray[np.uint8], accused: Mask, alarmed: Mask
) -> NDArray[np.uint8]:
    """Return why each track (N,) is detected or not."""
    fabricated = accused & (suspicions == FABRICATED)
    cases = (
        (alarmed, Explanation.ABSTAINED),
        (fabricated & (birth > np.maximum(look.ratio, 1.0)), Explanation.NEW_IN_FREE),
        (fabricated & ~(look.free < look.hidden), Explanation.SEEN_THROUGH),
        (fabricated, Explanation.NOT_VISIBLE),
        (accused & (suspicions == REMOVED), Explanation.MISSING),
        (accused, Explanation.TOO_FAST),
        (tracks.detection >= 0, Explanation.SEEN),
        (look.unknown > 0.5, Explanation.OUT_OF_VIEW),
        (tracks.visible < 0.5, Explanation.HIDDEN),
        (tracks.detectable < 0.5, Explanation.TOO_FEW_RETURNS),
    )
    return np.select([case for case, _ in cases], [int(why) for _, why in cases], int(Explanation.MISSED)).astype(
        np.uint8
    )


_NO_POSES = "no poses: sudden moves and births are not judged, and tracks that the tracker gave up are not carried over"

_MOST_WEALTH = 1e6
"""Largest e-value of a suspicion, so that a track can be acquitted again."""

_SAME_M = 1.2
"""A detected track within this distance of a given-up one is the same object."""

_KNOWN_HITS = 10
"""Only tracks with at least this number of detections can be missed."""

_BARE_S = 0.5
"""A given-up track without a surface for this time is gone."""


class _Look(NamedTuple):
    """What all views say of boxes, (K,) each; without cells nothing is free or hidden, and the surface is NaN."""

    ratio: F64  # of fabricated : honest, the mean over the views that say something
    surface: F64  # shares of the boxes, of the first view
    free: F64
    hidden: F64
    unknown: F64


def _look(boxes: F64, kinds: NDArray[np.uint8], views: Sequence[SensorView], model: EvidenceModel) -> _Look:
    """Ask all views of boxes (K, 7); however they depend on each other, the mean of their ratios is an e-value."""
    count = len(boxes)
    total, speaking = np.zeros(count), np.zeros(count)
    nothing = np.zeros(count)
    shares = np.full(count, np.nan), nothing, nothing, nothing
    for number, each in enumerate(views):
        if each.cells is None:
            ratio, speaks = ratios_of(model.view, view_bins(each.view.visible(boxes))), np.ones(count, np.bool_)
        else:
            seen, bins = cell_evidence(boxes, kinds, each)
            ratio, speaks = cell_ratios(np.array(model.weights), bins), bins[:, 0] != BLIND
            if number == 0:
                shares = seen.surface, seen.free, seen.hidden, 1.0 - seen.surface - seen.free - seen.hidden
        total += np.where(speaks, ratio, 0.0)
        speaking += speaks
    return _Look(np.where(speaking > 0, total / np.maximum(speaking, 1), 1.0), *shares)


def cell_evidence(boxes: F64, kinds: NDArray[np.uint8], view: SensorView) -> tuple[BoxCells, NDArray[np.int32]]:
    """Return what the cells of boxes (K, 7) are, and their bins (K, F) in the weights of a model.

    Raises:
        ValueError: the view has no cells.
    """
    if view.cells is None:
        raise ValueError(f"{view.sensor} must have cells, got none")
    cells = view.cells.look(boxes, view.place)
    return cells, cell_bins(cells, view.view.visible(boxes) * view.view.detectable(boxes, kinds))


def _predicted(rows: Tracks, t_s: float, dt_s: float, view: SensorView) -> Tracks:
    """Return tracks that the tracker has given up one sweep later, where they should be.

    One that moves is drawn to the nearest surface: it may brake or turn. One that stands stays.
    """
    states, boxes = rows.states.copy(), rows.boxes.copy()
    states[np.hypot(*states[:, 2:].T) < _CREEP_MPS, 2:] = 0.0
    states[:, :2] += dt_s * states[:, 2:]
    boxes[:, :2] = states[:, :2]
    moving = np.flatnonzero(states[:, 2:].any(axis=1))
    if view.cells is not None and len(moving):
        shift = _PULL * view.cells.shifts(boxes[moving])
        states[moving, :2] += shift
        boxes[moving, :2] += shift
    return replace(
        rows, t_s=t_s, states=states, boxes=boxes, detection=np.full(len(rows), -1, np.int32),
        visible=view.view.visible(boxes), detectable=view.view.detectable(boxes, rows.kinds),
    )  # fmt: skip


_CREEP_MPS = 1.0
"""A given-up track that was slower than this is taken to stand."""

_PULL = 0.3
"""Part of the way to the nearest surface that a given-up track goes each sweep."""


def _sentence(tracks: Tracks, k: int, why: Explanation, look: _Look, e_value: float, offset: F64) -> str:
    """Return in a sentence why a track is detected or not."""
    unseen_s, p_found = tracks.t_s - tracks.seen_s[k], tracks.visible[k] * tracks.detectable[k]
    against = f"e-value {e_value:.3g}"
    match why:
        case Explanation.SEEN:
            return "detected in this sweep"
        case Explanation.MISSED:
            return f"not detected for {unseen_s:.1f} s, though found with probability {p_found:.2f}"
        case Explanation.HIDDEN:
            return f"hidden: visible with probability {tracks.visible[k]:.2f}"
        case Explanation.OUT_OF_VIEW:
            return "no beams go there, or it left the grid"
        case Explanation.TOO_FEW_RETURNS:
            return f"in view, but found with probability {tracks.detectable[k]:.2f} only"
        case Explanation.ABSTAINED:
            return "the field of view is under alarm there"
        case Explanation.MISSING:
            return f"missing for {unseen_s:.1f} s though found with probability {p_found:.2f}, {against}"
        case Explanation.NEW_IN_FREE:
            return f"began where beams had passed just before, {against}"
        case Explanation.SEEN_THROUGH:
            return f"beams pass through {look.free[k]:.0%} of its box, {against}"
        case Explanation.NOT_VISIBLE:
            return f"detected where {look.hidden[k]:.0%} of its box is hidden, {against}"
        case Explanation.TOO_FAST:
            return f"jumped by {np.hypot(*offset):.1f} m faster than it can move, {against}"


@lru_cache(maxsize=1)
def shipped_model() -> EvidenceModel:
    """Return the shipped model: of benign drives with the package's detector (``tools/fit_fusion.py``)."""
    with resources.as_file(resources.files("viewshed.objects").joinpath("single.json")) as path:
        return EvidenceModel.load(path)
