"""Objects, the adversary and the center on a real graph: honest clouds in, forged ones on, tracks and trust out."""

import json
import time
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from messages import cloud
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, String, UInt8MultiArray
from visualization_msgs.msg import Marker, MarkerArray

pytest.importorskip("scipy", reason="scipy is not installed: nothing is tracked")
pytest.importorskip("cwt", reason="cwt is not installed: nothing is signed")

from viewshed.agents.receiver import Receiver
from viewshed.agents.signing import KeyRing, SigningKey, sign_message
from viewshed.agents.view_message import SensorFacts, ViewMessage
from viewshed.detections import Detections, ObjectKind
from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io.samples import junction_path
from viewshed_ros.adversary import AdversaryNode
from viewshed_ros.center import VIEWS, CenterNode
from viewshed_ros.conversions import pose_of, stamp_of
from viewshed_ros.node import FieldOfView
from viewshed_ros.object_layers import OBJECT_LAYERS, detection_cubes, detections_of
from viewshed_ros.sharing import POSE_COVARIANCE

POINTS = read_sweep(junction_path()).points
CAR, MAST = SigningKey("car", bytes(range(32))), SigningKey("mast", bytes(range(1, 33)))
WORLD_FROM_SENSOR = Rigid.from_yaw(0.5, (10.0, 3.0, 1.8))


class Graph:
    """A car's node, an adversary before it, a center behind it, and this test as sensor, mast and listener."""

    def __init__(self, folder: Path) -> None:
        for key in (CAR, MAST):
            (folder / f"{key.agent}.pub").write_text(key.public.hex())
        (folder / "car.key").write_text(CAR.private.hex() + "\n")
        (folder / "car.key").chmod(0o600)
        self.adversary = AdversaryNode(parameter_overrides=parameters(
            attack="far_wall", topic="honest", forged_topic="lidar/points", start_s=1.0, end_s=1e6
        ))  # fmt: skip
        self.car = FieldOfView(parameter_overrides=parameters(
            objects=True, agent="car", agent_key=str(folder / "car.key"), pose_source="odometry", pose_wait_s=0.3,
            grid="road", monitor="never", rate_hz=0.0,
        ))  # fmt: skip
        self.center = CenterNode(parameter_overrides=parameters(
            agents=["car", "mast"], keys=[str(folder / "car.pub"), str(folder / "mast.pub")], diagnostics_hz=5.0
        ))  # fmt: skip
        self.node = Node("around")
        self.executor = SingleThreadedExecutor()
        for each in (self.adversary, self.car, self.center, self.node):
            self.executor.add_node(each)
        assert self.car.trigger_configure() == TransitionCallbackReturn.SUCCESS
        assert self.car.trigger_activate() == TransitionCallbackReturn.SUCCESS
        self.honest = self.node.create_publisher(PointCloud2, "honest", qos_profile_sensor_data)
        self.odometry = self.node.create_publisher(Odometry, "odometry", 10)
        self.views = self.node.create_publisher(UInt8MultiArray, "/viewshed/views", VIEWS)
        self.got: dict[str, list[Any]] = {}
        for name, layer in OBJECT_LAYERS.items():
            self.subscribe(layer.message_type, f"lidar/{name}", 10)
        for kind, topic in (
            (MarkerArray, "center/tracks"), (String, "center/picture"), (Float64, "center/trust/car"),
            (OccupancyGrid, "center/visibility"), (DiagnosticArray, "/diagnostics"),
        ):  # fmt: skip
            self.subscribe(kind, topic, 10)
        self.subscribe(UInt8MultiArray, "/viewshed/views", VIEWS)
        self.subscribe(PointCloud2, "lidar/points", qos_profile_sensor_data)
        self.until(lambda: self.honest.get_subscription_count() == 1 and self.views.get_subscription_count() == 2)
        self.sequence = 0

    def subscribe(self, kind: type[Any], topic: str, qos: Any) -> None:
        self.got[topic] = []
        self.node.create_subscription(kind, topic, self.got[topic].append, qos)

    def until(self, is_so: Callable[[], bool], seconds: float = 30.0) -> None:
        end = time.monotonic() + seconds
        while not is_so():
            assert time.monotonic() < end, f"not within {seconds} s"
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def drive(self) -> int:
        """Publish a cloud and the odometry around it until the car's tracks of it come, and return its time.

        A cloud is sent at best effort, and may be lost.
        """
        for _ in range(10):
            t_ns = time.time_ns()
            for at_ns in (t_ns - 10**8, t_ns + 10**8):
                message = Odometry()
                message.header.stamp, message.header.frame_id = stamp_of(at_ns), "map"
                message.pose.pose = pose_of(WORLD_FROM_SENSOR)
                self.odometry.publish(message)
            self.executor.spin_once(timeout_sec=0.05)
            self.honest.publish(cloud(POINTS, t_ns))
            stamp, end = stamp_of(t_ns), time.monotonic() + 5.0
            while time.monotonic() < end:
                self.executor.spin_once(timeout_sec=0.05)
                if any(each.markers[0].header.stamp == stamp for each in self.got["lidar/tracks"]):
                    return t_ns
        raise AssertionError("no tracks came")

    def tell_as_mast(self, t_ns: int, shared: ViewMessage) -> None:
        """Publish what the car reported, as the mast, from the same place."""
        self.sequence += 1
        message = ViewMessage(
            "mast", self.sequence, t_ns, "map", shared.world_from_level, POSE_COVARIANCE, SensorFacts("mast", 1.8),
            view=shared.view, detections=shared.detections,
        )  # fmt: skip
        self.views.publish(UInt8MultiArray(data=array("B", sign_message(message, MAST))))

    def reported(self, word: str) -> bool:
        return any(word in str(message) for message in self.got["/diagnostics"][-6:])


