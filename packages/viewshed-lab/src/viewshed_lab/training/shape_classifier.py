"""Fit the shape classifier of detection candidates on simulated sweeps with true boxes [torch]."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.functional import cross_entropy

from viewshed.arrays import F64
from viewshed.detections import ObjectKind
from viewshed.objects.candidates import Candidates, find_candidates
from viewshed.objects.completion import complete_boxes
from viewshed.objects.shape_classifier import ENDS, KIND_SEEN_AS, SeenAs, ShapeClassifier
from viewshed_lab.data.object_truth import ObjectSweep, SweepObjects

NEAR_M = {
    ObjectKind.OTHER: 0.8, ObjectKind.PEDESTRIAN: 0.6, ObjectKind.CYCLIST: 1.0, ObjectKind.CAR: 1.5,
    ObjectKind.TRUCK: 3.0,
}  # fmt: skip
"""Largest distance between the centers of a candidate's completed box and its object's box, by kind."""

INSIDE_SHARE = 0.6
"""Smallest share of a candidate's returns in its object's box."""

AROUND_M = 0.15
"""Margin on every side of the object's box in that test."""

TURNED_M = 0.5
"""Penalty added to the distance of boxes whose headings differ by more than 45°."""

UNITS = (64, 32)
"""Units of the hidden layers."""

BATCH, EPOCHS, LEARNING_RATE, WEIGHT_DECAY = 512, 12, 4e-3, 1e-3


def labels_of(leveled_xy: NDArray[np.float32], candidates: Candidates, objects: SweepObjects) -> NDArray[np.int64]:
    """Return the true :class:`SeenAs` label (C,) of each candidate.

    Args:
        leveled_xy: (M, 2) points of the leveled sweep.
        candidates: C candidates.
        objects: true objects.
    """
    labels = np.full(len(candidates), SeenAs.NOTHING, np.int64)
    if not len(objects) or not len(candidates):
        return labels
    # 1. Assign each candidate to the object whose box holds the largest share of its returns.
    xy = leveled_xy[candidates.rows]
    shares = np.stack([_shares_inside(xy, box, candidates) for box in objects.boxes])
    owner, share = shares.argmax(axis=0), shares.max(axis=0)
    # 2. Complete the box in each way that the object's kind allows; the closest one within the limit is the label.
    nearest_m = np.full(len(candidates), np.inf)
    for seen_as in SeenAs:
        if seen_as == SeenAs.NOTHING:
            continue
        kind = KIND_SEEN_AS[seen_as]
        which = np.flatnonzero((objects.kinds[owner] == kind) & (share > INSIDE_SHARE))
        distance_m = _distances(candidates, which, seen_as, objects.boxes[owner[which]])
        better = (distance_m < NEAR_M[ObjectKind(kind)]) & (distance_m < nearest_m[which])
        labels[which[better]] = seen_as
        nearest_m[which] = np.minimum(nearest_m[which], distance_m)
    return labels


def fit_shape_classifier(sweeps: Iterable[ObjectSweep], seed: int) -> ShapeClassifier:
    """Fit a classifier on all candidates of the sweeps; the same seed gives the same weights on one machine."""
    shapes, labels = [], []
    for sweep in sweeps:
        candidates = find_candidates(sweep.leveled)
        shapes.append(candidates.shapes)
        labels.append(labels_of(sweep.leveled.points[:, :2], candidates, sweep.objects))
    return _fit(np.concatenate(shapes), np.concatenate(labels), seed)


def _fit(shapes: NDArray[np.float32], labels: NDArray[np.int64], seed: int) -> ShapeClassifier:
    mean, scale = shapes.mean(axis=0), (1.0 / (shapes.std(axis=0) + 1e-6)).astype(np.float32)
    inputs = torch.from_numpy(np.clip((shapes - mean) * scale, -6.0, 6.0))
    targets = torch.from_numpy(labels)
    generator = torch.Generator().manual_seed(seed)
    sizes = (shapes.shape[1], *UNITS, len(SeenAs))
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        linear = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    network = nn.Sequential(linear[0], nn.ReLU(), linear[1], nn.ReLU(), linear[2])
    optimizer = torch.optim.AdamW(network.parameters(), LEARNING_RATE / 2, weight_decay=WEIGHT_DECAY)
    batches = max(len(inputs) // BATCH, 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, LEARNING_RATE, total_steps=EPOCHS * batches)
    for _ in range(EPOCHS):
        order = torch.randperm(len(inputs), generator=generator)
        for k in range(batches):
            rows = order[k * BATCH : (k + 1) * BATCH]
            optimizer.zero_grad()
            cross_entropy(network(inputs[rows]), targets[rows]).backward()
            optimizer.step()
            schedule.step()
    weights = tuple(np.ascontiguousarray(layer.weight.detach().numpy().T) for layer in linear)
    return ShapeClassifier(mean, scale, weights, tuple(layer.bias.detach().numpy() for layer in linear))


def _shares_inside(xy: NDArray[np.float32], box: F64, candidates: Candidates) -> F64:
    """Return the share (C,) of each candidate's returns inside a box; ``xy`` (P, 2) are the returns in row order."""
    offset = xy - box[:2]
    c, s = np.cos(box[6]), np.sin(box[6])
    inside = np.abs(offset[:, 0] * c + offset[:, 1] * s) < box[3] / 2 + AROUND_M
    inside &= np.abs(offset[:, 1] * c - offset[:, 0] * s) < box[4] / 2 + AROUND_M
    cumulative = np.concatenate([[0], np.cumsum(inside)])
    result: F64 = (cumulative[candidates.last] - cumulative[candidates.first]) / candidates.returns
    return result


def _distances(candidates: Candidates, which: NDArray[np.intp], seen_as: SeenAs, boxes: F64) -> F64:
    """Return the distances (K,) between the centers of the candidates' completed boxes and their objects' ``boxes``."""
    kinds = np.full(len(which), KIND_SEEN_AS[seen_as], np.uint8)
    is_end = np.full(len(which), seen_as in ENDS)
    completed = complete_boxes(candidates.sides[which], kinds, is_end, candidates.column("top_m")[which])
    distance_m: F64 = np.hypot(*(completed[:, :2] - boxes[:, :2]).T)
    turned = np.abs((completed[:, 6] - boxes[:, 6] + np.pi / 2) % np.pi - np.pi / 2) > np.pi / 4
    has_side = kinds >= ObjectKind.CAR
    return distance_m + np.where(turned & has_side, TURNED_M, 0.0)
