"""Messages of an answer, one function for each topic: grids, a polygon, markers, and inputs of nav2.

Array fields are set from ``array.array``: numpy arrays would be checked element by element, a thousand times slower.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from geometry_msgs.msg import Point, PolygonStamped
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from shapely.geometry.polygon import orient
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.io.export.ros import visibility_layer
from viewshed.monitor.report import sector_corners
from viewshed_ros import nav2
from viewshed_ros.conversions import nanoseconds_of, pose_of, stamp_of
from viewshed_ros.stops import MASK_STOPS, stop_mask


@dataclass(frozen=True, slots=True)
class PosedEstimate:
    """The estimate of an answer, and its pose."""

    estimate: FovEstimate  # in the ``level`` frame of its sensor
    stamp: Any  # of the cloud
    frame: str  # of published grids, polygons and markers
    frame_from_level: Rigid  # pose of the ``level`` frame in it
    world_frame: str  # name of the map frame
    suspect: NDArray[np.bool_]  # (SECTORS,) bool, suspect sectors of the monitor
    speed_mps: float  # from which a vehicle can stop within the free cells ahead
    limits: nav2.SpeedLimits  # of the speed mask

    def header(self) -> Header:
        """Return the header of messages in ``frame``."""
        return Header(stamp=self.stamp, frame_id=self.frame)

    def world_from_level(self) -> Rigid:
        """Return the pose in the map."""
        if self.estimate.world_from_level is None:
            raise ValueError(f"a mask must have a pose in {self.world_frame!r}, got none for this sweep")
        return self.estimate.world_from_level


@dataclass(frozen=True, slots=True)
class Unseen:
    """Input of stop messages: nothing is seen any more, or nothing yet."""

    last: PosedEstimate | None  # the last view
    world_frame: str  # name of the map frame
    area: MapMetaData  # of masks in the map
    stamp: Any  # current time
    since: Any  # time of the newest sweep

    def view(self) -> PosedEstimate:
        """Return the last view with every cell UNKNOWN."""
        if self.last is None:
            raise ValueError("a view without a sweep takes the grid of the last view, got none yet")
        grid = self.last.estimate.grid
        estimate = FovEstimate(
            grid, np.zeros(grid.shape, np.float32), np.full(grid.shape, CellState.UNKNOWN, np.uint8),
            t_ns=nanoseconds_of(self.since),
        )  # fmt: skip
        suspect = np.zeros_like(self.last.suspect)
        return replace(self.last, estimate=estimate, stamp=self.stamp, suspect=suspect, speed_mps=0.0)


def own_grid(view: PosedEstimate, layer: str) -> OccupancyGrid:
    """Return a layer of :func:`viewshed.io.export.ros.visibility_layer`: visibility, state or doubt."""
    values = visibility_layer(view.estimate, layer)
    message = grid_message(values, view.estimate.grid, view.header(), view.frame_from_level)
    message.info.map_load_time = stamp_of(view.estimate.t_ns or 0)
    return message


def speed_mask(view: PosedEstimate) -> OccupancyGrid:
    """Return the mask for nav2's SpeedFilter in the map: percent of the maximum speed, 0 for no limit."""
    return _mask(view, nav2.speed_values(view.estimate, view.speed_mps, view.limits))


def keepout_mask(view: PosedEstimate) -> OccupancyGrid:
    """Return the mask for nav2's KeepoutFilter in the map: 100 in cells that are not seen, else 0."""
    return _mask(view, nav2.keepout_values(view.estimate))


def _mask(view: PosedEstimate, values: NDArray[np.int8]) -> OccupancyGrid:
    grid, in_map = nav2.in_the_map(values, view.estimate.grid, view.world_from_level())
    return grid_message(in_map, grid, Header(stamp=view.stamp, frame_id=view.world_frame), Rigid.identity())


def area_of(view: PosedEstimate) -> MapMetaData:
    """Return the area of a view's masks in the map."""
    grid = nav2.grid_in_the_map(view.estimate.grid, view.world_from_level())
    return _info(grid, stamp_of(view.estimate.t_ns or 0), Rigid.identity())


def _info(grid: BevGrid, stamp: Any, frame_from_grid: Rigid) -> MapMetaData:
    origin = pose_of(frame_from_grid @ Rigid(np.eye(3), np.array([*grid.origin_m, 0.0])))
    return MapMetaData(
        map_load_time=stamp, resolution=grid.cell_m, width=grid.cells, height=grid.cells, origin=origin
    )  # fmt: skip


