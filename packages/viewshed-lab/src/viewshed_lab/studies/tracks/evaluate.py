"""Evaluates one drive under one attack with one field of view: forged objects that are accused, and GOSPA."""

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
"""First sweep of attacks; tracks are compared from it on."""

FORGED_S = 1.0
"""Minimum duration of a forgery that counts."""

WITHIN_S = 1.0
"""A fabricated object is found in time if it is accused within this time of its first forgery."""

RANGE_M = 50.0
"""Maximum range of compared objects and tracks."""

COUNTED_RETURNS, RECENT_S = 10, 3.0
"""An object counts if it had at least this number of returns within this time."""

SURE = 0.9
"""Minimum visibility of removed objects that count."""

KNOWN_HITS = 10
"""A removed object is known if a confirmed track of it had at least this number of detections before."""

OCCLUDED_S = (0.3, 3.0)
"""Minimum and maximum duration of occlusions that count."""

NEAR_M = 2.0
"""Maximum distance between a track and its object."""


@dataclass(slots=True)
class Forgery:
    """Outcome of one forged object."""

    first_s: float  # time of the first forgery
    last_s: float  # time of the last forgery
    sweeps: int = 0  # number of sweeps in which it was forged
    visible: list[float] = field(default_factory=list)  # its visibility in these sweeps
    found_s: float = np.inf  # time of the first accusation; infinite if never
    # whether it had a confirmed track: a removed or moved object for :data:`KNOWN_HITS` detections before the forgery,
    # a fabricated one at any time
    known: bool = False
    highest: float = 0.0  # maximum evidence against it, as a share of the limit
    alarmed: bool = False  # whether a monitor of the LiDAR suspected its sector

    def row(self) -> list[float]:
        """Return seconds until accused (-1 for never), mean visibility, ``known``, ``highest`` and ``alarmed``."""
        return [
            self.found_s - self.first_s if self.found_s < np.inf else -1.0, float(np.mean(self.visible or [1.0])),
            float(self.known), round(self.highest, 5), float(self.alarmed),
        ]  # fmt: skip


