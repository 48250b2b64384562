"""ROS 2 node of viewshed: takes clouds and scans, publishes visibility grids, polygons, doubt, diagnostics, alarms."""
