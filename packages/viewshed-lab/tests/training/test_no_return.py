"""The mixture of the network of beams without a return, and the labels of its samples."""

import numpy as np
import torch
from fit_no_return import held_back

from viewshed.preprocess.leveling import level
from viewshed_lab.data.wild import wild_scenes
from viewshed_lab.training.no_return import (
    LOG_NONE,
    Mixture,
    NoReturnNet,
    arrays_of,
    samples_of,
    source_of,
)


def test_the_mixture_is_a_distribution() -> None:
    torch.manual_seed(3)
    net = NoReturnNet(torch.zeros(5), torch.ones(5), stops=3)
    feature, stop = torch.randn(4, 5), torch.tensor([[2.0, 3.0, LOG_NONE]] * 4)
    mixture = Mixture.of(net, feature, stop)
    ranges = torch.linspace(-30, 40, 20_001)
    density = torch.exp(torch.stack([mixture.log_likelihood(end.expand(4)) for end in ranges[ranges < LOG_NONE]], 1))
    survival = mixture.survival(ranges)
    assert (survival.diff(dim=1) <= 1e-6).all()
    assert torch.allclose(survival[:, 0], torch.ones(4), atol=1e-4)
    assert torch.allclose(survival[:, -1], torch.exp(mixture.log_free), atol=1e-4)
    # The density up to a range is what did not survive it.
    ended = (density * (ranges[1] - ranges[0])).sum(1)
    at_end = survival[:, int((ranges < LOG_NONE).sum())]
    assert torch.allclose(ended, 1 - at_end, atol=0.02)
    # A stop that is not there has no share.
    assert (torch.exp(mixture.log_share[:, 2]) < 1e-9).all()


def test_most_labels_are_where_something_proposed_stands() -> None:
    scene = wild_scenes("training", "road")[1]
    seen = scene.observe(0)
    made = samples_of(seen, level(seen.given("rings"), seen.truth.grid), np.zeros((0, 4)), None)
    assert made is not None
    stopped = made.end < LOG_NONE
    nearest = np.abs(made.stop - made.end[:, None]).min(axis=1)
    assert stopped.sum() > 1000
    # A tenth of an octave is 7 % of the range.
    assert np.mean(nearest[stopped] < 0.1) > 0.7
    blind = samples_of(seen, level(seen.given("rings"), seen.truth.grid), np.array([[0.0, 0.0, 4.0, 2.0]]), 0.6)
    assert blind is not None
    assert (blind.end <= np.log2(0.6) + 1e-6).all()


def test_the_source_for_the_core_holds_the_network() -> None:
    arrays = NoReturnNet(torch.randn(5), torch.ones(5), stops=3, units=7).arrays()
    back = arrays_of(source_of(arrays))
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        assert np.array_equal(back[name], array)


def test_whole_scenes_are_held_back() -> None:
    # Two of ten scenes; the last ones have few rows.
    scene = np.repeat(np.arange(20, 30), [5, 9, 4, 7, 8, 6, 5, 9, 2, 1])
    assert set(scene[held_back(scene)]) == {28, 29}
    assert not set(scene[~held_back(scene)]) & {28, 29}
