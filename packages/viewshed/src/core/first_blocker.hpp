// The first blocker: up to which range each azimuth is free of obstacles.
#pragma once

#include <optional>

#include "azimuth_bins.hpp"

namespace viewshed {

// What blocks; viewshed.estimators.first_blocker.FirstBlocker says what each is.
struct BlockerRules {
    std::size_t rank, median_bins;
    std::optional<float> reach_m;  // how far a bin without an obstacle is visible; without it, to its farthest return
    float margin_m;                // a cell's center may lie so far beyond
};

// The range (bins,) up to which a cell's center is visible, -1 in a bin without a return. Of 0 bins it is as many
// as the returns fill.
Buffer<float> first_blocker(const LeveledReturns& returns, std::size_t bins, const BlockerRules& rules);

}  // namespace viewshed
