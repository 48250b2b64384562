"""Convert objects to messages: detections and tracks as cubes, explanations as JSON; and cubes back to detections."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import Vector3
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from viewshed.agents.legend import LEGEND, ShownTracks, explained_rows, tracks_of_agent
from viewshed.detections import BOX_COLUMNS, Detections, ObjectKind
from viewshed.geometry import Rigid
from viewshed_ros.conversions import pose_of, rigid_of

if TYPE_CHECKING:  # not loaded by a node without objects
    from viewshed.objects.object_stream import SeenObjects

_DETECTION_COLOR = (0.6, 0.6, 0.6)


@dataclass(frozen=True, slots=True)
class ObjectsView:
    """The objects of one answer, and their frames."""

    objects: SeenObjects  # of the sensor
    stamp: Any  # of its cloud
    frame: str  # of the sensor
    frame_from_level: Rigid  # pose of the ``level`` frame in it
    world_frame: str  # name of the map frame, for tracks if poses are known

    def tracks(self) -> tuple[ShownTracks, Header]:
        """Return the tracks in the map, or in the sensor's frame if no pose is known."""
        tracks = tracks_of_agent(self.objects)
        if self.objects.explained.tracks.in_world:
            return tracks, Header(stamp=self.stamp, frame_id=self.world_frame)
        return tracks.moved(self.frame_from_level), Header(stamp=self.stamp, frame_id=self.frame)


def detections(view: ObjectsView) -> MarkerArray:
    """Return the detections of a sweep as cubes, in the sensor's frame."""
    in_frame = view.objects.detections.moved(view.frame_from_level)
    return detection_cubes(in_frame, Header(stamp=view.stamp, frame_id=view.frame))


def tracks(view: ObjectsView) -> MarkerArray:
    """Return the tracks as cubes: color and namespace give the explanation, the text its reason."""
    return track_cubes(*view.tracks())


def explained(view: ObjectsView) -> String:
    """Return the explanation of each track as JSON."""
    shown, header = view.tracks()
    stamp = header.stamp.sec + 1e-9 * header.stamp.nanosec
    rows = explained_rows(view.objects, shown)
    return String(data=json.dumps({"t_s": round(stamp, 6), "frame": header.frame_id, "tracks": rows}))


def detection_cubes(detected: Detections, header: Header) -> MarkerArray:
    """Return detections as cubes: the namespace is the kind, the text the number of returns."""
    kinds = [ObjectKind(kind).name.lower() for kind in detected.kinds]
    rows = zip(range(len(detected)), kinds, detected.boxes, map(str, detected.returns.tolist()), strict=True)
    return _cubes(header, ((*row, _DETECTION_COLOR) for row in rows))


def track_cubes(shown: ShownTracks, header: Header) -> MarkerArray:
    """Return tracks as cubes in the colors of the legend."""
    rows = zip(shown.ids.tolist(), shown.legend.tolist(), shown.boxes, shown.reasons, strict=True)
    return _cubes(header, ((number, LEGEND[at].word, box, why, LEGEND[at].color) for number, at, box, why in rows))


def _cubes(
    header: Header, rows: Iterable[tuple[int, str, NDArray[np.float64], str, tuple[float, float, float]]]
) -> MarkerArray:
    """Return cubes (number, namespace, box, text, color) that replace all earlier ones."""
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for number, namespace, box, text, (r, g, b) in rows:
        x_m, y_m, z_m = box[3:6].tolist()
        pose = Rigid.from_yaw(float(box[BOX_COLUMNS.index("yaw")]), box[:3])
        markers.append(
            Marker(
                header=header, ns=namespace, id=number, type=Marker.CUBE, action=Marker.ADD, pose=pose_of(pose),
                scale=Vector3(x=x_m, y=y_m, z=z_m), color=ColorRGBA(r=r, g=g, b=b, a=0.6), text=text,
            )
        )  # fmt: skip
    return MarkerArray(markers=markers)


def detections_of(message: MarkerArray) -> Detections:
    """Return the detections of cubes made by :func:`detection_cubes`; other markers are ignored."""
    kinds = {kind.name.lower(): kind for kind in ObjectKind}
    cubes = [marker for marker in message.markers if marker.action == Marker.ADD and marker.type == Marker.CUBE]
    boxes = np.zeros((len(cubes), 7))
    for k, cube in enumerate(cubes):
        pose = rigid_of(cube.pose.position, cube.pose.orientation)
        boxes[k] = [*pose.translation, cube.scale.x, cube.scale.y, cube.scale.z, pose.yaw]
    returns = [int(cube.text) if cube.text.isdecimal() else 0 for cube in cubes]
    return Detections(
        boxes, np.array([kinds.get(cube.ns, ObjectKind.OTHER) for cube in cubes], np.uint8), np.array(returns, np.int32)
    )


@dataclass(frozen=True, slots=True)
class ObjectLayer:
    """A topic of objects: the type of its messages, and the function that makes them."""

    message_type: type[Any]
    make: Callable[[ObjectsView], Any]


OBJECT_LAYERS = {
    "detections": ObjectLayer(MarkerArray, detections),
    "tracks": ObjectLayer(MarkerArray, tracks),
    "explained": ObjectLayer(String, explained),
}
"""The topics of a sensor's objects, by their name below the sensor's."""
