// What the leveled returns of a range image measure in `level`: depths by pixel, and counts by range.
#pragma once

#include <array>

#include "arrays.hpp"

namespace viewshed {

// The share of ground that returns is learned in SHARE_BINS bins of range (the last one holds everything beyond), and
// in SHARE_SECTORS sectors of azimuth, so that one thing that swallows light does not decide.
constexpr double SHARE_BIN_M = 2.5;
constexpr std::size_t SHARE_BINS = 52, SHARE_SECTORS = 24;

// Bins of one meter in which returns are counted for the reach.
constexpr std::size_t REACH_BINS = 512;

// Horizontal range of the nearest return of a pixel, and of the nearest one on an obstacle; +inf for none.
struct Depth {
    float nearest_m, obstacle_m;
};

using ShareCounts = std::array<std::array<std::int64_t, SHARE_BINS>, SHARE_SECTORS>;

struct DepthImages {
    std::size_t rings, columns;
    Buffer<std::uint8_t> counts;  // (rings, columns) returns of each pixel, up to 255
    Buffer<Depth> depths;         // (rings, columns)
    ShareCounts ground_counts;    // returns from ground beyond the steep part, by azimuth and range
    std::array<std::int64_t, REACH_BINS> meter_counts;  // returns in each meter of range

    View2<const std::uint8_t> all_counts() const { return {counts.data(), rings, columns}; }
    const Depth* ring(std::size_t r) const { return depths.data() + r * columns; }
};

// The pixels of the N returns of a sweep, and those of them that are no evidence: left_out (N,) and clutter (N,), which
// have no element where there are none. Leveled returns are never clutter.
struct Pixels {
    View1<const std::int16_t> ring;
    View1<const std::int32_t> column;
    View2<const std::uint8_t> counts;
    View1<const bool> left_out, clutter;
};

// The M leveled returns: horizontal range, height above the ground, row in the sweep.
struct Returns {
    View1<const float> range_m, height_m;
    View1<const std::int32_t> rows;
};

// Returns higher than low_m above the ground are on obstacles. Others count as ground beyond steep_m. Raises
// invalid_argument where a row, ring or column does not exist.
DepthImages depth_images(const Pixels& pixels, const Returns& returns, float low_m, float steep_m);

}  // namespace viewshed
