"""The small network: against numpy, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from viewshed.objects.candidates import SHAPES
from viewshed.objects.shape_classifier import SeenAs, shipped_classifier


def test_probabilities_are_those_of_the_same_network_in_numpy() -> None:
    network = shipped_classifier()
    shapes = np.random.default_rng(0).normal(1, 3, (300, len(SHAPES))).astype(np.float32)
    values = np.clip((shapes - network.mean) * network.scale, -6, 6).astype(np.float64)
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        values = np.maximum(values @ weight + bias, 0)
    values = np.exp(values @ network.weights[-1] + network.biases[-1])
    prob = network.probabilities(shapes)
    assert prob == pytest.approx(values / values.sum(axis=1, keepdims=True), abs=1e-4)
    assert prob.shape == (300, len(SeenAs))
    assert network.probabilities(shapes[:0]).shape == (0, len(SeenAs))


def test_arrays_that_do_not_fit_are_refused() -> None:
    network = shipped_classifier()
    with pytest.raises(ValueError, match="fit it again"):
        replace(network, weights=network.weights[:2])
    with pytest.raises(ValueError, match="finite"):
        replace(network, mean=np.full_like(network.mean, np.nan))
    with pytest.raises(ValueError, match="as long as a row"):
        network.probabilities(np.zeros((4, 3), np.float32))
