"""The files beside the node say what the node understands, and what makes no sense is refused until it is mended."""

import ast
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter

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
        for wrong, value in (
            ("pose_source", "tf"),
            ("profile", "car"),
            ("front.model", "vlp17"),
            ("vehicle_braking_mps2", 0.0),
        ):
            right = node.get_parameter(wrong).value if wrong != "pose_source" else "odometry"
            node.set_parameters([Parameter(wrong, value=value)])
            assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
            node.set_parameters([Parameter(wrong, value=right)])
        for _ in range(2):
            assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
            assert node.trigger_cleanup() == TransitionCallbackReturn.SUCCESS
    finally:
        node.destroy_node()
        context.shutdown()


def test_every_parameter_has_a_description() -> None:
    for table in (parameters.PARAMETERS, parameters.SENSOR_PARAMETERS):
        for parameter in table.values():
            assert parameter.description.endswith(".")
            assert not parameter.choices or parameter.default in parameter.choices


def test_the_servers_of_nav2_are_told_what_the_node_would_publish() -> None:
    servers = yaml.safe_load((PACKAGE / "config" / "nav2_filter_info.yaml").read_text(encoding="utf-8"))
    for mask in ("keepout_mask", "speed_mask"):
        told = servers[f"{mask.removesuffix('_mask')}_filter_info_server"]["ros__parameters"]
        info = costmap_filters.info_of(_Info(), mask, f"front/{mask}", SpeedLimits())
        assert (told["type"], told["mask_topic"], told["base"]) == (info.type, info.filter_mask_topic, info.base)
        assert told["multiplier"] == pytest.approx(info.multiplier)


def test_shared_memory_holds_many_clouds() -> None:
    root = ET.parse(PACKAGE / "config" / "fastdds.xml").getroot()
    assert [int(each.text or 0) for each in root.iter() if each.tag.endswith("segment_size")] == [64 << 20]


def test_rviz_shows_topics_that_exist() -> None:
    view = yaml.safe_load((PACKAGE / "rviz" / "field_of_view.rviz").read_text(encoding="utf-8"))
    topics = [each["Topic"]["Value"] for each in view["Visualization Manager"]["Displays"] if "Topic" in each]
    assert {topic.removeprefix("/front/") for topic in topics} <= {*LAYERS, "points"}


@pytest.mark.parametrize("file", sorted((PACKAGE / "launch").glob("*.launch.py")), ids=lambda file: file.name)
def test_launch_files_are_python_that_names_this_package(file: Path) -> None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    assert any(isinstance(node, ast.FunctionDef) and node.name == "generate_launch_description" for node in tree.body)
    assert "viewshed_ros" in file.read_text(encoding="utf-8")