def grid_message(values: NDArray[np.int8], grid: BevGrid, header: Header, frame_from_grid: Rigid) -> OccupancyGrid:
    """Return values (cells, cells), indexed (x, y), as an OccupancyGrid, whose data run along x first."""
    message = OccupancyGrid(header=header, info=_info(grid, header.stamp, frame_from_grid))
    message.data = array("b", values.T.tobytes())
    return message


def largest_part(view: PosedEstimate) -> bytes:
    """Return the largest part of the view as one ring (see :func:`keyhole`), a serialized PolygonStamped.

    Serialized here, because thousands of Python point objects would take longer than everything else.
    """
    parts = view.estimate.polygon().geoms
    corners = keyhole(max(parts, key=lambda part: part.area)) if parts else np.zeros((0, 2))
    on_ground = view.frame_from_level @ np.column_stack([corners, np.zeros(len(corners))])
    # The points come last in the message: their number, then x, y, z of each.
    empty: bytes = serialize_message(PolygonStamped(header=view.header()))
    return empty[:-4] + len(on_ground).to_bytes(4, "little") + on_ground.astype("<f4").tobytes()


def keyhole(polygon: shapely.Polygon) -> NDArray[np.float64]:
    """Return a polygon of cells with holes as one ring (N, 2): zero-width bridges connect the holes.

    >>> ring = shapely.box(0, 0, 3, 3).difference(shapely.box(1, 1, 2, 2))
    >>> round(shapely.LinearRing(keyhole(ring)).length, 6)  # 12 m outside, 4 m inside, 1 m to the hole and back
    18.0
    """
    polygon = orient(polygon)  # exterior counter-clockwise, holes clockwise
    rings = [np.asarray(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
    # 1. The vertical edges (E,) of all rings: x, y of both ends, ring, and corner at which the edge begins.
    begin, end = np.vstack(rings), np.vstack([np.roll(ring, -1, axis=0) for ring in rings])
    owner = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    corner = np.concatenate([np.arange(len(ring)) for ring in rings])
    upright = begin[:, 0] == end[:, 0]
    x, y, y_end, owner, corner = begin[upright, 0], begin[upright, 1], end[upright, 1], owner[upright], corner[upright]
    low, high = np.minimum(y, y_end), np.maximum(y, y_end)
    # 2. From the leftmost edge of each hole a bridge goes left to the next edge. It begins at the golden section of its
    #    edge, so that it hits no corner. A hole that it hits extends farther left, so bridges form no cycle.
    leftmost = np.lexsort((x, owner))[np.searchsorted(np.sort(owner), np.arange(1, len(rings)))]
    at_y = low[leftmost] + _GOLDEN * (high[leftmost] - low[leftmost])
    is_hit = (x < x[leftmost, None]) & (low < at_y[:, None]) & (at_y[:, None] < high)
    hit = np.where(is_hit, x, -np.inf).argmax(axis=1)
    # 3. Join the rings, rightmost first, so that the detours of a ring are complete when it is joined itself.
    detours: list[list[tuple[int, float, NDArray[np.float64]]]] = [[] for _ in rings]
    for hole in np.argsort(-x[leftmost]):
        first, last = leftmost[hole], hit[hole]
        there, here = np.array([[x[first], at_y[hole]], [x[last], at_y[hole]]])
        loop = _with_detours(np.roll(rings[hole + 1], -1 - corner[first], axis=0), detours[hole + 1])
        # Corners of a hole are counted from the end of the edge at which its bridge begins.
        start = 0 if owner[last] == 0 else 1 + corner[leftmost[owner[last] - 1]]
        place = int((corner[last] - start) % len(rings[owner[last]]))
        detours[owner[last]].append((place, abs(at_y[hole] - y[last]), np.vstack([here, there, loop, there, here])))
    return _with_detours(rings[0], detours[0])


_GOLDEN = (5.0**0.5 - 1.0) / 2.0


def _with_detours(
    ring: NDArray[np.float64], detours: list[tuple[int, float, NDArray[np.float64]]]
) -> NDArray[np.float64]:  # fmt: skip
    """Return a ring (N, 2) with detours (corner, distance along the edge that begins there, points) inserted."""
    parts, done = [], 0
    for place, _, detour in sorted(detours, key=lambda detour: detour[:2]):
        parts += [ring[done : place + 1], detour]
        done = place + 1
    return np.vstack([*parts, ring[done:]])


def markers(view: PosedEstimate) -> MarkerArray:
    """Return the outline of the view with its holes, and the suspect sectors as a fan."""
    rings = shapely.get_rings(view.estimate.polygon().geoms)
    corners = [Point(x=x, y=y) for x, y in shapely.get_coordinates(rings).tolist()]
    ends = np.cumsum(shapely.get_num_coordinates(rings)).tolist()
    # A LINE_LIST takes both ends of each line; there is no line from the last corner of a ring to the next ring.
    lines = [
        point for first, last in pairwise([0, *ends]) for at in range(first, last - 1) for point in corners[at : at + 2]
    ]
    outline = _marker(view, "view", Marker.LINE_LIST, lines, ColorRGBA(r=0.1, g=0.8, b=0.3, a=1.0))
    outline.scale.x = 0.1
    fans = [Point(x=x, y=y) for x, y in sector_corners(view.suspect, view.estimate.grid.half_extent_m).tolist()]
    suspect = _marker(view, "suspect", Marker.TRIANGLE_LIST, fans, ColorRGBA(r=0.9, g=0.2, b=0.1, a=0.4))
    suspect.scale.x = suspect.scale.y = suspect.scale.z = 1.0
    if not fans:
        suspect.action = Marker.DELETE
    return MarkerArray(markers=[outline, suspect])


def _marker(view: PosedEstimate, name: str, kind: int, points: list[Point], color: ColorRGBA) -> Marker:
    marker = Marker(header=view.header(), ns=name, type=kind, action=Marker.ADD, color=color)
    marker.pose = pose_of(view.frame_from_level)
    marker.points = points
    return marker


def clearing(view: PosedEstimate) -> PointCloud2:
    """Return virtual beam ends at the sensor's height; cells before each end are FREE and may be cleared."""
    ends = nav2.clearing_ends(view.estimate)
    height_m = 0.0 if view.estimate.basis is None else view.estimate.basis.sensor_height_m
    points = view.frame_from_level @ np.column_stack([ends, np.full(len(ends), height_m)])
    message = PointCloud2(header=view.header(), height=1, width=len(points), point_step=12, is_dense=True)
    message.fields = [
        PointField(name=axis, offset=4 * at, datatype=PointField.FLOAT32, count=1) for at, axis in enumerate("xyz")
    ]
    message.row_step = 12 * len(points)
    message.data = array("B", points.astype("<f4").tobytes())
    return message


def obstruction(view: PosedEstimate) -> String:
    """Return permanently obstructed directions as the value of STVL's ``obstruction_polygons``."""
    return String(data=nav2.obstruction_polygons(view.estimate))


def _unseen(make: Callable[[PosedEstimate], Any]) -> Callable[[Unseen], Any]:
    """Return a function that makes the stop message of a layer: the layer of a view with all cells UNKNOWN."""
    return lambda unseen: make(unseen.view())


def _stopped(mask: str) -> Callable[[Unseen], OccupancyGrid]:
    """Return a function that makes the stop message of a mask, with values that nav2's filters do not skip."""

    def make(unseen: Unseen) -> OccupancyGrid:
        area = copy(unseen.area)
        area.map_load_time = unseen.since
        return stop_mask(Header(stamp=unseen.stamp, frame_id=unseen.world_frame), area, MASK_STOPS[mask])

    return make


@dataclass(frozen=True, slots=True)
class Layer:
    """A topic of messages made from a view."""

    message_type: type[Any]
    make: Callable[[PosedEstimate], Any]  # makes a message, or its bytes
    latched: bool  # whether late subscribers receive the last message
    # makes the stop message; None if an old message does not claim that anything is clear
    stop: Callable[[Unseen], Any] | None


def _layer(message_type: type[Any], make: Callable[[PosedEstimate], Any], *, latched: bool) -> Layer:
    return Layer(message_type, make, latched, _unseen(make))


LAYERS = {
    "visibility": _layer(OccupancyGrid, partial(own_grid, layer="visibility"), latched=True),
    "state": _layer(OccupancyGrid, partial(own_grid, layer="state"), latched=True),
    "doubt": _layer(OccupancyGrid, partial(own_grid, layer="doubt"), latched=True),
    "view": _layer(PolygonStamped, largest_part, latched=False),
    "markers": _layer(MarkerArray, markers, latched=False),
    "speed_mask": Layer(OccupancyGrid, speed_mask, latched=True, stop=_stopped("speed_mask")),
    "keepout_mask": Layer(OccupancyGrid, keepout_mask, latched=True, stop=_stopped("keepout_mask")),
    "clearing": _layer(PointCloud2, clearing, latched=False),
    "obstruction": Layer(String, obstruction, latched=True, stop=None),
}
"""The topics of a sensor made from an estimate, by their name below the sensor's."""
