"""The lifecycle node: takes messages of a robot's sensors, publishes their fields of view, through one pipeline."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Header, UInt8MultiArray

from viewshed.estimators import load_estimator
from viewshed.estimators.temporal import SweepBuffer
from viewshed.geometry import Rigid
from viewshed.monitor.stream_monitor import StreamMonitor
from viewshed.pipeline import Answer, Caution, Pipeline, RateLimit, prepare_process
from viewshed.sweep import Sweep
from viewshed_ros import costmap_filters, nav2, parameters, poses, status
from viewshed_ros.conversions import nanoseconds_of, stamp_of
from viewshed_ros.layers import LAYERS, PosedEstimate, Unseen, area_of
from viewshed_ros.object_layers import OBJECT_LAYERS, ObjectsView
from viewshed_ros.outlets import FrameVote, Outlet, Sensor
from viewshed_ros.packets import Revolution, Revolutions
from viewshed_ros.parameters import FROM_PROFILE, NodeSettings, SensorSettings
from viewshed_ros.spinning import STEADY, until_a_signal
from viewshed_ros.stops import CHECK_S, LATCHED, MASK_STOPS, Stale, stale_alarm

NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
"""No publisher events: with them the executor waits for each event of each publisher anew at every message, which takes
longer than a laser scan. Subscribers still report an incompatible quality of service."""

PACKETS = QoSProfile(depth=256, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For sensors that send packets: two revolutions of most of them."""

