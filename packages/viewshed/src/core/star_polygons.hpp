// Star-shaped polygons around a point inside a mask: the free range of each direction, and the few vertices that keep
// most of the area. Directions are equal wedges; wedge k spans 2πk/bins to 2π(k+1)/bins, counter-clockwise from x.
#pragma once

#include <vector>

#include "concave_hull.hpp"

namespace viewshed {

// Write the free range of each wedge (bins,) from an apex to boxes around the centers of false cells, with half side
// half_m. Cells outside the grid are false. The range is 0 if the apex lies in a box or off the grid. With is_solid
// (boxes at least as large as cells), false cells without a true neighbor are occluded and skipped.
void find_free_ranges(View2<const bool> mask, const SquareGrid& grid, PlanePoint apex, double half_m, bool is_solid,
                      View1<double> ranges);

// Angle and range of a vertex.
struct StarVertex {
    double angle, range;
};

// Return the star polygon below ranges (bins,) that maximizes area minus a price per vertex. Vertices lie on wedge
// borders at a few dozen candidate ranges; the choice among those is optimal up to the first vertex, which comes from a
// first pass. Empty if some direction is blocked or no polygon pays.
std::vector<StarVertex> star_vertices(View1<const double> ranges, double price_m2);

}  // namespace viewshed
