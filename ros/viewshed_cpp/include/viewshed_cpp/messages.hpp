// Convert clouds to sweeps and estimates to grids: the node's messages, without rclcpp.
#pragma once

#include <string>
#include <vector>

#include <nav_msgs/msg/occupancy_grid.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <viewshed.hpp>

namespace viewshed_cpp {

// The sweep of a cloud. It points into the cloud's data, without a copy. If a ring field is named, it must be uint16 with 0
// as the lowest beam. Throws std::invalid_argument if the cloud is inconsistent.
viewshed_sweep sweep_of(const sensor_msgs::msg::PointCloud2 & cloud, const std::string & ring_field = "");

// Content of a grid: probabilities in percent, or states (FREE 0, HIDDEN 50, SURFACE 100). UNKNOWN is -1 in both.
enum class Layer { VISIBILITY, STATE };

// An estimate as a grid in the sensor's own frame, at the height and tilt of the ground below it.
nav_msgs::msg::OccupancyGrid grid_of(
  const viewshed::Estimate & estimate, const viewshed_options & options, Layer layer, const std_msgs::msg::Header & header);

}  // namespace viewshed_cpp
