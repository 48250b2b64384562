"""The node with a network: what comes back is what the library says."""

import numpy as np
import rclpy
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import OccupancyGrid
from robot import POINTS, Robot, running

import viewshed
from viewshed.io.export.ros import visibility_layer
from viewshed.sweep import Sweep


def test_a_network_of_named_weights_answers() -> None:
    parameters = {
        "sensors": "[front]", "method": "unet", "weights": "road_int8", "history": "0", "monitor": "never",
        "front.topic": "cloud", "stale_s": "5.0",
    }  # fmt: skip
    with running(parameters):
        rclpy.init()
        robot = Robot()
        assert robot.transition(Transition.TRANSITION_CONFIGURE)
        assert robot.transition(Transition.TRANSITION_ACTIVATE)
        message: OccupancyGrid = robot.answer("visibility")
        robot.until(lambda: robot.reported("road_int8"))
        robot.node.destroy_node()
        rclpy.try_shutdown()
    expected = viewshed.load_estimator("unet", weights="road_int8").estimate(Sweep(POINTS))
    got = np.array(message.data, np.int8).reshape(expected.grid.shape).T
    known = got >= 0
    assert (got == visibility_layer(expected, "visibility"))[known].mean() > 0.98
    assert (got == visibility_layer(viewshed.estimate(Sweep(POINTS)), "visibility"))[known].mean() < 0.5
