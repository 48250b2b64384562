"""Single-agent, security-aware fusion: each track explained by what its own sensors could have seen, or suspected.

A track that is not detected may be hidden, out of view, or too far for enough returns; or it is *missing though visible*. One that is detected
may be where the field of view says that beams pass (*seen through*), where nothing could be seen at all, may have begun in the
middle of cells that were seen free, or may have moved as nothing moves. None of this detects again in the points: it asks the field of view and the past.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from importlib import resources
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from viewshed.fusion.cells import BoxCells, SeenCells
from viewshed.fusion.evidence import (
    BLIND,
    CAP,
    EvidenceCounts,
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
from viewshed.integrity.calibration import alarms_allowed
from viewshed.integrity.evidence.base import sector_of
from viewshed.integrity.report import IntegrityReport
from viewshed.objects import Detections
from viewshed.tracking.tracks import Tracks
from viewshed.tracking.views import View

Floats = NDArray[np.float64]

Mask = NDArray[np.bool_]

SAME_TIME_S = 0.15
"""A view of another time than the tracks by more than this says nothing of them."""

MOST_TRACKS = 2000
"""More tracks in one message are refused: the work is bounded."""

MEMORY_S = 10.0
"""How long a track is remembered that the tracker has given up."""


class Explanation(IntEnum):
    """Why a track is detected or not; from ``MISSING`` on it is suspicious."""

    SEEN = 0
    """Detected, as it should be."""
    MISSED = 1
    """Not detected though it could be; so far as rarely as detectors miss."""
    HIDDEN = 2
    """Not detected: something nearer blocks the view of it."""
    OUT_OF_VIEW = 3
    """Not detected: no beams go there."""
    TOO_FEW_RETURNS = 4
    """Not detected: in view, but the detector rarely finds so few returns."""
    ABSTAINED = 5
    """The field of view itself is under alarm there: nothing is said."""
    MISSING = 6
    """Not detected though it is visible, again and again: its detections are removed."""
    NEW_IN_FREE = 7
    """It began in cells that were seen free a moment before: fabricated."""
    SEEN_THROUGH = 8
    """Beams pass through its box: fabricated."""
    NOT_VISIBLE = 9
    """Detected where nothing can be seen: fabricated."""
    TOO_FAST = 10
    """It jumped faster than physics: moved."""


FABRICATED, REMOVED, MOVED = range(3)
"""What a track may be suspected of: columns of wealth."""

_OF_FABRICATED = (Explanation.NEW_IN_FREE, Explanation.SEEN_THROUGH, Explanation.NOT_VISIBLE)


@dataclass(frozen=True, slots=True, eq=False)
class SensorView:
    """What one sensor's field of view says at the time of one sweep.

    Attributes:
        sensor: its name.
        view: what could be seen.
        place: (2,) x and y of the sensor in the tracks' frame.
        cells: states of the cells, or None where the field of view has none (a polygon, or no field of view).
        report: of the monitor of this sweep, or None.
        yaw: heading of the sensor's ``level`` frame in the tracks' frame, radians.
    """

    sensor: str
    view: View
    place: Floats
    cells: SeenCells | None = None
    report: IntegrityReport | None = None
    yaw: float = 0.0

    def alarmed(self, boxes: Floats) -> Mask:
        """Return which boxes (K,) lie in sectors under alarm; all of them where an alarm names no sector."""
        report = self.report
        if report is None or not report.inconsistent:
            return np.zeros(len(boxes), np.bool_)
        if not report.suspect.any():
            return np.ones(len(boxes), np.bool_)
        away = boxes[:, :2] - self.place
        azimuth = np.arctan2(away[:, 1], away[:, 0]) - self.yaw
        return np.asarray(report.suspect[sector_of((azimuth + np.pi) % (2 * np.pi) - np.pi)])


@dataclass(frozen=True, slots=True, eq=False)
class ExplainedTracks:
    """Tracks with what speaks for and against each.

    Attributes:
        tracks: those of the tracker, then those that it gave up and that are still remembered.
        explanations: (N,) uint8 of :class:`Explanation`.
        e_values: (N,) how much speaks against *honest*, the mean of the three suspicions.
        wealth: (N, 3) the e-value of each suspicion: ``FABRICATED``, ``REMOVED``, ``MOVED``.
        suspicions: (N,) uint8, the one that is nearest to its limit or farthest above.
        accused: (N,) bool, one of them has reached its limit.
        moved_m: (N, 2) by which a moved track jumped; 0 for all others.
        held: (N,) bool, the tracker has given it up.
        reasons: (N,) a sentence each.
    """

    tracks: Tracks
    explanations: NDArray[np.uint8]
    e_values: Floats
    wealth: Floats
    suspicions: NDArray[np.uint8]
    accused: Mask
    moved_m: Floats
    held: Mask
    reasons: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.tracks)

    def trusted(self) -> Tracks:
        """Return the confirmed tracks after fusion.

        Fabricated ones are dropped. Removed ones stay, also where the tracker has given them up, with a covariance
        that has grown since they were last detected. Moved ones are put back where they came from.
        """
        tracks, kind = self.tracks, self.suspicions
        removed = self.accused & (kind == REMOVED)
        kept = tracks.confirmed & ~(self.accused & (kind == FABRICATED)) & (~self.held | removed)
        states, boxes, covariances = tracks.states.copy(), tracks.boxes.copy(), tracks.covariances.copy()
        states[:, :2] -= self.moved_m
        boxes[:, :2] -= self.moved_m
        unseen_s = np.where(removed, tracks.t_s - tracks.seen_s, 0.0)
        covariances[:, [0, 1], [0, 1]] += (_GROWTH_MPS * unseen_s[:, None]) ** 2
        odds = self.wealth[:, REMOVED]
        existence = np.where(removed, np.maximum(tracks.existence, odds / (1.0 + odds)), tracks.existence)
        whole = replace(tracks, states=states, boxes=boxes, covariances=covariances, existence=existence)
        return take_tracks(whole, kept)


_GROWTH_MPS = 0.3
"""How fast the place of a removed object becomes unsure."""

_ROWS = (
    "ids", "states", "covariances", "boxes", "box_variances", "kinds", "existence", "confirmed", "detection", "visible",
    "detectable", "born_s", "seen_s", "born_hidden",
)  # fmt: skip


def take_tracks(tracks: Tracks, chosen: Mask | NDArray[np.intp]) -> Tracks:
    """Return some tracks, by a mask (N,) or by their numbers."""
    return replace(tracks, **{name: getattr(tracks, name)[chosen] for name in _ROWS})


def join_tracks(tracks: Tracks, others: Tracks) -> Tracks:
    """Return tracks and others of the same time after them."""
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(tracks, name), getattr(others, name)]) for name in _ROWS
    }
    return replace(tracks, **arrays)


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
    times: deque[float] = field(default_factory=lambda: deque(maxlen=_LATEST + _EARLIER))
    places: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_LATEST + _EARLIER))
    offset: Floats = field(default_factory=lambda: np.zeros(2))
    bare_s: float = 0.0
    hits: int = 0
    looks: int = 0
    looks_at_hit: int = 0

    @property
    def usually_found(self) -> float:
        """How often it was detected while it was: short tracks are often false detections that go again."""
        return (self.hits + 1.0) / (self.looks_at_hit + 3.0)


_LATEST, _EARLIER, _LEAST_EARLIER = 3, 12, 5
"""Detections whose mean is compared with where the earlier ones lead."""

_LEAST_STD_M = 0.08
"""No detector places boxes better."""

_TURN_MPS2 = 2.0
"""Acceleration that moving objects have without being suspicious."""

_PARKED_MPS = 0.5
"""Objects slower than this are taken for standing."""


def jump_of(times: Sequence[float], places: Sequence[tuple[float, float]]) -> tuple[float, Floats]:
    """Return by how many standard deviations the latest places leave what the earlier ones lead to, and the vector (2,) in m.

    The earlier places give a straight line in time, or one place if the object stands. NaN where they are too few.
    """
    if len(times) < _LATEST + _LEAST_EARLIER or times[-1] - times[-_LATEST] > 1.0:
        return float("nan"), np.zeros(2)
    t_s, xy = np.array(times), np.array(places)
    now_s, before_s, before = t_s[-_LATEST:].mean(), t_s[:-_LATEST], xy[:-_LATEST]
    count, mean_s, mean = len(before), before_s.mean(), before.mean(axis=0)
    spread = ((before_s - mean_s) ** 2).sum()
    velocity = ((before_s - mean_s)[:, None] * (before - mean)).sum(axis=0) / max(spread, 1e-9)
    ahead_s = now_s - mean_s
    if np.hypot(*velocity) < _PARKED_MPS:
        rest, expected, lever, turned = before - mean, mean, 0.0, 0.0
    else:
        rest = before - mean - velocity * (before_s - mean_s)[:, None]
        expected, lever = mean + velocity * ahead_s, ahead_s**2 / max(spread, 1e-9)
        turned = 0.5 * _TURN_MPS2 * (now_s - before_s[-1]) * ahead_s
    variance = max(float((rest**2).sum() / max(2 * count - 4, 1)), _LEAST_STD_M**2)
    std = np.sqrt(variance * (1 / _LATEST + 1 / count + lever) + turned**2)
    vector = xy[-_LATEST:].mean(axis=0) - expected
    return float(np.hypot(*vector) / std), vector


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

    @classmethod
    def calibrated(
        cls, drives: Sequence[Sequence[Observed]], rng: np.random.Generator, accused: float = 0.03
    ) -> Self:
        """Return the fusion whose tables and limit are from benign drives.

        Tables are counted on every other drive, and the limit is taken from the others: of their confirmed tracks at most
        the share ``accused`` reaches it at any time.

        Args:
            drives: of each what was observed, in the order of time.
            rng: places tracks elsewhere, to count what fabricated ones are like.
            accused: share of honest tracks.

        Raises:
            ValueError: there are fewer than two drives, or too few tracks for the share.
        """
        return cls(calibrate(drives, rng, accused))

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
                memory.log_mean = float(mean_after(memory.log_mean, ratios[k, FABRICATED], dt_s, age_s, model.window_s))
                memory.wealth[FABRICATED] = memory.birth * np.exp(memory.log_mean)
            for suspicion, block_s in zip((REMOVED, MOVED), model.block_s, strict=True):
                after = wealth_after(memory.wealth[suspicion], ratios[k, suspicion], dt_s, block_s)
                memory.wealth[suspicion] = min(float(after), _MOST_WEALTH)
            memory.bare_s = memory.bare_s + dt_s if look.surface[k] == 0 else 0.0
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
            both, explanations, e_values, wealth, suspicions, accused, np.where(moved[:, None], offsets, 0.0), is_held, reasons,
        )  # fmt: skip

    def _still_there(
        self, tracks: Tracks, look: _Look, is_matched: Mask, views: Sequence[SensorView]
    ) -> Floats:
        """Return gone : still there (N,) by the cells: those at the track, or at the nearest surface if these fit better."""
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
        arrays: dict[str, Any] = {name: np.concatenate([getattr(row, name) for row in rows]) for name in _ROWS}
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


Observed = tuple[Tracks, Detections, Sequence[SensorView]]
"""What fusion is given of one sweep."""

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
    return _Look(ratio, *shares, unknown)


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


def check_views(tracks: Tracks, views: Sequence[SensorView]) -> None:
    """Raise a ValueError unless there are views of the tracks' time, each sensor once, and not too many tracks."""
    if len(tracks) > MOST_TRACKS:
        raise ValueError(f"tracks must be at most {MOST_TRACKS} in one message, got {len(tracks)}")
    names = [view.sensor for view in views]
    if not names or len(set(names)) != len(names):
        raise ValueError(f"views must be of one sensor at least, each once, got {names}; name each sensor differently")
    for view in views:
        if not abs(view.view.t_s - tracks.t_s) <= SAME_TIME_S:
            raise ValueError(
                f"views must be of the tracks' time {tracks.t_s:.3f} s, got {view.view.t_s:.3f} s of {view.sensor}"
            )


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