def parameters(**given: Any) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in given.items()]


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    rclpy.init()
    made = Graph(tmp_path_factory.mktemp("keys"))
    try:
        yield made
    finally:
        made.car._release()
        rclpy.try_shutdown()


def test_tracks_are_published_with_their_explanations_and_objects_are_told_to_the_center(graph: Graph) -> None:
    receiver = Receiver(KeyRing((CAR.verifying(),)))
    for _ in range(30):  # what a loaded machine tells too late is refused
        t_ns = graph.drive()
        graph.spin(0.2)
        shared = None
        for message in graph.got["/viewshed/views"]:
            shared = receiver.receive(bytes(message.data), t_ns).message or shared
        if shared is None or shared.t_ns != t_ns:  # lost on its way
            continue
        assert (shared.agent, shared.t_ns) == ("car", t_ns)
        assert shared.view is not None
        assert shared.detections is not None
        graph.tell_as_mast(t_ns, shared)
        graph.spin(0.3)
        graph.got["/viewshed/views"].clear()
        if len(graph.got["center/picture"]) >= 5:
            break
    graph.until(lambda: len(graph.got["center/visibility"]) > 0)
    explained = json.loads(graph.got["lidar/explained"][-1].data)
    assert explained["frame"] == "map"
    assert len(explained["tracks"]) > 5
    assert all(track["explanation"] and track["reason"] for track in explained["tracks"])
    markers = graph.got["lidar/tracks"][-1].markers
    assert (markers[0].action, len(markers) - 1) == (Marker.DELETEALL, len(explained["tracks"]))
    assert [each.ns for each in markers[1:]] == [track["explanation"] for track in explained["tracks"]]
    assert len(graph.got["lidar/detections"][-1].markers) > 10
    # The center: when the last round came, joint tracks, trust in each agent, the joint view.
    assert time.monotonic() - graph.center._done_s < 60.0
    picture = json.loads(graph.got["center/picture"][-1].data)
    assert set(picture["agents"]) == {"car", "mast"}
    assert any(sorted(one["reported_by"]) == ["car", "mast"] for one in picture["objects"])
    assert len(graph.got["center/tracks"][-1].markers) > 5
    assert graph.got["center/trust/car"][-1].data == pytest.approx(picture["agents"]["car"]["trust"], abs=1e-3)
    assert (np.array(graph.got["center/visibility"][-1].data, np.int8) > 50).sum() > 1000


