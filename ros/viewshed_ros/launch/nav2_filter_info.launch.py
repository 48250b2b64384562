"""nav2's own servers that tell its filters what the masks mean, where the node cannot: it has no nav2_msgs."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch_ros.actions import Node

from launch import LaunchDescription

SERVERS = ["keepout_filter_info_server", "speed_filter_info_server"]


def generate_launch_description() -> LaunchDescription:
    """Return the two servers and what activates them."""
    parameters = str(Path(get_package_share_directory("viewshed_ros")) / "config" / "nav2_filter_info.yaml")
    servers = [
        Node(package="nav2_map_server", executable="costmap_filter_info_server", name=name, parameters=[parameters])
        for name in SERVERS
    ]
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_filter_info",
        parameters=[{"autostart": True, "node_names": SERVERS}],
    )
    return LaunchDescription([*servers, manager])
