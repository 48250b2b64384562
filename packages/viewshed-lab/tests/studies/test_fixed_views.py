"""Fixed views: their area by hand, and that no return changes them."""

import numpy as np
import pytest

from viewshed import BevGrid, read_sweep
from viewshed.io.samples import junction_path
from viewshed_lab.studies.fixed_views import FIXED_VIEWS, FixedView

GRID = BevGrid(256, 64.0)


def test_area_is_that_of_a_circle_and_of_a_sector_ahead() -> None:
    sweep = read_sweep(junction_path())
    circle = FixedView(GRID, range_m=40.0).estimate(sweep)
    cone = FixedView(GRID, range_m=40.0, opening_deg=90.0, name="cone").estimate(sweep)
    assert circle.area_m2() == pytest.approx(np.pi * 40.0**2, rel=0.01)
    assert cone.area_m2() == pytest.approx(np.pi * 40.0**2 / 4, rel=0.02)
    x, y = np.moveaxis(GRID.centers, -1, 0)
    assert (x[cone.visible()] > np.abs(y[cone.visible()]) - 1e-6).all()


@pytest.mark.parametrize("name", FIXED_VIEWS)
def test_no_return_changes_it(name: str) -> None:
    sweep = read_sweep(junction_path())
    few = sweep.replace(points=sweep.points[::9], ring=None, intensity=None, azimuth=None, time_s=None)
    make = FIXED_VIEWS[name]
    assert make(GRID).name == name
    assert np.array_equal(make(GRID).estimate(sweep).visible(), make(GRID).estimate(few).visible())