VIEWS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For messages between agents: late ones are useless."""

LIVE = QoSProfile(depth=5)
"""Reliable, but not kept for late subscribers."""


ALARM, VIEWS_TOPIC = "alarm", "views"
"""Outlets of a sensor that are no layers: its alarm, and messages to other agents."""


class FieldOfView(LifecycleNode):
    """Estimates what the sensors see; configured by :data:`viewshed_ros.parameters.PARAMETERS`."""

    def __init__(self, **options: Any) -> None:
        super().__init__("field_of_view", **options)
        parameters.declare(self)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self._settings: NodeSettings | None = None
        self._limit = RateLimit(0.0)
        self._pipeline: Pipeline | None = None
        self._poses: poses.PoseSource | None = None
        self._sensors: dict[str, Sensor] = {}
        self._facts: dict[str, str] = {}
        self._signer: Any = None
        self._destroy: list[Callable[[], object]] = []
        self._diagnostics: Any = None
        self._diagnostics_timer: Any = None
        self._is_active = False
        self._diagnosed_s = 0.0

    # Transitions of the lifecycle

    def _LifecycleNodeMixin__change_state(self, transition_id: int) -> TransitionCallbackReturn:  # noqa: N802
        """Refuse a transition that the current state does not have; rclpy would end the process (its issue 1209)."""
        if transition_id not in {possible[0] for possible in self._state_machine.available_transitions}:
            self.get_logger().error(f"no transition {transition_id} from state {self._state_machine.current_state[1]}")
            return TransitionCallbackReturn.FAILURE
        return super()._LifecycleNodeMixin__change_state(transition_id)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load estimator and monitor, and create the topics."""
        try:
            self._configure(parameters.read(self))
        except Exception as error:  # rclpy would drop any error silently
            self.get_logger().error(f"not configured: {' '.join(str(error).split())}")
            self._release()
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the sensors."""
        try:
            self._listen()
        except Exception as error:  # an invalid topic name, for example
            self.get_logger().error(f"not activated: {' '.join(str(error).split())}")
            self._stop_listening()
            return TransitionCallbackReturn.FAILURE
        returned = super().on_activate(state)
        for sensor in self._sensors.values():
            publishers = {name: outlet.publisher for name, outlet in sensor.outlets.items()}
            costmap_filters.publish_infos(publishers, self._settings_now().limits)
            # Until the first view, masks and alarm report that there is none.
            for name, outlet in sensor.outlets.items():
                outlet.is_open = True
                if name in MASK_STOPS or name == ALARM:
                    outlet.seen_s = -math.inf
        self._is_active = True
        self._watch()
        return returned

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish stop messages and unsubscribe; the state of the streams is kept."""
        self._close_outlets()
        self._stop_listening()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything except the parameters."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish stop messages and release everything."""
        self._close_outlets()
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to the unconfigured state after a failed transition."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    # Implementation of the transitions

    def _settings_now(self) -> NodeSettings:
        if self._settings is None:
            raise RuntimeError("the node is not configured")
        return self._settings

    def _configure(self, settings: NodeSettings) -> None:
        self._settings, self._limit = settings, RateLimit(settings.rate_hz)
        # 1. Estimator and monitor; all one-time loading happens here.
        estimator = load_estimator(
            settings.method, grid=settings.grid, target=settings.target,
            weights=settings.weights or None, passes=settings.passes or None,
        )  # fmt: skip
        if settings.history and not estimator.uses_history:
            raise ValueError(f"history must be 0 for {settings.method}, which uses one sweep only; or use shadow_map")
        monitor = self._monitor(settings)
        self._facts = {
            "method": settings.method, **({"weights": settings.weights} if settings.weights else {}),
            "grid": settings.grid or "that of the weights", "history": str(settings.history),
            "monitor": "off" if monitor is None else settings.monitor_file or "shipped",
        }  # fmt: skip
        # 2. Source of poses, and publishers.
        self._poses = self._pose_source(settings)
        self._sensors = {sensor.name: self._sensor(sensor) for sensor in settings.sensors}
        self._diagnostics = self._publisher(DiagnosticArray, "/diagnostics", LIVE)
        self._diagnose_at(settings.diagnostics_hz)
        watch = self.create_timer(CHECK_S, self._watch, clock=STEADY)
        self._destroy.append(partial(self.destroy_timer, watch))
        # 3. The threads of the pipeline.
        history = SweepBuffer(settings.history) if settings.history else None
        self._pipeline = Pipeline(
            estimator, self._publish, history=history, monitor=monitor, rules=settings.profile.rules,
            certify=settings.certify, certified_only=settings.certified_only, vehicle=settings.vehicle,
            objects=self._objects(settings),
        )  # fmt: skip
        self._diagnosed_s = time.monotonic()

    def _diagnose_at(self, hz: float) -> None:
        """Publish diagnostics at this rate from now on; 0 for never."""
        if self._diagnostics_timer is not None:
            self.destroy_timer(self._diagnostics_timer)
        self._diagnostics_timer = self.create_timer(1.0 / hz, self._diagnose, clock=STEADY) if hz else None

    def _objects(self, settings: NodeSettings) -> Any:
        """Return the detector and tracker of objects, or None; with an agent, also set up messages to other agents."""
        if settings.agent:
            from viewshed.agents.signing import read_signing_key  # needs packages that other nodes do not need
            from viewshed_ros.sharing import ViewSigner

            self._signer = ViewSigner(read_signing_key(settings.agent, settings.agent_key), settings.world_frame)
            views = self._publisher(UInt8MultiArray, settings.agent_topic, VIEWS)
            self._sensors[settings.sensors[0].name].outlets[VIEWS_TOPIC] = Outlet(views)
        if not (settings.objects or settings.agent):
            return None
        from viewshed.objects.object_stream import ObjectStream

        return ObjectStream()

    def _monitor(self, settings: NodeSettings) -> StreamMonitor | None:
        """Return the monitor, from a file or the shipped one; None if it is off."""
        is_on = settings.profile.monitor if settings.monitor == FROM_PROFILE else settings.monitor == "always"
        if not is_on:
            return None
        return StreamMonitor.of_file(settings.monitor_file) if settings.monitor_file else StreamMonitor()

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
        name = settings.name
        qos = {topic: LATCHED if layer.latched else LIVE for topic, layer in LAYERS.items()}
        outlets = {
            topic: Outlet(
                self._publisher(layer.message_type, f"{name}/{topic}", qos[topic]),
                layer.stop and partial(self._stop_message, name, layer.stop),
            )
            for topic, layer in LAYERS.items()
        }
        if self._settings_now().objects:
            for topic, objects in OBJECT_LAYERS.items():
                outlets[topic] = Outlet(self._publisher(objects.message_type, f"{name}/{topic}", LIVE))
        for topic, message_type in costmap_filters.info_types().items():
            outlets[topic] = Outlet(self._publisher(message_type, f"{name}/{topic}", LATCHED))
        outlets[ALARM] = Outlet(
            self._publisher(DiagnosticStatus, f"{name}/{ALARM}", LATCHED), partial(self._stop_alarm, name)
        )
        heartbeat = self._publisher(OccupancyGrid, f"{name}/heartbeat", LIVE)
        return Sensor(settings, outlets, heartbeat, FrameVote(settings.frame))

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
            # A revolution has some hundred packets, so their queue is longer than that of clouds.
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

    def _close_outlets(self) -> None:
        """Publish stop messages in place of the last messages, and nothing after that."""
        self._is_active, now_s = False, time.monotonic()
        for sensor in self._sensors.values():
            for outlet in sensor.outlets.values():
                self._stop_one(sensor, partial(outlet.close, now_s))

    def _release(self) -> None:
        """Release everything that was configured, the threads first, because they use the rest."""
        self._is_active = False
        self._stop_listening()
        pipeline, destroy, self._pipeline, self._destroy = self._pipeline, self._destroy, None, []
        try:
            if pipeline is not None:
                pipeline.close()
        except Exception as error:  # release the rest even if the pipeline hung or failed
            self.get_logger().error(f"the pipeline did not end well: {' '.join(str(error).split())}")
        if self._diagnostics_timer is not None:
            self.destroy_timer(self._diagnostics_timer)
        for destroy_one in destroy:
            destroy_one()
        self._diagnostics = self._diagnostics_timer = None
        self._sensors, self._poses, self._settings = {}, None, None
        self._signer = None

    # Messages in

    def _take(self, sensor: Sensor, message: Any) -> None:
        """Queue the sweep of a message."""
        sensor.counts.received += 1
        sensor.frames.add(message.header.frame_id.lstrip("/"), time.monotonic())
        source = partial(self._sweep, sensor, message)
        self._put(sensor, nanoseconds_of(message.header.stamp), source)

    def _take_packet(self, sensor: Sensor, message: Any) -> None:
        """Collect packets, and queue each completed revolution; its time is that of the node's clock."""
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
        """Queue a sweep unless it exceeds the rate."""
        if not self._limit.takes(sensor.settings.name, t_ns):
            sensor.counts.skipped += 1
        elif self._pipeline is not None:
            sensor.arrived(t_ns, time.monotonic())
            self._pipeline.put(source, sensor.settings.name)

    def _sweep_of_packets(self, sensor: Sensor, revolutions: Revolutions, revolution: Revolution) -> Sweep:
        """Return the sweep of a revolution's packets; called in the pipeline's thread."""
        sensor.frames.frame = sensor.settings.frame or sensor.settings.name
        pose = self._pose(sensor, revolution.t_ns)
        sweep = revolutions.sweep(revolution)
        return sweep.replace(agent=sensor.settings.name, world_from_sensor=pose, **sensor.settings.changes)

    def _sweep(self, sensor: Sensor, message: Any) -> Sweep:
        """Return the sweep of a message with the sensor's known attributes; called in the pipeline's thread."""
        sensor.frames.check(message.header.frame_id.lstrip("/"))
        known = sensor.settings.changes
        pose = self._pose(sensor, nanoseconds_of(message.header.stamp))
        return sensor.settings.input.sweep(message, agent=sensor.settings.name, world_from_sensor=pose, **known)

    def _pose(self, sensor: Sensor, t_ns: int) -> Rigid | None:
        """Return the pose of a sensor; if it is unknown, count that and return None."""
        if self._poses is None:
            return None
        try:
            return self._poses.world_from_sensor(sensor.frames.frame, t_ns, sensor.settings.base_from_sensor)
        except LookupError as error:
            sensor.counts.last_note = f"without a pose: {error}"
            sensor.counts.count("without a pose")
            return None

    def _take_pose(self, buffer: poses.PoseBuffer, message: Any) -> None:
        """Buffer a pose; count it if it is refused."""
        try:
            buffer.add(message)
        except ValueError as error:
            for sensor in self._sensors.values():
                sensor.counts.count(f"pose refused: {error}")

    # Answers out

    def _publish(self, answer: Answer) -> None:
        """Publish an answer on the topics that have subscribers; called in the pipeline's thread."""
        sensor = self._sensors[answer.agent]
        # 1. The view, when its sweep arrived, and whether it is too old already.
        view, now_s = self._counted_view(sensor, answer), time.monotonic()
        t_ns = None if answer.estimate is None else answer.estimate.t_ns
        seen_s = sensor.arrival_s(t_ns, now_s - answer.latency_s)
        is_late = answer.reaction.caution == Caution.STALE or now_s - seen_s > self._limit_s(sensor)
        if view is not None and not is_late:
            sensor.last_view = view
            if view.estimate.world_from_level is not None:
                sensor.area = area_of(view)
            if view.estimate.world_from_level is not None or self._poses is None:
                sensor.newest_s = seen_s
        # 2. The alarm, always, because it is latched. It becomes stale with the masks, also while views without a pose
        # come in.
        stale = self._stale(sensor, now_s, is_late=is_late)
        make = partial(status.alarm, f"{self.get_name()}: {answer.agent}", answer, stale)
        since_s = now_s if stale is not None or sensor.newest_s is None else sensor.newest_s
        self._publish_one(sensor, ALARM, make, since_s, always=True)
        # 3. The layers; for late views and views without a pose, :meth:`_watch` publishes stop messages.
        if view is None:
            return
        if is_late:
            sensor.counts.count("answered too late")
            return
        for topic, layer in LAYERS.items():
            self._publish_one(sensor, topic, partial(layer.make, view), seen_s)
        self._publish_objects(sensor, answer, seen_s)

    def _counted_view(self, sensor: Sensor, answer: Answer) -> PosedEstimate | None:
        """Return an answer with its pose; if estimate or required pose is missing, count that and return None."""
        if answer.notes:
            sensor.counts.last_note = answer.notes[0]
        if answer.estimate is None:
            sensor.counts.count(f"refused: {answer.refused}")
            self.get_logger().warning(f"{answer.agent}: {answer.refused}", throttle_duration_sec=5.0)
            return None
        sensor.counts.answered += 1
        try:
            return self._view(sensor, answer)
        except ValueError as error:
            sensor.counts.count(str(error))
            return None

    def _publish_objects(self, sensor: Sensor, answer: Answer, seen_s: float) -> None:
        """Publish the objects of an answer, and the message to other agents, if configured."""
        settings, objects, leveled = self._settings_now(), answer.objects, answer.leveled
        if settings.objects and objects is not None and leveled is not None:
            stamp = stamp_of(leveled.sweep.t_ns or 0)
            frame_from_level = leveled.level_from_sensor.inverse()
            view = ObjectsView(objects, stamp, sensor.frames.frame, frame_from_level, settings.world_frame)
            for topic, layer in OBJECT_LAYERS.items():
                self._publish_one(sensor, topic, partial(layer.make, view), seen_s)
        if self._signer is not None:
            self._publish_one(sensor, VIEWS_TOPIC, partial(self._signer.message, answer), seen_s)

    def _publish_one(
        self, sensor: Sensor, topic: str, make: Callable[[], Any], seen_s: float, *, always: bool = False
    ) -> None:  # fmt: skip
        """Make and publish a message if the topic has subscribers; count errors, which must not stop the others."""
        try:
            sensor.outlets[topic].publish(make, seen_s, always=always)
        except Exception as error:
            sensor.counts.count(f"not published: {error}")

    def _view(self, sensor: Sensor, answer: Answer) -> PosedEstimate:
        """Return an answer with its pose in the output frame."""
        settings, estimate, leveled = self._settings_now(), answer.estimate, answer.leveled
        if estimate is None or leveled is None:
            raise ValueError("an answer without an estimate has no view")
        frame, frame_from_level = sensor.frames.frame, leveled.level_from_sensor.inverse()
        if settings.output == "world":
            if estimate.world_from_level is None:
                raise ValueError(f"output in {settings.world_frame!r} needs a pose: not published")
            frame, frame_from_level = settings.world_frame, estimate.world_from_level
        return PosedEstimate(
            estimate, stamp_of(estimate.t_ns or 0), frame, frame_from_level, settings.world_frame,
            answer.reaction.suspect, answer.speed_mps, settings.limits,
        )  # fmt: skip

    # Stale views

    def _limit_s(self, sensor: Sensor) -> float:
        """Return the age in seconds beyond which a view of a sensor is stale."""
        settings = self._settings_now()
        return max(settings.stale_s, settings.stale_periods * sensor.pace.period_s())

    def _stale(self, sensor: Sensor, now_s: float, *, is_late: bool = False) -> Stale | None:
        """Return why a sensor's view is stale; None if its newest view is not too old."""
        limit_s = self._limit_s(sensor)
        age_s = math.inf if sensor.newest_s is None else now_s - sensor.newest_s
        if age_s <= limit_s and not is_late:
            return None
        what = "view" if self._poses is None else "view with a pose"
        return Stale(what, age_s, limit_s, self._settings_now().limits.unseen_mps)

    def _watch(self) -> None:
        """Replace messages that are too old by stop messages, whatever the cause; then publish the heartbeat."""
        if not self._is_active:
            return
        settings, now_s = self._settings_now(), time.monotonic()
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=settings.world_frame)
        for sensor in self._sensors.values():
            limit_s = self._limit_s(sensor)
            stopped = {
                topic: self._stop_one(sensor, partial(outlet.stop_if_older, limit_s, now_s))
                for topic, outlet in sensor.outlets.items()
            }
            if stopped[ALARM] and all(stopped[mask] for mask in MASK_STOPS):
                sensor.heartbeat.publish(OccupancyGrid(header=header, info=sensor.area))

    def _stop_one(self, sensor: Sensor, stop: Callable[[], None]) -> bool:
        """Publish a stop message on one topic, and return whether that succeeded."""
        try:
            stop()
        except Exception as error:  # a context that was shut down, for example; then the watchdog stops the vehicle
            sensor.counts.count(f"no stop message: {' '.join(str(error).split())}")
            return False
        return True

    def _stop_message(self, name: str, stop: Callable[[Unseen], Any]) -> Any:
        """Return the stop message of a layer, with the current time and that of the newest sweep."""
        sensor, now = self._sensors[name], self.get_clock().now().nanoseconds
        age_s = 0.0 if sensor.newest_s is None else time.monotonic() - sensor.newest_s
        stamp, since = stamp_of(now), stamp_of(max(now - round(1e9 * age_s), 0))
        return stop(Unseen(sensor.last_view, self._settings_now().world_frame, sensor.area, stamp, since))

    def _stop_alarm(self, name: str) -> DiagnosticStatus:
        """Return the alarm of a sensor whose view is stale, or whose node stops publishing."""
        stale = self._stale(self._sensors[name], time.monotonic(), is_late=True)
        assert stale is not None
        return stale_alarm(f"{self.get_name()}: {name}", stale)

    # Parameters

    def _check_parameters(self, changed: Sequence[Parameter]) -> SetParametersResult:
        """Refuse invalid values, and changes that need a new configuration."""
        try:
            for one in changed:
                if self.has_parameter(one.name):
                    is_same = one.value == self.get_parameter(one.name).value
                    parameters.check_change(one.name, one.value, is_configured=bool(self._settings) and not is_same)
            if self._settings is not None:
                parameters.changed(self._settings, {one.name: one.value for one in changed})
        except Exception as error:  # rclpy would end the node on any error
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, changed: Sequence[Parameter]) -> None:
        """Apply changes that are possible at run time."""
        if self._settings is None:
            return
        before, now = self._settings, parameters.changed(self._settings, {one.name: one.value for one in changed})
        self._settings = now
        if now.rate_hz != before.rate_hz:
            self._limit = RateLimit(now.rate_hz)
        if now.diagnostics_hz != before.diagnostics_hz:
            self._diagnose_at(now.diagnostics_hz)
        if self._poses is not None:
            self._poses.wait_s = now.pose_wait_s

    # Diagnostics

    def _diagnose(self) -> None:
        """Publish the diagnostics of pipeline and sensors."""
        if self._pipeline is None:
            return
        now_s = time.monotonic()
        passed_s, self._diagnosed_s = now_s - self._diagnosed_s, now_s
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        message.status = [
            status.pipeline_status(self.get_name(), self._pipeline.statistics(), self._facts),
            *(self._sensor_status(name, sensor, passed_s) for name, sensor in self._sensors.items()),
        ]
        self._diagnostics.publish(message)

    def _sensor_status(self, name: str, sensor: Sensor, passed_s: float) -> DiagnosticStatus:
        view, facts = sensor.last_view, dict[str, object]()
        if view is not None:
            facts["least range of clearing in m"] = f"{nav2.blind_m(view.estimate):.2f}"
            if view.estimate.basis is not None:
                facts["rests on"] = f"{view.estimate.basis.height_line}; {view.estimate.basis.view_line}"
        return sensor.counts.status(f"{self.get_name()}: {name}", passed_s, facts)


def main(arguments: list[str] | None = None) -> None:
    """Run the node until a signal ends it, also during startup."""
    prepare_process()
    with until_a_signal(arguments):
        node = FieldOfView()
        try:
            is_autostart = node.get_parameter("autostart").value
            if is_autostart and node.trigger_configure() == TransitionCallbackReturn.SUCCESS:
                node.trigger_activate()
            rclpy.spin(node)
        finally:
            node._release()
            node.destroy_node()


if __name__ == "__main__":
    main()
