"""Convert moments to Foxglove's schemas, for MCAP files that are readable without ROS and for a live server."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed.agents.legend import LEGEND, ShownTracks, tracks_of_agent, tracks_of_center
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.polygons import star_ring
from viewshed.geometry import Rigid, quaternion_from_rotation
from viewshed.io.export.ros import visibility_layer
from viewshed.io.messages.pointcloud2 import cloud_table
from viewshed.monitor.report import sector_corners
from viewshed.objects.object_stream import SeenObjects
from viewshed.recordings.write.bag_writers import Schema
from viewshed.recordings.write.moment import MAP, Moment, Severity
from viewshed.recordings.write.ros_topics import rigid_of_box

LAYERS = ("visibility", "state", "doubt")
"""Fields of the grid, int8 each; see :func:`visibility_layer`."""

_VISIBLE, _SUSPECT, _OBJECT = (0.1, 0.7, 0.5, 1.0), (0.9, 0.1, 0.1, 0.35), (0.2, 0.7, 1.0, 0.5)
_LEVELS = {Severity.OK: "Info", Severity.WARNING: "Warning", Severity.ERROR: "Error"}
_NUMERIC_TYPES = {"<f4": "Float32", "<u2": "Uint16", "|i1": "Int8"}


def foxglove_types() -> Any:
    """Return the message types of foxglove-sdk.

    Raises:
        ImportError: it is not installed.
    """
    with needed_for("writing Foxglove's schemas"):
        from foxglove import messages
    return messages


def _fields(table: np.dtype[Any]) -> list[Any]:
    """Return the Foxglove fields of a structured dtype."""
    fox, columns = foxglove_types(), dict[str, Any](table.fields or {})
    return [
        fox.PackedElementField(
            name=name, offset=offset, type=getattr(fox.PackedElementFieldNumericType, _NUMERIC_TYPES[form.str])
        )
        for name, (form, offset) in columns.items()
    ]


def foxglove_messages(moment: Moment) -> Iterator[tuple[str, Schema, bytes]]:
    """Yield (topic, schema, bytes) of the messages of a moment."""
    fox = foxglove_types()
    agent, stamp = moment.agent, _stamp(moment.t_ns)
    messages: list[tuple[str, Any]] = [("/tf", _transforms(moment)), (f"/{agent}/lidar/data", _cloud(moment))]
    if moment.answer.estimate is not None:
        messages.append((f"/{agent}/lidar/fov", _grid(moment.answer.estimate, stamp, moment.level_frame)))
    messages.append((f"/{agent}/lidar/scene", fox.SceneUpdate(entities=_entities(moment))))
    for sentence in moment.alarms() or [moment.summary()]:
        level = getattr(fox.LogLevel, _LEVELS[moment.verdict()])
        messages.append(("/log", fox.Log(timestamp=stamp, level=level, message=sentence, name=agent)))
    if moment.answer.objects is not None:
        messages.append(
            (f"/{agent}/lidar/objects", fox.SceneUpdate(entities=_object_entities(moment, moment.answer.objects)))
        )
    if moment.round is not None:
        completed, round_stamp = moment.round, _stamp(moment.round.t_ns)
        tracks = _tracks_entity(tracks_of_center(completed.picture), round_stamp, MAP)
        messages.append(("/command_center/objects", fox.SceneUpdate(entities=[tracks])))
        estimate = completed.joint.estimate(completed.t_ns)
        messages.append(("/command_center/fov", _grid(estimate, round_stamp, MAP, completed.joint.world_from_grid)))
        level = fox.LogLevel.Warning
        messages += [
            ("/log", fox.Log(timestamp=stamp, level=level, message=sentence, name="command_center"))
            for sentence in completed.sentences()
        ]
    for topic, message in messages:
        schema = message.get_schema()
        yield topic, Schema(schema.name, schema.encoding, "protobuf", schema.data), message.encode()
    yield from _plain_messages(moment)


def _plain_messages(moment: Moment) -> Iterator[tuple[str, Schema, bytes]]:
    """Yield the data without a Foxglove schema as JSON: explained tracks, metrics, trust, picture."""
    agent, completed = moment.agent, moment.round
    values: dict[str, object] = {
        f"/{agent}/lidar/explained": None if moment.answer.objects is None else {"tracks": moment.explained()},
        f"/metrics/{agent}": dict(moment.metrics) or None,
        f"/trust/{agent}": None if moment.trust is None else {"trust": moment.trust},
        "/command_center/picture": None if completed is None else completed.numbers(),
    }
    for topic, value in values.items():
        if value is not None:
            yield topic, _JSON, json.dumps(value, ensure_ascii=False).encode()


_HOST = "127.0.0.1"
_JSON = Schema("viewshed", "jsonschema", "json", b'{"type": "object"}')


def _stamp(t_ns: int) -> Any:
    return foxglove_types().Timestamp(*divmod(t_ns, 1_000_000_000))


def _pose(rigid: Rigid) -> Any:
    return foxglove_types().Pose(position=_vector(rigid.translation), orientation=_quaternion(rigid))


def _quaternion(rigid: Rigid) -> Any:
    w, x, y, z = quaternion_from_rotation(rigid.rotation).tolist()
    return foxglove_types().Quaternion(x=x, y=y, z=z, w=w)


def _transforms(moment: Moment) -> Any:
    """Return all transforms; static ones are repeated for viewers that connect later."""
    fox = foxglove_types()
    return fox.FrameTransforms(transforms=[
        fox.FrameTransform(
            timestamp=_stamp(moment.t_ns), parent_frame_id=edge.parent, child_frame_id=edge.child,
            translation=_vector(edge.parent_from_child.translation), rotation=_quaternion(edge.parent_from_child),
        )
        for edge in (*moment.static_transforms(), *moment.transforms())
    ])  # fmt: skip


def _cloud(moment: Moment) -> Any:
    table = cloud_table(moment.sweep)
    return foxglove_types().PointCloud(
        timestamp=_stamp(moment.t_ns), frame_id=moment.sensor_frame, pose=_pose(Rigid.identity()),
        point_stride=table.dtype.itemsize, fields=_fields(table.dtype), data=table.tobytes(),
    )  # fmt: skip


def _grid(estimate: FovEstimate, stamp: Any, frame: str, frame_from_grid: Rigid | None = None) -> Any:
    """Return all layers as one Grid; its columns go along x and its rows along y."""
    fox = foxglove_types()
    grid = estimate.grid
    corner = Rigid(np.eye(3), np.array([*grid.origin_m, 0.0]))
    cells = np.stack([visibility_layer(estimate, name).T for name in LAYERS], axis=-1)
    return fox.Grid(
        timestamp=stamp, frame_id=frame, pose=_pose(corner if frame_from_grid is None else frame_from_grid @ corner),
        column_count=grid.cells, cell_size=fox.Vector2(x=grid.cell_m, y=grid.cell_m),
        row_stride=grid.cells * len(LAYERS), cell_stride=len(LAYERS),
        fields=_fields(np.dtype([(name, "i1") for name in LAYERS])),
        data=cells.tobytes(),
    )  # fmt: skip


def _entities(moment: Moment) -> list[Any]:
    """Return the outline of the visible area, the suspect sectors and the ground truth objects.

    An entity replaces the previous one with its id, so that an empty one clears it.
    """
    fox = foxglove_types()
    stamp, estimate, report = _stamp(moment.t_ns), moment.answer.estimate, moment.answer.report
    lines, triangles = [], []
    if estimate is not None:
        corners = _points(star_ring(estimate.visible(), estimate.grid))
        loop = fox.LinePrimitiveLineType.LineLoop
        lines.append(
            fox.LinePrimitive(
                type=loop, pose=_pose(Rigid.identity()), thickness=0.15, points=corners, color=_color(_VISIBLE)
            )
        )
    if estimate is not None and report is not None and report.suspect.any():
        corners = _points(sector_corners(report.suspect, estimate.grid.half_extent_m))
        triangles.append(
            fox.TriangleListPrimitive(pose=_pose(Rigid.identity()), points=corners, color=_color(_SUSPECT))
        )
    entities = [
        fox.SceneEntity(timestamp=stamp, frame_id=moment.level_frame, id="visible", lines=lines),
        fox.SceneEntity(timestamp=stamp, frame_id=moment.level_frame, id="suspect", triangles=triangles),
    ]
    if moment.truth is not None:
        cubes = [_cube(item.world_from_box, item.size_m, _OBJECT) for item in moment.truth.objects]
        entities.append(fox.SceneEntity(timestamp=stamp, frame_id=MAP, id="objects", cubes=cubes))
    return entities


def _object_entities(moment: Moment, objects: SeenObjects) -> list[Any]:
    """Return detections, and tracks in the colors of their explanations with labels."""
    fox, stamp = foxglove_types(), _stamp(moment.t_ns)
    detections = [_box_cube(box, (0.6, 0.6, 0.6, 0.25)) for box in objects.detections.boxes]
    return [
        fox.SceneEntity(timestamp=stamp, frame_id=moment.level_frame, id="detections", cubes=detections),
        _tracks_entity(tracks_of_agent(objects), stamp, moment.tracks_frame),
    ]


def _tracks_entity(tracks: ShownTracks, stamp: Any, frame: str) -> Any:
    """Return tracks as one entity: cubes in the color of their explanation, labeled with id and explanation."""
    fox = foxglove_types()
    cubes, texts = [], []
    for number, index, box in zip(tracks.ids.tolist(), tracks.legend.tolist(), tracks.boxes, strict=True):
        word, color = LEGEND[index]
        cubes.append(_box_cube(box, (*color, 0.6)))
        above = Rigid(np.eye(3), box[:3] + np.array([0.0, 0.0, box[5] / 2 + 0.6]))
        texts.append(
            fox.TextPrimitive(
                pose=_pose(above), billboard=True, font_size=0.8, color=_color((*color, 1.0)), text=f"{number} {word}"
            )
        )
    return fox.SceneEntity(timestamp=stamp, frame_id=frame, id="tracks", cubes=cubes, texts=texts)


def _box_cube(box: NDArray[np.float64], color: tuple[float, float, float, float]) -> Any:
    return _cube(rigid_of_box(box), box[3:6], color)


def _points(corners: NDArray[np.float64]) -> list[Any]:
    fox = foxglove_types()
    return [fox.Point3(x=x, y=y, z=0.05) for x, y in corners.tolist()]


def _color(rgba: tuple[float, float, float, float]) -> Any:
    r, g, b, a = rgba
    return foxglove_types().Color(r=r, g=g, b=b, a=a)


def _cube(world_from_box: Rigid, size_m: Iterable[float], color: tuple[float, float, float, float]) -> Any:
    return foxglove_types().CubePrimitive(pose=_pose(world_from_box), size=_vector(size_m), color=_color(color))


def _vector(xyz: Iterable[float]) -> Any:
    x, y, z = map(float, xyz)
    return foxglove_types().Vector3(x=x, y=y, z=z)


@contextmanager
def foxglove_server(port: int) -> Iterator[Callable[[Moment], None]]:
    """Serve moments live to Foxglove on localhost; yield the function that takes them. Port 0 picks a free port.

    Raises:
        ImportError: foxglove-sdk is not installed.
        OSError: the port is not available.
    """
    foxglove_types()
    import foxglove

    context = foxglove.Context()
    try:
        server = foxglove.start_server(name="viewshed", host=_HOST, port=port, context=context)
    except Exception as error:  # foxglove has its own exception types
        raise OSError(f"port {port} of {_HOST} cannot be served: {error}; choose another --foxglove") from error
    channels: dict[str, Any] = {}

    def record(moment: Moment) -> None:
        for topic, schema, raw in foxglove_messages(moment):
            if topic not in channels:
                declared = foxglove.Schema(name=schema.name, encoding=schema.encoding, data=schema.definition)
                channels[topic] = foxglove.Channel(
                    topic, schema=declared, message_encoding=schema.message_encoding, context=context
                )
            channels[topic].log(raw, log_time=moment.t_ns)

    try:
        yield record
    finally:
        server.stop()
