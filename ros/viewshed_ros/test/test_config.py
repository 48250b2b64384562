"""The files beside the node say what the node understands, and what makes no sense is refused until it is mended."""

import ast
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter

from viewshed.estimators.unet import UnetEstimator
from viewshed.grid import GRIDS
from viewshed_ros import costmap_filters, parameters
from viewshed_ros.layers import LAYERS
from viewshed_ros.nav2 import SpeedLimits
from viewshed_ros.node import FieldOfView

PACKAGE = Path(__file__).parents[1]


class _Info:
    """Stands in for ``nav2_msgs/CostmapFilterInfo``."""


def test_the_example_is_read_and_what_is_missing_for_it_is_refused_and_can_be_mended() -> None:
    file = PACKAGE / "config" / "field_of_view.yaml"
    context = rclpy.Context()
    context.init(args=["--ros-args", "--params-file", str(file)])
    node = FieldOfView(context=context)
    try:
        settings = parameters.read(node)
        assert [(each.name, each.topic, each.input.name) for each in settings.sensors] == [
            ("front", "front/points", "PointCloud2"), ("laser", "scan", "LaserScan"),
        ]  # fmt: skip
        assert settings.sensors[1].changes == {"sensor_height_m": 0.25}
        # What only configuring can tell is said there, and can be mended.
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE  # pose_source tf needs tf2_ros
        assert node.set_parameters([Parameter("pose_source", value="odometry")])[0].successful
        publishers = len(list(node.publishers))
        for _ in range(2):
            assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
            node._pipeline._publish_failed = ValueError("broken")  # is raised when it closes
            assert node.trigger_cleanup() == TransitionCallbackReturn.SUCCESS
            assert len(list(node.publishers)) == publishers
    finally:
        node.destroy_node()
        context.shutdown()


NONSENSE = [
    ("profile", "car", "profile must be one of robot, infrastructure, mapping, contested, got 'car'"),
    ("method", "nonesuch", "method: method must be one of"),
    ("grid", "street", "grid must be one of profile, road"),
    ("weights", "nonesuch", "weights: weights must be a file that viewshed train exported or one of road"),
    ("passes", -1, "passes"),
    ("monitor_file", "/nonesuch.npz", "nonesuch.npz"),
    ("sensors", ["a", "a"], "sensors must be different names"),
    ("rate_hz", -2.0, "rate_hz"),
    ("rate_hz", float("nan"), "rate_hz"),
    ("stale_s", 0.0, "stale_s"),
    ("vehicle_braking_mps2", 0.0, "vehicle_braking_mps2"),
    ("history", -2, "history"),
    ("lidar.model", "vlp17", "lidar.model: sensor must be one of"),
    ("lidar.type", "clouds", "lidar.type must be one of cloud"),
    ("lidar.height_m", -1.8, "lidar.height_m"),
    ("lidar.attitude", [2.0, 0.0, 0.0, 0.0], "lidar.attitude"),
    ("lidar.mounting", [0.0], "lidar.mounting: mounting must be seven numbers, got 1"),
    ("speed_unseen_mps", "fast", "Wrong parameter type"),
    ("autostart", True, "read-only"),
]


@pytest.fixture(scope="module")
def context() -> Iterator[rclpy.Context]:
    """One context for all nodes, and one that stays: each end of a context's last node ends its DDS participant."""
    made = rclpy.Context()
    made.init(args=["--ros-args", "-p", "monitor:=never"])
    stays = rclpy.create_node("stays", context=made)
    yield made
    stays.destroy_node()
    made.shutdown()


@pytest.fixture
def node(context: rclpy.Context) -> Iterator[FieldOfView]:
    made = FieldOfView(context=context)
    parameters.read(made)  # declares those of the sensor
    yield made
    if made._settings is not None:
        made.trigger_cleanup()
    made.destroy_node()


@pytest.mark.parametrize(("name", "value", "reason"), NONSENSE)
def test_nonsense_is_refused_when_it_is_set_with_the_reason(
    node: FieldOfView, name: str, value: Any, reason: str
) -> None:
    before = node.get_parameter(name).value
    result = node.set_parameters([Parameter(name, value=value)])[0]
    assert not result.successful
    assert reason in result.reason
    assert "\n" not in result.reason
    assert node.get_parameter(name).value == before


def test_a_networks_weights_and_passes_are_taken_and_refused_where_they_do_not_go_together(node: FieldOfView) -> None:
    def configured(**values: Any) -> bool:
        given = {"history": 0, "weights": "", "passes": 0, "target": "car", **values}
        assert all(node.set_parameters([Parameter(name, value=value)])[0].successful for name, value in given.items())
        return bool(node.trigger_configure() == TransitionCallbackReturn.SUCCESS)

    assert not configured(method="shadow_map", weights="road_int8")  # it is no network
    assert not configured(method="unet", passes=5)
    assert not configured(method="unet", weights="indoor_int8")  # for a pedestrian, not a car
    assert configured(method="mc_dropout", weights="indoor_int8", passes=5, target="pedestrian")
    assert node._pipeline is not None
    estimator = node._pipeline._estimator
    assert isinstance(estimator, UnetEstimator)
    assert (estimator.name, estimator.passes, estimator.grid) == ("mc_dropout", 5, GRIDS["indoor"])


