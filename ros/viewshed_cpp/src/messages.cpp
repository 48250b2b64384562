#include "viewshed_cpp/messages.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>

namespace viewshed_cpp {
namespace {

using sensor_msgs::msg::PointCloud2;
using sensor_msgs::msg::PointField;

// The offset of a field in a point. Throws unless it has one value of this type and lies within the point.
std::size_t offset_of(const PointCloud2 & cloud, const std::string & name, std::uint8_t type, std::size_t size) {
  const auto field = std::find_if(cloud.fields.begin(), cloud.fields.end(), [&](const auto & f) {return f.name == name;});
  if (field == cloud.fields.end() || field->datatype != type || field->count > 1) {
    throw std::invalid_argument("a cloud must have one value of its usual type in field " + name);
  }
  if (cloud.point_step < size || field->offset > cloud.point_step - size) {
    throw std::invalid_argument("field " + name + " must lie within point_step");
  }
  return field->offset;
}

// The quaternion (x, y, z, w) of the transpose of a rotation, by Shepperd's method, which divides by the largest component.
std::array<double, 4> quaternion_of_transpose(const double * r) {
  const double trace = r[0] + r[4] + r[8];
  const std::array<double, 4> squares{1 + 2 * r[0] - trace, 1 + 2 * r[4] - trace, 1 + 2 * r[8] - trace, 1 + trace};
  const auto largest = std::size_t(std::max_element(squares.begin(), squares.end()) - squares.begin());
  const double q = std::sqrt(squares[largest]) / 2, s = 1 / (4 * q);
  const double x = r[5] - r[7], y = r[6] - r[2], z = r[1] - r[3];  // 4 w times x, y, z, of the transpose
  const double xy = r[1] + r[3], xz = r[2] + r[6], yz = r[5] + r[7];
  switch (largest) {
    case 0: return {q, s * xy, s * xz, s * x};
    case 1: return {s * xy, q, s * yz, s * y};
    case 2: return {s * xz, s * yz, q, s * z};
    default: return {s * x, s * y, s * z, q};
  }
}

}  // namespace

viewshed_sweep sweep_of(const PointCloud2 & cloud, const std::string & ring_field) {
  if (cloud.is_bigendian) {throw std::invalid_argument("a cloud must be little-endian");}
  const std::size_t x = offset_of(cloud, "x", PointField::FLOAT32, 4);
  if (offset_of(cloud, "y", PointField::FLOAT32, 4) != x + 4 || offset_of(cloud, "z", PointField::FLOAT32, 4) != x + 8) {
    throw std::invalid_argument("fields x, y and z must follow each other");
  }
  viewshed_sweep sweep = viewshed_no_sweep();
  sweep.count = std::size_t(cloud.width) * cloud.height;
  const bool is_padded = cloud.height > 1 && cloud.row_step != std::uint64_t(cloud.width) * cloud.point_step;
  // Divide instead of multiplying, so that count * point_step cannot overflow.
  if (is_padded || (sweep.count > 0 && cloud.data.size() / sweep.count < cloud.point_step)) {
    throw std::invalid_argument("data must hold width * height points without padding");
  }
  sweep.points = cloud.data.data() + x;
  sweep.point_step = cloud.point_step;
  if (!ring_field.empty()) {
    sweep.ring = cloud.data.data() + offset_of(cloud, ring_field, PointField::UINT16, 2);
    sweep.ring_step = cloud.point_step;
  }
  return sweep;
}

nav_msgs::msg::OccupancyGrid grid_of(
  const viewshed::Estimate & estimate, const viewshed_options & options, Layer layer, const std_msgs::msg::Header & header)
{
  const std::size_t cells = options.cells;
  nav_msgs::msg::OccupancyGrid grid;
  grid.header = header;
  grid.info.map_load_time = header.stamp;
  grid.info.resolution = float(2 * options.half_extent_m / double(cells));
  grid.info.width = grid.info.height = options.cells;
  // The corner of the grid on the ground, in the sensor's frame.
  const double * r = estimate.basis.level_from_sensor;
  const double level[3] = {
    options.offset_m[0] - options.half_extent_m, options.offset_m[1] - options.half_extent_m, -estimate.basis.sensor_height_m};
  grid.info.origin.position.x = r[0] * level[0] + r[3] * level[1] + r[6] * level[2];
  grid.info.origin.position.y = r[1] * level[0] + r[4] * level[1] + r[7] * level[2];
  grid.info.origin.position.z = r[2] * level[0] + r[5] * level[1] + r[8] * level[2];
  const auto [qx, qy, qz, qw] = quaternion_of_transpose(r);
  grid.info.origin.orientation.x = qx;
  grid.info.origin.orientation.y = qy;
  grid.info.origin.orientation.z = qz;
  grid.info.origin.orientation.w = qw;
  // OccupancyGrid data run along x first, cells of the estimate along y.
  constexpr std::array<std::int8_t, 4> STATES{-1, 0, 100, 50};
  grid.data.resize(cells * cells);
  for (std::size_t i = 0; i < cells; ++i) {
    for (std::size_t j = 0; j < cells; ++j) {
      const std::size_t n = i * cells + j;
      const std::uint8_t state = estimate.state[n];
      const auto percent = std::int8_t(std::nearbyint(100.0f * estimate.visible_prob[n]));
      grid.data[j * cells + i] = layer == Layer::STATE ? STATES[state] : state == VIEWSHED_UNKNOWN ? std::int8_t(-1) : percent;
    }
  }
  return grid;
}

}  // namespace viewshed_cpp
