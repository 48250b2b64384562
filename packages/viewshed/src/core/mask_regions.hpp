// Connected regions of a mask, and how deep a cell lies in one.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Write the number of each cell's connected region, 0 where the mask is false. Regions are numbered from 1 on by their first
// cells in row-major order. Cells connect across sides, and also across corners where `diagonal`.
void label_regions(View2<const bool> mask, bool diagonal, View2<std::int32_t> labels);

// Write the squared distance from each cell to the nearest false one, in cells; 0 at those. Cells beyond the border are
// false.
void find_squared_depth(View2<const bool> mask, View2<std::int64_t> depth);

}  // namespace viewshed