def test_a_forged_message_is_refused_and_counted(graph: Graph) -> None:
    stranger = SigningKey("mast", bytes(range(2, 34)))
    message = ViewMessage("mast", 10**6, time.time_ns(), "map", Rigid.identity(), POSE_COVARIANCE, SensorFacts("x"))
    graph.views.publish(UInt8MultiArray(data=array("B", sign_message(message, stranger))))
    graph.views.publish(UInt8MultiArray(data=array("B", bytes(100))))
    graph.until(lambda: graph.reported("signed by a key that is not known"))
    graph.until(lambda: graph.reported("no signed message"))
    graph.until(lambda: graph.reported("trust of mast"))
    # No valid message, no round: what the center said of the last one is no word of now.
    graph.until(lambda: graph.reported("nothing is known about the present"))


def test_a_message_without_a_view_is_noted(graph: Graph) -> None:
    graph.sequence += 1
    message = ViewMessage(
        "mast", graph.sequence, time.time_ns(), "map", Rigid.identity(), POSE_COVARIANCE, SensorFacts("x")
    )
    graph.views.publish(UInt8MultiArray(data=array("B", sign_message(message, MAST))))
    graph.until(lambda: graph.reported("mast: sends no field of view, which a center needs"))


def test_clouds_are_forged_from_the_start_on(graph: Graph) -> None:
    def is_forged(message: PointCloud2) -> bool:
        assert message.header.frame_id == "lidar"
        points = np.frombuffer(bytes(message.data), np.uint8).reshape(-1, message.point_step)[:, :12].copy()
        return points.tobytes() != POINTS.astype("<f4").tobytes()

    for _ in range(20):
        if graph.got["lidar/points"] and is_forged(graph.got["lidar/points"][-1]):
            break
        graph.drive()
    forged = [is_forged(message) for message in graph.got["lidar/points"]]
    assert forged[-1]
    assert not forged[0]
    assert forged == sorted(forged)


def test_cubes_are_detections_again_and_can_be_forged(graph: Graph) -> None:
    boxes = np.array([[12.0, 3.0, 0.8, 4.2, 1.8, 1.5, 0.4], [-8.0, 9.0, 0.9, 0.6, 0.6, 1.7, -2.0]])
    found = Detections(boxes, np.array([ObjectKind.CAR, ObjectKind.PEDESTRIAN]), np.array([40, 9]))
    back = detections_of(detection_cubes(found, cloud(POINTS[:1]).header))
    np.testing.assert_allclose(back.boxes, boxes, atol=1e-9)
    assert (back.kinds.tolist(), back.returns.tolist()) == (found.kinds.tolist(), [40, 9])
    forger = AdversaryNode(parameter_overrides=parameters(
        attack="fabricate_static", type="detections", topic="found", forged_topic="found_forged", start_s=0.0, count=3
    ))  # fmt: skip
    graph.executor.add_node(forger)
    graph.subscribe(MarkerArray, "found_forged", 5)
    sender = graph.node.create_publisher(MarkerArray, "found", 5)
    graph.until(lambda: sender.get_subscription_count() == 1)
    sender.publish(detection_cubes(found, cloud(POINTS[:1], frame="map").header))
    graph.until(lambda: len(graph.got["found_forged"]) > 0)
    assert len(detections_of(graph.got["found_forged"][-1])) == 5


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"agent": "car"}, "agent car needs one sensor, a pose_source and an agent_key"),
        ({"agent": "car", "pose_source": "odometry", "agent_key": "KEY"}, "a key must be 64 hexadecimal digits"),
    ],
)
def test_an_agent_without_key_or_poses_is_refused(
    capfd: pytest.CaptureFixture[str], graph: Graph, tmp_path: Path, given: dict[str, Any], message: str
) -> None:
    if "agent_key" in given:
        key = tmp_path / "key"
        key.write_text("no key")
        key.chmod(0o600)
        given = given | {"agent_key": str(key)}
    node = FieldOfView(parameter_overrides=parameters(monitor="never", **given), namespace="other")
    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    node.destroy_node()
    assert message in capfd.readouterr().err
