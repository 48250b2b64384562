"""What is published of an answer, by hand on small asymmetric grids."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from geometry_msgs.msg import Polygon, PolygonStamped
from rclpy.serialization import deserialize_message

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed_ros import nav2
from viewshed_ros.conversions import rigid_of, stamp_of
from viewshed_ros.layers import LAYERS, PosedEstimate, Unseen, area_of
from viewshed_ros.stops import everywhere

U, F, S, H = CellState.UNKNOWN, CellState.FREE, CellState.SURFACE, CellState.HIDDEN
GRID = BevGrid(4, 2.0, (1.0, 0.0))
STATE = np.array([[F, F, F, U], [F, F, F, U], [F, F, S, U], [H, H, H, U]], np.uint8)
"""Cells of 1 m, x from -1 to 3 m forward, y from -2 to 2 m left."""
PROB = np.where(np.isin(STATE, (F, S)), np.float32(0.9), np.float32(0.2))
LIMITS = nav2.SpeedLimits(most_mps=10.0, unseen_mps=2.0, here_m=0.8)


def view(world_from_level: Rigid | None = None, state: np.ndarray = STATE, grid: BevGrid = GRID) -> PosedEstimate:
    prob = PROB if state is STATE else np.isin(state, (F, S)).astype(np.float32)
    estimate = FovEstimate(grid, prob, state, world_from_level=world_from_level, t_ns=7)
    up = Rigid(np.eye(3), np.array([0.0, 0.0, -1.8]))
    suspect = np.arange(72) == 40
    return PosedEstimate(estimate, stamp_of(7), "lidar", up, "map", suspect, 3.0, LIMITS)


def polygon_of(shown: PosedEstimate) -> Polygon:
    """Return the polygon of the topic ``view``, which is made as bytes."""
    message = deserialize_message(LAYERS["view"].make(shown), PolygonStamped)
    assert message.header == shown.header()
    return message.polygon


def test_grids_go_along_x_first_and_stand_on_the_ground_below_the_sensor() -> None:
    message = LAYERS["state"].make(view())
    assert list(message.data) == [0, 0, 0, 50, 0, 0, 0, 50, 0, 0, 100, 50, -1, -1, -1, -1]
    origin = rigid_of(message.info.origin.position, message.info.origin.orientation)
    np.testing.assert_allclose(origin.translation, [-1.0, -2.0, -1.8])
    assert (message.info.width, message.info.height, message.info.resolution) == (4, 4, 1.0)
    assert (message.header.frame_id, message.header.stamp) == ("lidar", stamp_of(7))


def test_visibility_and_doubt_are_percent_and_unknown_where_nothing_is_known() -> None:
    visibility, doubt = (np.array(LAYERS[name].make(view()).data).reshape(4, 4) for name in ("visibility", "doubt"))
    assert visibility[2].tolist() == [90, 90, 90, 20]
    assert doubt[2].tolist() == np.rint(100 * view().estimate.doubt()[2]).tolist()
    assert (visibility[3] == -1).all()
    assert (doubt[3] == -1).all()


def test_no_topic_is_called_occupancy() -> None:
    assert not any("occupancy" in name for name in LAYERS)


def test_the_polygon_holds_the_cells_of_the_largest_part_and_no_other_whatever_the_holes() -> None:
    rng = np.random.default_rng(0)
    grid = BevGrid(24, 12.0)
    for _ in range(20):
        state = np.where(rng.random(grid.shape) < 0.8, np.uint8(F), np.uint8(H))
        shown = view(state=state, grid=grid)
        ring = np.array([(point.x, point.y) for point in polygon_of(shown).points])
        # Even-odd: edges that a ray from a cell's center along x crosses.
        (x, y), (x_next, y_next) = ring.T, np.roll(ring, -1, axis=0).T
        centers = grid.centers.reshape(-1, 1, 2)
        between = (y <= centers[..., 1]) != (y_next <= centers[..., 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            at = x + (centers[..., 1] - y) / (y_next - y) * (x_next - x)
        inside = ((between & (at > centers[..., 0])).sum(axis=1) % 2).reshape(grid.shape).astype(bool)
        largest = max(shown.estimate.polygon().geoms, key=lambda part: part.area)
        np.testing.assert_array_equal(inside, shapely.contains_xy(largest, *np.moveaxis(grid.centers, -1, 0)))
        assert 0.5 * np.sum(x * y_next - x_next * y) == pytest.approx(largest.area, abs=1e-3)


def test_a_view_of_nothing_is_a_polygon_without_points() -> None:
    nothing = view(state=np.full((4, 4), H, np.uint8))
    assert len(polygon_of(nothing).points) == 0


def test_markers_outline_the_view_and_fan_out_the_suspect_sectors() -> None:
    outline, suspect = LAYERS["markers"].make(view()).markers
    ends = np.array([(point.x, point.y) for point in outline.points]).reshape(-1, 2, 2)
    assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(12.0)
    assert len(suspect.points) == 3
    calm = LAYERS["markers"].make(replace(view(), suspect=np.zeros(72, bool))).markers[1]
    assert calm.action == calm.DELETE


def test_masks_lie_along_the_axes_of_the_map() -> None:
    # Turned left by 90° at (10, 20): level's x is the map's y, level's y its -x.
    pose = Rigid.from_yaw(np.pi / 2, (10.0, 20.0, 0.0))
    message = LAYERS["keepout_mask"].make(view(pose))
    data = np.array(message.data).reshape(4, 4)  # rows along y, columns along x
    assert (message.header.frame_id, message.header.stamp) == ("map", stamp_of(7))
    assert (message.info.origin.position.x, message.info.origin.position.y) == (8.0, 19.0)
    assert message.info.origin.orientation.w == 1.0
    assert data.tolist() == [[100, 0, 0, 0], [100, 0, 0, 0], [100, 0, 0, 0], [100, 100, 100, 100]]


def test_the_speed_mask_limits_what_is_not_seen_and_the_place_where_the_robot_is() -> None:
    values = nav2.speed_values(view().estimate, 3.0, LIMITS)
    assert values[3].tolist() == [20, 20, 20, 20]
    assert values[:2, 1:3].tolist() == [[30, 30], [30, 30]]
    assert values[2].tolist() == [0, 0, 0, 20]


def test_what_stops_the_vehicle_claims_nothing_in_any_cell() -> None:
    # Turned by 30°, so that a mask along the axes has corners outside the view: they stop as well.
    last, stamp, since = view(Rigid.from_yaw(np.pi / 6, (10.0, 20.0, 0.0))), stamp_of(9 * 10**9), stamp_of(8 * 10**9)
    assert -1 in LAYERS["speed_mask"].make(last).data
    unseen = Unseen(last, "map", area_of(last), stamp, since)
    made = {name: layer.stop(unseen) for name, layer in LAYERS.items() if layer.stop is not None}
    for name, value in (("speed_mask", 1), ("keepout_mask", 100), ("visibility", -1), ("state", -1), ("doubt", -1)):
        assert set(made[name].data) == {value}
        assert len(made[name].data) == 16
        assert (made[name].header.stamp, made[name].info.map_load_time) == (stamp, since)
    mask = LAYERS["speed_mask"].make(last)
    assert (made["speed_mask"].info.origin, made["speed_mask"].header.frame_id) == (mask.info.origin, "map")
    assert made["state"].header.frame_id == "lidar"
    assert len(deserialize_message(made["view"], PolygonStamped).polygon.points) == 0
    assert [len(marker.points) for marker in made["markers"].markers] == [0, 0]
    assert made["clearing"].width == 0
    assert set(LAYERS) - set(made) == {"obstruction"}  # what the body hides goes on to be hidden
    # Before any view there are masks, which cover the map; grids have no place yet.
    before = Unseen(None, "map", everywhere(), stamp, stamp)
    assert set(LAYERS["keepout_mask"].stop(before).data) == {100}
    with pytest.raises(ValueError, match="got none yet"):
        LAYERS["state"].stop(before)


def test_a_mask_without_a_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="must have a pose in 'map'"):
        LAYERS["speed_mask"].make(view())


def test_between_the_blind_range_and_each_end_of_a_clearing_beam_all_is_free() -> None:
    rng = np.random.default_rng(1)
    grid = BevGrid(40, 10.0)
    for _ in range(10):
        state = np.where(rng.random(grid.shape) < 0.95, np.uint8(F), np.uint8(H))
        shown = view(state=state, grid=grid)
        message = LAYERS["clearing"].make(shown)
        ends = sweep_of_cloud(message).points[:, :2].astype(np.float64)
        blind_m = nav2.blind_m(shown.estimate)
        assert len(ends) > 100
        for end in ends:
            length = np.hypot(*end)
            steps = end * (np.arange(0.0, length, 0.02)[:, None] / length)
            cells, inside = grid.index(steps[np.hypot(*steps.T) >= blind_m])
            assert inside.all()
            # Samples are a quarter of a cell apart: a beam may clip a cell's corner, never cross the cell.
            assert (state[cells[:, 0], cells[:, 1]] != F).sum() * 0.02 <= 0.125 * np.sqrt(2) * length


def test_what_the_body_hides_is_said_as_stvl_takes_it() -> None:
    # Hidden behind the robot: azimuths from 135° to 225°, and a strip to the right of it from 300° to 330°.
    grid = BevGrid(160, 10.0)
    azimuth = np.degrees(np.arctan2(grid.centers[..., 1], grid.centers[..., 0])) % 360
    hidden = ((azimuth > 135) & (azimuth < 225)) | ((azimuth > 300) & (azimuth < 330))
    shown = view(state=np.where(hidden, np.uint8(H), np.uint8(F)), grid=grid)
    polygons = json.loads(LAYERS["obstruction"].make(shown).data)
    spans = [(np.degrees(min(polygon[::2])), np.degrees(max(polygon[::2]))) for polygon in polygons]
    covered = sum(last - first for first, last in spans)
    # An edge is uncertain by a cell at 1 m.
    assert covered == pytest.approx(120.0, abs=15.0)
    for polygon in polygons:
        assert len(polygon) == 8
        assert 0.0 <= min(polygon[::2]) < max(polygon[::2]) <= min(polygon[::2]) + np.pi / 2 + 1e-3
        assert max(polygon[::2]) <= 2 * np.pi
        assert (min(polygon[1::2]), max(polygon[1::2])) == (-1.4, 1.4)
    for inside in (150.0, 180.0, 210.0, 315.0):
        assert any(first < inside < last for first, last in spans)
    for outside in (0.0, 90.0, 120.0, 240.0, 290.0, 345.0):
        assert not any(first < outside < last for first, last in spans)
    assert LAYERS["obstruction"].make(view(state=np.full(grid.shape, F, np.uint8), grid=grid)).data == ""
