"""Convert ROS messages to sweeps, in numpy."""
