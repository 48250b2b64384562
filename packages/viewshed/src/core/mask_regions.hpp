// Connected regions of a mask, and the distance of its cells to the border.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Label the connected regions of a mask, 0 for false cells. Regions are numbered from 1 by their first cell in
// row-major order. Cells connect across sides, with `diagonal` also across corners.
void label_regions(View2<const bool> mask, bool diagonal, View2<std::int32_t> labels);

// Write the squared distance in cells to the nearest false cell, 0 for false cells. Cells beyond the border are false.
void find_squared_depth(View2<const bool> mask, View2<std::int64_t> depth);

}  // namespace viewshed
