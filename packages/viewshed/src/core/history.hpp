// What earlier sweeps saw: obstacles by direction from where the sensor is now, and which cells a sweep confirms.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Rows by rise over range from the least to the greatest at which obstacles are remembered, 0.2° each; azimuth columns of .25°.
constexpr std::size_t SLOPE_ROWS = 320, AZIMUTHS = 1440;
constexpr double LEAST_SLOPE = -0.75, MOST_SLOPE = 0.35;

// Lines of sight are looked along in every fourth row and column.
constexpr std::size_t SIGHT_STEP = 4;
constexpr std::size_t SIGHT_LINES = SLOPE_ROWS / SIGHT_STEP * (AZIMUTHS / SIGHT_STEP);

struct Point {
    float x, y, z;
};

// The returns (M,) of a sweep that are higher above the ground than `least_m`, moved by a transform (3, 4).
std::vector<Point> obstacle_points(View2<const float> points, View1<const float> height_m, View2<const float> transform,
                                   float least_m);

// The horizontal range of the nearest obstacle by slope and azimuth, +inf where there is none: what two sweeps saw in one
// place of the map, or what the only sweep saw. The edges of obstacles are left out.
void draw_image(const std::vector<std::vector<Point>>& sweeps, float sensor_height_m, View2<float> image);

// Write the depth of each beam, no deeper than the obstacle in its direction.
void end_at_obstacles(const float* image, const float* azimuth, const float* slope, const float* depth_m, std::size_t size,
                      float* out);

// Write the azimuth and slope (SIGHT_LINES,) of the lines of sight.
void sight_lines(View1<float> azimuth, View1<float> slope);

// Mark the cells that an earlier sweep saw, as a mask (cells, cells) of its own frame says, and to which enough of the line
// of sight is open. `earlier_from_now` (2, 3) maps x, y, 1.
void confirm_cells(View2<const bool> seen, View2<const float> earlier_from_now, const float* origin_m, float cell_m,
                   const float* open, const float* whole, bool* confirmed);

}  // namespace viewshed
