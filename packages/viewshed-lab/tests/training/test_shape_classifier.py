"""Labels of candidates by hand, and a fit that learns them."""

import numpy as np
import pytest
from tests.objects.scenes import car, person, seen

from viewshed.detections import ObjectKind
from viewshed.objects.candidates import find_candidates
from viewshed.objects.shape_classifier import SeenAs
from viewshed_lab.data.object_truth import ObjectSweep, SweepObjects
from viewshed_lab.sim import Box

pytest.importorskip("torch")

from viewshed_lab.training.shape_classifier import fit_shape_classifier, labels_of  # after the skip

BOXES = np.array([
    [14.0, 2.0, 0.75, 4.4, 1.8, 1.5, 0.0],
    [3.0, 9.0, 0.75, 4.4, 1.8, 1.5, 0.0],
    [9.0, -3.0, 0.86, 0.54, 0.54, 1.72, 0.0],
])  # fmt: skip


def scene() -> ObjectSweep:
    leveled = seen(*car(14.0, 2.0), *car(3.0, 9.0), person(9.0, -3.0), Box(16.0, -6.0, 5.0, 0.3, 1.4))
    kinds = np.array([ObjectKind.CAR, ObjectKind.CAR, ObjectKind.PEDESTRIAN], np.uint8)
    return ObjectSweep("by hand", "hdl64e", leveled, SweepObjects(BOXES, kinds, np.full(3, 99), np.arange(3)))


def test_candidates_are_what_they_lie_on() -> None:
    each = scene()
    candidates = find_candidates(each.leveled)
    labels = labels_of(each.leveled.points[:, :2], candidates, each.objects)
    largest = {
        kind: np.flatnonzero(labels == kind)[np.argmax(candidates.returns[labels == kind])]
        for kind in (SeenAs.CAR_SIDE, SeenAs.PEDESTRIAN)
    }
    xy = each.leveled.points[candidates.rows[candidates.first[largest[SeenAs.CAR_SIDE]]], :2]
    assert min(np.hypot(*(xy - box[:2])) for box in BOXES[:2]) < 2.5
    xy = each.leveled.points[candidates.rows[candidates.first[largest[SeenAs.PEDESTRIAN]]], :2]
    assert np.hypot(*(xy - BOXES[2, :2])) < 0.5
    wall = np.hypot(*(each.leveled.points[candidates.rows[candidates.first], :2] - (16.0, -6.0)).T) < 2.6
    assert wall.any()
    assert (labels[wall] == SeenAs.NOTHING).all()


@pytest.mark.slow
def test_a_fit_learns_what_it_is_shown_and_the_same_seed_gives_the_same() -> None:
    each = scene()
    one, same, other = (fit_shape_classifier([each] * 60, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.weights[0], same.weights[0])
    assert not np.array_equal(one.weights[0], other.weights[0])
    candidates = find_candidates(each.leveled)
    labels = labels_of(each.leveled.points[:, :2], candidates, each.objects)
    surest = fit_shape_classifier([each] * 600, seed=3).probabilities(candidates.shapes)[np.arange(len(labels)), labels]
    assert surest.mean() > 0.6  # a guess has an eighth
