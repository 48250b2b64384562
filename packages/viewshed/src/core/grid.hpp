// Count points by cell of a bird's-eye-view grid.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Grid and limits of the counted points; lengths in meters, heights in the level frame.
struct Counted {
    float origin_x, origin_y, cells_per_m, side;
    float low, high, most_range2, least_distance2;
};

// Write the number of points (N, 3) in each cell (cells · cells), after a rotation (3, 3) and a translation (3,).
void count_points(View2<const float> points, const float* rotation, const float* translation, const Counted& counted,
                  View1<std::int32_t> counts);

// A square grid: cells per side, cell size, and corner of least x and y, in meters.
struct CellCenters {
    std::size_t cells;
    double cell_m, x0_m, y0_m;
};

// Write the range in meters and azimuth in [-π, π) of cell centers (cells · cells).
void polar_of_cells(const CellCenters& grid, View1<float> range_m, View1<float> azimuth);

}  // namespace viewshed
