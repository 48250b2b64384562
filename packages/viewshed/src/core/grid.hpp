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

// Cells of a square grid: their number a side, their length, and the corner of least x and y, in meters.
struct CellCenters {
    std::size_t cells;
    double cell_m, x0_m, y0_m;
};

// Write range in meters and azimuth in [-π, π) of the centers of cells (cells · cells).
void polar_of_cells(const CellCenters& grid, View1<float> range_m, View1<float> azimuth);

}  // namespace viewshed
