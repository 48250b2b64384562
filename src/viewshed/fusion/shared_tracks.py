"""Tracks that agents share, put together without a center: each joins those of the agents that it hears.

Tracks of one object are not independent, for agents may have heard of it from one another. Covariance intersection
(Julier and Uhlmann, 1997) claims no more than the best of them, whatever they have in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viewshed.tracking.association import assign

if TYPE_CHECKING:
    from viewshed.messages.view_message import SharedTracks

Floats = NDArray[np.float64]

GATE = 16.0
"""Squared distance of two centers, in units of their covariances, beyond which tracks are of two objects."""

GATE_M = 4.0
"""And in meters, however unsure they are."""


@dataclass(frozen=True, slots=True, eq=False)
class JoinedTracks:
    """What several agents say of N objects.

    Attributes:
        states: (N, 4) x, y in meters and their velocities in m/s, in the map.
        covariances: (N, 4, 4).
        boxes: (N, 7) columns ``viewshed.objects.BOX_COLUMNS``, the size of the surest track.
        existence: (N,) probability that any trusted agent is right.
        members: (N, A) number of each agent's track of it, -1 for none.
    """

    states: Floats
    covariances: Floats
    boxes: Floats
    existence: Floats
    members: NDArray[np.int32]


def join_shared(said: Sequence[SharedTracks], trust: NDArray[np.floating]) -> JoinedTracks:
    """Return the tracks of A agents as one list: those of one object by covariance intersection, weighted by trust.

    Args:
        said: tracks of each agent, in one map, of about one time.
        trust: (A,) in each agent, above 0.

    Raises:
        ValueError: there is another number of trusts, or one is not positive.
    """
    if len(trust) != len(said) or not (np.asarray(trust) > 0).all():
        raise ValueError(f"trust must be {len(said)} positive numbers, got {np.asarray(trust)}")
    members = np.zeros((0, len(said)), np.int32)
    rows: list[list[int]] = []
    states, covariances = np.zeros((0, 4)), np.zeros((0, 4, 4))
    for place, tracks in enumerate(said):
        # Matched with the objects so far, by how far apart the centers are in units of what both say of their errors.
        apart = states[:, None, :2] - tracks.states[None, :, :2]
        both = covariances[:, None, :2, :2] + tracks.covariances[None, :, :2, :2]
        distance2 = np.einsum("kni,kni->kn", apart, np.linalg.solve(both, apart[..., None])[..., 0])
        near = np.linalg.norm(apart, axis=-1) < GATE_M
        matched = assign(np.where(near, GATE - distance2, -1.0))
        for row, number in zip(rows, matched.tolist(), strict=True):
            row[place] = number
        new = sorted(set(range(len(tracks))) - set(matched.tolist()))
        rows += [[-1] * place + [number] + [-1] * (len(said) - place - 1) for number in new]
        members = np.array(rows, np.int32).reshape(-1, len(said))
        fused = [_fused(said, trust, line) for line in members]
        states = np.array([state for state, _ in fused]).reshape(-1, 4)
        covariances = np.array([covariance for _, covariance in fused]).reshape(-1, 4, 4)
    missed, boxes = np.ones(len(members)), np.zeros((len(members), 7))
    most = np.full(len(members), -1.0)
    for place, tracks in enumerate(said):
        hit = np.flatnonzero(members[:, place] >= 0)
        of = members[hit, place]
        worth = trust[place] * tracks.existence[of]
        missed[hit] *= 1.0 - np.minimum(worth, 1.0)
        better = worth > most[hit]
        boxes[hit[better]], most[hit[better]] = tracks.boxes[of[better]], worth[better]
    boxes[:, :2] = states[:, :2]
    return JoinedTracks(states, covariances, boxes, 1.0 - missed, members)


def _fused(
    said: Sequence[SharedTracks], trust: NDArray[np.floating], members: NDArray[np.int32]
) -> tuple[Floats, Floats]:
    chosen = np.flatnonzero(members >= 0).tolist()
    tracks = [(said[place].states[members[place]], said[place].covariances[members[place]]) for place in chosen]
    states, covariances = (np.array(part) for part in zip(*tracks, strict=True))
    return fuse_by_trust(states, covariances, np.asarray(trust, np.float64)[chosen])


def fuse_by_trust(states: Floats, covariances: Floats, trust: Floats) -> tuple[Floats, Floats]:
    """Return state (4,) and covariance (4, 4) of one object by covariance intersection, weighted by trust.

    P⁻¹ = Σ ω_i P_i⁻¹ and P⁻¹ x = Σ ω_i P_i⁻¹ x_i with ω_i = trust_i / Σ trust.

    Args:
        states: (N, 4) of the tracks of several agents.
        covariances: (N, 4, 4).
        trust: (N,) mean trust of their agents, not all 0.

    Raises:
        ValueError: there is no track, or no trust in any.
    """
    if len(trust) == 0 or not trust.sum() > 0.0:
        raise ValueError("tracks must be fused with trust in one of them at least")
    information = (trust / trust.sum())[:, None, None] * np.linalg.inv(covariances)
    covariance = np.linalg.inv(information.sum(axis=0))
    return covariance @ np.einsum("nij,nj->i", information, states), covariance


def heard(xy_m: Floats, radio_m: float) -> NDArray[np.bool_]:
    """Return who hears whom (A, A) of agents at (A, 2); nobody hears itself."""
    is_near = np.linalg.norm(xy_m[:, None] - xy_m[None], axis=-1) <= radio_m
    return np.asarray(is_near & ~np.eye(len(xy_m), dtype=np.bool_))
