// Exact choice of the few circle sectors that cover most of the area below a range profile.
#pragma once

#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Sectors: first bin, end bin (beyond the last if it wraps) and range.
struct BestSectors {
    std::vector<std::int64_t> first, end;
    std::vector<double> range;
};

// Return at most `sectors` sectors below ranges (bins,) with the largest union; area nearer than `inner` does not
// count.
//
// A sector reaches as far as the shortest of its bins, so only the widest sector for each range matters. Those are
// nested or disjoint: they are the nodes of the profile's Cartesian tree (Vuillemin 1980). The choice is dynamic
// programming over the tree, with the nearest chosen ancestor as state.
BestSectors best_sectors(View1<const double> ranges, std::size_t sectors, double inner);

}  // namespace viewshed