def test_what_can_change_at_run_time_does_and_the_rest_says_how(node: FieldOfView) -> None:
    assert node.set_parameters([Parameter("profile", value="contested")])[0].successful
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    for name, value in (("method", "first_blocker"), ("sensors", ["other"]), ("lidar.topic", "other")):
        result = node.set_parameters([Parameter(name, value=value)])[0]
        assert not result.successful
        assert "deactivate it, clean it up" in result.reason
    # What is set to what it is changes nothing, and is no fault.
    assert node.set_parameters([Parameter("profile", value="contested")])[0].successful
    for name, value in (
        ("rate_hz", 2.0), ("diagnostics_hz", 0.0), ("diagnostics_hz", 20.0), ("stale_s", 3.0), ("stale_periods", 4.0),
        ("pose_wait_s", 0.5), ("speed_unseen_mps", 4.0),
    ):  # fmt: skip
        assert node.set_parameters([Parameter(name, value=value)])[0].successful, name
    settings = node._settings_now()
    assert (settings.rate_hz, settings.stale_s, settings.stale_periods, settings.diagnostics_hz) == (
        2.0,
        3.0,
        4.0,
        20.0,
    )
    assert settings.limits == SpeedLimits(10.0, 4.0)
    # 4 m/s are taken alone, 40 m/s contradict the greatest speed.
    result = node.set_parameters([Parameter("speed_unseen_mps", value=40.0)])[0]
    assert "speeds must satisfy" in result.reason
    # -1 leaves the rate to the profile again.
    assert node.set_parameters([Parameter("rate_hz", value=-1.0)])[0].successful
    assert node._settings_now().rate_hz == settings.profile.rate_hz


@pytest.mark.parametrize(
    ("given", "why"), [("-1", r"must lie in \[0\.05, 60\], got -1"), ("true", "must be a value like 0.5, got True")]
)
def test_what_is_given_wrongly_at_the_start_is_told_and_can_be_mended(given: str, why: str) -> None:
    context = rclpy.Context()
    words = [f"stale_s:={given}", "monitor:=never", "vehicle_front_m:=4", "lidar.mounting:=[0, 0, 1, 0, 0, 0, 1]"]
    context.init(args=["--ros-args", *(word for each in words for word in ("-p", each))])
    node = FieldOfView(context=context)
    try:
        with pytest.raises(ValueError, match=f"stale_s {why}"):
            parameters.read(node)
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert node.set_parameters([Parameter("stale_s", value=1.0)])[0].successful
        [sensor] = parameters.read(node).sensors
        assert abs(sensor.changes["vehicle_yaw"]) == pytest.approx(np.pi)  # it looks back
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        assert node.trigger_cleanup() == TransitionCallbackReturn.SUCCESS
    finally:
        node.destroy_node()
        context.shutdown()


def test_the_servers_of_nav2_are_told_what_the_node_would_publish() -> None:
    servers = yaml.safe_load((PACKAGE / "config" / "nav2_filter_info.yaml").read_text(encoding="utf-8"))
    for mask in ("keepout_mask", "speed_mask"):
        server = servers[f"{mask.removesuffix('_mask')}_filter_info_server"]["ros__parameters"]
        info = costmap_filters.info_of(_Info(), mask, f"front/{mask}", SpeedLimits())
        assert (server["type"], server["mask_topic"], server["base"]) == (info.type, info.filter_mask_topic, info.base)
        assert server["multiplier"] == pytest.approx(info.multiplier)
    assert SpeedLimits().percent(2.0) * info.multiplier == pytest.approx(2.0)


def test_rviz_shows_topics_that_exist() -> None:
    view = yaml.safe_load((PACKAGE / "rviz" / "field_of_view.rviz").read_text(encoding="utf-8"))
    topics = [each["Topic"]["Value"] for each in view["Visualization Manager"]["Displays"] if "Topic" in each]
    assert {topic.removeprefix("/front/") for topic in topics} <= {*LAYERS, "points"}


def test_the_package_names_what_it_imports_by_keys_that_rosdep_knows() -> None:
    package = ET.parse(PACKAGE / "package.xml").getroot()
    named = {each.text for each in package.iter("exec_depend")}
    imported = set[str]()
    for file in [*(PACKAGE / "viewshed_ros").glob("*.py"), *(PACKAGE / "launch").glob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(str(node.module).partition(".")[0])
    # The library, its laboratory and shapely are of wheels; what Ubuntu packages has another name there.
    imported -= {*sys.stdlib_module_names, "viewshed_ros", "viewshed", "viewshed_lab", "shapely"}
    assert {{"numpy": "python3-numpy"}.get(name, name) for name in imported} <= named
    # Of the build type, which is no key.
    assert "ament_python" not in {each.text for each in package.iter() if "depend" in each.tag}
