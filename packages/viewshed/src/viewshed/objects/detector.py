"""Detect objects in a leveled sweep.

Returns above local ground are clustered at several distances (:mod:`.candidates`). Each candidate is classified by its
shape (:mod:`.shape_classifier`). Of nested candidates the most probable are kept, their boxes are completed by the
usual sizes of their kind (:mod:`.completion`), and overlapping boxes are removed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.detections import Detections, ObjectKind
from viewshed.objects.association import inside, no_part_of_earlier
from viewshed.objects.candidates import Candidates, find_candidates
from viewshed.objects.completion import complete_boxes, middles_of
from viewshed.objects.shape_classifier import ENDS, KIND_SEEN_AS, SeenAs, ShapeClassifier, shipped_classifier
from viewshed.preprocess.leveling import LeveledSweep

Numbers = NDArray[np.intp]

MIN_PROB = 0.4
"""Minimum probability of its kind for a candidate to become an object, fitted with the classifier."""

MAX_OBJECTS = 500
"""Maximum number of objects per sweep, the most probable ones; no street has as many."""

_KINDS = np.eye(len(ObjectKind), dtype=np.float32)[KIND_SEEN_AS]
"""(7, 5) 1 where a member of :class:`SeenAs` is of a kind."""

_BESIDE_M = 0.2
"""Boxes are the same object if the middle of one lies in the other, or at most this far outside."""


@dataclass(frozen=True, slots=True)
class Detector:
    """Detects objects in single sweeps.

    Raises:
        ValueError: the probability does not lie in (0, 1].
    """

    least_prob: float = MIN_PROB  # minimum probability of its kind for a candidate to become an object
    classifier: ShapeClassifier = field(default_factory=shipped_classifier)  # of candidates by shape

    def __post_init__(self) -> None:
        if not 0 < self.least_prob <= 1:
            raise ValueError(f"least_prob must lie in (0, 1], got {self.least_prob:g}")

    def detect(self, leveled: LeveledSweep) -> Detections:
        """Return the objects in a leveled sweep, in its ``level`` frame, the most probable first."""
        # 1. Find candidates and classify each by its shape.
        candidates = find_candidates(leveled)
        prob = self.classifier.probabilities(candidates.shapes)
        # 2. Keep the most probable of nested ones, then those above the threshold for one kind.
        chosen = choose_nested(candidates, 1.0 - prob[:, SeenAs.NOTHING])
        by_kind = prob[chosen, : SeenAs.NOTHING] @ _KINDS
        kinds, max_prob = by_kind.argmax(axis=1).astype(np.uint8), by_kind.max(axis=1, initial=0.0)
        order = np.argsort(-max_prob, kind="stable")
        order = order[max_prob[order] >= self.least_prob][:MAX_OBJECTS]
        chosen, kinds = chosen[order], kinds[order]
        # 3. Complete the boxes, put them on local ground, and remove overlaps.
        boxes = boxes_of(candidates, chosen, kinds, prob[chosen])
        boxes[:, 2] += leveled.ground.at(boxes[:, :2])
        kept = first_of_overlapping(boxes, middles_of(candidates.sides[chosen]))
        return Detections(boxes[kept], kinds[kept], candidates.returns[chosen[kept]])


def choose_nested(candidates: Candidates, score: NDArray[np.float32]) -> Numbers:
    """Return the indices (K,) of candidates, none part of another, with the highest mean score.

    A candidate is kept as a whole unless its parts score higher, each weighted by its returns (after Hu, Held and
    Ramanan, "Learning to optimally segment point clouds", 2020).
    """
    parent, returns, scores = candidates.parent.tolist(), candidates.returns.tolist(), score.tolist()
    count = len(parent)
    best, is_whole = list(scores), [True] * count
    sum_of_parts, returns_of_parts = [0.0] * count, [0] * count
    # 1. Bottom up: the best score of each candidate's returns. Parts have larger indices than their parent.
    for k in range(count - 1, -1, -1):
        if returns_of_parts[k] and sum_of_parts[k] > scores[k] * returns_of_parts[k]:
            best[k], is_whole[k] = sum_of_parts[k] / returns_of_parts[k], False
        above = parent[k]
        if above >= 0:
            sum_of_parts[above] += best[k] * returns[k]
            returns_of_parts[above] += returns[k]
    # 2. Top down: the first candidate kept whole in each branch.
    is_inside, chosen = [False] * count, []
    for k in range(count):
        above = parent[k]
        is_inside[k] = above >= 0 and (is_inside[above] or is_whole[above])
        if is_whole[k] and not is_inside[k]:
            chosen.append(k)
    return np.array(chosen, np.intp)


def boxes_of(candidates: Candidates, chosen: Numbers, kinds: NDArray[np.uint8], prob: NDArray[np.float32]) -> F64:
    """Return completed boxes (K, 7) of chosen candidates over flat ground at z = 0.

    Args:
        candidates: all candidates.
        chosen: (K,) indices of those that are objects.
        kinds: (K,) of :class:`viewshed.detections.ObjectKind`.
        prob: (K, 8) of the members of :class:`viewshed.objects.shape_classifier.SeenAs`.
    """
    is_end = np.zeros(len(chosen), np.bool_)
    for end in ENDS:
        is_end |= (kinds == KIND_SEEN_AS[end]) & (prob[:, end] > prob[:, end - 1])
    return complete_boxes(candidates.sides[chosen], kinds, is_end, candidates.column("top_m")[chosen])


def first_of_overlapping(boxes: F64, seen: F64) -> Numbers:
    """Return the indices of boxes (K, 7) that are not part of an earlier box that is kept.

    A box is part of another if its middle, or the middle ``seen`` (K, 2) of its visible sides, lies in the other.
    """
    is_part = inside(boxes, boxes, _BESIDE_M) | inside(seen, boxes, _BESIDE_M)
    return np.flatnonzero(no_part_of_earlier(is_part))
