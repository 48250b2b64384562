// Measurements of the leveled returns of a range image: depths by pixel, and counts by range.
#pragma once

#include <array>

#include "arrays.hpp"

namespace viewshed {

// The share of ground that returns is measured in SHARE_BINS range bins (the last one is open) and SHARE_SECTORS
// azimuth sectors, so that a single absorbing object does not decide.
constexpr double SHARE_BIN_M = 2.5;
constexpr std::size_t SHARE_BINS = 52, SHARE_SECTORS = 24;

// One-meter range bins that measure the sensor's reach.
constexpr std::size_t REACH_BINS = 512;

// Horizontal ranges of the nearest return of a pixel and of the nearest one on an obstacle; +inf for none.
struct Depth {
    float nearest_m, obstacle_m;
};

using ShareCounts = std::array<std::array<std::int64_t, SHARE_BINS>, SHARE_SECTORS>;

struct DepthImages {
    std::size_t rings, columns;
    Buffer<std::uint8_t> counts;  // (rings, columns) returns of each pixel, saturated at 255
    Buffer<Depth> depths;         // (rings, columns)
    ShareCounts ground_counts;    // returns from ground beyond the steep part, by azimuth and range
    std::array<std::int64_t, REACH_BINS> meter_counts;  // returns in each meter of range

    View2<const std::uint8_t> all_counts() const { return {counts.data(), rings, columns}; }
    const Depth* ring(std::size_t r) const { return depths.data() + r * columns; }
};

// Pixels of the N returns of a sweep, and masks left_out (N,) and clutter (N,) of returns to ignore; a mask may be
// empty. Leveled returns are never clutter.
struct Pixels {
    View1<const std::int16_t> ring;
    View1<const std::int32_t> column;
    View2<const std::uint8_t> counts;
    View1<const bool> left_out, clutter;
};

// M leveled returns: horizontal range, height above the ground, row in the sweep.
struct Returns {
    View1<const float> range_m, height_m;
    View1<const std::int32_t> rows;
};

// Build depth images. Returns higher than low_m above the ground lie on obstacles; others beyond steep_m count as
// ground. Throws std::invalid_argument if a row, ring or column does not exist.
DepthImages depth_images(const Pixels& pixels, const Returns& returns, float low_m, float steep_m);

}  // namespace viewshed
