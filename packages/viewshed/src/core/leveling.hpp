// The returns of a sweep in its level frame, and what they measure there.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// The M returns that count, in the sweep's order; viewshed.preprocess.leveling.LeveledSweep says what each is.
struct LevelPoints {
    std::size_t count;
    Buffer<float> points;  // (M, 3)
    Buffer<float> range_m, azimuth, height_m;
    Buffer<std::int32_t> rows;
};

// Where the ground is: heights (n, n) of a lattice that spans ±half_extent_m, bilinear in between.
struct Ground {
    View2<const float> heights_m;
    float half_extent_m;
};

// Turn and raise points (N, 3) by level_from_sensor (3, 4), and measure those that count: within [near_m, far_m] of the
// sensor, not clutter (N,) if there is a mask of it, not in the box of a vehicle with this heading below the sensor.
LevelPoints level_points(View2<const float> points, View1<const bool> clutter, View2<const float> level_from_sensor,
                         float near_m, float far_m, double heading, const Ground& ground);

// Cells of a square grid, the corner of least x and y first, and the heights above the ground that count.
struct SquareCells {
    float x0_m, y0_m, cells_per_m, low_m, high_m;
    std::int32_t cells;
};

// Mark the cells (cells · cells + 1,) that hold a level point (M, 3) between two heights above the ground (M,); the last one is
// marked for points in no cell.
void mark_cells(View2<const float> points, View1<const float> height_m, const SquareCells& of, View1<bool> mask);

// Write the rise over range (M,) from the sensor to level points (M, 3), +inf for those whose row is left_out (N,);
// without any element nothing is left out.
void beam_slopes(View2<const float> points, View1<const float> range_m, float sensor_height_m,
                 View1<const bool> left_out, View1<const std::int32_t> rows, View1<float> slope);

}  // namespace viewshed
