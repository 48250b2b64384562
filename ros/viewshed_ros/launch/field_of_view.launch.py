"""The node, configured and activated, and the watchdog that stops in its place; with ``rviz:=true`` a view of it."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return what is started."""
    share = Path(get_package_share_directory("viewshed_ros"))
    simulated = {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value=""),
            DeclareLaunchArgument("parameters", default_value=str(share / "config" / "field_of_view.yaml")),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            DeclareLaunchArgument("rviz", default_value="false"),
            SetEnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", str(share / "config" / "fastdds.xml")),
            LifecycleNode(
                package="viewshed_ros",
                executable="field_of_view",
                name="field_of_view",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("parameters"), simulated, {"autostart": True}],
                output="screen",
            ),
            Node(
                package="viewshed_ros",
                executable="watchdog",
                name="field_of_view_watchdog",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("parameters"), simulated],
                respawn=True,
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(share / "rviz" / "field_of_view.rviz")],
                parameters=[simulated],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
