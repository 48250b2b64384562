// Returns of a sweep in its level frame, and their measurements there.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// The M kept returns in the sweep's order; the fields are documented in viewshed.preprocess.leveling.LeveledSweep.
struct LevelPoints {
    std::size_t count;
    Buffer<float> points;  // (M, 3)
    Buffer<float> range_m, azimuth, height_m;
    Buffer<std::int32_t> rows;
};

// Ground heights (n, n) on a lattice that spans ±half_extent_m, bilinear in between.
struct Ground {
    View2<const float> heights_m;
    float half_extent_m;
};

// Transform points (N, 3) by level_from_sensor (3, 4) and measure those that are kept: within [near_m, far_m] of the
// sensor, not clutter (N,; may be empty), and outside the box of a vehicle with this heading below the sensor. Their
// heights are not measured yet.
LevelPoints level_points(View2<const float> points, View1<const bool> clutter, View2<const float> level_from_sensor,
                         float near_m, float far_m, double heading);

// Measure the heights of level points above the ground.
void measure_heights(LevelPoints& level, const Ground& ground);

// A square grid, given by its corner of least x and y, and the height limits above the ground.
struct SquareCells {
    float x0_m, y0_m, cells_per_m, low_m, high_m;
    std::int32_t cells;
};

// Mark the cells (cells · cells + 1,) that hold a level point (M, 3) within the height limits above the ground (M,).
// The last element is marked by points outside all cells.
void mark_cells(View2<const float> points, View1<const float> height_m, const SquareCells& of, View1<bool> mask);

// Write the slope (M,) from the sensor to level points (M, 3), +inf where their row is left_out (N,; may be empty).
void beam_slopes(View2<const float> points, View1<const float> range_m, float sensor_height_m,
                 View1<const bool> left_out, View1<const std::int32_t> rows, View1<float> slope);

}  // namespace viewshed
