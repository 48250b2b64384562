// Clouds as sweeps, and estimates as grids: what the node says and hears, without rclcpp.
#pragma once

#include <string>
#include <vector>

#include <nav_msgs/msg/occupancy_grid.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <viewshed.hpp>

namespace viewshed_cpp {

// The sweep of a cloud; it points into the cloud's data, so that nothing is copied. A ring field is read where one is named:
// uint16, 0 the lowest beam. Throws std::invalid_argument where the cloud contradicts itself.
viewshed_sweep sweep_of(const sensor_msgs::msg::PointCloud2 & cloud, const std::string & ring_field = "");

// Which numbers a grid has: probabilities in percent, or states: FREE 0, HIDDEN 50, SURFACE 100; UNKNOWN is -1 in both.
enum class Layer { VISIBILITY, STATE };

// An estimate as a grid in the sensor's own frame, at the height and tilt of the ground below it.
nav_msgs::msg::OccupancyGrid grid_of(
  const viewshed::Estimate & estimate, const viewshed_options & options, Layer layer, const std_msgs::msg::Header & header);

}  // namespace viewshed_cpp
