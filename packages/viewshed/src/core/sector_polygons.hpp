// The few sectors of a circle that cover the most of what lies below a profile of ranges, exactly.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Sectors: first bin, end bin (beyond the last where it wraps) and range.
struct BestSectors {
    std::vector<std::int64_t> first, end;
    std::vector<double> range;
};

// At most this number of sectors below ranges (bins,) of largest union; what is nearer than `inner` does not count.
//
// A sector of several directions reaches as far as the shortest of them, so only the widest sectors for each range
// matter. Those are nested or apart: they are the nodes of the profile's Cartesian tree (Vuillemin 1980), and choosing
// some of them is dynamic programming over the tree with the nearest chosen ancestor as state.
BestSectors best_sectors(View1<const double> ranges, std::size_t sectors, double inner);

}  // namespace viewshed
