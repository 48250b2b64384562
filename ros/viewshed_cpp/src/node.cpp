// Composable node without Python: takes clouds of a LiDAR, publishes grids of its field of view with the clouds' stamps.
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>

#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>

#include "viewshed_cpp/messages.hpp"

namespace viewshed_cpp {

class FieldOfView : public rclcpp::Node
{
public:
  explicit FieldOfView(const rclcpp::NodeOptions & options)
  : Node("field_of_view", options)
  {
    // 1. Parameters, named as in the Python node.
    model_ = declare_parameter<std::string>("model", "auto");
    ring_field_ = declare_parameter<std::string>("ring_field", "");
    height_m_ = declare_parameter<double>("height_m", 0.0);
    options_.cells = std::uint32_t(declare_parameter<int>("cells", int(options_.cells)));
    options_.half_extent_m = declare_parameter<double>("half_extent_m", options_.half_extent_m);
    options_.sensor = model_ == "auto" ? nullptr : model_.c_str();
    stream_.emplace(options_);  // throws if an option is invalid
    // 2. Topics: grids are latched, clouds are best-effort.
    const auto latched = rclcpp::QoS(1).reliable().transient_local();
    visibility_ = create_publisher<nav_msgs::msg::OccupancyGrid>("visibility", latched);
    state_ = create_publisher<nav_msgs::msg::OccupancyGrid>("state", latched);
    cloud_ = create_subscription<sensor_msgs::msg::PointCloud2>(
      "points", rclcpp::SensorDataQoS().keep_last(1),
      [this](sensor_msgs::msg::PointCloud2::ConstSharedPtr cloud) {answer(*cloud);});
  }

private:
  void answer(const sensor_msgs::msg::PointCloud2 & cloud)
  {
    const bool wants_visibility = visibility_->get_subscription_count() > 0, wants_state = state_->get_subscription_count() > 0;
    if (!wants_visibility && !wants_state) {return;}
    try {
      viewshed_sweep sweep = sweep_of(cloud, ring_field_);
      if (height_m_ != 0.0) {sweep.sensor_height_m = height_m_;}  // 0: estimate it
      const viewshed::Estimate estimate = stream_->estimate(sweep);
      if (wants_visibility) {
        visibility_->publish(std::make_unique<nav_msgs::msg::OccupancyGrid>(
          grid_of(estimate, options_, Layer::VISIBILITY, cloud.header)));
      }
      if (wants_state) {
        state_->publish(std::make_unique<nav_msgs::msg::OccupancyGrid>(
          grid_of(estimate, options_, Layer::STATE, cloud.header)));
      }
    } catch (const std::exception & error) {  // drop an inconsistent message
      RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), 5000, "cloud dropped: %s", error.what());
    }
  }

  std::string model_, ring_field_;
  double height_m_;
  viewshed_options options_ = viewshed_defaults();
  std::optional<viewshed::Stream> stream_;
  rclcpp::Publisher<nav_msgs::msg::OccupancyGrid>::SharedPtr visibility_, state_;
  rclcpp::Subscription<sensor_msgs::msg::PointCloud2>::SharedPtr cloud_;
};

}  // namespace viewshed_cpp

RCLCPP_COMPONENTS_REGISTER_NODE(viewshed_cpp::FieldOfView)