def calibrate(drives: Sequence[Sequence[Observed]], rng: np.random.Generator, accused: float = 0.03) -> EvidenceModel:
    """Return the model whose tables and limit are from benign drives, see :meth:`SingleFusion.calibrated`."""
    if len(drives) < 2:
        raise ValueError(f"drives must be two at least, some for the tables and some for the limit, got {len(drives)}")
    counts = EvidenceCounts()
    for drive in drives[::2]:
        count_drive(drive, counts, rng)
    tables = {name: counts.table(name) for name in ("view", "birth", "jump")}
    model = EvidenceModel(counts.weights(), **tables, limits=_NO_LIMITS, accused=accused)
    highest: list[Floats] = []
    for drive in drives[1::2]:
        highest += highest_e_values(drive, model).values()
    return replace(model, limits=limits_of(np.array(highest).reshape(-1, 3), accused), tracks=len(highest))


_NO_LIMITS = (np.inf, np.inf, np.inf)


def limits_of(highest: Floats, accused: float) -> tuple[float, float, float]:
    """Return limits that the honest tracks reach with probability ``accused`` at most, equally rare for each suspicion.

    Args:
        highest: (T, 3) the largest e-values of each honest track.
        accused: share of a further honest track to reach one of the three limits.

    Raises:
        ValueError: there are too few tracks for the share.
    """
    allowed = alarms_allowed(len(highest), accused, unit="tracks")
    ranked = np.sort(highest, axis=0)[::-1]
    for rank in range(allowed, -1, -1):
        limits = np.maximum(np.nextafter(ranked[rank], np.inf), 1.0)
        if (highest >= limits).any(axis=1).sum() <= allowed:
            break
    first, second, third = limits.tolist()
    return first, second, third


