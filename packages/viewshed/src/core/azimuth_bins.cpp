#include "azimuth_bins.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <vector>

#include "parallel.hpp"

namespace viewshed {
namespace {

// Candidate numbers of bins, and the default if there are too few returns to measure the sensor's step.
constexpr std::array<std::size_t, 6> LADDER = {NARROWEST_BINS, 540, 360, 216, 180, 120};
constexpr std::size_t FALLBACK_BINS = 360;

// Required share of occupied bins with returns in both neighbors.
constexpr double FILLED_SHARE = 0.95;

constexpr float NO_OBSTACLE = std::numeric_limits<float>::infinity(), NO_RETURN = -1.0f;

// Tables filled in turn: consecutive returns mostly fall into the same bin, and would wait for the previous store.
constexpr std::size_t TABLES = 4;

// Fewest returns or cells for which a part pays for its thread.
constexpr std::size_t PART = 16384;

// Write the index of each return of a block in the tables.
MULTIVERSION void find_places(const float* azimuth, std::size_t count, std::size_t bins, std::int32_t* slot) {
    const double per_rad = bins_per_rad(bins), last = double(bins - 1);
    for (std::size_t k = 0; k < count; ++k) slot[k] = azimuth_bin(azimuth[k], per_rad, last);
    for (std::size_t k = 0; k < count; ++k) slot[k] += std::int32_t(k % TABLES) * std::int32_t(bins);
}

// Write the range of each return of a block that is an obstacle, +inf for the others.
MULTIVERSION void keep_obstacles(const float* range_m, const float* height_m, std::size_t count, float low_m,
                                 float high_m, float* obstacle_m) {
    for (std::size_t k = 0; k < count; ++k) {
        const bool is_obstacle = (low_m < height_m[k]) & (height_m[k] < high_m);
        obstacle_m[k] = is_obstacle ? range_m[k] : NO_OBSTACLE;
    }
}

// Insert a value into a row sorted by `before`, and drop the last one.
template <typename Before>
void insert(float* row, std::size_t size, float value, Before before) {
    if (!before(value, row[size - 1])) return;
    std::size_t k = size - 1;
    for (; k > 0 && before(value, row[k - 1]); --k) row[k] = row[k - 1];
    row[k] = value;
}

MULTIVERSION void compare(const float* range_m, const float* limit_m, std::size_t count, float* visible) {
    for (std::size_t k = 0; k < count; ++k) visible[k] = range_m[k] <= limit_m[k] ? 1.0f : 0.0f;
}

}  // namespace

std::size_t bins_filled(View1<const bool> occupied) {
    std::array<bool, NARROWEST_BINS> filled;
    for (const std::size_t bins : LADDER) {
        const std::size_t width = NARROWEST_BINS / bins;
        for (std::size_t b = 0; b < bins; ++b) {
            filled[b] = std::find(&occupied[b * width], &occupied[b * width] + width, true) != &occupied[b * width] + width;
        }
        std::size_t occupied_bins = 0, inner = filled[bins - 1] && filled[0] && filled[1];
        inner += filled[bins - 2] && filled[bins - 1] && filled[0];
        for (std::size_t b = 0; b < bins; ++b) occupied_bins += filled[b];
        for (std::size_t b = 1; b + 1 < bins; ++b) inner += filled[b - 1] & filled[b] & filled[b + 1];
        if (double(inner) >= FILLED_SHARE * double(std::max<std::size_t>(occupied_bins, 1))) return bins;
    }
    return FALLBACK_BINS;
}

std::size_t bins_filled_by(View1<const float> azimuth) {
    Buffer<bool> occupied(TABLES * NARROWEST_BINS, false);
    std::int32_t slot[BLOCK];
    for (std::size_t start = 0; start < azimuth.size; start += BLOCK) {
        const std::size_t size = std::min(BLOCK, azimuth.size - start);
        find_places(&azimuth[start], size, NARROWEST_BINS, slot);
        for (std::size_t k = 0; k < size; ++k) occupied[std::size_t(slot[k])] = true;
    }
    for (std::size_t k = NARROWEST_BINS; k < occupied.size(); ++k) occupied[k % NARROWEST_BINS] |= occupied[k];
    return bins_filled({occupied.data(), NARROWEST_BINS});
}

BinRanges find_ranges(const LeveledReturns& returns, std::size_t bins) {
    if (bins == 0) return ranges_of_filled(returns, find_ranges(returns, NARROWEST_BINS));
    const std::size_t count = returns.azimuth.size, size = TABLES * bins;
    const bool has_heights = returns.height_m.size > 0;
    // 1. Fill separate tables for each part of the returns.
    const std::size_t parts = count_parts(count, PART);
    Buffer<float> farthest(parts * size, NO_RETURN), nearest(has_heights ? parts * size : 0, NO_OBSTACLE);
    for_ranges(count, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        float *far = farthest.data() + part * size, *near = nearest.data() + part * size;
        std::int32_t slot[BLOCK];
        float obstacle_m[BLOCK];
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t block = std::min(BLOCK, end - start);
            const float* range_m = &returns.range_m[start];
            find_places(&returns.azimuth[start], block, bins, slot);
            for (std::size_t k = 0; k < block; ++k) far[slot[k]] = std::max(far[slot[k]], range_m[k]);
            if (!has_heights) continue;
            keep_obstacles(range_m, &returns.height_m[start], block, returns.low_m, returns.high_m, obstacle_m);
            for (std::size_t k = 0; k < block; ++k) near[slot[k]] = std::min(near[slot[k]], obstacle_m[k]);
        }
    });
    // 2. Merge by maxima and minima, which do not depend on the parts.
    BinRanges found(bins);
    std::fill_n(found.farthest_m.data(), bins, NO_RETURN);
    std::fill_n(found.nearest_m.data(), bins, NO_OBSTACLE);
    for (std::size_t t = 0; t < parts * TABLES; ++t) {
        const float *far = farthest.data() + t * bins, *near = nearest.data() + t * bins;
        for (std::size_t b = 0; b < bins; ++b) found.farthest_m[b] = std::max(found.farthest_m[b], far[b]);
        if (!has_heights) continue;
        for (std::size_t b = 0; b < bins; ++b) found.nearest_m[b] = std::min(found.nearest_m[b], near[b]);
    }
    return found;
}

