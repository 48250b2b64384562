"""What the LiDARs of one vehicle see together: by hand, as a law, and in a scene where each sees past what hides it."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.cli.commands import run

import viewshed
from viewshed import BevGrid, CellState, FovEstimate, Rigid, Sweep
from viewshed.fov.union import union_of_views
from viewshed.io import write_sweep
from viewshed.preprocess.leveling import level
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

GRID = BevGrid(4, 2.0)  # cells of a meter
MODEL = LidarModel("test", np.deg2rad(np.linspace(-25, 8, 32)), azimuth_columns=720)
QUARTER_LEFT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
WALL = Box(x_m=8.0, y_m=3.0, length_m=0.4, width_m=6.0, top_m=3.0)
"""A wall across x = 8 m, from y = 0 to 6 m: higher than the sensor."""


def _view(cells: dict[tuple[int, int], tuple[float, CellState]], pose: Rigid | None, **changes: object) -> FovEstimate:
    prob, state = np.zeros((4, 4), np.float32), np.zeros((4, 4), np.uint8)
    for cell, (value, what) in cells.items():
        prob[cell], state[cell] = value, what
    return FovEstimate(GRID, prob, state, world_from_level=pose, **changes)  # type: ignore[arg-type]


def test_each_view_lies_where_its_sensor_is_mounted() -> None:
    """The second sensor is 1 m ahead and looks left: what it sees ahead of it lies to the left of the first."""
    first = _view({(0, 3): (0.9, CellState.FREE)}, Rigid.identity())
    ahead = _view({(3, 1): (0.8, CellState.SURFACE)}, Rigid(QUARTER_LEFT, np.array([1.0, 0.0, 0.0])))
    both = union_of_views([first, ahead])
    # Its cell has its center at (1.5, -.5) of its own: at (1.5, 1.5) of the first, cell (3, 3).
    assert np.argwhere(both.visible()).tolist() == [[0, 3], [3, 3]]
    assert (both.state[0, 3], both.state[3, 3]) == (CellState.FREE, CellState.SURFACE)


@pytest.mark.parametrize("order", [1, -1])
def test_the_sensor_that_says_most_of_a_cell_decides(order: int) -> None:
    says = [CellState.UNKNOWN, CellState.HIDDEN, CellState.FREE, CellState.SURFACE]
    for less, more in pairwise(says):
        views = [_view({(2, 0): (0.0, what)}, Rigid.identity()) for what in (less, more)]
        assert union_of_views(views[::order]).state[2, 0] == more


@given(st.integers(0, 2**32 - 1))
def test_nothing_is_claimed_that_no_sensor_claims(seed: int) -> None:
    rng = np.random.default_rng(seed)
    made = [(rng.random((4, 4), np.float32), rng.integers(0, 4, (4, 4), np.uint8)) for _ in range(3)]
    views = [FovEstimate(GRID, prob, state, world_from_level=Rigid.identity()) for prob, state in made]
    both = union_of_views(views)
    assert (both.visible() == np.any([view.visible() for view in views], axis=0)).all()
    assert np.isin(both.state, (CellState.FREE, CellState.SURFACE)).tolist() == (
        np.any([np.isin(view.state, (CellState.FREE, CellState.SURFACE)) for view in views], axis=0).tolist()
    )


def test_mountings_and_times_that_cannot_be_are_refused() -> None:
    here = _view({}, Rigid.identity(), t_ns=0)
    turned = Rigid(np.array([[1.0, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]), np.zeros(3))
    for other, message in [
        (_view({}, None), "must have its mounting, number 1 has none"),
        (_view({}, Rigid.identity(), t_ns=700_000_000), "within 0.5 s, got 0.7 s"),
        (_view({}, turned), "sweeps 0 and 1 it differs by 37°; give roll and pitch"),
        (_view({}, Rigid.identity(), target=viewshed.PEDESTRIAN), "one target"),
    ]:
        with pytest.raises(ValueError, match=message):
            union_of_views([here, other])
    with pytest.raises(ValueError, match="one or more, got none"):
        union_of_views([])
    with pytest.raises(ValueError, match=r"several LiDARs must be Sweeps"):
        viewshed.estimate([_sweep(0.0), np.zeros((3, 3))])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"several LiDARs .* without history"):
        viewshed.estimate([_sweep(0.0), _sweep(9.0)], history=[])


def _sweep(y_m: float) -> Sweep:
    """A sweep at (0, y) of the vehicle; the wall is where it is."""
    sweep = cast(MODEL, Scene((replace(WALL, y_m=WALL.y_m - y_m),)), 1.8)
    return sweep.replace(world_from_sensor=Rigid(np.eye(3), np.array([0.0, y_m, 0.0])))


def test_a_second_lidar_sees_past_the_wall_that_hides_from_the_first() -> None:
    """Of (14, 7.5), (14, -1) and (10, 3) of the vehicle each sensor sees one of the first two, none the third."""
    sweeps = [_sweep(-3.0), _sweep(9.0)]
    one, other = (viewshed.estimate(sweep) for sweep in sweeps)
    both = viewshed.estimate(sweeps)
    places = np.array([[14.0, 10.5], [14.0, 2.0], [10.0, 6.0]])  # in the level frame of the first, 3 m to the right
    assert (one.at(places) >= 0.5).tolist() == [False, True, False]
    assert (other.at(places - [0.0, 12.0]) >= 0.5).tolist() == [True, False, False]
    assert (both.at(places) >= 0.5).tolist() == [True, True, False]
    assert both.area_m2() > max(one.area_m2(), other.area_m2())


@pytest.mark.slow
@pytest.mark.parametrize("place", ["0001", "0002", "0003"])
def test_three_lidars_of_a_real_car_see_all_around_it(real_data: Path, place: str) -> None:
    """Yaw and place are those of the recording's file; the tilt, which it lacks, is that of each sweep's ground."""
    folder = real_data.parent / "recordings/PJLab-ADG__SensorsCalibration/lidar2lidar/auto_calib/data" / place
    if not folder.is_dir():
        pytest.skip("no recordings")
    sweeps = []
    for line, name in zip(
        (folder / "initial_extrinsic.txt").read_text().splitlines()[1::2], ("top", "left", "right"), strict=True
    ):
        _, _, yaw_deg, *place_m = map(float, line.partition(": ")[2].split())
        sweep = viewshed.read_sweep(next(folder.glob(f"{name}*.pcd")))
        mounting = Rigid.from_yaw(np.deg2rad(yaw_deg), place_m) @ Rigid(
            level(sweep, viewshed.GRIDS["road"]).level_from_sensor.rotation, np.zeros(3)
        )
        sweeps.append(sweep.replace(world_from_sensor=mounting))
    roof, all_three = viewshed.estimate(sweeps[0]), viewshed.estimate(sweeps)
    near = np.hypot(*np.moveaxis(roof.grid.centers, -1, 0)) < 10.0
    assert not roof.visible()[near].all()
    assert all_three.visible()[near].all()


def test_the_command_makes_one_estimate_of_all_its_files(tmp_path: Path) -> None:
    for y_m in (-3.0, 9.0):
        write_sweep(_sweep(y_m).replace(world_from_sensor=None), tmp_path / f"{y_m:g}.npz")
    (tmp_path / "car.txt").write_text("1 0 0 0 0 1 0 -3 0 0 1 0\n1 0 0 0 0 1 0 9 0 0 1 0\n")
    files = tmp_path / "-3.npz", tmp_path / "9.npz"
    words = "estimate", *files, "--together", "--grid", "64x32", "--results", "npz", "--out", tmp_path / "out"
    done = run(*words, "--poses", tmp_path / "car.txt")
    assert done.returncode == 0, done.stderr
    assert "shadow_map of 2 sensors" in done.stdout
    assert [place.name for place in (tmp_path / "out").iterdir()] == ["-3_together.npz"]
    assert "number 0 has none" in run(*words).stderr
    assert "makes one estimate" in run(*words, "--history", 2).stderr
