// Memory of earlier sweeps: obstacles by direction from the present sensor position, and cells that a sweep confirms.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Image of obstacles: rows of 0.2° between MIN_SLOPE and MAX_SLOPE (rise over range), azimuth columns of 0.25°.
constexpr std::size_t SLOPE_ROWS = 320, AZIMUTHS = 1440;
constexpr double MIN_SLOPE = -0.75, MAX_SLOPE = 0.35;

// Lines of sight are sampled in every fourth row and column.
constexpr std::size_t SIGHT_STEP = 4;
constexpr std::size_t SIGHT_LINES = SLOPE_ROWS / SIGHT_STEP * (AZIMUTHS / SIGHT_STEP);

struct Point {
    float x, y, z;
};

// Return the returns of a sweep higher than `least_m` above the ground, transformed by (3, 4).
std::vector<Point> obstacle_points(View2<const float> points, View1<const float> height_m, View2<const float> transform,
                                   float least_m);

// Write the horizontal range of the nearest obstacle by slope and azimuth, +inf for none: obstacles that two sweeps saw
// at the same place of the map, or all of a single sweep. The edges of obstacles are removed.
void draw_image(const std::vector<std::vector<Point>>& sweeps, float sensor_height_m, View2<float> image);

// Write the depth of each beam, limited by the obstacle in its direction.
void end_at_obstacles(const float* image, const float* azimuth, const float* slope, const float* depth_m, std::size_t size,
                      float* out);

// Write azimuth and slope (SIGHT_LINES,) of the lines of sight.
void sight_lines(View1<float> azimuth, View1<float> slope);

// Mark the cells that an earlier sweep saw (mask (cells, cells) in its own frame) and to which enough of the line of
// sight is open. `earlier_from_now` (2, 3) maps x, y, 1.
void confirm_cells(View2<const bool> seen, View2<const float> earlier_from_now, const float* origin_m, float cell_m,
                   const float* open, const float* whole, bool* confirmed);

}  // namespace viewshed
