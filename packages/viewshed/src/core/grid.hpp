// Points by cell of a bird's-eye-view grid.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Where points are counted and which of them; lengths in meters, heights in the level frame.
struct Counted {
    float origin_x, origin_y, cells_per_m, side;
    float low, high, most_range2, least_distance2;
};

// Write how many of the points (N, 3), after a rotation (3, 3) and a translation (3,), lie in each cell (cells · cells).
void count_points(View2<const float> points, const float* rotation, const float* translation, const Counted& counted,
                  View1<std::int32_t> counts);

}  // namespace viewshed
