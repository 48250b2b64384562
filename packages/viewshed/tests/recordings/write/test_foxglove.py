"""Foxglove's schemas: read back by the mcap package and by their own definitions in the file."""

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.recordings.write.moments import doubted, drive_moments, write

from viewshed.io.export.ros import visibility_layer
from viewshed.recordings.write.moment import Moment

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: its schemas are not written")
pytest.importorskip("mcap", reason="mcap is not installed: its files are not read back")
protobuf: Any = pytest.importorskip("google.protobuf", reason="protobuf is not installed: messages are not decoded")


pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


@pytest.fixture(scope="module")
def drive() -> list[Moment]:
    return drive_moments()


def _decoded(place: Path) -> dict[str, list[tuple[int, Any]]]:
    """Topic → (time, message), decoded by the definitions in the file alone."""
    from mcap.reader import make_reader

    pool_module, pb2 = import_module("google.protobuf.descriptor_pool"), import_module("google.protobuf.descriptor_pb2")
    factory = import_module("google.protobuf.message_factory")
    pool, found = pool_module.DescriptorPool(), dict[str, list[tuple[int, Any]]]()
    known: dict[str, Any] = {}
    with place.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            if schema.name not in known:
                for each in pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(each)
                known[schema.name] = factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            found.setdefault(channel.topic, []).append((message.log_time, known[schema.name].FromString(message.data)))
    return found


def test_a_drive_in_foxgloves_schemas(drive: list[Moment], tmp_path: Path) -> None:
    found = _decoded(write(tmp_path / "run.mcap", drive, "foxglove"))
    agents = sorted({moment.agent for moment in drive})
    expected = {f"/{agent}/lidar/{part}" for agent in agents for part in ("data", "fov", "scene")}
    assert set(found) == expected | {"/tf", "/log"}
    moment = drive[0]
    estimate = moment.answer.estimate
    t_ns, cloud = found[f"/{moment.agent}/lidar/data"][0]
    assert t_ns == moment.t_ns == cloud.timestamp.seconds * 1_000_000_000 + cloud.timestamp.nanos
    points = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)[:, :12].copy().view("<f4")
    np.testing.assert_array_equal(points, moment.sweep.points)
    _, grid = found[f"/{moment.agent}/lidar/fov"][0]
    cells = np.frombuffer(grid.data, np.int8).reshape(grid.column_count, grid.column_count, 3)
    for k, field in enumerate(grid.fields):
        np.testing.assert_array_equal(cells[..., k].T, visibility_layer(estimate, field.name))
    assert (grid.frame_id, grid.pose.position.x) == (f"{moment.agent}/level", -64.0)
    _, scene = found[f"/{moment.agent}/lidar/scene"][0]
    assert [entity.id for entity in scene.entities] == ["visible", "suspect", "objects"]
    assert len(scene.entities[0].lines[0].points) > 100
    assert len(scene.entities[2].cubes) == len(moment.truth.objects)
    _, log = found["/log"][0]
    assert (log.name, log.message.partition(" ")[0]) == (moment.agent, "visible")


def test_alarms_are_logged_and_suspect_sectors_drawn(drive: list[Moment], tmp_path: Path) -> None:
    found = _decoded(write(tmp_path / "run.mcap", [doubted(drive[0]), drive[0]], "foxglove"))
    levels = [(log.level, log.message) for _, log in found["/log"]]
    error, info = 4, 2
    assert levels[:2] == [(error, "a wall hangs in the air"), (error, "and moves")]
    assert levels[2][0] == info
    scenes = [scene for _, scene in found[f"/{drive[0].agent}/lidar/scene"]]
    assert [len(scene.entities[1].triangles) for scene in scenes] == [1, 0]
    assert len(scenes[0].entities[1].triangles[0].points) == 6


def test_the_layout_names_topics_fields_and_frames_that_exist(drive: list[Moment], tmp_path: Path) -> None:
    tool: Any = import_module("foxglove_layout")
    assert json.loads(tool.PLACE.read_text(encoding="utf-8")) == tool.layout()
    moment = drive[0]
    found = _decoded(write(tmp_path / "run.mcap", [moment], "foxglove"))
    view, log = (item["content"] for item in tool.layout(moment.agent)["content"]["items"])
    assert (view["panelType"], log["panelType"], log["config"]["topicToRender"]) == ("ThreeDee", "Log", "/log")
    of_tracks = {f"/{moment.agent}/lidar/objects", "/command_center/objects"}
    for topic, settings in view["config"]["topics"].items():
        assert topic in found or topic in of_tracks
        if "colorField" in settings:
            assert settings["colorField"] in {field.name for field in found[topic][0][1].fields}
    frames = {
        name
        for _, each in found["/tf"]
        for one in each.transforms
        for name in (one.parent_frame_id, one.child_frame_id)
    }
    assert view["config"]["followTf"] in frames
    assert {found[f"/{moment.agent}/lidar/{part}"][0][1].frame_id for part in ("data", "fov")} <= frames
