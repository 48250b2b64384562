// Outline rings of a mask's true cells, and cells inside rings; in units of cells.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Concatenated rings: x and y of cell corners, starts of rings (one more), and their regions, negative for holes.
struct MaskRings {
    std::vector<std::int16_t> corners;
    std::vector<std::int64_t> begin;
    std::vector<std::int32_t> region;
};

// Trace the rings around the true cells of a square mask, with connected regions numbered in `regions`. Only corners
// where a ring turns are stored. Cells that touch only at a corner are separate.
MaskRings trace_rings(View2<const bool> mask, View2<const std::int32_t> regions);

// Closed rings of points (V, 2), whose last point repeats the first; `begin` (rings + 1,) holds their starts.
struct ClosedRings {
    View2<const double> points;
    View1<const std::int64_t> begin;
};

// Mark the cells whose centers lie inside closed rings, by the even-odd rule; cell (i, j) spans [i, i + 1].
void fill_closed_rings(const ClosedRings& rings, View2<bool> inside);

// Mark the cells that an edge of a ring crosses or touches.
void find_cells_met(const ClosedRings& rings, View2<bool> met);

}  // namespace viewshed
