"""Detector: a leveled sweep to the objects that it shows.

Returns above local ground are linked at several distances (:mod:`.candidates`); each candidate is classified by its
shape (:mod:`.shape_classifier`); of nested candidates the surest are kept; their boxes are completed by the usual sizes
of their kind (:mod:`.completion`); and of boxes that lie in each other one is kept.
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

LEAST_PROB = 0.4
"""Probability of its kind from which a candidate is an object: fitted with the classifier."""

MOST_OBJECTS = 500
"""Most objects of a sweep that are given, the surest; no street has as many."""

_KINDS = np.eye(len(ObjectKind), dtype=np.float32)[KIND_SEEN_AS]
"""(7, 5) 1 where a member of :class:`SeenAs` is of a kind."""

_BESIDE_M = 0.2
"""A box whose middle lies in another, or so far beside it, is the same object."""


@dataclass(frozen=True, slots=True)
class Detector:
    """Finds objects in single sweeps.

    Raises:
        ValueError: the probability does not lie in (0, 1].
    """

    least_prob: float = LEAST_PROB  # probability of its kind from which a candidate is an object
    classifier: ShapeClassifier = field(default_factory=shipped_classifier)  # says what a candidate is by its shape

    def __post_init__(self) -> None:
        if not 0 < self.least_prob <= 1:
            raise ValueError(f"least_prob must lie in (0, 1], got {self.least_prob:g}")

    def detect(self, leveled: LeveledSweep) -> Detections:
        """Return the objects in a leveled sweep, in its ``level`` frame; the surest first."""
        # 1. Candidates, and what each is by its shape.
        candidates = find_candidates(leveled)
        prob = self.classifier.probabilities(candidates.shapes)
        # 2. The surest of nested ones, then those that are sure enough of one kind.
        chosen = choose_nested(candidates, 1.0 - prob[:, SeenAs.NOTHING])
        by_kind = prob[chosen, : SeenAs.NOTHING] @ _KINDS
        kinds, sureness = by_kind.argmax(axis=1).astype(np.uint8), by_kind.max(axis=1, initial=0.0)
        order = np.argsort(-sureness, kind="stable")
        order = order[sureness[order] >= self.least_prob][:MOST_OBJECTS]
        chosen, kinds = chosen[order], kinds[order]
        # 3. Whole boxes, on the local ground; one for each object.
        boxes = boxes_of(candidates, chosen, kinds, prob[chosen])
        boxes[:, 2] += leveled.ground.at(boxes[:, :2])
        single = first_of_overlapping(boxes, middles_of(candidates.sides[chosen]))
        return Detections(boxes[single], kinds[single], candidates.returns[chosen[single]])


def choose_nested(candidates: Candidates, score: NDArray[np.float32]) -> Numbers:
    """Return candidates (K,) of which none is part of another: those with the highest mean score.

    A candidate is kept whole unless its parts score higher, each weighted by its returns (after Hu, Held and Ramanan,
    "Learning to optimally segment point clouds", 2020).
    """
    parent, returns, scores = candidates.parent.tolist(), candidates.returns.tolist(), score.tolist()
    count = len(parent)
    best, is_whole = list(scores), [True] * count
    sum_of_parts, returns_of_parts = [0.0] * count, [0] * count
    # 1. From the parts up: the best score that each candidate's returns can have. Parts stand after their parent.
    for k in range(count - 1, -1, -1):
        if returns_of_parts[k] and sum_of_parts[k] > scores[k] * returns_of_parts[k]:
            best[k], is_whole[k] = sum_of_parts[k] / returns_of_parts[k], False
        above = parent[k]
        if above >= 0:
            sum_of_parts[above] += best[k] * returns[k]
            returns_of_parts[above] += returns[k]
    # 2. From the top down: the first that is whole of each branch.
    is_inside, chosen = [False] * count, []
    for k in range(count):
        above = parent[k]
        is_inside[k] = above >= 0 and (is_inside[above] or is_whole[above])
        if is_whole[k] and not is_inside[k]:
            chosen.append(k)
    return np.array(chosen, np.intp)


def boxes_of(candidates: Candidates, chosen: Numbers, kinds: NDArray[np.uint8], prob: NDArray[np.float32]) -> F64:
    """Return whole boxes (K, 7) of the chosen candidates over flat ground at z = 0.

    Args:
        candidates: all of them.
        chosen: (K,) numbers of those that are objects.
        kinds: (K,) of :class:`viewshed.detections.ObjectKind`.
        prob: (K, 8) of the members of :class:`viewshed.objects.shape_classifier.SeenAs`.
    """
    is_end = np.zeros(len(chosen), np.bool_)
    for end in ENDS:
        is_end |= (kinds == KIND_SEEN_AS[end]) & (prob[:, end] > prob[:, end - 1])
    return complete_boxes(candidates.sides[chosen], kinds, is_end, candidates.column("top_m")[chosen])


def first_of_overlapping(boxes: F64, seen: F64) -> Numbers:
    """Return the numbers of boxes (K, 7) that are not part of one before that is kept.

    A box is part of another if its middle, or that of the sides that were ``seen`` (K, 2), lies in it.
    """
    is_part = inside(boxes, boxes, _BESIDE_M) | inside(seen, boxes, _BESIDE_M)
    return np.flatnonzero(no_part_of_earlier(is_part))
