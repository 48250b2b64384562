"""Single-agent, security-aware fusion: each track explained by what its own sensors could have seen, or suspected.

A track that is not detected may be hidden, out of view, or too far for enough returns; or it is *missing though
visible*. One that is detected may be where beams pass (*seen through*) or where nothing can be seen, may have begun in
the middle of cells that were seen free, or may have jumped as nothing moves. Nothing is detected again in the points:
fusion asks the field of view and the past.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.fusion.cells import BoxCells
from viewshed.fusion.evidence import (
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
from viewshed.fusion.explained import (
    FABRICATED,
    MOVED,
    REMOVED,
    TRACK_ROWS,
    ExplainedTracks,
    Explanation,
    join_tracks,
    take_tracks,
)
from viewshed.fusion.jumps import EARLIER, LATEST, jump_of
from viewshed.fusion.sensor_view import SensorView, check_views
from viewshed.objects import Detections
from viewshed.tracking.tracks import Tracks

Floats = NDArray[np.float64]

Mask = NDArray[np.bool_]

MEMORY_S = 10.0
"""How long a track is remembered that the tracker has given up."""


@dataclass(slots=True, eq=False)
class _Remembered:
    """What fusion keeps of a track.

    Attributes:
        wealth: (3,) against it.
        birth: ratio of its birth.
        log_mean: log of the mean ratio of what its boxes held.
        looked_s: for how long they were looked at.
        last, number: the tracks in which it was last, and its place among them.
        times, places: of its last detections.
        offset: (2,) by which it jumped, if it is believed to be moved.
        bare_s: for how long no surface has been where it should be.
        hits, looks, looks_at_hit: sweeps with a detection; with a view of it; with a view until the last detection.
    """

    wealth: Floats
    birth: float
    last: Tracks
    number: int = 0
    log_mean: float = 0.0
    looked_s: float = 0.0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=LATEST + EARLIER))
    places: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=LATEST + EARLIER))
    offset: Floats = field(default_factory=lambda: np.zeros(2))
    bare_s: float = 0.0
    hits: int = 0
    looks: int = 0
    looks_at_hit: int = 0

    @property
    def usually_found(self) -> float:
        """How often it was detected while it was: short tracks are often false detections that go again."""
        return (self.hits + 1.0) / (self.looks_at_hit + 3.0)


class SingleFusion:
    """Explains the tracks of one agent, sweep after sweep, by the fields of view of its sensors.

    Attributes:
        model: what evidence is worth.
    """

    def __init__(self, model: EvidenceModel | None = None) -> None:
        """Begin without a past; without a model take the shipped one."""
        self.model = shipped_model() if model is None else model
        self._remembered: dict[int, _Remembered] = {}
        self._last_s: float | None = None

    def reset(self) -> None:
        """Forget all tracks."""
        self._remembered.clear()
        self._last_s = None

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
        if self._last_s is not None and tracks.t_s < self._last_s:
            self.reset()
        dt_s = 0.1 if self._last_s is None else max(tracks.t_s - self._last_s, 0.0)
        self._last_s = tracks.t_s
        model = self.model
        self._remember(tracks, detections)
        held = self._held(tracks, views[0], dt_s)
        both = join_tracks(tracks, held) if len(held) else tracks
        count, is_matched = len(both), both.detection >= 0

        # What is looked at: the detection where there is one, else where the track should be.
        boxes = both.boxes.copy()
        boxes[is_matched] = detections.boxes[both.detection[is_matched]]
        look = _look(boxes, both.kinds, views, model)
        alarmed = np.any([view.alarmed(boxes) for view in views], axis=0)
        found = np.clip(both.visible * both.detectable, 0.0, 1.0 - model.still_found)
        usual = np.array([self._remembered[i].usually_found for i in both.ids.tolist()])
        found = np.where(is_matched, found, np.minimum(found, usual))

        ratios = np.ones((count, 3))
        ratios[is_matched, FABRICATED] = look.ratio[is_matched]
        # Removed: nothing is detected where the object still stands. Else it was missed, or it is gone.
        still = self._still_there(both, look, is_matched, views)
        missed = 1.0 / ((1.0 - model.gone) * (1.0 - found) + model.gone * still)
        ratios[:, REMOVED] = np.where(is_matched, model.still_found / np.maximum(found, model.still_found), missed)
        for k in np.flatnonzero(is_matched):
            memory = self._remembered[int(both.ids[k])]
            deviation, vector = jump_of(memory.times, memory.places)
            ratio = float(ratios_of(model.jump, jump_bins(np.array([deviation])))[0])
            ratios[k, MOVED] = 1.0 - model.jump_share + model.jump_share * ratio
            if ratio > 1.0 and np.hypot(*vector) > np.hypot(*memory.offset):
                memory.offset = vector
        ratios = np.clip(ratios, 1.0 / CAP, CAP)
        # What was seen for a moment only is often a false detection: nobody need have removed it.
        hits = np.array([self._remembered[i].hits for i in both.ids.tolist()])
        ratios[~is_matched & ((hits < _KNOWN_HITS) | ~both.confirmed), REMOVED] = 1.0

        for k in np.flatnonzero(~alarmed):
            memory = self._remembered[int(both.ids[k])]
            if is_matched[k]:
                memory.looked_s += dt_s
                age_s = np.array(memory.looked_s)
                memory.log_mean = float(
                    mean_after(np.array(memory.log_mean), ratios[k, FABRICATED], dt_s, age_s, model.window_s)
                )
                memory.wealth[FABRICATED] = memory.birth * np.exp(memory.log_mean)
            for suspicion, block_s in zip((REMOVED, MOVED), model.block_s, strict=True):
                after = wealth_after(memory.wealth[suspicion], ratios[k, suspicion], dt_s, block_s)
                memory.wealth[suspicion] = min(float(after), _MOST_WEALTH)
            is_bare = look.surface[k] == 0 and not is_matched[k]
            memory.bare_s = memory.bare_s + dt_s if is_bare else 0.0
        wealth = np.array([self._remembered[int(i)].wealth for i in both.ids]).reshape(-1, 3)
        e_values = wealth.mean(axis=1)
        over = wealth / np.array(model.limits)
        accused = (over >= 1.0).any(axis=1) & ~alarmed
        suspicions = over.argmax(axis=1).astype(np.uint8)
        moved = accused & (suspicions == MOVED)
        offsets = np.array([self._remembered[int(i)].offset for i in both.ids]).reshape(-1, 2)
        explanations = self._explanations(both, look, suspicions, accused, alarmed)
        reasons = tuple(
            _sentence(both, k, Explanation(explanations[k]), look, float(e_values[k]), offsets[k]) for k in range(count)
        )
        is_held = np.arange(count) >= len(tracks)
        return ExplainedTracks(
            both, explanations, e_values, wealth, suspicions, accused, np.where(moved[:, None], offsets, 0.0), is_held,
            reasons,
        )  # fmt: skip

    def _still_there(self, tracks: Tracks, look: _Look, is_matched: Mask, views: Sequence[SensorView]) -> Floats:
        """Return gone : still there (N,) by the cells at the track, or at the nearest surface if these fit better."""
        ratio = look.ratio.copy()
        lost, cells = np.flatnonzero(~is_matched), views[0].cells
        if cells is not None and len(lost):
            boxes = tracks.boxes[lost].copy()
            boxes[:, :2] += cells.shifts(boxes)
            ratio[lost] = np.minimum(ratio[lost], _look(boxes, tracks.kinds[lost], views, self.model).ratio)
        return ratio

    def _remember(self, tracks: Tracks, detections: Detections) -> None:
        """Take note of the tracker's tracks; forget what is too long ago."""
        for k, number in enumerate(tracks.ids.tolist()):
            memory = self._remembered.get(number)
            if memory is None:
                born = np.array([tracks.born_hidden[k]])
                birth = float(ratios_of(self.model.birth, birth_bins(born))[0])
                memory = self._remembered[number] = _Remembered(np.array([birth, 0.0, 0.0]), birth, tracks)
            memory.last, memory.number = tracks, k
            memory.looks += tracks.visible[k] >= 0.5
            if tracks.detection[k] >= 0:
                memory.hits += 1
                memory.looks_at_hit = max(memory.looks, memory.hits)
                x_m, y_m = detections.boxes[tracks.detection[k], :2]
                memory.times.append(tracks.t_s)
                memory.places.append((float(x_m), float(y_m)))

    def _held(self, tracks: Tracks, view: SensorView, dt_s: float) -> Tracks:
        """Return the tracks that the tracker has given up, where they should be now; forget those that are gone."""
        known, is_matched = set(tracks.ids.tolist()), tracks.detection >= 0
        suspected = np.array([self._remembered[i].wealth[FABRICATED] for i in tracks.ids[is_matched].tolist()])
        honest = tracks.boxes[is_matched][suspected < self.model.limits[FABRICATED]]
        rows = []
        for number, memory in list(self._remembered.items()):
            if number in known:
                continue
            row = take_tracks(memory.last, np.array([memory.number]))
            found_again = np.hypot(*(honest[:, :2] - row.boxes[0, :2]).T).min(initial=np.inf) < _SAME_M
            is_old = tracks.t_s - row.seen_s[0] > MEMORY_S or memory.bare_s > _BARE_S
            if found_again or is_old or not row.confirmed[0]:
                del self._remembered[number]
                continue
            memory.last, memory.number = _predicted(row, tracks.t_s, dt_s, view), 0
            rows.append(memory.last)
        if not rows:
            return take_tracks(tracks, np.zeros(len(tracks), np.bool_))
        arrays: dict[str, Any] = {name: np.concatenate([getattr(row, name) for row in rows]) for name in TRACK_ROWS}
        return replace(tracks, **arrays)

    def _explanations(
        self, tracks: Tracks, look: _Look, suspicions: NDArray[np.uint8], accused: Mask, alarmed: Mask
    ) -> NDArray[np.uint8]:
        """Return why each track (N,) is detected or not."""
        found = np.zeros(len(tracks), np.uint8)
        for k in range(len(tracks)):
            if alarmed[k]:
                found[k] = Explanation.ABSTAINED
            elif accused[k] and suspicions[k] == FABRICATED:
                birth, now = self._remembered[int(tracks.ids[k])].birth, look.ratio[k]
                if birth > max(now, 1.0):
                    found[k] = Explanation.NEW_IN_FREE
                else:
                    is_open = look.free[k] >= look.hidden[k]
                    found[k] = Explanation.SEEN_THROUGH if is_open else Explanation.NOT_VISIBLE
            elif accused[k]:
                found[k] = Explanation.MISSING if suspicions[k] == REMOVED else Explanation.TOO_FAST
            elif tracks.detection[k] >= 0:
                found[k] = Explanation.SEEN
            elif look.unknown[k] > 0.5:
                found[k] = Explanation.OUT_OF_VIEW
            elif tracks.visible[k] < 0.5:
                found[k] = Explanation.HIDDEN
            else:
                few = tracks.detectable[k] < 0.5
                found[k] = Explanation.TOO_FEW_RETURNS if few else Explanation.MISSED
        return found


