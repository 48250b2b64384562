// Count the beams that would meet boxes without the boxes' own returns.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Columns of boxes: center x, y, z, length, width, height in meters, yaw in radians.
constexpr std::size_t NUMBERS = 7;

// A box seen from the sensor: position of the sensor relative to the box's center and axes; half sizes; heading.
struct SeenBox {
    float from_x, from_y, from_z, half_x, half_y, half_z, cosine, sine;
};

// Beams (B,) sorted by azimuth: horizontal direction, inverse slope, and depth.
class BeamsByAzimuth {
public:
    BeamsByAzimuth(View1<const float> azimuth, View1<const float> slope, View1<const float> depth_m);

    // Write how many beams meet each box (K, NUMBERS) from a sensor height. With leave_out_own, beams that end in it
    // continue.
    void count(View2<const float> boxes, float sensor_height_m, bool leave_out_own, View1<std::int32_t> returns) const;

private:
    std::int32_t count_one(const float* box, float sensor_height_m, bool leave_out_own) const;
    std::int32_t count_within(std::size_t begin, std::size_t end, const SeenBox& seen, bool leave_out_own) const;

    std::vector<std::size_t> first_;  // (COLUMNS + 1,)
    Buffer<float> x_, y_, per_rise_, depth_m_;
};

}  // namespace viewshed
