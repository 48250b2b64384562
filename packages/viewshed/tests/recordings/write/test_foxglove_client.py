"""What a viewer gets from ``viewshed view --foxglove``: a client of the WebSocket by hand, and the layout for it."""

import base64
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from tests.recordings.write.moments import drive_moments

from viewshed.io.export.ros import visibility_layer
from viewshed.recordings.write.moment import Moment

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: nothing is served")
protobuf: Any = pytest.importorskip("google.protobuf", reason="protobuf is not installed: messages are not decoded")

TEXT, MESSAGE_DATA = 1, 1
"""Opcodes: of a WebSocket's frame, and of a binary message of Foxglove's protocol."""


class Client:
    """A client of a Foxglove server.

    Args:
        connection: to it.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._stream = connection, connection.makefile("rb")
        connection.sendall(
            b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        )
        assert b"101" in self._stream.readline()
        while self._stream.readline().strip():
            pass

    def send(self, **said: object) -> None:
        """Send JSON; what a client sends is masked, here by zeros."""
        content = json.dumps(said).encode()
        assert len(content) < 1 << 16
        self._connection.sendall(bytes((0x80 | TEXT, 0x80 | 126)) + len(content).to_bytes(2) + bytes(4) + content)

    def take(self) -> dict[str, Any] | tuple[int, bytes]:
        """Return the next JSON, or the subscription and the content of the next message."""
        while True:
            opcode, size = self._stream.read(2)
            length = size & 127
            if length >= 126:
                length = int.from_bytes(self._stream.read(2 if length == 126 else 8), "big")
            content = self._stream.read(length)
            if opcode & 15 == TEXT:
                return dict(json.loads(content))
            if content[:1] == bytes((MESSAGE_DATA,)):
                return int.from_bytes(content[1:5], "little"), content[13:]

    def channels(self, count: int) -> dict[str, dict[str, Any]]:
        """Return channels by topic, when so many are advertised."""
        found: dict[str, dict[str, Any]] = {}
        while len(found) < count:
            said = self.take()
            if isinstance(said, dict):
                found |= {channel["topic"]: channel for channel in said.get("channels", ())}
        return found


@contextmanager
def served() -> Iterator[tuple[Any, Client]]:
    """Start a server; yield what takes its moments, and a client."""
    from viewshed.recordings.write.foxglove_topics import foxglove_server

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with foxglove_server(port) as record, socket.create_connection(("127.0.0.1", port), timeout=20) as connection:
        yield record, Client(connection)


def message_class(channel: dict[str, Any]) -> Any:
    """Return the class of a channel's messages, by nothing but the schema that came with it."""
    assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
    pool_module, pb2 = import_module("google.protobuf.descriptor_pool"), import_module("google.protobuf.descriptor_pb2")
    pool = pool_module.DescriptorPool()
    for each in pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
        pool.Add(each)
    factory: Any = import_module("google.protobuf.message_factory")
    return factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


@pytest.fixture(scope="module")
def moment() -> Moment:
    return drive_moments()[0]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_viewer_reads_all_topics_by_their_schemas_and_the_layout_names_only_these(moment: Moment) -> None:
    with served() as (record, client):
        record(moment)
        channels = client.channels(5)
        client.send(
            op="subscribe",
            subscriptions=[{"id": number, "channelId": each["id"]} for number, each in enumerate(channels.values())],
        )
        # A subscription begins when it has arrived: moments go on until each topic has come.
        topics, got, done = list(channels), dict[str, Any](), threading.Event()

        def go_on() -> None:
            while not done.wait(0.1):
                record(moment)

        feeder = threading.Thread(target=go_on)
        feeder.start()
        try:
            while len(got) < len(topics):
                said = client.take()
                if isinstance(said, tuple):
                    topic = topics[said[0]]
                    got[topic] = message_class(channels[topic]).FromString(said[1])
        finally:
            done.set()
            feeder.join()
    # 1. Topics and their schemas.
    agent = moment.agent
    kinds = {
        "/tf": "FrameTransforms", "/log": "Log", f"/{agent}/lidar/data": "PointCloud", f"/{agent}/lidar/fov": "Grid",
        f"/{agent}/lidar/scene": "SceneUpdate",
    }  # fmt: skip
    assert {topic: channel["schemaName"] for topic, channel in channels.items()} == {
        topic: f"foxglove.{kind}" for topic, kind in kinds.items()
    }
    # 2. What came is the moment's.
    estimate = moment.answer.estimate
    assert estimate is not None
    cloud, grid = got[f"/{agent}/lidar/data"], got[f"/{agent}/lidar/fov"]
    assert len(cloud.data) == len(moment.sweep) * cloud.point_stride
    cells = np.frombuffer(grid.data, np.int8).reshape(grid.column_count, grid.column_count, -1)
    np.testing.assert_array_equal(cells[..., 0].T, visibility_layer(estimate, grid.fields[0].name))
    # 3. The layout, for this agent, names topics that came or that come with tracks, fields that they have, and a frame
    # that is placed.
    tool: Any = import_module("foxglove_layout")
    view, log = (item["content"] for item in tool.layout(agent)["content"]["items"])
    assert (view["panelType"], log["panelType"], log["config"]["topicToRender"]) == ("ThreeDee", "Log", "/log")
    fields = {
        topic: {field.name for field in got[topic].fields} for topic in (f"/{agent}/lidar/data", f"/{agent}/lidar/fov")
    }
    for topic, settings in view["config"]["topics"].items():
        assert topic in got or topic in {f"/{agent}/lidar/objects", "/command_center/objects"}
        if "colorField" in settings:
            assert settings["colorField"] in fields[topic]
    frames = {name for each in got["/tf"].transforms for name in (each.parent_frame_id, each.child_frame_id)}
    assert view["config"]["followTf"] in frames
    assert {cloud.frame_id, grid.frame_id, got[f"/{agent}/lidar/scene"].entities[0].frame_id} <= frames
