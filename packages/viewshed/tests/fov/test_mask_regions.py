import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from viewshed._core import label_regions, squared_depth
from viewshed.arrays import Mask

MASKS = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24), elements=st.booleans())


@given(MASKS)
def test_regions_are_numbered_as_scipy_numbers_them(mask: Mask) -> None:
    np.testing.assert_array_equal(label_regions(mask, False), ndimage.label(mask)[0])
    np.testing.assert_array_equal(label_regions(mask, True), ndimage.label(mask, structure=np.ones((3, 3)))[0])


@given(MASKS)
def test_the_depth_is_scipys_distance(mask: Mask) -> None:
    distance = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    np.testing.assert_array_equal(squared_depth(mask), np.rint(distance**2))


@pytest.mark.parametrize("side", [2, 37, 80])
def test_a_spiral_is_one_region(side: int) -> None:
    """The longest way that numbers must travel: one corridor, wound up."""
    mask = np.zeros((side, side), np.bool_)
    (i, j), (di, dj), turns = (0, 0), (0, 1), 0
    mask[i, j] = True
    while turns < 2:
        beyond = i + 2 * di, j + 2 * dj
        on_grid = 0 <= i + di < side and 0 <= j + dj < side
        beyond_on_grid = all(0 <= k < side for k in beyond)
        if not on_grid or mask[i + di, j + dj] or (beyond_on_grid and mask[beyond]):
            (di, dj), turns = (dj, -di), turns + 1
            continue
        (i, j), turns = (i + di, j + dj), 0
        mask[i, j] = True
    assert label_regions(mask, False).max() == 1
    np.testing.assert_array_equal(label_regions(mask, False) == 1, mask)
