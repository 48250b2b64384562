// Star shapes about a point that stay inside a mask: how far each direction is free, and the few vertices that keep the
// most of it. Directions are equal wedges, wedge k from angle 2πk/bins to 2π(k+1)/bins, counter-clockwise from x.
#pragma once

#include <vector>

#include "concave_hull.hpp"

namespace viewshed {

// Write how far each wedge (bins,) reaches from an apex, up to boxes of half a side about the centers of the false cells of
// a mask and of the cells around the grid; 0 where the apex lies in one, or off the grid. Where the boxes are solid (no less than the
// cells), those with no true cell beside them lie behind others and are left out.
void find_free_ranges(View2<const bool> mask, const SquareGrid& grid, PlanePoint apex, double half_m, bool is_solid,
                      View1<double> ranges);

// Angle and range of a vertex.
struct StarVertex {
    double angle, range;
};

// The star polygon below ranges (bins,) with the most area less a price for each vertex. Vertices stand on the wedges'
// borders at a few dozen candidate ranges; among those the choice is optimal but for its first vertex, which a first
// pass finds. Empty where some direction is not free or nothing pays.
std::vector<StarVertex> star_vertices(View1<const double> ranges, double price_m2);

}  // namespace viewshed
