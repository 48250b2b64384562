"""Center node: fuses the signed messages of many agents, and publishes its trust in each."""

from __future__ import annotations

import json
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, Header, String, UInt8MultiArray
from visualization_msgs.msg import MarkerArray

from viewshed.agents.legend import tracks_of_center
from viewshed.agents.many import AgentReport
from viewshed.agents.receiver import Receiver
from viewshed.agents.rounds import HEARD_S, NO_OBJECTS, Round, Rounds
from viewshed.agents.signing import KeyRing, read_verifying_keys
from viewshed.io.export.ros import visibility_layer
from viewshed_ros import parameters
from viewshed_ros.conversions import stamp_of
from viewshed_ros.layers import grid_message
from viewshed_ros.object_layers import track_cubes
from viewshed_ros.parameters import Parameter
from viewshed_ros.spinning import STEADY, spin

VIEWS = QoSProfile(depth=64, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For messages of agents: late ones are useless."""

TICK_S = 0.1
"""Period of checks for rounds that have waited long enough."""

PARAMETERS: dict[str, Parameter] = {
    "agents": Parameter([""], "Names of the agents whose signed messages are accepted."),
    "keys": Parameter([""], "Files of their public keys, 64 hexadecimal digits each, in the same order."),
    "topic": Parameter("/viewshed/views", "Topic of the messages of all agents."),
    "world_frame": Parameter("map", "Frame of their poses."),
    "slop_s": Parameter(
        0.1, "Maximum time difference of the reports of one round, by the center's clock.", bounds=(0.0, 10.0)
    ),
    "diagnostics_hz": Parameter(1.0, "How often /diagnostics is published.", bounds=(0.01, 100.0)),
    "state": Parameter(
        "", "File that remembers the newest message of each key, so that replayed messages are refused after a restart."
    ),
}
"""Parameters of the node."""


class CenterNode(Node):
    """Fuses the messages of agents, configured by :data:`PARAMETERS`."""

    def __init__(self, **options: Any) -> None:
        super().__init__("viewshed_center", **options)
        parameters.declare_table(self, PARAMETERS, fixed=True)
        given: dict[str, Any] = parameters.values_of(self, PARAMETERS)
        agents = list(given["agents"])
        if not all(agents):
            raise ValueError(f"agents must name agents, and keys the files of their public keys, got agents {agents}")
        self._frame = given["world_frame"]
        ring = KeyRing(read_verifying_keys(agents, list(given["keys"])))
        self._receiver = Receiver(ring, frozenset({self._frame}), state=given["state"] or None)
        self._rounds = Rounds(tuple(agents), given["slop_s"])
        self._notes: list[str] = []
        self._done: Round | None = None
        self._count, self._done_s = 0, 0.0
        self._topics = {
            name: self.create_publisher(kind, f"center/{name}", 5)
            for name, kind in (("visibility", OccupancyGrid), ("tracks", MarkerArray), ("picture", String))
        }
        self._trust = {
            agent: self.create_publisher(Float64, f"center/trust/{topic_name(agent)}", 5) for agent in agents
        }
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 5)
        self.create_subscription(UInt8MultiArray, given["topic"], self._take, VIEWS)
        self.create_timer(1.0 / given["diagnostics_hz"], self._diagnose, clock=STEADY)
        self.create_timer(TICK_S, self._tick, clock=STEADY)

    def _take(self, message: UInt8MultiArray) -> None:
        """Handle a message of an agent; the receiver counts refused ones by reason."""
        now_ns = self.get_clock().now().nanoseconds
        receipt = self._receiver.receive(bytes(message.data), now_ns)
        received = receipt.message
        if received is None:
            reason = "" if receipt.reason is None else receipt.reason.value
            self.get_logger().warning(f"refused: {receipt.agent} {reason} {receipt.detail}", throttle_duration_sec=5.0)
            return
        if received.view is None:
            line = f"{received.agent}: sends no field of view, which a center needs; its report is left out"
            self._note([] if line in self._notes else [line])
            return
        try:
            self._publish_all(self._rounds.add(1e-9 * received.t_ns, AgentReport.of_message(received), 1e-9 * now_ns))
        except Exception as error:  # an error with one message must not stop the others
            self._note([f"{received.agent}: {type(error).__name__}: {error}"])

    def _tick(self) -> None:
        """Publish the rounds that have waited long enough."""
        try:
            self._publish_all(self._rounds.close(1e-9 * self.get_clock().now().nanoseconds))
        except Exception as error:
            self._note([f"{type(error).__name__}: {error}"])

    def _note(self, notes: list[str]) -> None:
        self._notes = [*self._notes, *notes][-10:]

    def _publish_all(self, rounds: list[Round]) -> None:
        self._note(self._rounds.notes)
        for done in rounds:
            self._publish(done)

    def _publish(self, done: Round) -> None:
        """Publish a round: tracks, numbers and trust always, the joint view if it has subscribers."""
        self._done, self._count, self._done_s = done, self._count + 1, time.monotonic()
        header = Header(stamp=stamp_of(done.t_ns), frame_id=self._frame)
        self._topics["picture"].publish(String(data=json.dumps(done.numbers())))
        self._topics["tracks"].publish(track_cubes(tracks_of_center(done.picture), header))
        for agent, trust in zip(done.picture.agents, done.picture.verdicts.trust.tolist(), strict=True):
            self._trust[agent].publish(Float64(data=float(trust)))
        if self._topics["visibility"].get_subscription_count():
            joint = done.joint
            layer = visibility_layer(joint.estimate(done.t_ns), "visibility")
            self._topics["visibility"].publish(grid_message(layer, joint.grid, header, joint.world_from_grid))

    def _diagnose(self) -> None:
        """Publish the counts of messages, and the trust in agents: who is accused, disputed or missing."""
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        lines = self._receiver.summary()
        status = DiagnosticStatus(name=f"{self.get_name()}: messages", message=lines[0], hardware_id="center")
        status.values = [KeyValue(key=str(k), value=line) for k, line in enumerate([*lines[1:], *self._notes])]
        message.status.append(status)
        message.status.append(self._trust_status())
        self._diagnostics.publish(message)

    def _trust_status(self) -> DiagnosticStatus:
        """Return the trust in agents after the last round; STALE if that round is too old."""
        status = DiagnosticStatus(name=f"{self.get_name()}: trust", hardware_id="center")
        if self._done is None:
            status.level, status.message = DiagnosticStatus.STALE, "no round yet: nothing is known"
            return status
        silent_s = time.monotonic() - self._done_s
        sentences = self._done.sentences()
        # A scene without objects is no fault.
        status.level = DiagnosticStatus.WARN if set(sentences) - {NO_OBJECTS} else DiagnosticStatus.OK
        if silent_s > HEARD_S:
            sentences.insert(0, f"no round for {silent_s:.1f} s: nothing is known about the present")
            status.level = DiagnosticStatus.STALE
        status.message = "; ".join(sentences) or f"{self._count} rounds, nobody contradicts the others"
        for agent, numbers in self._done.numbers()["agents"].items():
            status.values.append(KeyValue(key=f"trust of {agent}", value=f"{numbers['trust']:.3f}"))
            if numbers["refused"]:
                status.values.append(KeyValue(key=f"refused reports of {agent}", value=str(numbers["refused"])))
        return status


def topic_name(agent: str) -> str:
    """Return an agent's name as a valid part of a topic.

    >>> topic_name("car-1.top")
    'car_1_top'
    """
    return "".join(letter if letter.isalnum() else "_" for letter in agent)


def main(arguments: list[str] | None = None) -> None:
    """Run the node until a signal ends it."""
    spin(CenterNode, arguments)


if __name__ == "__main__":
    main()
