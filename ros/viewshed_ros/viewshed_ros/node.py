"""The lifecycle node: sensors of a robot in, their fields of view out, through one pipeline."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import UInt8MultiArray

from viewshed.estimators import load_estimator
from viewshed.estimators.temporal import SweepBuffer
from viewshed.geometry import Rigid
from viewshed.integrity.stream_monitor import StreamMonitor
from viewshed.integrity.sweep_monitor import load_sweep_monitor, shipped_monitor
from viewshed.pipeline import Answer, Pipeline, RateLimit, prepare_process
from viewshed.sweep import Sweep
from viewshed_ros import costmap_filters, nav2, parameters, poses, status
from viewshed_ros.conversions import nanoseconds_of, stamp_of
from viewshed_ros.layers import LAYERS, PosedEstimate
from viewshed_ros.object_layers import OBJECT_LAYERS, ObjectsView
from viewshed_ros.packets import Revolution, Revolutions
from viewshed_ros.parameters import OF_PROFILE, NodeSettings, SensorSettings

NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
"""Each event of each publisher would be waited for anew at every message, which takes longer than a laser scan;
subscribers still say themselves where their quality of service does not fit."""

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Reliable, and who comes late is given the last message."""

PACKETS = QoSProfile(depth=256, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of sensors that send packets: two revolutions of most of them."""

VIEWS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of what agents tell each other: what is late is of no use any more."""

LIVE = QoSProfile(depth=5)
"""Reliable, for who is there."""


@dataclass(slots=True)
class Sensor:
    """A sensor while the node is configured."""

    settings: SensorSettings
    publishers: dict[str, Any]
    alarm: Any
    counts: status.SensorCounts = field(default_factory=status.SensorCounts)
    frame: str = ""
    last_view: PosedEstimate | None = None
    last_said: tuple[object, ...] = ()
    subscription: Any = None


class FieldOfView(LifecycleNode):
    """Estimates what the sensors see; configured by :data:`viewshed_ros.parameters.PARAMETERS`."""

    def __init__(self, **options: Any) -> None:
        super().__init__("field_of_view", **options)
        parameters.declare(self)
        self._settings: NodeSettings | None = None
        self._limit = RateLimit(0.0)
        self._pipeline: Pipeline | None = None
        self._poses: poses.PoseSource | None = None
        self._sensors: dict[str, Sensor] = {}
        self._facts: dict[str, str] = {}
        self._speaker: Any = None
        self._views: Any = None
        self._destroy: list[Callable[[], object]] = []
        self._told_s = 0.0

    # Transitions of the lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load what is needed and announce the topics."""
        try:
            self._configure(parameters.read(self))
        except Exception as error:  # whatever it is: rclpy would drop it without a word
            self.get_logger().error(f"not configured: {' '.join(str(error).split())}")
            self._release()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to listen."""
        try:
            self._listen()
        except Exception as error:  # a topic's name, for example
            self.get_logger().error(f"not activated: {' '.join(str(error).split())}")
            self._stop_listening()
            return TransitionCallbackReturn.FAILURE
        returned = super().on_activate(state)
        for sensor in self._sensors.values():
            costmap_filters.publish_infos(sensor.publishers, self._settings_now().limits)
        return returned

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening; what was learned of the streams is kept."""
        self._stop_listening()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything but the parameters."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End for good."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin anew, unconfigured, after a transition that failed."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    # What the transitions do

    def _settings_now(self) -> NodeSettings:
        if self._settings is None:
            raise RuntimeError("the node is not configured")
        return self._settings

    def _configure(self, settings: NodeSettings) -> None:
        self._settings, self._limit = settings, RateLimit(settings.rate_hz)
        # 1. What estimates and watches; whatever is loaded once is loaded here.
        estimator = load_estimator(settings.method, grid=settings.grid, target=settings.target)
        if settings.history and not estimator.uses_history:
            raise ValueError(f"history must be 0 for {settings.method}, which looks at one sweep; or take shadow_map")
        monitor = self._monitor(settings)
        self._facts = {
            "method": settings.method, "grid": settings.grid, "history": str(settings.history),
            "monitor": "off" if monitor is None else settings.monitor_file or "in the box",
        }  # fmt: skip
        # 2. Where poses are from, and what is published.
        self._poses = self._pose_source(settings)
        self._sensors = {each.name: self._sensor(each) for each in settings.sensors}
        diagnostics = self._publisher(DiagnosticArray, "/diagnostics", LIVE)
        if settings.diagnostics_hz:
            clock = Clock(clock_type=ClockType.STEADY_TIME)  # diagnostics come where simulated time stands still, too
            timer = self.create_timer(
                1.0 / settings.diagnostics_hz, partial(self._diagnose, diagnostics), clock=clock
            )  # fmt: skip
            self._destroy.append(partial(self.destroy_timer, timer))
        # 3. The threads that do it.
        history = SweepBuffer(settings.history) if settings.history else None
        self._pipeline = Pipeline(
            estimator, self._publish, history=history, monitor=monitor, rules=settings.profile.rules,
            vehicle=settings.vehicle, objects=self._objects(settings),
        )  # fmt: skip
        self._told_s = time.monotonic()

    def _objects(self, settings: NodeSettings) -> Any:
        """Return what follows objects, or None; and prepare to tell others, where that is wanted.

        Raises:
            ImportError: a package is not installed.
            OSError, ValueError: the key cannot be read.
        """
        if settings.agent:
            from viewshed_ros.sharing import Speaker, read_signing_key  # needs packages that other nodes do without

            self._speaker = Speaker(read_signing_key(settings.agent, settings.agent_key), settings.world_frame)
            self._views = self._publisher(UInt8MultiArray, settings.agent_topic, VIEWS)
        if not (settings.objects or settings.agent):
            return None
        from viewshed.fusion.object_stream import ObjectStream

        return ObjectStream()

    def _monitor(self, settings: NodeSettings) -> StreamMonitor | None:
        """Return what watches the streams, by a file or by the monitor in the box; None where it is off."""
        wished = settings.profile.monitor if settings.monitor == OF_PROFILE else settings.monitor == "always"
        if not wished:
            return None
        monitor = load_sweep_monitor(settings.monitor_file) if settings.monitor_file else shipped_monitor()
        return StreamMonitor(monitor, monitor.detector())

    def _pose_source(self, settings: NodeSettings) -> poses.PoseSource | None:
        if settings.pose_source == "none":
            return None
        if settings.pose_source == "tf":
            return poses.TfPoses(poses.tf_buffer(self), settings.world_frame, settings.pose_wait_s)
        topic = poses.POSE_TOPICS[settings.pose_source]
        buffer = poses.PoseBuffer(topic, settings.world_frame, settings.pose_wait_s)
        subscription = self.create_subscription(
            topic.message_type, settings.pose_topic, partial(self._take_pose, buffer), LIVE,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )  # fmt: skip
        self._destroy.append(partial(self.destroy_subscription, subscription))
        return buffer

    def _sensor(self, settings: SensorSettings) -> Sensor:
        settings.input.message_type()
        publishers = {
            name: self._publisher(layer.message_type, f"{settings.name}/{name}", LATCHED if layer.latched else LIVE)
            for name, layer in LAYERS.items()
        }
        if self._settings_now().objects:
            for name, objects in OBJECT_LAYERS.items():
                publishers[name] = self._publisher(objects.message_type, f"{settings.name}/{name}", LIVE)
        for name, message_type in costmap_filters.info_types().items():
            publishers[name] = self._publisher(message_type, f"{settings.name}/{name}", LATCHED)
        return Sensor(settings, publishers, self._publisher(DiagnosticStatus, f"{settings.name}/alarm", LATCHED))

    def _publisher(self, message_type: type[Any], topic: str, qos: QoSProfile) -> Any:
        publisher = self.create_lifecycle_publisher(
            message_type, topic, qos, qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            event_callbacks=NO_EVENTS,
        )  # fmt: skip
        self._destroy.append(partial(self.destroy_lifecycle_publisher, publisher))
        return publisher

    def _listen(self) -> None:
        for sensor in self._sensors.values():
            settings = sensor.settings
            take = self._take if settings.revolutions is None else self._take_packet
            # Packets come some hundred times for each revolution: more of them may wait than of clouds.
            qos = qos_profile_sensor_data if settings.revolutions is None else PACKETS
            sensor.subscription = self.create_subscription(
                settings.input.message_type(), settings.topic, partial(take, sensor), qos,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )  # fmt: skip
            self.get_logger().info(f"{settings.name} listens to {sensor.subscription.topic_name}")

    def _stop_listening(self) -> None:
        for sensor in self._sensors.values():
            if sensor.subscription is not None:
                self.destroy_subscription(sensor.subscription)
                sensor.subscription = None

    def _release(self) -> None:
        """Undo what was configured, the threads first: they use the rest."""
        self._stop_listening()
        pipeline, destroy, self._pipeline, self._destroy = self._pipeline, self._destroy, None, []
        if pipeline is not None:
            pipeline.close()
        for each in destroy:
            each()
        self._sensors, self._poses, self._settings = {}, None, None
        self._speaker = self._views = None

    # Messages in

    def _take(self, sensor: Sensor, message: Any) -> None:
        """Put in a message that holds a sweep."""
        sensor.counts.received += 1
        source = partial(self._sweep, sensor, message)
        self._put(sensor, nanoseconds_of(message.header.stamp), source)

    def _take_packet(self, sensor: Sensor, message: Any) -> None:
        """Gather packets, and put in the revolution that one ends; its time is that of the node's clock."""
        revolutions = sensor.settings.revolutions
        if revolutions is None:
            raise RuntimeError("the sensor sends no packets")
        try:
            data = getattr(message, sensor.settings.input.packet)
            revolution = revolutions.add(data, self.get_clock().now().nanoseconds)
        except ValueError as error:
            sensor.counts.count(f"refused: {error}")
            return
        if revolution is not None:
            sensor.counts.received += 1
            self._put(sensor, revolution.t_ns, partial(self._sweep_of_packets, sensor, revolutions, revolution))

    def _put(self, sensor: Sensor, t_ns: int, source: Callable[[], Sweep]) -> None:
        """Put a sweep in, unless it comes sooner after the one before than the rate allows."""
        if not self._limit.takes(sensor.settings.name, t_ns):
            sensor.counts.skipped += 1
        elif self._pipeline is not None:
            self._pipeline.put(source, sensor.settings.name)

    def _sweep_of_packets(self, sensor: Sensor, revolutions: Revolutions, revolution: Revolution) -> Sweep:
        """Return the sweep of a revolution's packets; the pipeline calls this in its thread."""
        sensor.frame = sensor.settings.frame
        pose = self._pose(sensor, revolution.t_ns)
        sweep = revolutions.sweep(revolution)
        return sweep.replace(agent=sensor.settings.name, world_from_sensor=pose, **sensor.settings.changes)

    def _sweep(self, sensor: Sensor, message: Any) -> Sweep:
        """Return the sweep of a message with what is known of its sensor; the pipeline calls this in its thread.

        Raises:
            ValueError: the message contradicts itself, or is in another frame than those before.
        """
        frame = message.header.frame_id.lstrip("/")
        if not frame:
            raise ValueError("header.frame_id must name the sensor's frame, got none")
        sensor.frame = sensor.frame or frame
        if frame != sensor.frame:
            raise ValueError(f"a cloud must be in frame {sensor.frame!r} like those before, got {frame!r}")
        known = sensor.settings.changes
        pose = self._pose(sensor, nanoseconds_of(message.header.stamp))
        return sensor.settings.input.sweep(message, agent=sensor.settings.name, world_from_sensor=pose, **known)

    def _pose(self, sensor: Sensor, t_ns: int) -> Rigid | None:
        """Return where a sensor stood; None, counted, where nobody knows: the sweep is taken by itself."""
        if self._poses is None:
            return None
        try:
            return self._poses.world_from_sensor(sensor.frame, t_ns, sensor.settings.base_from_sensor)
        except LookupError as error:
            sensor.counts.last_note = f"without a pose: {error}"
            sensor.counts.count("without a pose")
            return None

    def _take_pose(self, buffer: poses.PoseBuffer, message: Any) -> None:
        """Keep a pose; one that is none is counted."""
        try:
            buffer.add(message)
        except ValueError as error:
            for sensor in self._sensors.values():
                sensor.counts.count(f"pose refused: {error}")

    # Answers out

    def _publish(self, answer: Answer) -> None:
        """Publish of an answer what somebody listens to; the pipeline calls this in its thread."""
        sensor = self._sensors[answer.agent]
        name = f"{self.get_name()}: {answer.agent}"
        # Who comes late is given the last alarm that said something new.
        says = (answer.reaction.caution, answer.refused, answer.notes)
        is_new, sensor.last_said = says != sensor.last_said, says
        self._publish_one(sensor, sensor.alarm, partial(status.alarm, name, answer), always=is_new)
        if answer.notes:
            sensor.counts.last_note = answer.notes[0]
        if answer.estimate is None:
            sensor.counts.count(f"refused: {answer.refused}")
            self.get_logger().warning(f"{answer.agent}: {answer.refused}", throttle_duration_sec=5.0)
            return
        sensor.counts.answered += 1
        try:
            view = self._view(sensor, answer)
        except ValueError as error:
            sensor.counts.count(str(error))
            return
        sensor.last_view = view
        for topic, layer in LAYERS.items():
            self._publish_one(sensor, sensor.publishers[topic], partial(layer.make, view))
        self._publish_objects(sensor, answer)

    def _publish_objects(self, sensor: Sensor, answer: Answer) -> None:
        """Publish the objects of an answer, and tell other agents of it, where that is wanted."""
        settings, objects, leveled = self._settings_now(), answer.objects, answer.leveled
        if settings.objects and objects is not None and leveled is not None:
            stamp = stamp_of(leveled.sweep.t_ns or 0)
            frame_from_level = leveled.level_from_sensor.inverse()
            view = ObjectsView(objects, stamp, sensor.frame, frame_from_level, settings.world_frame)
            for topic, layer in OBJECT_LAYERS.items():
                self._publish_one(sensor, sensor.publishers[topic], partial(layer.make, view))
        if self._speaker is not None:
            self._publish_one(sensor, self._views, partial(self._speaker.message, answer))

    def _publish_one(
        self, sensor: Sensor, publisher: Any, make: Callable[[], Any], *, always: bool = False
    ) -> None:  # fmt: skip
        """Make and publish a message where somebody listens; one that cannot be made is counted, the others go out."""
        try:
            if always or publisher.get_subscription_count():
                publisher.publish(make())
        except Exception as error:
            sensor.counts.count(f"not published: {error}")

    def _view(self, sensor: Sensor, answer: Answer) -> PosedEstimate:
        """Return an answer with where it stands.

        Raises:
            ValueError: it is to stand in the map, and its pose is not known.
        """
        settings, estimate, leveled = self._settings_now(), answer.estimate, answer.leveled
        if estimate is None or leveled is None:
            raise ValueError("an answer without an estimate has no view")
        frame, frame_from_level = sensor.frame, leveled.level_from_sensor.inverse()
        if settings.output == "world":
            if estimate.world_from_level is None:
                raise ValueError(f"output in {settings.world_frame!r} needs a pose: not published")
            frame, frame_from_level = settings.world_frame, estimate.world_from_level
        return PosedEstimate(
            estimate, stamp_of(estimate.t_ns or 0), frame, frame_from_level, settings.world_frame,
            answer.reaction.suspect, answer.speed_mps, settings.limits,
        )  # fmt: skip

    def _diagnose(self, publisher: Any) -> None:
        """Publish how the pipeline and the sensors are."""
        if self._pipeline is None:
            return
        now_s = time.monotonic()
        passed_s, self._told_s = now_s - self._told_s, now_s
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        message.status = [
            status.pipeline_status(self.get_name(), self._pipeline.statistics(), self._facts),
            *(self._sensor_status(name, each, passed_s) for name, each in self._sensors.items()),
        ]
        publisher.publish(message)

    def _sensor_status(self, name: str, sensor: Sensor, passed_s: float) -> DiagnosticStatus:
        view, facts = sensor.last_view, dict[str, object]()
        if view is not None:
            facts["least range of clearing in m"] = f"{nav2.blind_m(view.estimate):.2f}"
            if view.estimate.basis is not None:
                facts["rests on"] = f"{view.estimate.basis.height_line}; {view.estimate.basis.view_line}"
        return sensor.counts.status(f"{self.get_name()}: {name}", passed_s, facts)


def main(arguments: list[str] | None = None) -> None:
    """Run the node until a signal ends it; one that comes while it starts ends it as well."""
    prepare_process()
    rclpy.init(args=arguments or sys.argv)
    node = None
    try:
        node = FieldOfView()
        is_wanted = node.get_parameter("autostart").value
        if is_wanted and node.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            node.trigger_activate()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        # A signal shuts the context down at once; whatever is made after that fails, each thing in its own words.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node._release()
            node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