BinRanges ranges_of_filled(const LeveledReturns& returns, const BinRanges& narrowest) {
    Buffer<bool> occupied(NARROWEST_BINS);
    for (std::size_t b = 0; b < NARROWEST_BINS; ++b) occupied[b] = narrowest.farthest_m[b] >= 0.0f;
    const std::size_t bins = bins_filled(occupied), width = NARROWEST_BINS / bins;
    // The edges of 216 bins round differently from those of 1080.
    if (bins == 216) return find_ranges(returns, bins);
    BinRanges wide(bins);
    for (std::size_t b = 0; b < bins; ++b) {
        const float *far = &narrowest.farthest_m[b * width], *near = &narrowest.nearest_m[b * width];
        wide.farthest_m[b] = *std::max_element(far, far + width);
        wide.nearest_m[b] = *std::min_element(near, near + width);
    }
    return wide;
}

void find_farthest_but(View1<const float> azimuth, View1<const float> range_m, std::size_t drop, View1<float> limit_m) {
    const std::size_t bins = limit_m.size, row = drop + 1;
    const double per_rad = bins_per_rad(bins), last = double(bins - 1);
    Buffer<float> farthest(bins * row, NO_RETURN);
    for (std::size_t n = 0; n < azimuth.size; ++n) {
        insert(&farthest[std::size_t(azimuth_bin(azimuth[n], per_rad, last)) * row], row, range_m[n],
               [](float a, float b) { return a > b; });
    }
    for (std::size_t b = 0; b < bins; ++b) limit_m[b] = farthest[b * row + drop];
}

void find_nearest_obstacle(const LeveledReturns& returns, std::size_t rank, View1<float> limit_m) {
    const std::size_t bins = limit_m.size;
    const double per_rad = bins_per_rad(bins), last = double(bins - 1);
    Buffer<float> nearest(bins * rank, NO_OBSTACLE);
    for (std::size_t n = 0; n < returns.azimuth.size; ++n) {
        if (!(returns.low_m < returns.height_m[n] && returns.height_m[n] < returns.high_m)) continue;
        insert(&nearest[std::size_t(azimuth_bin(returns.azimuth[n], per_rad, last)) * rank], rank, returns.range_m[n],
               [](float a, float b) { return a < b; });
    }
    for (std::size_t b = 0; b < bins; ++b) limit_m[b] = nearest[b * rank + rank - 1];
}

void find_cells_within(View1<const float> limit_m, View1<const float> cell_range_m, View1<const std::int16_t> cell_bin,
                       View1<float> visible) {
    const std::size_t count = visible.size;
    for_ranges(count, count_parts(count, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        // The comparison vectorizes, the look-up does not: separate loops.
        float limit_of[BLOCK];
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t size = std::min(BLOCK, end - start);
            for (std::size_t k = 0; k < size; ++k) limit_of[k] = limit_m[std::size_t(cell_bin[start + k])];
            compare(&cell_range_m[start], limit_of, size, &visible[start]);
        }
    });
}

}  // namespace viewshed
