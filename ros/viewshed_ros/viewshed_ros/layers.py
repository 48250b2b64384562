"""What is published of an answer, one function a topic: grids, a polygon, markers, and what nav2 takes.

Arrays of messages are set from ``array.array``: from numpy they would be checked element by element, a thousand times
slower.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import shapely
from geometry_msgs.msg import Point, Point32, Polygon, PolygonStamped
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from shapely.geometry.polygon import orient
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.integrity.evidence import SECTORS
from viewshed.io.export.ros import visibility_layer
from viewshed_ros import nav2
from viewshed_ros.conversions import pose_of


@dataclass(frozen=True, slots=True)
class View:
    """One answer with an estimate, and where it stands.

    Attributes:
        estimate: in the ``level`` frame of its sensor.
        stamp: of the cloud.
        frame: the frame that grids, polygons and markers are published in.
        frame_from_level: where the ``level`` frame stands in it.
        world_frame: name of the map's frame.
        suspect: (SECTORS,) bool, the sectors that the monitor suspects.
        speed_mps: from which a vehicle stops within what is seen free ahead.
        limits: of speed, for nav2.
    """

    estimate: FovEstimate
    stamp: Any
    frame: str
    frame_from_level: Rigid
    world_frame: str
    suspect: NDArray[np.bool_]
    speed_mps: float
    limits: nav2.SpeedLimits

    def header(self) -> Header:
        """Return the header of messages in ``frame``."""
        return Header(stamp=self.stamp, frame_id=self.frame)

    def world_from_level(self) -> Rigid:
        """Return the pose in the map.

        Raises:
            ValueError: it is not known.
        """
        if self.estimate.world_from_level is None:
            raise ValueError(f"a mask must have a pose in {self.world_frame!r}, got none for this sweep")
        return self.estimate.world_from_level


def own_grid(view: View, layer: str) -> OccupancyGrid:
    """Return a layer of :func:`viewshed.io.export.ros.visibility_layer`: visibility, state or doubt."""
    return grid_message(
        visibility_layer(view.estimate, layer), view.estimate.grid, view.header(), view.frame_from_level
    )


def speed_mask(view: View) -> OccupancyGrid:
    """Return the mask for nav2's SpeedFilter in the map: percent of the greatest speed, 0 for no limit."""
    return _mask(view, nav2.speed_values(view.estimate, view.speed_mps, view.limits))


def keepout_mask(view: View) -> OccupancyGrid:
    """Return the mask for nav2's KeepoutFilter in the map: 100 where nothing is seen, 0 where it is."""
    return _mask(view, nav2.keepout_values(view.estimate))


def _mask(view: View, values: NDArray[np.int8]) -> OccupancyGrid:
    grid, in_map = nav2.in_the_map(values, view.estimate.grid, view.world_from_level())
    return grid_message(in_map, grid, Header(stamp=view.stamp, frame_id=view.world_frame), Rigid.identity())


def grid_message(values: NDArray[np.int8], grid: BevGrid, header: Header, frame_from_grid: Rigid) -> OccupancyGrid:
    """Return values (cells, cells), x first, as a grid, whose data go along x first."""
    message = OccupancyGrid(header=header)
    message.info.map_load_time = header.stamp
    message.info.resolution = grid.cell_m
    message.info.width, message.info.height = values.shape
    message.info.origin = pose_of(frame_from_grid @ Rigid(np.eye(3), np.array([*grid.origin_m, 0.0])))
    message.data = array("b", values.T.tobytes())
    return message


def largest_part(view: View) -> PolygonStamped:
    """Return the largest part of the view as one ring, see :func:`keyhole`: exactly its cells."""
    parts = view.estimate.polygon().geoms
    corners = keyhole(max(parts, key=lambda part: part.area)) if parts else np.zeros((0, 2))
    on_ground = view.frame_from_level @ np.column_stack([corners, np.zeros(len(corners))])
    points = [Point32(x=x, y=y, z=z) for x, y, z in on_ground.tolist()]
    return PolygonStamped(header=view.header(), polygon=Polygon(points=points))


