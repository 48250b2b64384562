"""viewshed on a ROS 2 graph: clouds and scans in; visibility grids, polygons, doubt, diagnostics and alarms out."""
