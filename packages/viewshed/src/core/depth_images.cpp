#include "depth_images.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <optional>
#include <vector>

#include "parallel.hpp"
#include "range_image.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();

constexpr const char* NO_PIXEL = "rows must lie in the sweep, ring and column in its range image";

// Fewest returns or pixels for which a part pays for its thread.
constexpr std::size_t PART = 8192;

// Consecutive returns often fall into one bin. HISTOGRAMS take turns, so that increments do not wait.
constexpr std::size_t HISTOGRAMS = 4;

// One extra bin for returns that are not from the ground.
constexpr std::size_t SECTOR_BINS = SHARE_BINS + 1;

// Measurements of one part of the returns.
struct Part {
    explicit Part(std::size_t pixels) : depths(pixels) {
        std::fill_n(depths.data(), pixels, Depth{NONE, NONE});
    }

    Buffer<Depth> depths;
    std::array<std::array<std::int32_t, REACH_BINS>, HISTOGRAMS> meters{};
    std::array<std::array<std::int32_t, SHARE_SECTORS * SECTOR_BINS>, HISTOGRAMS> ground{};
};

// Write the one-meter range bin and the share bin of each return, and its depth if it lies on an obstacle.
MULTIVERSION void find_bins(const float* range_m, const float* height_m, std::size_t count, float low_m, float steep_m,
                            std::int32_t* meter, std::int32_t* share, float* obstacle_m) {
    constexpr float per_bin = float(1.0 / SHARE_BIN_M);
    constexpr float last_meter = float(REACH_BINS - 1), last = float(SHARE_BINS - 1);
    for (std::size_t k = 0; k < count; ++k) {
        float d = range_m[k] > 0.0f ? range_m[k] : 0.0f, bin = d * per_bin;
        const bool is_high = height_m[k] > low_m;
        obstacle_m[k] = is_high ? d : NONE;
        bin = bin < last ? bin : last;
        share[k] = is_high | !(d > steep_m) ? std::int32_t(SHARE_BINS) : std::int32_t(bin);
        d = d < last_meter ? d : last_meter;
        meter[k] = std::int32_t(d);
    }
}

// Accumulate a part of the returns.
void measure_part(const Pixels& pixels, const Returns& returns, const std::uint8_t* sector, float low_m, float steep_m,
                  std::size_t begin, std::size_t end, Part& part) {
    const std::uint32_t rings = std::uint32_t(pixels.counts.rows), columns = std::uint32_t(pixels.counts.columns);
    const std::uint32_t count = std::uint32_t(pixels.ring.size);
    const bool has_left_out = pixels.left_out.size > 0;
    std::int32_t meter[BLOCK], share[BLOCK];
    float obstacle_m[BLOCK];
    for (std::size_t start = begin; start < end; start += BLOCK) {
        const std::size_t size = std::min(BLOCK, end - start);
        find_bins(&returns.range_m[start], &returns.height_m[start], size, low_m, steep_m, meter, share, obstacle_m);
        for (std::size_t k = 0; k < size; ++k) {
            const auto n = std::uint32_t(read_once(returns.rows, start + k));
            require(n < count, NO_PIXEL);
            const std::int32_t column = read_once(pixels.column, n);
            if (column < 0 || (has_left_out && pixels.left_out[n])) continue;
            const auto r = std::uint32_t(read_once(pixels.ring, n)), c = std::uint32_t(column);
            require(r < rings && c < columns, NO_PIXEL);
            ++part.meters[k % HISTOGRAMS][std::size_t(meter[k])];
            ++part.ground[k % HISTOGRAMS][sector[c] * SECTOR_BINS + std::size_t(share[k])];
            Depth& depth = part.depths[std::size_t(r) * columns + c];
            const float d = returns.range_m[start + k];
            depth.nearest_m = d < depth.nearest_m ? d : depth.nearest_m;
            depth.obstacle_m = obstacle_m[k] < depth.obstacle_m ? obstacle_m[k] : depth.obstacle_m;
        }
    }
}

