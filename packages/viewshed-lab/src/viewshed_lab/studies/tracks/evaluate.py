"""One drive under one attack, tracked and fused with one field of view: what was found, and what it cost."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.objects.evidence import EvidenceModel
from viewshed.objects.explained import REMOVED, ExplainedTracks
from viewshed.objects.metrics import gospa
from viewshed.objects.sensor_view import Observed
from viewshed.objects.single import SingleFusion
from viewshed.objects.tracker import Rules, Tracker
from viewshed_lab.studies.tracks.drives import HZ, SEEN_FROM, Moment, ObjectsTruth
from viewshed_lab.threats.object_attacks import ForgedDetections, RunningAttack

ATTACKED_FROM = round(2.0 * HZ)
"""Sweep in which attacks begin; tracks are compared from then on."""

FORGED_S = 1.0
"""Objects that are forged for less than this are not counted."""

WITHIN_S = 1.0
"""A fabricated object is found in time if it is accused so soon after it is first forged."""

RANGE_M = 50.0
"""Objects and tracks farther from the sensor are not compared."""

COUNTED_RETURNS, RECENT_S = 10, 3.0
"""Objects count while they gave at least this number of returns at most this time ago."""

SURE = 0.9
"""Removed objects count where they are visible with this probability."""

KNOWN_HITS = 10
"""A removed object is known if a confirmed track of it had at least this number of detections before."""

OCCLUDED_S = (0.3, 3.0)
"""Shortest and longest occlusions that are counted."""

NEAR_M = 2.0
"""A track is of an object within this distance of it."""


@dataclass(slots=True)
class Forgery:
    """What became of one forged object."""

    first_s: float  # when it was first forged
    last_s: float  # when it was last forged
    sweeps: int = 0  # in how many sweeps it was
    visible: list[float] = field(default_factory=list)  # probabilities with which it was visible in these sweeps
    found_s: float = np.inf  # when it was first accused; infinite if never
    # it was a confirmed track: one that was removed or moved for :data:`KNOWN_HITS` detections before that, a
    # fabricated one at any time
    known: bool = False
    highest: float = 0.0  # the most that spoke against it, as a part of the limit
    alarmed: bool = False  # a monitor of the LiDAR suspected the sector in which it is

    def row(self) -> list[float]:
        """Return seconds until accused (-1 for never), visibility, and the rest, as plain numbers."""
        return [
            self.found_s - self.first_s if self.found_s < np.inf else -1.0, float(np.mean(self.visible or [1.0])),
            float(self.known), round(self.highest, 5), float(self.alarmed),
        ]  # fmt: skip


@dataclass(slots=True)
class Outcome:
    """What was found on one drive."""

    # ghosts, removed, moved: forged objects by number
    ghosts: dict[int, Forgery] = field(default_factory=dict)
    removed: dict[int, Forgery] = field(default_factory=dict)
    moved: dict[int, Forgery] = field(default_factory=dict)
    # for each confirmed track of an honest object the most that spoke against it, as a part of the limit
    honest: dict[int, float] = field(default_factory=dict)
    accused: set[int] = field(default_factory=set)  # the honest tracks that were accused
    # tracked objects that were hidden for up to 3 s: whether each had another track when it came back
    occluded: list[bool] = field(default_factory=list)
    gospa_m: list[tuple[float, float]] = field(default_factory=list)  # of each sweep without fusion and after it
    # of each confirmed track and sweep, its existence after fusion and whether an object is there
    calibration: list[tuple[float, bool]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """Return what tables need as plain values: of each forged object seconds until accused, and what it was."""
        forgeries = {
            kind: [one.row() for one in getattr(self, kind).values() if one.sweeps >= FORGED_S * HZ]
            for kind in ("ghosts", "removed", "moved")
        }
        existence, is_object = np.array(self.calibration, np.float64).reshape(-1, 2).T
        bins = np.minimum((10 * existence).astype(np.intp), 9)
        return forgeries | {
            "honest": [len(self.accused), len(self.honest)],
            "highest": [round(value, 5) for value in self.honest.values()],
            "occluded": [sum(self.occluded), len(self.occluded)],
            "gospa_m": np.array(self.gospa_m[ATTACKED_FROM:]).reshape(-1, 2).mean(axis=0).tolist(),
            "existence": [np.bincount(bins, weights, 10).tolist() for weights in (None, existence, is_object)],
        }


@dataclass(frozen=True, slots=True, eq=False)
class TrackedMoment:
    """One sweep, attacked or not, with its tracks."""

    moment: Moment
    forged: ForgedDetections
    observed: Observed


def track_drive(
    moments: Sequence[Moment], fov: str, attack: RunningAttack | None = None, rules: Rules | None = None
) -> Iterator[TrackedMoment]:
    """Yield the sweeps of a drive tracked with one field of view; an attack forges what the tracker is given."""
    tracker = Tracker(rules)
    for moment in moments:
        forged = ForgedDetections.honest(moment.detections)
        if attack is not None:
            forged = attack.apply(moment.detections, moment.t_s, moment.ground)
        elif moment.ghost.any():
            forged = replace(forged, ghost=np.where(moment.ghost, 0, -1))
        view = moment.views[fov]
        # What an attacker adds looks like the detections about it.
        odds = np.append(moment.false_odds, tracker.rules.false_odds)[forged.source]
        tracks = tracker.step(moment.t_s, forged.detections, view.view, false_odds=odds)
        yield TrackedMoment(moment, forged, (tracks, forged.detections, (view,)))


def evaluate(tracked: Sequence[TrackedMoment], model: EvidenceModel) -> Outcome:
    """Return what fusion finds on a drive."""
    fusion, outcome, last = SingleFusion(model), Outcome(), dict[int, tuple[str, int]]()
    returned: dict[int, float] = {}
    follower = _Follower()
    for one in tracked:
        moment, forged = one.moment, one.forged
        explained = fusion.explain(*one.observed)
        _note_forgeries(outcome, moment, forged, follower)
        follower.note(one, outcome.occluded)
        recent = _returned_lately(moment, returned)
        _note_accusations(outcome, one, explained, last, np.array(model.limits))
        if moment.report is not None:
            _note_alarms(outcome, one)
        tracks = one.observed[0]
        trusted = explained.trusted()
        both = (tracks.boxes[tracks.confirmed], trusted.boxes)
        there = is_at_object(trusted.boxes, moment.truth)
        outcome.calibration += zip(trusted.existence.tolist(), there.tolist(), strict=True)
        before, after = (compare(boxes, moment, recent) for boxes in both)
        outcome.gospa_m.append((before, after))
    return outcome


def is_at_object(boxes: F64, truth: ObjectsTruth) -> NDArray[np.bool_]:
    """Return which boxes (N, 7) have an object within 2 m, or within a quarter of its length.

    So the detector's own table counts: of a long vehicle only one end is seen.
    """
    apart = np.hypot(*(boxes[:, None, :2] - truth.boxes[None, :, :2]).transpose(2, 0, 1))
    return np.asarray((apart <= np.maximum(NEAR_M, truth.boxes[:, 3] / 4)).any(axis=1))


def tracks_of_objects(tracked: Iterable[TrackedMoment]) -> set[int]:
    """Return the ids of the tracks most of whose detections are of objects."""
    balance = dict[int, int]()
    for one in tracked:
        tracks = one.observed[0]
        for k in np.flatnonzero(tracks.detection >= 0):
            is_object = one.moment.of_object[one.forged.source[tracks.detection[k]]] >= 0
            number = int(tracks.ids[k])
            balance[number] = balance.get(number, 0) + (1 if is_object else -1)
    return {number for number, more in balance.items() if more > 0}


def tracking_gospa_m(moments: Sequence[Moment], centers: Iterable[F64]) -> float:
    """Return the mean GOSPA of a drive in meters, of the tracks (N, 2 or more) that are shown after each sweep."""
    returned, found = dict[int, float](), list[float]()
    for moment, shown in zip(moments, centers, strict=True):
        found.append(compare(shown, moment, _returned_lately(moment, returned)))
    return float(np.mean(found[ATTACKED_FROM:]))


def _returned_lately(moment: Moment, returned: dict[int, float]) -> NDArray[np.bool_]:
    """Return which objects (M,) gave enough returns lately, and note those that do now in ``returned``."""
    for number in moment.truth.numbers[moment.truth.returns >= COUNTED_RETURNS].tolist():
        returned[number] = moment.t_s
    return np.array([moment.t_s - returned.get(n, -np.inf) <= RECENT_S for n in moment.truth.numbers.tolist()], bool)


@dataclass(slots=True)
class _Follower:
    """Follows objects, whatever their tracks are."""

    hits: dict[int, int] = field(default_factory=dict)  # sweeps in which a confirmed track was matched with each object
    _track: dict[int, int] = field(default_factory=dict)
    _seen_s: dict[int, float] = field(default_factory=dict)
    _was_hidden: set[int] = field(default_factory=set)

    def note(self, one: TrackedMoment, occluded: list[bool]) -> None:
        """Take note of a sweep; add to ``occluded`` whether objects that come back have another track than before."""
        moment, tracks, t_s = one.moment, one.observed[0], one.moment.t_s
        hidden = moment.truth.numbers[moment.truth.returns < SEEN_FROM].tolist()
        self._was_hidden.update(number for number in hidden if number in self._track)
        for k in np.flatnonzero((tracks.detection >= 0) & tracks.confirmed):
            row = int(tracks.detection[k])
            number = int(moment.of_object[one.forged.source[row]])
            if one.forged.ghost[row] >= 0 or number < 0:
                continue
            away_s = t_s - self._seen_s.get(number, t_s)
            if number in self._was_hidden and OCCLUDED_S[0] <= away_s <= OCCLUDED_S[1]:
                occluded.append(self._track[number] != int(tracks.ids[k]))
            self._was_hidden.discard(number)
            self._track[number], self._seen_s[number] = int(tracks.ids[k]), t_s
            self.hits[number] = self.hits.get(number, 0) + 1


def compare(boxes: F64, moment: Moment, counted: NDArray[np.bool_]) -> float:
    """Return GOSPA in meters of track boxes (N, 7) against the counted objects (M,) of a moment, both near the sensor.

    A track at an object that does not count is neither right nor false.
    """
    xy = boxes[:, :2]
    apart = np.hypot(*(xy[:, None] - moment.truth.boxes[None, :, :2]).transpose(2, 0, 1))
    nearest = apart.argmin(axis=1)
    ignored = (apart[np.arange(len(xy)), nearest] <= NEAR_M) & ~counted[nearest]
    near = np.hypot(*(xy - moment.ground[:2]).T) < RANGE_M
    truth = moment.truth.boxes[counted, :2]
    truth = truth[np.hypot(*(truth - moment.ground[:2]).T) < RANGE_M]
    return gospa(xy[near & ~ignored], truth).distance_m


def _note_forgeries(outcome: Outcome, moment: Moment, forged: ForgedDetections, follower: _Follower) -> None:
    """Take note of which objects are forged in a sweep."""
    t_s = moment.t_s
    visible = dict(zip(moment.truth.numbers.tolist(), moment.visible.tolist(), strict=True))

    def note(of: dict[int, Forgery], number: int, hits: int = 0) -> Forgery:
        one = of.setdefault(number, Forgery(t_s, t_s, known=hits >= KNOWN_HITS))
        one.last_s, one.sweeps = t_s, one.sweeps + 1
        return one

    for ghost in forged.ghost[forged.ghost >= 0].tolist():
        note(outcome.ghosts, ghost)
    for number in {*moment.of_object[forged.removed].tolist(), *moment.gone}:
        if number >= 0:
            note(outcome.removed, number, follower.hits.get(number, 0)).visible.append(visible[number])
    for row in np.flatnonzero(forged.moved):
        number = int(moment.of_object[forged.source[row]])
        if number >= 0:
            note(outcome.moved, number, follower.hits.get(number, 0)).visible.append(visible[number])


def _note_accusations(
    outcome: Outcome, one: TrackedMoment, explained: ExplainedTracks, last: dict[int, tuple[str, int]], limits: F64
) -> None:
    """Take note of which tracks are accused, by what their last detection was."""
    moment, forged, tracks = one.moment, one.forged, explained.tracks
    against = (explained.wealth / limits).max(axis=1, initial=0.0)
    for k, number in enumerate(tracks.ids.tolist()):
        row = int(tracks.detection[k])
        if row >= 0:
            if forged.ghost[row] >= 0:
                last[number] = "ghost", int(forged.ghost[row])
            else:
                of_object = int(moment.of_object[forged.source[row]])
                last[number] = "moved" if forged.moved[row] else "honest", of_object
        kind, of = last.get(number, ("honest", -1))
        is_accused, is_shown = bool(explained.accused[k]), bool(tracks.confirmed[k])
        if kind in ("ghost", "moved") and of >= 0:
            forgery = (outcome.ghosts if kind == "ghost" else outcome.moved)[of]
            forgery.known |= kind == "ghost" and row >= 0 and is_shown
            forgery.highest = max(forgery.highest, float(against[k]))
            if is_accused:
                forgery.found_s = min(forgery.found_s, moment.t_s)
        target = outcome.removed.get(of) or outcome.moved.get(of) if kind == "honest" else None
        if target is not None and target.last_s == moment.t_s:
            target.highest = max(target.highest, float(explained.wealth[k, REMOVED] / limits[REMOVED]))
            if is_accused and explained.suspicions[k] == REMOVED:
                target.found_s = min(target.found_s, moment.t_s)
        elif kind == "honest" and of >= 0 and is_shown and of not in outcome.removed and of not in outcome.moved:
            outcome.honest[number] = max(outcome.honest.get(number, 0.0), float(against[k]))
            if is_accused:
                outcome.accused.add(number)


def _note_alarms(outcome: Outcome, one: TrackedMoment) -> None:
    """Take note of which forged objects are in sectors that the monitor suspects."""
    moment, forged = one.moment, one.forged
    view = replace(one.observed[2][0], report=moment.report)
    for row, is_alarmed in enumerate(view.alarmed(forged.detections.boxes).tolist()):
        if is_alarmed and forged.ghost[row] >= 0:
            outcome.ghosts[int(forged.ghost[row])].alarmed = True
    alarmed = view.alarmed(moment.truth.boxes)
    for number in moment.truth.numbers[alarmed].tolist():
        if number in moment.gone:
            outcome.removed[number].alarmed = True
