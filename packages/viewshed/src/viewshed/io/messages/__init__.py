"""ROS messages as sweeps; numpy alone."""