// Take the minimum with the depths of another part.
MULTIVERSION void merge_depths(Depth* depths, const Depth* other, std::size_t count) {
    float* to = &depths->nearest_m;
    const float* from = &other->nearest_m;
    for (std::size_t k = 0; k < 2 * count; ++k) to[k] = from[k] < to[k] ? from[k] : to[k];
}

// Subtract masked returns from the counts; saturated counts stay. Eight elements are tested at once: masks are mostly
// empty.
void take_out_of_counts(const Pixels& pixels, View1<const bool> mask, View1<const bool> counted,
                        View1<std::uint8_t> counts) {
    const auto subtract = [&](std::size_t n) {
        if (!mask[n] || (counted.size > 0 && counted[n])) return;
        const std::int32_t column = read_once(pixels.column, n);
        if (column < 0) return;
        const std::size_t r = std::size_t(read_once(pixels.ring, n)), c = std::size_t(column);
        require(r < pixels.counts.rows && c < pixels.counts.columns, "ring and column must be pixels of counts");
        const std::size_t pixel = r * pixels.counts.columns + c;
        counts[pixel] = std::uint8_t(counts[pixel] - (pixels.counts.data[pixel] != FULL_COUNT && counts[pixel] > 0));
    };
    std::size_t n = 0;
    for (; n + 8 <= mask.size; n += 8) {
        std::uint64_t eight;
        std::memcpy(&eight, mask.data + n, 8);
        if (eight == 0) continue;
        for (std::size_t k = n; k < n + 8; ++k) subtract(k);
    }
    for (; n < mask.size; ++n) subtract(n);
}

}  // namespace

DepthImages depth_images(const Pixels& pixels, const Returns& returns, float low_m, float steep_m) {
    const std::size_t rings = pixels.counts.rows, columns = pixels.counts.columns, size = rings * columns;
    // 1. Subtract left-out returns and clutter from the counts; returns in both masks are subtracted once.
    Buffer<std::uint8_t> counts(size);
    std::copy_n(pixels.counts.data, size, counts.data());
    take_out_of_counts(pixels, pixels.left_out, {nullptr, 0}, counts);
    take_out_of_counts(pixels, pixels.clutter, pixels.left_out, counts);

    // 2. Accumulate each part of the returns in its own images.
    Buffer<std::uint8_t> sector(columns);
    const float per_column = float(double(SHARE_SECTORS) / double(columns));
    for (std::size_t c = 0; c < columns; ++c) {
        sector[c] = std::uint8_t(std::min(std::size_t(float(c) * per_column), SHARE_SECTORS - 1));
    }
    const std::size_t count = returns.rows.size, parts = count_parts(count, PART);
    std::vector<std::optional<Part>> part_results(parts);
    for_ranges(count, parts, [&](std::size_t k, std::size_t begin, std::size_t end) {
        part_results[k].emplace(size);
        measure_part(pixels, returns, sector.data(), low_m, steep_m, begin, end, *part_results[k]);
    });

    // 3. Merge the parts by minima and sums.
    for_ranges(size, count_parts(size, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t k = 1; k < parts; ++k) {
            merge_depths(part_results[0]->depths.data() + begin, part_results[k]->depths.data() + begin, end - begin);
        }
    });
    DepthImages images{rings, columns, std::move(counts), std::move(part_results[0]->depths), {}, {}};
    for (const auto& part : part_results) {
        for (std::size_t h = 0; h < HISTOGRAMS; ++h) {
            for (std::size_t b = 0; b < REACH_BINS; ++b) images.meter_counts[b] += part->meters[h][b];
            for (std::size_t s = 0; s < SHARE_SECTORS; ++s) {
                for (std::size_t b = 0; b < SHARE_BINS; ++b) {
                    images.ground_counts[s][b] += part->ground[h][s * SECTOR_BINS + b];
                }
            }
        }
    }
    return images;
}

}  // namespace viewshed
