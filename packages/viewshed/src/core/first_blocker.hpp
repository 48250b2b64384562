// First blocker: the range up to which each azimuth is free of obstacles.
#pragma once

#include <optional>

#include "azimuth_bins.hpp"

namespace viewshed {

// Parameters, as documented in viewshed.estimators.first_blocker.FirstBlocker.
struct BlockerRules {
    std::size_t rank, median_bins;
    std::optional<float> reach_m;  // visible range of a bin without an obstacle; by default its farthest return
    float margin_m;                // tolerance for a cell's center beyond the limit
};

// Return the range (bins,) up to which a cell's center is visible, -1 for a bin without a return. `bins` = 0 takes as
// many bins as the returns fill.
Buffer<float> first_blocker(const LeveledReturns& returns, std::size_t bins, const BlockerRules& rules);

}  // namespace viewshed