def keyhole(polygon: shapely.Polygon) -> NDArray[np.float64]:
    """Return a polygon with holes as one ring (N, 2) of its area: bridges without width lead to holes and back.

    >>> ring = shapely.box(0, 0, 3, 3).difference(shapely.box(1, 1, 2, 2))
    >>> shapely.LinearRing(keyhole(ring)).length  # 12 m outside, 4 m inside, 1 m to the hole and back
    18.0
    """
    polygon = orient(polygon)  # holes turn the other way
    ring, holes = np.asarray(polygon.exterior.coords)[:-1], np.array(polygon.interiors, object)
    # Next is always the hole nearest to what is joined already (Prim's tree): the shortest bridges cross nothing.
    nearest, apart_m = np.full(len(holes), polygon.exterior), shapely.distance(polygon.exterior, holes)
    for _ in holes:
        number = int(apart_m.argmin())
        hole = holes[number]
        here, there = shapely.get_coordinates(shapely.shortest_line(nearest[number], hole))
        inner = np.asarray(hole.coords)[:-1]
        cut, begin = _edge_at(ring, here) + 1, _edge_at(inner, there) + 1
        ring = np.vstack([ring[:cut], here, there, np.roll(inner, -begin, axis=0), there, here, ring[cut:]])
        # What is left may be nearer to this hole; what is joined lies infinitely far.
        apart_m[number] = np.inf
        to_hole_m = np.where(np.isinf(apart_m), np.inf, shapely.distance(hole, holes))
        nearest[to_hole_m < apart_m] = hole
        apart_m = np.minimum(apart_m, to_hole_m)
    return ring


def _edge_at(ring: NDArray[np.float64], point: NDArray[np.float64]) -> int:
    """Return the number of the edge of a ring (N, 2) that passes nearest to a point (2,)."""
    along, to_point = np.roll(ring, -1, axis=0) - ring, point - ring
    share = (to_point * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-12)
    missed = to_point - np.clip(share, 0.0, 1.0)[:, None] * along
    return int((missed * missed).sum(axis=1).argmin())


def markers(view: View) -> MarkerArray:
    """Return the outline of the view with its holes, and the suspect sectors as a fan."""
    rings = [
        np.asarray(ring.coords)
        for part in view.estimate.polygon().geoms
        for ring in (part.exterior, *part.interiors)
    ]  # fmt: skip
    # A LINE_LIST takes the two ends of each line.
    lines = [np.stack([ring[:-1], ring[1:]], axis=1).reshape(-1, 2) for ring in rings]
    outline = _marker(view, "view", Marker.LINE_LIST, lines, ColorRGBA(r=0.1, g=0.8, b=0.3, a=1.0))
    outline.scale.x = 0.1
    fans = _fans(view.suspect, view.estimate.grid.half_extent_m)
    suspect = _marker(view, "suspect", Marker.TRIANGLE_LIST, fans, ColorRGBA(r=0.9, g=0.2, b=0.1, a=0.4))
    suspect.scale.x = suspect.scale.y = suspect.scale.z = 1.0
    if not fans:
        suspect.action = Marker.DELETE
    return MarkerArray(markers=[outline, suspect])


def _fans(suspect: NDArray[np.bool_], radius_m: float) -> list[NDArray[np.float64]]:
    """Return a triangle (3, 2) for each suspect sector."""
    edges = np.linspace(-np.pi, np.pi, SECTORS + 1)
    on_circle = radius_m * np.column_stack([np.cos(edges), np.sin(edges)])
    return [np.vstack([np.zeros(2), on_circle[number : number + 2]]) for number in np.flatnonzero(suspect)]


def _marker(view: View, name: str, kind: int, parts: Iterable[NDArray[np.float64]], color: ColorRGBA) -> Marker:
    marker = Marker(header=view.header(), ns=name, type=kind, action=Marker.ADD, color=color)
    marker.pose = pose_of(view.frame_from_level)
    marker.points = [Point(x=x, y=y) for part in parts for x, y in part.tolist()]
    return marker


def clearing(view: View) -> PointCloud2:
    """Return virtual ends of beams at the sensor's height: what lies before each is FREE, and may be cleared."""
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


def obstruction(view: View) -> String:
    """Return what hides the view from the beginning as the value of STVL's ``obstruction_polygons``."""
    return String(data=nav2.obstruction_polygons(view.estimate))


@dataclass(frozen=True, slots=True)
class Layer:
    """A topic: the type of its messages, what makes them, and whether who comes late is given the last one."""

    message_type: type[Any]
    make: Callable[[View], Any]
    latched: bool


LAYERS = {
    "visibility": Layer(OccupancyGrid, partial(own_grid, layer="visibility"), latched=True),
    "state": Layer(OccupancyGrid, partial(own_grid, layer="state"), latched=True),
    "doubt": Layer(OccupancyGrid, partial(own_grid, layer="doubt"), latched=True),
    "view": Layer(PolygonStamped, largest_part, latched=False),
    "markers": Layer(MarkerArray, markers, latched=False),
    "speed_mask": Layer(OccupancyGrid, speed_mask, latched=True),
    "keepout_mask": Layer(OccupancyGrid, keepout_mask, latched=True),
    "clearing": Layer(PointCloud2, clearing, latched=False),
    "obstruction": Layer(String, obstruction, latched=True),
}
"""The topics of a sensor that are made from an estimate, by name below the sensor's."""
