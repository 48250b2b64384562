#include "first_blocker.hpp"

#include <algorithm>
#include <vector>

namespace viewshed {
namespace {

// Replace each limit by the lower median over bins with returns, `half` to either side.
void smooth(View1<const float> farthest_m, std::size_t half, View1<float> blocker_m) {
    const std::size_t bins = blocker_m.size;
    const std::vector<float> before(blocker_m.begin(), blocker_m.end());
    std::vector<float> window;
    for (std::size_t b = 0; b < bins; ++b) {
        window.clear();
        for (std::size_t k = 0; k <= 2 * half; ++k) {
            const std::size_t c = (b + k + bins * half - half) % bins;
            if (farthest_m[c] >= 0.0f) window.push_back(before[c]);
        }
        if (window.empty()) continue;
        const auto middle = window.begin() + std::ptrdiff_t((window.size() - 1) / 2);
        std::nth_element(window.begin(), middle, window.end());
        blocker_m[b] = *middle;
    }
}

}  // namespace

Buffer<float> first_blocker(const LeveledReturns& returns, std::size_t bins, const BlockerRules& rules) {
    // 1. Find the blocking obstacle of each bin.
    BinRanges ranges = find_ranges(returns, bins);
    Buffer<float> &farthest_m = ranges.farthest_m, &limit_m = ranges.nearest_m;
    if (rules.rank > 1) find_nearest_obstacle(returns, rules.rank, limit_m);
    if (rules.median_bins > 0) smooth(farthest_m, rules.median_bins / 2, limit_m);
    // 2. Limit the visible range by it, and by the farthest return or the sensor's reach.
    for (std::size_t b = 0; b < limit_m.size(); ++b) {
        const float free_m = std::min(limit_m[b], rules.reach_m.value_or(farthest_m[b]));
        limit_m[b] = farthest_m[b] >= 0.0f ? free_m + rules.margin_m : -1.0f;
    }
    return std::move(limit_m);
}

}  // namespace viewshed