@dataclass(slots=True)
class Outcome:
    """Outcome of one drive."""

    # ghosts, removed, moved: forged objects by number
    ghosts: dict[int, Forgery] = field(default_factory=dict)
    removed: dict[int, Forgery] = field(default_factory=dict)
    moved: dict[int, Forgery] = field(default_factory=dict)
    # by confirmed track of an honest object: maximum evidence against it, as a share of the limit
    honest: dict[int, float] = field(default_factory=dict)
    accused: set[int] = field(default_factory=set)  # accused honest tracks
    # for each tracked object that was hidden for up to 3 s: whether it had another track when it came back
    occluded: list[bool] = field(default_factory=list)
    gospa_m: list[tuple[float, float]] = field(default_factory=list)  # per sweep, without fusion and after it
    # per confirmed track and sweep: existence after fusion, and whether an object is there
    calibration: list[tuple[float, bool]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """Return the outcome as plain values for tables; forged objects as rows of :meth:`Forgery.row`."""
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
    """Yield the sweeps of a drive tracked with one field of view; an attack forges the tracker's detections."""
    tracker = Tracker(rules)
    for moment in moments:
        forged = ForgedDetections.honest(moment.detections)
        if attack is not None:
            forged = attack.apply(moment.detections, moment.t_s, moment.ground)
        elif moment.ghost.any():
            forged = replace(forged, ghost=np.where(moment.ghost, 0, -1))
        view = moment.views[fov]
        # A fabricated detection gets the tracker's own odds.
        odds = np.append(moment.false_odds, tracker.rules.false_odds)[forged.source]
        tracks = tracker.step(moment.t_s, forged.detections, view.view, false_odds=odds)
        yield TrackedMoment(moment, forged, (tracks, forged.detections, (view,)))


def evaluate(tracked: Sequence[TrackedMoment], model: EvidenceModel) -> Outcome:
    """Return the outcome of fusion on a drive."""
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
        is_true = is_at_object(trusted.boxes, moment.truth)
        outcome.calibration += zip(trusted.existence.tolist(), is_true.tolist(), strict=True)
        before, after = (compare(boxes, moment, recent) for boxes in both)
        outcome.gospa_m.append((before, after))
    return outcome


def is_at_object(boxes: F64, truth: ObjectsTruth) -> NDArray[np.bool_]:
    """Return the mask (N,) of boxes (N, 7) with an object within 2 m, or within a quarter of its length.

    The detector's own table uses the same rule, as only one end of a long vehicle is seen.
    """
    distance_m = np.hypot(*(boxes[:, None, :2] - truth.boxes[None, :, :2]).transpose(2, 0, 1))
    return np.asarray((distance_m <= np.maximum(NEAR_M, truth.boxes[:, 3] / 4)).any(axis=1))


def tracks_of_objects(tracked: Iterable[TrackedMoment]) -> set[int]:
    """Return the ids of the tracks with more detections of objects than false ones."""
    balance = dict[int, int]()
    for one in tracked:
        tracks = one.observed[0]
        for k in np.flatnonzero(tracks.detection >= 0):
            is_object = one.moment.of_object[one.forged.source[tracks.detection[k]]] >= 0
            number = int(tracks.ids[k])
            balance[number] = balance.get(number, 0) + (1 if is_object else -1)
    return {number for number, surplus in balance.items() if surplus > 0}


def tracking_gospa_m(moments: Sequence[Moment], centers: Iterable[F64]) -> float:
    """Return the mean GOSPA of a drive in meters, of tracks with centers (N, 2 or more) after each sweep."""
    returned, gospa_m = dict[int, float](), list[float]()
    for moment, tracks in zip(moments, centers, strict=True):
        gospa_m.append(compare(tracks, moment, _returned_lately(moment, returned)))
    return float(np.mean(gospa_m[ATTACKED_FROM:]))


def _returned_lately(moment: Moment, returned: dict[int, float]) -> NDArray[np.bool_]:
    """Return the mask (M,) of objects with enough returns lately; update their last times in ``returned``."""
    for number in moment.truth.numbers[moment.truth.returns >= COUNTED_RETURNS].tolist():
        returned[number] = moment.t_s
    return np.array([moment.t_s - returned.get(n, -np.inf) <= RECENT_S for n in moment.truth.numbers.tolist()], bool)


@dataclass(slots=True)
class _Follower:
    """Follows objects and the tracks that are matched with them."""

    hits: dict[int, int] = field(default_factory=dict)  # by object: number of sweeps with a matched confirmed track
    _track: dict[int, int] = field(default_factory=dict)
    _seen_s: dict[int, float] = field(default_factory=dict)
    _was_hidden: set[int] = field(default_factory=set)

    def note(self, one: TrackedMoment, occluded: list[bool]) -> None:
        """Process a sweep; append to ``occluded`` whether objects that come back have another track than before."""
        moment, tracks, t_s = one.moment, one.observed[0], one.moment.t_s
        hidden = moment.truth.numbers[moment.truth.returns < SEEN_FROM].tolist()
        self._was_hidden.update(number for number in hidden if number in self._track)
        for k in np.flatnonzero((tracks.detection >= 0) & tracks.confirmed):
            row = int(tracks.detection[k])
            number = int(moment.of_object[one.forged.source[row]])
            if one.forged.ghost[row] >= 0 or number < 0:
                continue
            hidden_s = t_s - self._seen_s.get(number, t_s)
            if number in self._was_hidden and OCCLUDED_S[0] <= hidden_s <= OCCLUDED_S[1]:
                occluded.append(self._track[number] != int(tracks.ids[k]))
            self._was_hidden.discard(number)
            self._track[number], self._seen_s[number] = int(tracks.ids[k]), t_s
            self.hits[number] = self.hits.get(number, 0) + 1


def compare(boxes: F64, moment: Moment, counted: NDArray[np.bool_]) -> float:
    """Return GOSPA in meters of track boxes (N, 7) against the objects in the mask ``counted`` (M,), within RANGE_M.

    A track at an object that does not count is ignored.
    """
    xy = boxes[:, :2]
    distance_m = np.hypot(*(xy[:, None] - moment.truth.boxes[None, :, :2]).transpose(2, 0, 1))
    nearest = distance_m.argmin(axis=1)
    ignored = (distance_m[np.arange(len(xy)), nearest] <= NEAR_M) & ~counted[nearest]
    near = np.hypot(*(xy - moment.ground[:2]).T) < RANGE_M
    truth = moment.truth.boxes[counted, :2]
    truth = truth[np.hypot(*(truth - moment.ground[:2]).T) < RANGE_M]
    return gospa(xy[near & ~ignored], truth).distance_m


def _note_forgeries(outcome: Outcome, moment: Moment, forged: ForgedDetections, follower: _Follower) -> None:
    """Record the forged objects of a sweep."""
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
    """Record the accused tracks of a sweep, by the kind of their last detection: ghost, moved or honest."""
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
    """Record the forged objects in sectors that the monitor suspects."""
    moment, forged = one.moment, one.forged
    view = replace(one.observed[2][0], report=moment.report)
    for row, is_alarmed in enumerate(view.alarmed(forged.detections.boxes).tolist()):
        if is_alarmed and forged.ghost[row] >= 0:
            outcome.ghosts[int(forged.ghost[row])].alarmed = True
    alarmed = view.alarmed(moment.truth.boxes)
    for number in moment.truth.numbers[alarmed].tolist():
        if number in moment.gone:
            outcome.removed[number].alarmed = True
