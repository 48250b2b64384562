"""Multi-object tracker: detections and views of successive sweeps to tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind
from viewshed.objects.association import assign, assignment_solver, inside, no_part_of_earlier
from viewshed.objects.existence import (
    LEVELS,
    after_detection,
    after_miss,
    forget,
    found_probability,
    levels_after,
    shares_found,
)
from viewshed.objects.kalman import (
    Motion,
    center_log_density,
    inverse,
    predict,
    quarter_turned,
    settle,
    squared_distances,
    standing_probability,
    update,
    update_boxes,
    wrapped,
)
from viewshed.objects.tracks import TRACK_ROWS, Tracks
from viewshed.objects.views import View

Numbers = NDArray[np.int32]

MAX_TRACKS, MAX_DETECTIONS = 500, 1000
"""Maximum number of tracks (further detections start none, with a note), and of detections per sweep (more are
refused)."""

_MAX_LENGTH_M = 30.0
"""Maximum length of a box; longer ones are left out, with a note."""

_LATE_S = 0.5
"""Sweeps late by up to this are left out; one from longer ago starts a new recording."""

_SAME_TIME_S = 0.02
"""Maximum time difference between the view and the detections of one sweep."""

MOTION = Motion(standing_share=0.5, outlier_share=0.2)
"""Motion of road users, and accuracy of boxes around clusters of returns."""

SPREAD_FROM_M = 0.5
"""The view is sampled at several positions of a track if the standard deviation of its position is larger."""

_EXTENT = [2, 3, 4, 5, 6]
"""Columns of a box that are filtered apart from the state: z, length, width, height, yaw."""

_KIND_KEPT = 0.9
"""Factor on the votes for a track's kind at each further vote."""

_SPEEDS_MPS = {
    ObjectKind.OTHER: 15.0, ObjectKind.PEDESTRIAN: 4.0, ObjectKind.CYCLIST: 15.0,
    ObjectKind.CAR: 40.0, ObjectKind.TRUCK: 30.0,
}  # fmt: skip
"""Maximum speed of a kind of object that comes out of an unseen place."""


