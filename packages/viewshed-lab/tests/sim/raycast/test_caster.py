"""Depths computed by hand, in scenes where a swapped axis or a mirrored azimuth changes the answer."""

import numpy as np
import pytest

from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Cylinder, Scene, cast, depth_image, junction

FOUR = LidarModel("four", np.deg2rad([-30.0, 0.0]), azimuth_columns=4, max_range_m=80.0)
BACK, RIGHT, FRONT, LEFT = range(4)
HEIGHT_M = 2.0


def test_sloping_ground_by_hand() -> None:
    """Uphill in x by 0.1: from z = 2 down 30°, 2 - t/2 = 0.1 · (√3/2) t ahead and the sign turned behind."""
    depth = depth_image(FOUR, Scene(slope=(0.1, 0.0)), HEIGHT_M)[0]
    root = np.sqrt(3) / 2
    assert depth[FRONT] == pytest.approx(2.0 / (0.5 + 0.1 * root))
    assert depth[BACK] == pytest.approx(2.0 / (0.5 - 0.1 * root))
    assert depth[[LEFT, RIGHT]] == pytest.approx([4.0, 4.0])


def test_a_cylinder_is_met_at_its_near_side_and_off_center() -> None:
    scene = Scene(cylinders=(Cylinder(0.3, -8.0, 0.5, 3.0),))
    depth = depth_image(FOUR, scene, HEIGHT_M)[1]
    assert depth[RIGHT] == pytest.approx(8.0 - 0.4)
    assert np.isinf(depth[[BACK, FRONT, LEFT]]).all()


def test_a_box_stands_on_the_slope() -> None:
    """The ground below the box at x = 20 is 2 m up: a box of 0.5 m is met by the level beam at 2 m."""
    scene = Scene(boxes=(Box(20.0, 0.0, 2.0, 2.0, 0.5, bottom_m=-0.5),), slope=(0.1, 0.0))
    assert depth_image(FOUR, scene, HEIGHT_M)[1, FRONT] == pytest.approx(19.0)


def test_attitude_tilts_the_beams() -> None:
    """Pitched down 30° about y (left): the level beam ahead meets the ground after 4 m, the other looks at the sky."""
    half = np.deg2rad(15.0)
    depth = depth_image(FOUR, Scene(), HEIGHT_M, (np.cos(half), 0.0, np.sin(half), 0.0))
    assert depth[1, FRONT] == pytest.approx(4.0)
    assert np.isinf(depth[1, BACK])
    assert depth[0, FRONT] == pytest.approx(2.0 / np.sin(np.deg2rad(60.0)))


def test_offsets_and_origins_of_beams_count() -> None:
    model = LidarModel("odd", np.deg2rad([-30.0]), 4, azimuth_offset=np.array([np.pi / 2]), origin_m=np.array([1.0]))
    scene = Scene(boxes=(Box(0.0, 3.0, 2.0, 2.0, 9.0),))
    depth = depth_image(model, scene, HEIGHT_M)[0]
    assert depth[FRONT] == pytest.approx(2.0 / np.cos(np.deg2rad(30.0)))
    assert depth[LEFT] == pytest.approx(6.0)


def test_cast_gives_points_ring_and_firing_azimuth_of_returns_only() -> None:
    sweep = cast(FOUR, Scene(boxes=(Box(0.0, 11.0, 6.0, 2.0, 3.0),)), HEIGHT_M)
    assert len(sweep) == 5
    assert sweep.ring.tolist() == [0, 0, 0, 0, 1]
    assert sweep.azimuth[4] == pytest.approx(np.pi / 2)
    assert sweep.points[4] == pytest.approx([0.0, 10.0, 0.0], abs=1e-5)
    assert sweep.points[2] == pytest.approx([2.0 * np.sqrt(3.0), 0.0, -2.0], abs=1e-5)


def test_returns_outside_the_range_are_left_out() -> None:
    short = LidarModel("short", np.deg2rad([-30.0, 0.0]), 4, min_range_m=5.0, max_range_m=9.0)
    assert len(cast(short, Scene(boxes=(Box(0.0, 11.0, 6.0, 2.0, 3.0),)), HEIGHT_M)) == 0


def test_noise_is_along_the_beam_and_repeats_with_the_seed() -> None:
    model = LidarModel("fan", np.deg2rad([-30.0]), 2000)
    sweeps = [cast(model, Scene(), HEIGHT_M, rng=np.random.default_rng(4)) for _ in range(2)]
    ranges = np.linalg.norm(sweeps[0].points, axis=1)
    assert (sweeps[0].points == sweeps[1].points).all()
    assert ranges.std() == pytest.approx(0.015, rel=0.1)
    assert ranges.mean() == pytest.approx(4.0, abs=0.002)


def test_the_junction_is_not_symmetric() -> None:
    depth = depth_image(LidarModel("flat", np.array([0.0]), 360, max_range_m=200.0), junction(), 1.8)[0]
    assert depth.min() > 2.0
    for other in (depth[::-1], np.roll(depth, 90), np.roll(depth, 180)):
        assert (np.abs(np.minimum(depth, 99.0) - np.minimum(other, 99.0)) > 1.0).mean() > 0.5


def test_beams_that_graze_a_cylinder_have_a_depth() -> None:
    """Where single precision meets the side and double precision just misses it, the depth is that of the side."""
    model = LidarModel("level", np.array([0.0]), azimuth_columns=720, max_range_m=80.0)
    step = 2 * np.pi / 720
    found = []
    for number in range(1, 60):
        away_m = 3.0 + 0.11 * number  # the beam straight ahead, half a step beside x, touches the side
        radius = float(np.float32(away_m * np.sin(number * step) * (1 - 1e-9)))
        depth = depth_image(model, Scene(cylinders=(Cylinder(away_m, 0.0, radius, 4.0),)), HEIGHT_M)[0]
        assert (depth > 0).all()
        azimuth = np.arange(720) * step - np.pi
        beside = np.argsort(np.abs(np.abs(azimuth) - number * step))[:2]
        met = depth[beside][np.isfinite(depth[beside])]
        assert np.allclose(met, away_m * np.cos(number * step), atol=0.02)
        found += list(met)
    assert found