_MOST_WEALTH = 1e6
"""Wealth is held below this, so that a track can be acquitted again."""

_SAME_M = 1.2
"""A detected track so near a given-up one is the same object."""

_KNOWN_HITS = 10
"""Only tracks with so many detections can be missed."""

_BARE_S = 0.5
"""A given-up track without a surface for so long is gone."""


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What all views say of boxes, (K,) each.

    Attributes:
        ratio: of fabricated : honest, the mean over the views that say something.
        surface, free, hidden, unknown: shares of the boxes, of the first view; unknown is 0 without cells.
    """

    ratio: Floats
    surface: Floats
    free: Floats
    hidden: Floats
    unknown: Floats


def _look(boxes: Floats, kinds: NDArray[np.uint8], views: Sequence[SensorView], model: EvidenceModel) -> _Look:
    """Ask all views of boxes (K, 7); however they depend on each other, the mean of their ratios is an e-value."""
    count = len(boxes)
    total, speaking = np.zeros(count), np.zeros(count)
    shares = [np.full(count, np.nan), np.zeros(count), np.zeros(count)]
    unknown = np.zeros(count)
    for number, each in enumerate(views):
        if each.cells is None:
            ratio, speaks = ratios_of(model.view, view_bins(each.view.visible(boxes))), np.ones(count, np.bool_)
        else:
            seen, bins = cell_evidence(boxes, kinds, each)
            ratio, speaks = cell_ratios(np.array(model.weights), bins), bins[:, 0] != BLIND
            if number == 0:
                shares, unknown = [seen.surface, seen.free, seen.hidden], 1.0 - seen.surface - seen.free - seen.hidden
        total += np.where(speaks, ratio, 0.0)
        speaking += speaks
    ratio = np.where(speaking > 0, total / np.maximum(speaking, 1), 1.0)
    surface, free, hidden = shares
    return _Look(ratio, surface, free, hidden, unknown)


def cell_evidence(boxes: Floats, kinds: NDArray[np.uint8], view: SensorView) -> tuple[BoxCells, NDArray[np.int64]]:
    """Return what the cells of boxes (K, 7) are, and their bins (K, F) in the weights of a model.

    Raises:
        ValueError: the view has no cells.
    """
    if view.cells is None:
        raise ValueError(f"{view.sensor} must have cells, got none")
    cells = view.cells.look(boxes, view.place)
    return cells, cell_bins(cells, view.view.visible(boxes) * view.view.detectable(boxes, kinds))


def _predicted(row: Tracks, t_s: float, dt_s: float, view: SensorView) -> Tracks:
    """Return a track that the tracker has given up one sweep later, where it should be.

    One that moves is drawn to the nearest surface: it may brake or turn. One that stands stays.
    """
    states, boxes = row.states.copy(), row.boxes.copy()
    if np.hypot(*states[0, 2:]) < _CREEP_MPS:
        states[:, 2:] = 0.0
    states[:, :2] += dt_s * states[:, 2:]
    boxes[:, :2] = states[:, :2]
    if view.cells is not None and states[0, 2:].any():
        shift = _PULL * view.cells.shifts(boxes)
        states[:, :2] += shift
        boxes[:, :2] += shift
    return replace(
        row, t_s=t_s, states=states, boxes=boxes, detection=np.array([-1], np.int32),
        visible=view.view.visible(boxes), detectable=view.view.detectable(boxes, row.kinds),
    )  # fmt: skip


_CREEP_MPS = 1.0
"""A given-up track that was slower than this is taken to stand."""

_PULL = 0.3
"""Part of the way to the nearest surface that a given-up track goes each sweep."""


def _sentence(tracks: Tracks, k: int, why: Explanation, look: _Look, e_value: float, offset: Floats) -> str:
    """Return in a sentence why a track is detected or not."""
    unseen_s = tracks.t_s - tracks.seen_s[k]
    p_found = tracks.visible[k] * tracks.detectable[k]
    against = f"e-value {e_value:.3g}"
    return {
        Explanation.SEEN: "detected in this sweep",
        Explanation.MISSED: f"not detected for {unseen_s:.1f} s, though found with probability {p_found:.2f}",
        Explanation.HIDDEN: f"hidden: visible with probability {tracks.visible[k]:.2f}",
        Explanation.OUT_OF_VIEW: "no beams go there, or it left the grid",
        Explanation.TOO_FEW_RETURNS: f"in view, but found with probability {tracks.detectable[k]:.2f} only",
        Explanation.ABSTAINED: "the field of view is under alarm there",
        Explanation.MISSING: f"missing for {unseen_s:.1f} s though found with probability {p_found:.2f}, {against}",
        Explanation.NEW_IN_FREE: f"began where everything near was seen free, {against}",
        Explanation.SEEN_THROUGH: f"beams pass through {look.free[k]:.0%} of its box, {against}",
        Explanation.NOT_VISIBLE: f"detected where {look.hidden[k]:.0%} of its box is hidden, {against}",
        Explanation.TOO_FAST: f"jumped by {np.hypot(*offset):.1f} m faster than it can move, {against}",
    }[why]


@lru_cache(maxsize=1)
def shipped_model() -> EvidenceModel:
    """Return the model in the box, calibrated on simulated drives (docs/fusion.md)."""
    with resources.as_file(resources.files("viewshed.fusion").joinpath("single.json")) as path:
        return EvidenceModel.load(path)