@dataclass(slots=True)
class TrackTable:
    """Internal state of N tracks; the first arrays are those of :class:`Tracks`."""

    ids: NDArray[np.int64]
    states: F64
    covariances: F64
    boxes: F64
    box_variances: F64
    existence: F64
    confirmed: NDArray[np.bool_]
    detection: Numbers
    visible: F64
    detectable: F64
    born_s: F64
    seen_s: F64
    born_hidden: F64
    votes: F64  # (N, kinds) of the detections for each kind
    levels: F64  # (N, LEVELS) distribution of the hidden number u that decides detectability; see ``existence``
    updates: Numbers  # (N,) int32 number of detections
    misses: Numbers  # (N,) int32 consecutive missed sweeps since the last detection, of those that count
    lasting: F64  # (N,) probability that it is a persistent false source that looks like an object
    standing: F64  # (N,) probability that it has stood still since its last detection; 0 while it is detected

    @classmethod
    def begun(cls, t_s: float, boxes: F64, kinds: NDArray[np.uint8], noise: F64, motion: Motion) -> Self:
        """Return new tracks at detections (K, 7) with center covariances (K, 2, 2), without ids."""
        count = len(boxes)
        states = np.zeros((count, 4))
        states[:, :2] = boxes[:, :2]
        std = motion.box_std if motion.new_box_std is None else motion.new_box_std
        votes = np.zeros((count, len(ObjectKind)))
        votes[np.arange(count), kinds] = 1.0
        return cls(
            ids=np.full(count, -1, np.int64),
            states=states,
            covariances=motion.new_covariances(noise),
            boxes=np.array(boxes, np.float64),
            box_variances=np.tile(np.square(std), (count, 1)),
            existence=np.ones(count),
            confirmed=np.zeros(count, np.bool_),
            detection=np.full(count, -1, np.int32),
            visible=np.ones(count),
            detectable=np.ones(count),
            born_s=np.full(count, t_s),
            seen_s=np.full(count, t_s),
            born_hidden=np.ones(count),
            votes=votes,
            levels=np.full((count, LEVELS), 1.0 / LEVELS),
            updates=np.ones(count, np.int32),
            misses=np.zeros(count, np.int32),
            lasting=np.zeros(count),
            standing=np.zeros(count),
        )

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.ids)

    @property
    def kinds(self) -> NDArray[np.uint8]:
        """(N,) kind with the most votes."""
        return np.asarray(self.votes.argmax(axis=1), np.uint8)

    def take(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        """Return some of the tracks, as a copy."""
        return type(self)(*(getattr(self, name)[chosen] for name in self.__slots__))

    def joined(self, others: Self) -> Self:
        """Return these tracks followed by others."""
        arrays = ((getattr(self, name), getattr(others, name)) for name in self.__slots__)
        return type(self)(*(np.concatenate(pair) for pair in arrays))


@dataclass(frozen=True, slots=True)
class Measured:
    """The K detections of one sweep with their uncertainty."""

    boxes: F64  # (K, 7)
    kinds: NDArray[np.uint8]  # (K,) uint8
    noise: F64  # (K, 2, 2) covariances of their centers in square meters
    false_odds: F64  # (K,) false detections like each per true one

    def __len__(self) -> int:
        """Return the number of detections."""
        return len(self.boxes)

    def take(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | Numbers) -> Self:
        """Return some of the detections."""
        return type(self)(self.boxes[chosen], self.kinds[chosen], self.noise[chosen], self.false_odds[chosen])


class Rules(Protocol):
    """Rules of a tracker: association, existence, and start and end of tracks."""

    @property
    def motion(self) -> Motion:
        """Motion and measurement model."""
        ...

    @property
    def false_odds(self) -> float:
        """False detections per true one."""
        ...

    def look(self, tracks: TrackTable, view: View, dt_s: float) -> None:
        """Update the tracks by the view and by the elapsed time ``dt_s``."""
        ...

    def match(self, tracks: TrackTable, measured: Measured) -> Numbers:
        """Return the index (N,) of each track's detection, -1 for none."""
        ...

    def judge(self, tracks: TrackTable, measured: Measured, matched: Numbers) -> None:
        """Update the tracks by hits and misses; their states are the predicted ones."""
        ...

    def begin(
        self, born: TrackTable, measured: Measured, tracks: TrackTable, view: View, before: View | None
    ) -> TrackTable:
        """Return the new tracks to start, with their probabilities; each has its detection."""
        ...

    def keep(self, tracks: TrackTable, t_s: float) -> NDArray[np.bool_]:
        """Update which tracks are confirmed, and return the mask (N,) of tracks to keep."""
        ...


@dataclass(frozen=True, slots=True)
class ExistenceRules:
    """Rules by the probability of existence; the view tells whether a missed track could have been seen."""

    motion: Motion = MOTION  # motion and measurement model
    # maximum squared Mahalanobis distance of a match; 13.8 excludes one true detection in a thousand
    gate: float = 13.8
    objects_per_m2: float = 1e-3  # detected objects per square meter
    false_odds: float = 0.1  # false detections per true one, where nothing better is known of a detection
    lasting_share: float = 0.6  # persistent false sources per false detection that does not come back
    unseen_share: float = 0.2  # share of the detected objects that are not tracked yet, where they could not be seen
    seen_share: float = 0.1  # share of these where they would have been seen
    recurrence: float = 0.8  # detection rate of a persistent false source relative to that of an object
    most_found: float = 0.98  # maximum probability that a detector finds a detectable object
    doubt_s: float = 0.1  # correlation time of doubt about one track; 0 treats each sweep as independent evidence
    lifetime_s: float = 60.0  # mean lifetime of an object
    surest: float = 0.99  # maximum of existence
    confirm_from: float = 0.75  # a track is confirmed when its existence reaches this
    drop_below: float = 0.05  # a track ends when its existence is lower
    vague_m: float = 2.5  # a track is not confirmed while the standard deviation of its position is larger
    lost_m: float = 6.0  # a track ends when the standard deviation of its position is larger
    spreads: bool = True  # sample the view at five positions of a track's distribution where its mean is not enough

    def __post_init__(self) -> None:
        for name in ("unseen_share", "seen_share", "recurrence", "most_found", "surest", "confirm_from", "drop_below"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        for name in ("gate", "objects_per_m2", "false_odds", "lifetime_s", "vague_m", "lost_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")

    def look(self, tracks: TrackTable, view: View, dt_s: float) -> None:
        """Query the view of each track, and let existence and the knowledge of u decay."""
        tracks.visible = _spread_visible(tracks, view) if self.spreads else view.visible(tracks.boxes)
        tracks.detectable = view.detectable(tracks.boxes, tracks.kinds)
        kept = np.exp(-dt_s / self.lifetime_s)
        tracks.existence, tracks.lasting = kept * tracks.existence, kept * tracks.lasting
        tracks.levels = forget(tracks.levels, float(np.exp(-dt_s / self.doubt_s)) if self.doubt_s > 0.0 else 0.0)

    def match(self, tracks: TrackTable, measured: Measured) -> Numbers:
        """Return the most likely assignment: maximum sum of log-likelihood ratios (of this track, false detection)."""
        motion, centers, noise = self.motion, measured.boxes[:, :2], measured.noise
        squared, determinants = squared_distances(tracks.states, tracks.covariances, centers, noise)
        log_density = center_log_density(squared, determinants)
        if motion.outlier_share:
            wide = motion.outlier_noise(noise)
            squared, determinants = squared_distances(tracks.states, tracks.covariances, centers, wide)
            log_density = np.logaddexp(
                np.log1p(-motion.outlier_share) + log_density,
                np.log(motion.outlier_share) + center_log_density(squared, determinants),
            )
        # A track that could not be seen may still be detected: the view may be wrong.
        prob_found = np.clip(self._found(tracks), 1.0 - self.most_found, self.most_found)
        real = np.maximum(tracks.existence * prob_found, 1e-300)  # existence underflows after a night without sweeps
        benefit = log_density + np.log(real / (1.0 - real))[:, None] - np.log(self._clutter_per_m2(measured))
        return assign(np.where(squared <= self.gate, benefit, 0.0))

    def judge(self, tracks: TrackTable, measured: Measured, matched: Numbers) -> None:
        """Update existence and u by hits and misses."""
        is_hit = matched >= 0
        shares = shares_found(tracks.visible * tracks.detectable, self.most_found)
        prob_found = found_probability(tracks.levels, shares)
        density, clutter = np.zeros(len(tracks)), np.ones(len(tracks))
        hits = measured.take(matched[is_hit])
        density[is_hit] = _densities(tracks.states[is_hit], tracks.covariances[is_hit], hits, self.motion).sum(axis=0)
        clutter[is_hit] = self._clutter_per_m2(hits)
        priors = tracks.existence, tracks.lasting, prob_found
        hit = after_detection(*priors, density, clutter, self.recurrence)
        miss = after_miss(*priors, self.recurrence)
        existence, tracks.lasting = (np.where(is_hit, *pair) for pair in zip(hit, miss, strict=True))
        tracks.existence = np.minimum(existence, self.surest)
        hit_levels = (1.0 - shares) * clutter[:, None] + shares * density[:, None]
        tracks.levels = levels_after(tracks.levels, np.where(is_hit[:, None], hit_levels, 1.0 - shares))

    def begin(
        self, born: TrackTable, measured: Measured, tracks: TrackTable, view: View, before: View | None
    ) -> TrackTable:
        """Return the new tracks, with their existence by whether they could have come unseen.

        A detection in the box of a detected track or of another new one is a part of it and starts no track.
        """
        is_part = inside(born.boxes, tracks.boxes[tracks.detection >= 0]).any(axis=0)
        begins = ~is_part & no_part_of_earlier(inside(born.boxes, born.boxes))
        born, clutter = born.take(begins), self._clutter_per_m2(measured.take(begins))
        born.visible, born.detectable = view.visible(born.boxes), view.detectable(born.boxes, born.kinds)
        unseen = np.ones(len(born))
        if before is not None:
            speeds = np.array([_SPEEDS_MPS[kind] for kind in ObjectKind])[born.kinds]
            within_m = speeds * abs(view.t_s - before.t_s) + self.motion.center_std_m
            born.born_hidden = before.hides_near(born.boxes, within_m)
            # It may also have been in view and missed.
            unseen = 1.0 - (1.0 - born.born_hidden) * before.detectable(born.boxes, born.kinds)
        new_per_m2 = self.objects_per_m2 * self.unseen_share
        expected = new_per_m2 * (self.seen_share + (1.0 - self.seen_share) * unseen)
        total = expected + (1.0 + self.lasting_share) * clutter
        born.existence = np.minimum(expected / total, self.surest)
        born.lasting = self.lasting_share * clutter / total
        shares = shares_found(born.visible * born.detectable, self.most_found)
        born.levels = levels_after(born.levels, shares)
        return born

    def keep(self, tracks: TrackTable, t_s: float) -> NDArray[np.bool_]:
        """Keep tracks that are likely to exist and whose position is known."""
        variance = np.maximum(tracks.covariances[:, 0, 0], tracks.covariances[:, 1, 1])
        tracks.confirmed = tracks.confirmed | (tracks.existence >= self.confirm_from)
        tracks.confirmed &= variance <= self.vague_m**2
        return np.asarray((tracks.existence >= self.drop_below) & (variance <= self.lost_m**2))

    def _clutter_per_m2(self, measured: Measured) -> F64:
        """Return the density (K,) per square meter of false detections like each that do not come back."""
        return self.objects_per_m2 * measured.false_odds

    def _found(self, tracks: TrackTable) -> F64:
        return found_probability(tracks.levels, shares_found(tracks.visible * tracks.detectable, self.most_found))


class Tracker:
    """Tracks of one sensor's detections over time, in the world or, without poses, in the sensor's ``level`` frame.

    >>> from viewshed.objects.views import SeesAll
    >>> car = np.array([[10.0, 0.0, 0.8, 4.2, 1.8, 1.5, 0.0]])
    >>> tracker = Tracker()
    >>> for k in range(20):
    ...     found = Detections(car + [k, 0, 0, 0, 0, 0, 0], np.array([ObjectKind.CAR]), np.array([50]))
    ...     tracks = tracker.step(0.1 * k, found, SeesAll(0.1 * k))
    >>> tracks.ids.tolist(), tracks.confirmed.tolist(), tracks.states[0].round().tolist()
    ([0], [True], [29.0, 0.0, 10.0, 0.0])
    """

    def __init__(self, rules: Rules | None = None) -> None:
        """Build a tracker without tracks.

        Args:
            rules: association, existence, and start and end of tracks; None is :class:`ExistenceRules`.

        Raises:
            ImportError: scipy is not installed.
        """
        assignment_solver()
        self.rules: Rules = ExistenceRules() if rules is None else rules
        self._next_id = 0
        self._table = _no_tracks(self.rules.motion)
        self._last: Tracks | None = None
        self._view: View | None = None
        self._has_noted_odds = False

    def reset(self) -> None:
        """Forget all tracks and times; new ids continue after the old ones."""
        self._table, self._last, self._view = _no_tracks(self.rules.motion), None, None

    def step(
        self, t_s: float, detections: Detections, view: View, noise: F64 | None = None, false_odds: F64 | None = None
    ) -> Tracks:
        """Return all tracks after the detections of one sweep.

        Args:
            t_s: time of the sweep in seconds.
            detections: in the frame of the view: the world, or ``level`` if there is no pose.
            view: what could be seen in this sweep.
            noise: (K, 2, 2) covariance of each detection's center in square meters; None is that of the rules.
            false_odds: (K,) false detections like each per true one
                (:meth:`viewshed.objects.detection_table.DetectionTable.false_odds`); None takes those of the view, or
                else those of the rules, with a note at the first detections.

        Raises:
            ValueError: there are too many detections, a covariance is not positive definite, odds are not positive, or
                the view is of another time. The tracks are unchanged, and the next sweep can follow.
        """
        rules, notes = self.rules, list[str]()
        measured = self._checked(t_s, detections, view, noise, false_odds, notes)
        unchanged = self._time_note(t_s, view, notes)
        if unchanged is not None:
            return unchanged
        numbers = np.flatnonzero(detections.boxes[:, 3:6].max(axis=1, initial=0.0) <= _MAX_LENGTH_M)
        if len(numbers) < len(detections):
            refused = len(detections) - len(numbers)
            notes.append(f"{refused} of {len(detections)} boxes left out: longer than {_MAX_LENGTH_M:g} m")
        measured = measured.take(numbers)

        # Predict, query the view, associate and update.
        tracks, motion = self._table.take(np.arange(len(self._table))), rules.motion  # copy, because a view may raise
        dt_s = 0.0 if self._last is None else t_s - self._last.t_s
        _predict(tracks, dt_s, motion)
        rules.look(tracks, view, dt_s)
        matched = rules.match(tracks, measured)
        rules.judge(tracks, measured, matched)
        _update(tracks, t_s, measured, matched, motion)

        # Start tracks at unmatched detections, up to the maximum number of tracks.
        boxes, is_unused = measured.boxes, np.ones(len(measured), np.bool_)
        is_unused[matched[matched >= 0]] = False
        unused = np.flatnonzero(is_unused)
        unused = unused[np.lexsort((boxes[unused, 1], boxes[unused, 0], -detections.returns[numbers[unused]]))]
        new = measured.take(unused)
        born = TrackTable.begun(t_s, new.boxes, new.kinds, new.noise, motion)
        born.detection = unused.astype(np.int32)
        if len(born):
            born = rules.begin(born, new, tracks, view, self._view)
        tracks = _kept(tracks, rules.keep(tracks, t_s))
        capacity = max(MAX_TRACKS - len(tracks), 0)
        if len(born) > capacity:
            notes.append(f"{len(born) - capacity} new tracks refused: at most {MAX_TRACKS} are kept")
            born = born.take(np.sort(np.argsort(-born.existence, kind="stable")[:capacity]))
        born.ids = np.arange(self._next_id, self._next_id + len(born))
        self._next_id += len(born)
        if len(born):
            tracks = tracks.joined(born)
            tracks = _kept(tracks, rules.keep(tracks, t_s))

        self._table, self._view = tracks, view
        self._last = _shown(tracks, t_s, numbers, view.in_world, tuple(notes))
        return self._last

    def _checked(
        self,
        t_s: float,
        detections: Detections,
        view: View,
        noise: F64 | None,
        false_odds: F64 | None,
        notes: list[str],
    ) -> Measured:
        """Return the validated detections with noise and odds, a note where odds are defaults, or raise ValueError."""
        count = len(detections)
        if not np.isfinite(t_s):
            raise ValueError(f"t_s must be finite, got {t_s}")
        if count > MAX_DETECTIONS:
            raise ValueError(f"detections must be at most {MAX_DETECTIONS}, got {count}; this sweep is refused")
        if not abs(view.t_s - t_s) <= _SAME_TIME_S:
            raise ValueError(f"view must be of the time of the detections, {t_s:.3f} s, got {view.t_s:.3f} s")
        given_odds = view.false_odds(detections.boxes, detections.kinds) if false_odds is None else false_odds
        odds = np.full(count, self.rules.false_odds) if given_odds is None else np.asarray(given_odds, np.float64)
        if odds.shape != (count,) or not (np.isfinite(odds) & (odds > 0.0)).all():
            raise ValueError(f"false_odds must be {count} positive numbers, got shape {odds.shape} or other numbers")
        spread = self.rules.motion.center_noise(count) if noise is None else np.asarray(noise, np.float64)
        if spread.shape != (count, 2, 2):
            raise ValueError(f"noise must have shape ({count}, 2, 2), got {spread.shape}")
        determinants = spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] * spread[:, 1, 0]
        is_valid = (determinants > 0.0) & (spread[:, 0, 0] > 0.0) & np.isfinite(spread).all(axis=(1, 2))
        is_valid &= np.isclose(spread[:, 0, 1], spread[:, 1, 0])
        if not is_valid.all():
            first = int(np.flatnonzero(~is_valid)[0])
            raise ValueError(
                f"noise must be symmetric and positive definite, got {spread[first].tolist()} for detection {first}"
            )
        if given_odds is None and count and not self._has_noted_odds:
            self._has_noted_odds = True
            guess = f"{self.rules.false_odds:g} per true one"
            notes.append(f"the rate of false detections is not known for this view: {guess} assumed; give false_odds")
        return Measured(detections.boxes, detections.kinds, spread, odds)

    def _time_note(self, t_s: float, view: View, notes: list[str]) -> Tracks | None:
        """Return the last tracks if a sweep is late or repeated; reset if the recording or the frame changed."""
        last = self._last
        if last is None:
            return None
        back_s = last.t_s - t_s
        if 0.0 <= back_s <= _LATE_S:
            notes.append(
                f"a sweep {'with a repeated time' if back_s == 0.0 else f'{back_s:.3f} s late'}: its detections are"
                " left out"
            )
            return replace(last, detection=np.full(len(last), -1, np.int32), notes=tuple(notes))
        if back_s > 0.0:
            notes.append(f"time went back by {back_s:.3f} s: all tracks dropped")
            self.reset()
        elif last.in_world != view.in_world:
            frame = "the world" if view.in_world else "the sensor's level frame (no poses)"
            notes.append(f"tracks are in {frame} from now on: all tracks dropped")
            self.reset()
        return None


def _kept(tracks: TrackTable, is_kept: NDArray[np.bool_]) -> TrackTable:
    return tracks if is_kept.all() else tracks.take(is_kept)


def _no_tracks(motion: Motion) -> TrackTable:
    return TrackTable.begun(0.0, np.zeros((0, 7)), np.zeros(0, np.uint8), np.zeros((0, 2, 2)), motion)


def _predict(tracks: TrackTable, dt_s: float, motion: Motion) -> None:
    """Predict the tracks ``dt_s`` seconds ahead; missed tracks that stand still stay where they are."""
    noise = motion.process_noise(dt_s)
    if motion.standing_share:
        lost = np.flatnonzero((tracks.detection < 0) & (tracks.standing == 0.0))
        if len(lost):
            states, covariances = tracks.states[lost], tracks.covariances[lost]
            tracks.standing[lost] = standing_probability(states, covariances, motion)
            tracks.states[lost], tracks.covariances[lost] = settle(states, covariances, tracks.standing[lost])
        noise = noise * (1.0 - tracks.standing)[:, None, None]
    tracks.states, tracks.covariances = predict(tracks.states, tracks.covariances, dt_s, noise)
    tracks.boxes[:, :2] = tracks.states[:, :2]
    tracks.box_variances = tracks.box_variances + np.square(motion.box_drift) * dt_s


def _update(tracks: TrackTable, t_s: float, measured: Measured, matched: Numbers, motion: Motion) -> None:
    """Update states, boxes and kinds of the matched tracks."""
    hit = np.flatnonzero(matched >= 0)
    matched_detections = measured.take(matched[hit])
    tracks.detection = matched
    states, covariances, noise = tracks.states[hit], tracks.covariances[hit], matched_detections.noise
    if motion.outlier_share and len(hit):
        # Inflate the noise by the probability that the detection is an outlier.
        usual, outlier = _densities(states, covariances, matched_detections, motion)
        share = outlier / np.maximum(usual + outlier, 1e-300)
        noise = noise + share[:, None, None] * (motion.outlier_noise(noise) - noise)
    tracks.states[hit], tracks.covariances[hit] = update(states, covariances, matched_detections.boxes[:, :2], noise)
    extents, variances = tracks.boxes[hit][:, _EXTENT], tracks.box_variances[hit]
    extents, tracks.box_variances[hit] = update_boxes(
        extents, variances, matched_detections.boxes[:, _EXTENT], np.array(motion.box_std)
    )
    vx, vy = tracks.states[hit, 2], tracks.states[hit, 3]
    turns = np.round(wrapped(np.arctan2(vy, vx) - extents[:, 4]) / (np.pi / 2))
    turns[np.hypot(vx, vy) < motion.heading_from_mps] = 0.0
    extents = quarter_turned(extents, turns)
    extents[:, 4] = wrapped(extents[:, 4])
    odd = hit[turns % 2 == 1]
    tracks.box_variances[odd] = tracks.box_variances[odd][:, [0, 2, 1, 3, 4]]
    tracks.boxes[hit[:, None], _EXTENT] = extents
    tracks.boxes[:, :2] = tracks.states[:, :2]
    tracks.votes[hit] *= _KIND_KEPT
    tracks.votes[hit, matched_detections.kinds] += 1.0
    tracks.seen_s[hit] = t_s
    tracks.updates[hit] += 1
    tracks.misses[hit], tracks.standing[hit] = 0, 0.0


def _spread_visible(tracks: TrackTable, view: View) -> F64:
    """Return the probability (N,) that each track could be seen, averaged over its position.

    Unscented mean (Julier and Uhlmann, 1997) over five points: weight 1/3 for the mean, and 1/6 each for the points at
    √3 standard deviations along both axes of the covariance. A track with a known position is sampled at its mean only.
    """
    covariances = tracks.covariances[:, :2, :2]
    uncertain = np.flatnonzero(np.maximum(covariances[:, 0, 0], covariances[:, 1, 1]) > SPREAD_FROM_M**2)
    if not len(uncertain):
        return view.visible(tracks.boxes)
    values, axes = np.linalg.eigh(covariances[uncertain])
    steps = (np.sqrt(3.0 * np.maximum(values, 0.0))[:, None, :] * axes).transpose(0, 2, 1)  # (wide, axis, xy)
    boxes = np.repeat(tracks.boxes[uncertain, None], 4, axis=1)
    boxes[:, :2, :2] += steps
    boxes[:, 2:, :2] -= steps
    visible = view.visible(np.concatenate([tracks.boxes, boxes.reshape(-1, 7)]))
    mean_visible, around = visible[: len(tracks)].copy(), visible[len(tracks) :].reshape(-1, 4)
    mean_visible[uncertain] = mean_visible[uncertain] / 3.0 + around.sum(axis=1) / 6.0
    return mean_visible


def _densities(states: F64, covariances: F64, measured: Measured, motion: Motion) -> F64:
    """Return the densities (2, M) per square meter of each track's detection, as an inlier and as an outlier."""
    off, noise = measured.boxes[:, :2] - states[:, :2], measured.noise
    densities = []
    for share, spread in ((1.0 - motion.outlier_share, noise), (motion.outlier_share, motion.outlier_noise(noise))):
        inverses, determinants = inverse(covariances[:, :2, :2] + spread)
        squared = (off[:, None, :] @ inverses @ off[:, :, None])[:, 0, 0]
        densities.append(share * np.exp(center_log_density(squared, determinants)))
    return np.stack(densities)


def _shown(tracks: TrackTable, t_s: float, numbers: NDArray[np.intp], in_world: bool, notes: tuple[str, ...]) -> Tracks:
    """Return a read-only copy of the tracks; detections are indices into those given to the tracker."""
    arrays: dict[str, NDArray[Any]] = {name: np.array(getattr(tracks, name)) for name in TRACK_ROWS}
    arrays["detection"] = np.append(numbers, -1)[tracks.detection].astype(np.int32)
    for array in arrays.values():
        array.setflags(write=False)
    return Tracks(t_s, **arrays, in_world=in_world, notes=notes)
