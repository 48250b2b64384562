import numpy as np

from viewshed_lab._numba import atan2


def test_within_twenty_microradians_of_numpy() -> None:
    rng = np.random.default_rng(0)
    xy = rng.normal(0, 20, (2000, 2)).astype(np.float32)
    found = np.array([atan2(y, x) for x, y in xy])
    assert np.abs(found - np.arctan2(xy[:, 1], xy[:, 0])).max() < 2e-5


def test_axes_and_the_half_open_end() -> None:
    one, none = np.float32(1), np.float32(0)
    assert [float(atan2(*yx)) for yx in ((none, one), (one, none), (none, none))] == [0.0, np.float32(np.pi / 2), 0.0]
    assert atan2(none, -one) == np.float32(-np.pi)
    assert atan2(-one, none) == np.float32(-np.pi / 2)
