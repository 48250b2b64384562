"""The published trust of agents and tracks (MATE, public code, MIT), formula by formula: the baseline to beat.

Trust is a Beta distribution for each agent and each track of the center. A **pseudo-measurement**, a value v in [0, 1]
with a confidence c in [0, 1], updates it by

    n = bias if v < threshold else 1,   α += n / (n + 1) · c · v,   β += n² / (n + 1) · c · (1 - v).

Before each round, both decay: α ← (1 - w) α + w α₀ with w = min(1, dt / return_s), and β alike. Agent i and track j of
the center, with trust τ_i and τ_j of mean E and standard deviation σ, measure each other:

| track j of the center | agent i gets | track j gets |
|---|---|---|
| matched by one of i's own within the gate | v = E[τ_j], c = clip(1 - 2σ_j) | v = 1, c = E[τ_i] |
| is agent i itself | nothing | v = 1, c = 1 |
| not matched, inside i's view, near enough | v = 1 - E[τ_j], c = clip(w (1 - 2σ_j)) | v = 0, c = w E[τ_i] |
| not matched, outside i's view or too far | nothing | nothing |

Tracks of i that the center lacks have no effect. Confidences of agents are clipped to [1e-4, 0.9999]. The weight w of
an unmatched track is the product of three weights: by its frames in view, its distance and its number of updates.

Choices that the publication leaves open: frames in view are consecutive; a round uses all trusts as they were at its
beginning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.objects.association import assign

PRIOR_MEANS = {"distrusted": 0.2, "untrusted": 0.5, "trusted": 0.8}
"""Means of the priors of new agents and tracks; their strength, α + β, is 1."""

UNKNOWN = np.array([0.5, 0.5])
"""α and β to which trust decays without measurements."""

AGENT_BIAS, AGENT_THRESHOLD = 4.0, 0.4
"""Bias of values below the threshold; also published: 6 and 0.3, 8 and 0.2, and for aerial agents 3."""

TRACK_BIAS, TRACK_THRESHOLD = 1.0, 0.4

RETURN_S = 10.0
"""After this time without measurements trust is ``UNKNOWN`` again; also published: 1 s."""

GATE_M, SELF_M, REACH_M = 3.0, 1.0, 70.0
"""Maximum distance of matched tracks of an agent and the center (also published: 2 and 1); maximum distance of an agent
from the track that is itself; maximum distance of unmatched tracks that count."""

NEAR_M, NEAR_FRAMES, NEAR_WEIGHT = 30.0, 2, 0.25
"""Nearer than ``NEAR_M`` the weight is 1 after more than ``NEAR_FRAMES`` frames in view, and ``NEAR_WEIGHT`` before."""

FAR_FRAMES, DISTANT_M, DISTANT_WEIGHT = 3, 60.0, 0.5
"""Farther away the weight grows from 0 to 1 between ``FAR_FRAMES`` frames in view and twice that number; beyond
``DISTANT_M`` it is multiplied by ``DISTANT_WEIGHT``."""

MIN_UPDATES, MIN_MEASUREMENTS = 2, 2
"""A track of the center with fewer updates does not count as missed; one with fewer pseudo-measurements in a round
keeps its trust."""

MIN_TRUST = 0.4
"""Tracks with less trust are left out of the fused picture; for aerial agents 0.5."""

_MIN_CONFIDENCE, _MAX_CONFIDENCE = 1e-4, 0.9999


def mean_of(beta: F64) -> F64:
    """Return the mean (…) of Beta distributions (…, 2)."""
    return np.asarray(beta[..., 0] / beta.sum(axis=-1))


def std_of(beta: F64) -> F64:
    """Return the standard deviation (…) of Beta distributions (…, 2)."""
    total = beta.sum(axis=-1)
    return np.asarray(np.sqrt(beta.prod(axis=-1) / (total**2 * (total + 1.0))))


def gains(value: F64, confidence: F64, bias: float, threshold: float) -> F64:
    """Return the increments of α and β (…, 2) from pseudo-measurements (…).

    >>> gains(np.array([1.0, 0.0]), np.ones(2), bias=4.0, threshold=0.4).tolist()
    [[0.5, 0.0], [0.0, 3.2]]
    """
    n = np.where(value < threshold, bias, 1.0)
    return np.stack([n / (n + 1) * confidence * value, n**2 / (n + 1) * confidence * (1 - value)], axis=-1)


def prior(name: str) -> F64:
    """Return α and β (2,) of one of ``PRIOR_MEANS``.

    >>> prior("trusted").tolist()
    [0.8, 0.2]

    Raises:
        ValueError: there is no such prior.
    """
    if name not in PRIOR_MEANS:
        raise ValueError(f"prior must be one of {', '.join(PRIOR_MEANS)}, got {name!r}")
    return np.array([PRIOR_MEANS[name], round(1.0 - PRIOR_MEANS[name], 9)])


def forget(beta: F64, dt_s: float, return_s: float = RETURN_S) -> F64:
    """Return Beta distributions (…, 2) after ``dt_s`` seconds of decay.

    >>> forget(np.array([8.5, 0.5]), dt_s=2.5).tolist()
    [6.5, 0.5]
    """
    share = min(1.0, dt_s / return_s)
    return np.asarray((1.0 - share) * beta + share * UNKNOWN)


def miss_weight(distance_m: F64, frames: F64, updates: F64) -> F64:
    """Return the weight w (…) of tracks that an agent should have seen.

    Args:
        distance_m: (…) distance from the agent.
        frames: (…) number of consecutive frames in which its view covered the track.
        updates: (…) number of updates of the track at the center.
    """
    near = np.where(frames > NEAR_FRAMES, 1.0, NEAR_WEIGHT)
    far = np.clip((frames - FAR_FRAMES) / FAR_FRAMES, 0.0, 1.0)
    of_view = np.where(distance_m < NEAR_M, near, far)
    of_distance = np.where(distance_m > DISTANT_M, DISTANT_WEIGHT, 1.0)
    return np.asarray(of_view * of_distance * (updates >= MIN_UPDATES))


@dataclass(frozen=True, slots=True, eq=False)
class MateReport:
    """Input of one agent to a round."""

    agent: str  # name
    xy_m: F64  # (2,) position
    seen_xy_m: F64  # (K, 2) positions of its own tracks
    covers: Mask  # (J,) bool, tracks of the center that its view covers


@dataclass(frozen=True, slots=True, eq=False)
class PseudoMeasurements:
    """Pseudo-measurements between one agent and the J tracks of the center; NaN where there is none.

    Attributes:
        agent_value, agent_confidence: (J,) of the agent, from each track.
        track_value, track_confidence: (J,) of each track, from the agent.
    """

    agent_value: F64
    agent_confidence: F64
    track_value: F64
    track_confidence: F64


def pseudo_measurements(
    report: MateReport,
    agent_trust: F64,
    xy_m: F64,
    updates: NDArray[np.int32],
    track_trust: F64,
    frames: NDArray[np.int32],
    gate_m: float = GATE_M,
) -> PseudoMeasurements:
    """Return the pseudo-measurements between an agent and the tracks of the center in one round.

    Args:
        report: input of the agent.
        agent_trust: its α and β (2,).
        xy_m: (J, 2) positions of the center's tracks.
        updates: (J,) number of updates of each track.
        track_trust: (J, 2) α and β of each track.
        frames: (J,) number of consecutive frames, with this one, in which the agent's view covered each track.
        gate_m: maximum distance of matched tracks.
    """
    track_distance_m = np.linalg.norm(xy_m[:, None] - report.seen_xy_m[None], axis=-1)
    is_matched = assign(gate_m - track_distance_m) >= 0
    distance_m = np.linalg.norm(xy_m - report.xy_m, axis=-1)
    is_self = distance_m < SELF_M
    is_missed = ~is_matched & ~is_self & report.covers & (distance_m <= REACH_M)
    is_matched &= ~is_self

    weight = miss_weight(distance_m, frames.astype(np.float64), updates.astype(np.float64))
    mean, certainty = mean_of(track_trust), 1.0 - 2.0 * std_of(track_trust)
    own = mean_of(agent_trust)
    values = np.full((4, len(xy_m)), np.nan)
    values[2:, is_self] = 1.0
    values[:, is_matched] = np.stack([mean, certainty, np.ones_like(mean), np.full_like(mean, own)])[:, is_matched]
    values[:, is_missed] = np.stack([1.0 - mean, weight * certainty, np.zeros_like(mean), weight * own])[:, is_missed]
    values[1] = np.clip(values[1], _MIN_CONFIDENCE, _MAX_CONFIDENCE)
    return PseudoMeasurements(*values)


@dataclass(slots=True)
class MateTrust:
    """Trust of agents and of the tracks of a center, round by round.

    >>> trust = MateTrust()
    >>> here, there = np.array([[10.0, 0.0]]), np.array([0.0, 0.0])
    >>> report = MateReport("car", there, here, np.array([True]))
    >>> trust.update(0.0, [report], np.array([7]), here, np.array([5], np.int32))
    >>> round(trust.of_agent("car"), 3)
    0.5
    """

    agent_prior: str = "untrusted"  # prior of new agents, of ``PRIOR_MEANS``
    track_prior: str = "untrusted"  # prior of new tracks
    agent_bias: float = AGENT_BIAS  # bias of values below the threshold
    agent_threshold: float = AGENT_THRESHOLD
    return_s: float = RETURN_S  # time without measurements after which trust is ``UNKNOWN``
    gate_m: float = GATE_M  # maximum distance of matched tracks
    agents: dict[str, F64] = field(default_factory=dict)
    tracks: dict[int, F64] = field(default_factory=dict)
    _frames: dict[tuple[str, int], int] = field(default_factory=dict)
    _t_s: float | None = None

    def of_agent(self, agent: str) -> float:
        """Return the mean trust of an agent; the prior mean of an unknown one."""
        return float(mean_of(self.agents.get(agent, prior(self.agent_prior))))

    def of_tracks(self, ids: NDArray[np.int64]) -> F64:
        """Return the mean trust (J,) of tracks; the prior mean of unknown ones."""
        return mean_of(self._betas(ids))

    def _betas(self, ids: NDArray[np.int64]) -> F64:
        new = prior(self.track_prior)
        return np.array([self.tracks.get(int(track), new) for track in ids]).reshape(-1, 2)

    def update(
        self, t_s: float, reports: Sequence[MateReport], ids: NDArray[np.int64], xy_m: F64, updates: NDArray[np.int32]
    ) -> None:
        """Update the trust of agents and tracks by one round of pseudo-measurements.

        Args:
            t_s: time of the round.
            reports: input of the agents that report.
            ids: (J,) ids of the center's tracks; the trust of other tracks is dropped.
            xy_m: (J, 2) positions of the tracks.
            updates: (J,) number of updates of each track.

        Raises:
            ValueError: time goes back, or ``covers`` of a report does not have one value per track.
        """
        if self._t_s is not None and t_s < self._t_s:
            raise ValueError(f"t_s of a round must not decrease, got {t_s} after {self._t_s}")
        if any(report.covers.shape != (len(ids),) for report in reports):
            raise ValueError(f"covers of each report must have one value for each of {len(ids)} tracks")
        # 1. Decay; new agents and tracks start with the prior.
        dt_s = 0.0 if self._t_s is None else t_s - self._t_s
        self._t_s = t_s
        self.agents = {name: forget(beta, dt_s, self.return_s) for name, beta in self.agents.items()}
        new = prior(self.agent_prior)
        self.agents |= {report.agent: new for report in reports if report.agent not in self.agents}
        is_known = np.array([int(track) in self.tracks for track in ids], np.bool_)
        betas = self._betas(ids)
        betas[is_known] = forget(betas[is_known], dt_s, self.return_s)

        # 2. Pseudo-measurements, all with the trust at the beginning of the round.
        measured = []
        for report in reports:
            frames = self._count_frames(report, ids)
            own = self.agents[report.agent]
            measured.append(pseudo_measurements(report, own, xy_m, updates, betas, frames, self.gate_m))

        # 3. Update agents, and the tracks with enough pseudo-measurements.
        for report, one in zip(reports, measured, strict=True):
            gain = gains(one.agent_value, one.agent_confidence, self.agent_bias, self.agent_threshold)
            self.agents[report.agent] = self.agents[report.agent] + np.nansum(gain, axis=0)
        if measured:
            values = np.stack([one.track_value for one in measured])
            confidences = np.stack([one.track_confidence for one in measured])
            gain = np.nansum(gains(values, confidences, TRACK_BIAS, TRACK_THRESHOLD), axis=0)
            is_enough = (~np.isnan(values)).sum(axis=0) >= MIN_MEASUREMENTS
            betas = betas + gain * is_enough[:, None]
        self.tracks = {int(track): beta for track, beta in zip(ids, betas, strict=True)}

    def _count_frames(self, report: MateReport, ids: NDArray[np.int64]) -> NDArray[np.int32]:
        """Return the number (J,) of consecutive frames, with this one, in which a view covered each track."""
        frames = np.zeros(len(ids), np.int32)
        counted = {}
        for k, (track, covers) in enumerate(zip(ids, report.covers, strict=True)):
            if covers:
                frames[k] = counted[report.agent, int(track)] = self._frames.get((report.agent, int(track)), 0) + 1
        others = {key: count for key, count in self._frames.items() if key[0] != report.agent}
        self._frames = others | counted
        return frames