def highest_e_values(drive: Iterable[Observed], model: EvidenceModel) -> dict[int, Floats]:
    """Return the largest e-values (3,) that each confirmed track of a drive reaches, by its id."""
    fusion, highest = SingleFusion(replace(model, limits=_NO_LIMITS)), dict[int, Floats]()
    for tracks, detections, views in drive:
        explained = fusion.explain(tracks, detections, views)
        shown = explained.tracks
        for k in np.flatnonzero(shown.confirmed):
            number = int(shown.ids[k])
            highest[number] = np.maximum(highest.get(number, np.zeros(3)), explained.wealth[k])
    return highest


_FALSE_JUMPS_M = (0.3, 3.0)
"""Jumps of moved tracks that tables are counted with."""


def count_drive(drive: Iterable[Observed], counts: EvidenceCounts, rng: np.random.Generator) -> None:
    """Count the evidence of the tracks of a benign drive, and of the same tracks put elsewhere.

    Elsewhere is at the same distance from the sensor in a random direction; a moved track jumps by up to 3 m.
    """
    times: dict[int, deque[float]] = {}
    places: dict[int, deque[tuple[float, float]]] = {}
    before: SensorView | None = None
    for tracks, detections, views in drive:
        is_matched = tracks.detection >= 0
        boxes = detections.boxes[tracks.detection[is_matched]]
        view = views[0]
        elsewhere = _turned(boxes, view.place, rng)
        counts.add("view", view_bins(view.view.visible(boxes)), view_bins(view.view.visible(elsewhere)))
        if view.cells is not None:
            kinds = tracks.kinds[is_matched]
            counts.honest_cells.append(cell_evidence(boxes, kinds, view)[1])
            counts.forged_cells.append(cell_evidence(elsewhere, kinds, view)[1])
        born = is_matched & (tracks.born_s == tracks.t_s)
        if before is not None and born.any():
            new = _turned(tracks.boxes[born], view.place, rng)
            within_m = np.full(len(new), _NEAR_BIRTH_M)
            counts.add("birth", birth_bins(tracks.born_hidden[born]), birth_bins(before.view.hides_near(new, within_m)))
        for number, box in zip(tracks.ids[is_matched].tolist(), boxes, strict=True):
            when = times.setdefault(number, deque(maxlen=_LATEST + _EARLIER))
            where = places.setdefault(number, deque(maxlen=_LATEST + _EARLIER))
            when.append(tracks.t_s)
            where.append((float(box[0]), float(box[1])))
            honest = jump_of(when, where)[0]
            length, way = rng.uniform(*_FALSE_JUMPS_M), rng.uniform(-np.pi, np.pi)
            false = np.array(where)
            false[-_LATEST:] += length * np.array([np.cos(way), np.sin(way)])
            moved = jump_of(when, cast(Any, false))[0]
            counts.add("jump", jump_bins(np.array([honest])), jump_bins(np.array([moved])))
        before = view


_NEAR_BIRTH_M = 4.0
"""How far an object may come unseen in a sweep: 40 m/s."""


def _turned(boxes: Floats, place: Floats, rng: np.random.Generator) -> Floats:
    """Return boxes (K, 7) at the same distance from a place in random directions, with random headings."""
    away = np.hypot(*(boxes[:, :2] - place).T)
    way = rng.uniform(-np.pi, np.pi, len(boxes))
    turned = boxes.copy()
    turned[:, :2] = place + np.column_stack([away * np.cos(way), away * np.sin(way)])
    turned[:, 6] = rng.uniform(-np.pi, np.pi, len(boxes))
    return turned


def shipped_model() -> EvidenceModel:
    """Return the model in the box, calibrated on simulated drives (docs/fusion.md)."""
    with resources.as_file(resources.files("viewshed.fusion").joinpath("single.json")) as path:
        return EvidenceModel.load(path)
