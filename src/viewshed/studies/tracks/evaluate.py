"""One drive under one attack, tracked and fused with one field of view: what was found, and what it cost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.fusion.evidence import EvidenceModel
from viewshed.fusion.explained import REMOVED, ExplainedTracks
from viewshed.fusion.sensor_view import Observed
from viewshed.fusion.single import SingleFusion
from viewshed.object_metrics import gospa
from viewshed.studies.tracks.drives import HZ, Moment
from viewshed.threats.object_attacks import ForgedDetections, RunningAttack
from viewshed.tracking.tracker import Rules, Tracker

ATTACKED_FROM = round(2.0 * HZ)
"""Sweep in which attacks begin; tracks are compared from then on."""

FORGED_S = 1.0
"""Objects that are forged for less than this are not counted."""

WITHIN_S = 1.0
"""A fabricated object is found in time if it is accused so soon after it is first forged."""

RANGE_M = 50.0
"""Objects and tracks farther from the sensor are not compared."""

COUNTED_RETURNS, RECENT_S = 10, 3.0
"""Objects count while they gave so many returns so short a time ago."""

SURE = 0.9
"""Removed objects are asked for where they are visible with this probability."""

NEAR_M = 2.0
"""A removed track is of an object so near to it."""

Floats = NDArray[np.float64]


@dataclass(slots=True)
class Forgery:
    """What became of one forged object.

    Attributes:
        first_s: when it was first forged.
        last_s: when it was last forged.
        sweeps: in how many sweeps it was.
        visible: probabilities with which it was visible in these sweeps.
        shifts_m: by how much it was moved.
        found_s: when it was first accused; infinite if never.
        tracked_s: when it was first a confirmed track; infinite if never.
    """

    first_s: float
    last_s: float
    sweeps: int = 0
    visible: list[float] = field(default_factory=list)
    shifts_m: list[float] = field(default_factory=list)
    found_s: float = np.inf
    tracked_s: float = np.inf


@dataclass(slots=True)
class Outcome:
    """What was found on one drive.

    Attributes:
        ghosts, removed, moved: forged objects by number.
        honest: for each confirmed track of an honest object whether it was ever accused.
        gospa_m: of each sweep without fusion and after it.
        calibration: of each confirmed track and sweep, its existence after fusion and whether an object is there.
    """

    ghosts: dict[int, Forgery] = field(default_factory=dict)
    removed: dict[int, Forgery] = field(default_factory=dict)
    moved: dict[int, Forgery] = field(default_factory=dict)
    honest: dict[int, bool] = field(default_factory=dict)
    gospa_m: list[tuple[float, float]] = field(default_factory=list)
    calibration: list[tuple[float, bool]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """Return what tables need as plain values: of each forged object seconds until accused, and what it was."""
        forgeries = {
            kind: [
                [one.found_s - one.first_s if one.found_s < np.inf else -1.0, one.tracked_s < np.inf,
                 float(np.mean(one.visible or [1.0])), float(np.mean(one.shifts_m or [0.0]))]
                for one in getattr(self, kind).values() if one.sweeps >= FORGED_S * HZ
            ]
            for kind in ("ghosts", "removed", "moved")
        }  # fmt: skip
        existence, is_object = np.array(self.calibration, np.float64).reshape(-1, 2).T
        bins = np.minimum((10 * existence).astype(np.intp), 9)
        return forgeries | {
            "honest": [sum(self.honest.values()), len(self.honest)],
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
        honest = ForgedDetections.honest(moment.detections)
        forged = honest if attack is None else attack.apply(moment.detections, moment.t_s, moment.ground)
        view = moment.views[fov]
        tracks = tracker.step(moment.t_s, forged.detections, view.view)
        yield TrackedMoment(moment, forged, (tracks, forged.detections, (view,)))


def evaluate(tracked: Sequence[TrackedMoment], model: EvidenceModel) -> Outcome:
    """Return what fusion finds on a drive."""
    fusion, outcome, last = SingleFusion(model), Outcome(), dict[int, tuple[str, int]]()
    returned: dict[int, float] = {}
    for one in tracked:
        moment, forged = one.moment, one.forged
        explained = fusion.explain(*one.observed)
        _note_forgeries(outcome, moment, forged)
        for number in moment.truth.numbers[moment.truth.returns >= COUNTED_RETURNS].tolist():
            returned[number] = moment.t_s
        _note_accusations(outcome, one, explained, last)
        recent = np.array(
            [moment.t_s - returned.get(n, -np.inf) <= RECENT_S for n in moment.truth.numbers.tolist()], bool
        )
        tracks = one.observed[0]
        trusted = explained.trusted()
        both = (tracks.boxes[tracks.confirmed], trusted.boxes)
        apart = np.hypot(*(trusted.boxes[:, None, :2] - moment.truth.boxes[None, :, :2]).transpose(2, 0, 1))
        is_object = (apart <= NEAR_M).any(axis=1)
        outcome.calibration += zip(trusted.existence.tolist(), is_object.tolist(), strict=True)
        before, after = (compare(boxes, moment, recent) for boxes in both)
        outcome.gospa_m.append((before, after))
    return outcome


def compare(boxes: Floats, moment: Moment, counted: NDArray[np.bool_]) -> float:
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


def _note_forgeries(outcome: Outcome, moment: Moment, forged: ForgedDetections) -> None:
    """Take note of which objects are forged in a sweep."""
    t_s = moment.t_s
    visible = dict(zip(moment.truth.numbers.tolist(), moment.visible.tolist(), strict=True))

    def note(of: dict[int, Forgery], number: int) -> Forgery:
        one = of.setdefault(number, Forgery(t_s, t_s))
        one.last_s, one.sweeps = t_s, one.sweeps + 1
        return one

    for ghost in forged.ghost[forged.ghost >= 0].tolist():
        note(outcome.ghosts, ghost)
    for number in moment.of_object[forged.removed].tolist():
        if number >= 0:
            note(outcome.removed, number).visible.append(visible[number])
    for row in np.flatnonzero(forged.moved):
        number = int(moment.of_object[forged.source[row]])
        if number >= 0:
            one = note(outcome.moved, number)
            one.visible.append(visible[number])
            shift = forged.detections.boxes[row, :2] - moment.detections.boxes[forged.source[row], :2]
            one.shifts_m.append(float(np.hypot(*shift)))


def _note_accusations(
    outcome: Outcome, one: TrackedMoment, explained: ExplainedTracks, last: dict[int, tuple[str, int]]
) -> None:
    """Take note of which tracks are accused, by what their last detection was."""
    moment, forged, tracks = one.moment, one.forged, explained.tracks
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
            if row >= 0 and is_shown:
                forgery.tracked_s = min(forgery.tracked_s, moment.t_s)
            if is_accused:
                forgery.found_s = min(forgery.found_s, moment.t_s)
        target = outcome.removed.get(of) or outcome.moved.get(of) if kind == "honest" else None
        if target is not None and target.last_s == moment.t_s:
            if is_accused and explained.suspicions[k] == REMOVED:
                target.found_s = min(target.found_s, moment.t_s)
        elif kind == "honest" and is_shown and of not in outcome.removed and of not in outcome.moved:
            outcome.honest[number] = outcome.honest.get(number, False) or is_accused
