#include "ground_guess.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <numbers>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();

// Azimuths, and ranges in nodes, by which the lowest passing beam is kept.
constexpr std::size_t BINS = 1024, RANGES = 100;

// A beam passes over what lies this number of nodes before its end, or more.
constexpr float BEFORE_END = 2.0f;

// Half the width in nodes of what a beam must cross to pass over a node.
constexpr float HALF_NODE = 0.35f;

// Heights farther above or below the ground as it was found are cut off; units of height and range.
constexpr float MOST_ABOVE_M = 15.0f, GROUND_UNIT_M = 4.0f, RANGE_UNIT_M = 64.0f;

// What a lattice of n × n nodes shows from its middle, whatever the size of its nodes.
struct Sight {
    std::size_t nodes;
    std::vector<float> range;              // (n, n) in nodes
    std::vector<std::int16_t> first, last;  // (n, n) bins of azimuth that a beam over the node lies in; first may be negative
};

std::shared_ptr<const Sight> sight_of(std::size_t n) {
    static std::mutex mutex;
    static std::shared_ptr<const Sight> kept;
    std::lock_guard lock(mutex);
    if (kept && kept->nodes == n) return kept;
    auto made = std::make_shared<Sight>(Sight{n, {}, {}, {}});
    constexpr double PER_RAD = BINS / (2 * std::numbers::pi);
    for (std::size_t at = 0; at < n * n; ++at) {
        const double u = double(at / n) + 0.5 - double(n) / 2, v = double(at % n) + 0.5 - double(n) / 2;
        const double range = std::hypot(u, v), middle = std::atan2(v, u) + std::numbers::pi;
        const double wide = double(HALF_NODE) / std::max(range, 0.5);
        made->range.push_back(float(range));
        made->first.push_back(std::int16_t(std::floor((middle - wide) * PER_RAD)));
        made->last.push_back(std::int16_t(std::floor((middle + wide) * PER_RAD)));
    }
    return kept = made;
}

// Returns of each node: how many, z of the two lowest and of the highest; +inf, +inf and -inf for none.
struct Columns {
    explicit Columns(std::size_t size) : count(size, 0.0f), second(size, NONE), lowest(size, NONE), highest(size, -NONE) {}
    Buffer<float> count, second, lowest, highest;
};

// The least slope by range (RANGES + 1) and azimuth (BINS) of the beams that end well beyond that range.
Buffer<float> sort_returns(const LevelReturns& returns, std::size_t n, float half_m, float sensor_m, Columns& columns) {
    const float per_m = float(n) / (2.0f * half_m), side = float(n);
    constexpr float PER_RAD = float(BINS / (2 * std::numbers::pi));
    Buffer<float> slopes((RANGES + 1) * BINS, NONE);
    for (std::size_t k = 0; k < returns.range_m.size; ++k) {
        const float* p = returns.points[k];
        const float z = p[2], u = (p[0] + half_m) * per_m, v = (p[1] + half_m) * per_m;
        if (u >= 0.0f && v >= 0.0f && u < side && v < side) {
            const std::size_t at = std::size_t(u) * n + std::size_t(v);
            columns.count[at] += 1.0f;
            columns.second[at] = std::min(columns.second[at], std::max(columns.lowest[at], z));
            columns.lowest[at] = std::min(columns.lowest[at], z);
            columns.highest[at] = std::max(columns.highest[at], z);
        }
        const float range_m = returns.range_m[k], turned = (returns.azimuth[k] + PI) * PER_RAD;
        const float before_end = range_m * per_m - BEFORE_END;
        if (!(before_end >= 0.0f && turned >= 0.0f)) continue;  // nor what is no number
        const auto beyond = std::size_t(std::min(before_end, float(RANGES)));
        float& slope = slopes[beyond * BINS + std::size_t(std::min(turned, float(BINS - 1)))];
        slope = std::min(slope, (z - sensor_m) / range_m);
    }
    for (std::size_t b = RANGES; b-- > 0;) {
        float *here = &slopes[b * BINS], *beyond = here + BINS;
        for (std::size_t a = 0; a < BINS; ++a) here[a] = beyond[a] < here[a] ? beyond[a] : here[a];
    }
    return slopes;
}

// The least slope of the beams over a node; +inf for none.
INLINE float lowest_slope(const Buffer<float>& slopes, const Sight& sight, std::size_t at) {
    float least = NONE;
    if (sight.range[at] >= float(RANGES + 1)) return least;
    const float* row = &slopes[std::size_t(sight.range[at]) * BINS];
    for (int a = sight.first[at]; a <= sight.last[at]; ++a) least = std::min(least, row[std::size_t(a) % BINS]);
    return least;
}

INLINE float cut(float above) {
    return std::clamp(above, -MOST_ABOVE_M, MOST_ABOVE_M);
}

}  // namespace

void guess_inputs(const LevelReturns& returns, const FoundOnLattice& ground, float sensor_height_m, View1<float> inputs) {
    const std::size_t n = ground.heights_m.rows;
    const auto sight = sight_of(n);
    Columns columns(n * n);
    const Buffer<float> slopes = sort_returns(returns, n, ground.half_m, sensor_height_m, columns);
    const float node_m = 2.0f * ground.half_m / float(n);
    for_ranges(n, count_parts(n, 32), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            for (std::size_t j = 0; j < n; ++j) {
                const std::size_t at = i * n + j;
                const float range = sight->range[at], count = columns.count[at], z = ground.heights_m(i, j);
                const float least = lowest_slope(slopes, *sight, at);
                const bool is_met = count > 0.0f, is_passed = least < NONE;
                const float second = count == 1.0f ? columns.lowest[at] : columns.second[at];
                const std::array<float, GUESS_INPUTS> values{
                    is_met ? 1.0f : 0.0f,
                    is_met ? cut(second - z) : 0.0f,
                    is_met ? cut(columns.lowest[at] - z) : 0.0f,
                    is_met ? cut(columns.highest[at] - z) : 0.0f,
                    std::log1p(count) / 3.0f,
                    is_passed ? cut(sensor_height_m + least * range * node_m - z) : 0.0f,
                    is_passed ? 1.0f : 0.0f,
                    ground.seen(i, j) ? 1.0f : 0.0f,
                    z / GROUND_UNIT_M,
                    range * node_m / RANGE_UNIT_M,
                    sensor_height_m / 2.0f,
                    node_m,
                    std::min(ground.std_m(i, j), MOST_ABOVE_M),
                };
                for (std::size_t c = 0; c < GUESS_INPUTS; ++c) inputs[c * n * n + at] = values[c];
            }
        }
    });
}

}  // namespace viewshed
