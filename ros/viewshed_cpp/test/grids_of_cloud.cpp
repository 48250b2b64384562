// Convert a cloud from a file of x, y, z to grids, as the node does; and refuse inconsistent clouds.
#include <cstring>
#include <fstream>
#include <iostream>
#include <iterator>
#include <stdexcept>

#include "viewshed_cpp/messages.hpp"

using sensor_msgs::msg::PointCloud2;
using sensor_msgs::msg::PointField;

static PointCloud2 cloud_of(const std::vector<char> & xyz)
{
  constexpr std::size_t STEP = 22;
  PointCloud2 cloud;
  const char * const names[] = {"ring", "x", "y", "z"};
  const std::uint32_t offsets[] = {0, 4, 8, 12};
  for (std::size_t k = 0; k < 4; ++k) {
    PointField field;
    field.name = names[k], field.offset = offsets[k], field.count = 1;
    field.datatype = k == 0 ? PointField::UINT16 : PointField::FLOAT32;
    cloud.fields.push_back(field);
  }
  cloud.height = 1, cloud.width = std::uint32_t(xyz.size() / 12), cloud.point_step = STEP;
  cloud.row_step = cloud.width * cloud.point_step;
  cloud.data.resize(cloud.row_step);
  for (std::size_t n = 0; n < cloud.width; ++n) {std::memcpy(&cloud.data[n * STEP + 4], &xyz[12 * n], 12);}
  return cloud;
}

template<typename Change>
static bool refuses(PointCloud2 cloud, const Change & change)
{
  change(cloud);
  try {
    viewshed_cpp::sweep_of(cloud, "ring");
  } catch (const std::invalid_argument &) {
    return true;
  }
  return false;
}

int main(int argc, char ** argv)
{
  if (argc != 3) {return 2;}
  std::ifstream file(argv[1], std::ios::binary);
  const std::vector<char> xyz{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  const PointCloud2 cloud = cloud_of(xyz);
  // 1. Inconsistent clouds.
  if (refuses(cloud, [](PointCloud2 &) {})) {return 3;}
  if (!refuses(cloud, [](PointCloud2 & c) {c.data.pop_back();})) {return 4;}
  if (!refuses(cloud, [](PointCloud2 & c) {c.fields[3].offset = 20;})) {return 5;}
  if (!refuses(cloud, [](PointCloud2 & c) {c.fields[0].datatype = PointField::UINT8;})) {return 6;}
  if (!refuses(cloud, [](PointCloud2 & c) {c.fields.pop_back();})) {return 7;}
  if (!refuses(cloud, [](PointCloud2 & c) {c.width = c.height = 0xffffffff;})) {return 8;}
  if (!refuses(cloud, [](PointCloud2 & c) {c.is_bigendian = true;})) {return 9;}
  // 2. The grids of a cloud.
  const viewshed_options options = viewshed_defaults();
  const viewshed::Stream stream(options);
  viewshed_sweep sweep = viewshed_cpp::sweep_of(cloud);
  const double attitude[4] = {0.9689124217106447, 0.0, 0.24740395925452294, 0.0};  // turned by half a radian about y
  sweep.attitude = argv[2][0] == 't' ? attitude : nullptr;
  const viewshed::Estimate estimate = stream.estimate(sweep);
  for (const auto layer : {viewshed_cpp::Layer::VISIBILITY, viewshed_cpp::Layer::STATE}) {
    const auto grid = viewshed_cpp::grid_of(estimate, options, layer, cloud.header);
    std::cout.write(reinterpret_cast<const char *>(grid.data.data()), std::streamsize(grid.data.size()));
    const auto & at = grid.info.origin;
    const double pose[7] = {at.position.x, at.position.y, at.position.z, at.orientation.w, at.orientation.x,
      at.orientation.y, at.orientation.z};
    std::cout.write(reinterpret_cast<const char *>(pose), sizeof pose);
  }
  return 0;
}
