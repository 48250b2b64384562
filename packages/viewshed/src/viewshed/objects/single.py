"""Single-agent, security-aware fusion: explain each track by the sensors' fields of view, or suspect it.

A track that is not detected may be hidden, out of view, or too far for enough returns; otherwise it is *missing though
visible*. A detected track is suspect if beams pass through its box (*seen through*), if nothing can be seen there, if
it began in cells that were seen free, or if it jumped faster than physics allows. Fusion uses the field of view and the
past; it does not search the points again.
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
"""How long a track that the tracker has given up is remembered."""


class SingleFusion:
    """Explains the tracks of one agent, sweep by sweep, by the fields of view of its sensors.

    Attributes:
        model: evidence model.
    """

    def __init__(self, model: EvidenceModel | None = None) -> None:
        """Start without a past; None takes the shipped model."""
        self.model = shipped_model() if model is None else model
        self.reset()

    def reset(self) -> None:
        """Forget all tracks."""
        self._last: Tracks | None = None
        self._memory = Memory.begun(0)
        self._before = SeenBefore()

    def explain(self, tracks: Tracks, detections: Detections, views: Sequence[SensorView]) -> ExplainedTracks:
        """Return the tracks of a sweep with their explanations.

        Args:
            tracks: after the sweep.
            detections: input of the tracks, in the same frame.
            views: of the sensor of that sweep first, then of the agent's other sensors.

        Raises:
            ValueError: there is no view or one of another time, two have the same name, or there are too many tracks.
        """
        check_views(tracks, views)
        if self._last is not None and (tracks.t_s < self._last.t_s or tracks.in_world != self._last.in_world):
            self.reset()
        dt_s = 0.1 if self._last is None else max(tracks.t_s - self._last.t_s, 0.0)
        model = self.model

        # Append the remembered tracks that the tracker has given up.
        all_tracks, memory = self._remembered(tracks, detections, views[0], dt_s)
        count, is_matched = len(all_tracks), all_tracks.detection >= 0

        # Look at the matched detection, or else at the predicted box.
        boxes = all_tracks.boxes.copy()
        boxes[is_matched] = detections.boxes[all_tracks.detection[is_matched]]
        look = _look(boxes, all_tracks.kinds, views, model)
        alarmed = np.any([view.alarmed(boxes) for view in views], axis=0)
        prob_found = np.clip(all_tracks.visible * all_tracks.detectable, 0.0, 1.0 - model.still_found)
        prob_found = np.where(is_matched, prob_found, np.minimum(prob_found, memory.usually_found))

        ratios = np.ones((count, 3))
        ratios[is_matched, FABRICATED] = look.ratio[is_matched]
        # Removed: the object is still there, undetected. Alternative: the detector missed it, or it has gone.
        gone_ratio = self._still_there(all_tracks, look, is_matched, views)
        missed = 1.0 / ((1.0 - model.gone) * (1.0 - prob_found) + model.gone * gone_ratio)
        ratios[:, REMOVED] = np.where(is_matched, model.still_found / np.maximum(prob_found, model.still_found), missed)
        deviations, vectors = memory.sightings.jumps()
        # Without poses, motion of the own vehicle would look like jumps of the tracks.
        can_jump = is_matched & all_tracks.in_world
        jumped = np.where(can_jump, ratios_of(model.jump, jump_bins(deviations)), 1.0)
        ratios[is_matched, MOVED] = 1.0 - model.jump_share + model.jump_share * jumped[is_matched]
        is_larger = (jumped > 1.0) & (np.hypot(*vectors.T) > np.hypot(*memory.offset.T))
        memory.offset[is_larger] = vectors[is_larger]
        ratios = np.clip(ratios, 1.0 / CAP, CAP)
        # A briefly seen track often is a false detection that ends by itself.
        ratios[~is_matched & ((memory.hits < _KNOWN_HITS) | ~all_tracks.confirmed), REMOVED] = 1.0

        # Accumulate evidence over time, of tracks without an alarm.
        detected, judged = np.flatnonzero(is_matched & ~alarmed), np.flatnonzero(~alarmed)
        memory.looked_s[detected] += dt_s
        memory.log_mean[detected] = mean_after(
            memory.log_mean[detected], ratios[detected, FABRICATED], dt_s, memory.looked_s[detected], model.window_s
        )
        # Cells reveal forged detections, the origin of the surface reveals ghosts made in the sweep: half each.
        followed = is_matched & ~alarmed & np.isin(memory.hits, FOLLOWED_AFTER)
        surface = np.zeros(count)
        surface[followed] = surface_shares(views[0].cells, all_tracks.boxes[followed])
        birth = birth_bins(self._before.free_shares(all_tracks, surface, followed))
        memory.birth = np.where(birth == BLIND, memory.birth, ratios_of(model.birth, birth))
        memory.wealth[detected, FABRICATED] = 0.5 * (np.exp(memory.log_mean[detected]) + memory.birth[detected])
        for suspicion, block_s in zip((REMOVED, MOVED), model.block_s, strict=True):
            after = wealth_after(memory.wealth[judged, suspicion], ratios[judged, suspicion], dt_s, block_s)
            memory.wealth[judged, suspicion] = np.minimum(after, _MAX_WEALTH)
        is_bare = (look.surface == 0) & ~is_matched
        memory.bare_s = np.where(alarmed, memory.bare_s, np.where(is_bare, memory.bare_s + dt_s, 0.0))

        # Verdicts.
        e_values = memory.wealth.mean(axis=1)
        over = memory.wealth / np.array(model.limits)
        accused = (over >= 1.0).any(axis=1) & ~alarmed
        suspicions = over.argmax(axis=1).astype(np.uint8)
        moved = accused & (suspicions == MOVED)
        explanations = _explanations(all_tracks, memory.birth, look, suspicions, accused, alarmed)
        reasons = tuple(
            _sentence(all_tracks, k, Explanation(why), look, float(e_values[k]), memory.offset[k])
            for k, why in enumerate(explanations.tolist())
        )
        self._last, self._memory = all_tracks, memory
        self._before.add(tracks.t_s, views[0].cells)
        return ExplainedTracks(
            all_tracks, explanations, e_values, memory.wealth.copy(), suspicions, accused,
            np.where(moved[:, None], memory.offset, 0.0), np.arange(count) >= len(tracks), reasons,
            () if all_tracks.in_world else (_NO_POSES,),
        )  # fmt: skip

    def _remembered(
        self, tracks: Tracks, detections: Detections, view: SensorView, dt_s: float
    ) -> tuple[Tracks, Memory]:
        """Return the tracks followed by remembered ones that the tracker has given up, with the memory of each."""
        last = tracks.take(np.zeros(0, np.intp)) if self._last is None else self._last
        memory = aligned(self._memory, last.ids, tracks.ids)
        is_matched = tracks.detection >= 0
        places = detections.boxes[tracks.detection[is_matched], :2]
        memory.note(np.arange(len(tracks)), tracks.visible, is_matched, tracks.t_s, places)
        given_up = rows_of(last.ids, tracks.ids) < 0
        given_up &= (
            tracks.in_world & last.confirmed & (tracks.t_s - last.seen_s <= MEMORY_S) & (self._memory.bare_s <= _BARE_S)
        )
        # Forget a given-up track that is detected again under another id.
        honest = tracks.boxes[is_matched & (memory.wealth[:, FABRICATED] < self.model.limits[FABRICATED])]
        distance_m = np.hypot(*(last.boxes[:, None, :2] - honest[None, :, :2]).transpose(2, 0, 1))
        given_up &= (distance_m >= _SAME_M).all(axis=1)
        if not given_up.any():
            return tracks, memory
        carried_over = _predicted(last.take(given_up), tracks.t_s, dt_s, view)
        return tracks.joined(carried_over), memory.joined(self._memory.take(given_up))

    def _still_there(self, tracks: Tracks, look: _Look, is_matched: Mask, views: Sequence[SensorView]) -> F64:
        """Return the ratio gone : still there (N,) by the cells at the track, or at the nearest surface if better."""
        ratio = look.ratio.copy()
        missed, cells = np.flatnonzero(~is_matched), views[0].cells
        if cells is not None and len(missed):
            boxes = tracks.boxes[missed].copy()
            boxes[:, :2] += cells.shifts(boxes)
            ratio[missed] = np.minimum(ratio[missed], _look(boxes, tracks.kinds[missed], views, self.model).ratio)
        return ratio


def _explanations(
    tracks: Tracks, birth: F64, look: _Look, suspicions: NDArray[np.uint8], accused: Mask, alarmed: Mask
) -> NDArray[np.uint8]:
    """Return the explanation of each track (N,)."""
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

_MAX_WEALTH = 1e6
"""Maximum e-value of a suspicion, so that a track can be acquitted again."""

_SAME_M = 1.2
"""A detected track within this distance of a given-up one is the same object."""

_KNOWN_HITS = 10
"""Minimum number of detections of a track that can be missing."""

_BARE_S = 0.5
"""A given-up track without a surface for this time is gone."""


class _Look(NamedTuple):
    """Result of all views for boxes, (K,) each; without cells nothing is free or hidden, and the surface is NaN."""

    ratio: F64  # fabricated : honest, the mean over the views that know the place
    surface: F64  # shares of the boxes, by the first view
    free: F64
    hidden: F64
    unknown: F64


def _look(boxes: F64, kinds: NDArray[np.uint8], views: Sequence[SensorView], model: EvidenceModel) -> _Look:
    """Query all views at boxes (K, 7); the mean of their ratios is an e-value however they depend on each other."""
    count = len(boxes)
    total, speaking_views = np.zeros(count), np.zeros(count)
    nothing = np.zeros(count)
    shares = np.full(count, np.nan), nothing, nothing, nothing
    for number, view in enumerate(views):
        if view.cells is None:
            ratio, speaks = ratios_of(model.view, view_bins(view.view.visible(boxes))), np.ones(count, np.bool_)
        else:
            cells, bins = cell_evidence(boxes, kinds, view)
            ratio, speaks = cell_ratios(np.array(model.weights), bins), bins[:, 0] != BLIND
            if number == 0:
                shares = cells.surface, cells.free, cells.hidden, 1.0 - cells.surface - cells.free - cells.hidden
        total += np.where(speaks, ratio, 0.0)
        speaking_views += speaks
    return _Look(np.where(speaking_views > 0, total / np.maximum(speaking_views, 1), 1.0), *shares)


def cell_evidence(boxes: F64, kinds: NDArray[np.uint8], view: SensorView) -> tuple[BoxCells, NDArray[np.int32]]:
    """Return the cells of boxes (K, 7), and their bins (K, F) in the weights of a model.

    Raises:
        ValueError: the view has no cells.
    """
    if view.cells is None:
        raise ValueError(f"{view.sensor} must have cells, got none")
    cells = view.cells.look(boxes, view.place)
    return cells, cell_bins(cells, view.view.visible(boxes) * view.view.detectable(boxes, kinds))


def _predicted(rows: Tracks, t_s: float, dt_s: float, view: SensorView) -> Tracks:
    """Return given-up tracks one sweep later, at their predicted positions.

    A moving track is pulled toward the nearest surface, because it may brake or turn; a standing one stays.
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
"""A given-up track slower than this is taken as standing."""

_PULL = 0.3
"""Fraction of the way to the nearest surface that a given-up track moves per sweep."""


def _sentence(tracks: Tracks, k: int, why: Explanation, look: _Look, e_value: float, offset: F64) -> str:
    """Return a sentence on why a track is detected or not."""
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
    """Return the shipped model, fitted on benign drives with the shipped detector (``tools/fit_fusion.py``)."""
    with resources.as_file(resources.files("viewshed.objects").joinpath("single.json")) as path:
        return EvidenceModel.load(path)
