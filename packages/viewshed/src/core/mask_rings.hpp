// Rings around the true cells of a mask, and cells inside rings; in units of cells.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Rings of corners of cells, one after the other: x and y of each corner, where each ring begins (one more than there
// are rings), and the region of each ring, negative where it is a hole.
struct MaskRings {
    std::vector<std::int16_t> corners;
    std::vector<std::int64_t> begin;
    std::vector<std::int32_t> region;
};

// The rings around the true cells of a square mask, whose connected regions are numbered in `regions`. Only corners where
// a ring turns are in it. Cells that touch at a corner alone are apart.
MaskRings trace_rings(View2<const bool> mask, View2<const std::int32_t> regions);

// Closed rings of points (V, 2), the last of each the same as its first; `begin` (rings + 1,) says where they begin.
struct ClosedRings {
    View2<const double> points;
    View1<const std::int64_t> begin;
};

// Write whether the center of each cell lies inside closed rings, by the even-odd rule: cell (i, j) spans [i, i + 1].
void fill_closed_rings(const ClosedRings& rings, View2<bool> inside);

// Write whether an edge of a ring passes through each cell, or merely meets it.
void find_cells_met(const ClosedRings& rings, View2<bool> met);

}  // namespace viewshed
