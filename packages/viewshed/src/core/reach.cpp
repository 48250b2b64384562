#include "reach.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Ranges are counted in bins by the first bits of the number: eight of the exponent and five of the mantissa. Numbers of more
// bits are greater, so that bins stand in the order of the ranges. The last bin is for those that do not count.
constexpr int DROPPED_BITS = 18;
constexpr std::size_t BINS = (std::size_t{1} << (31 - DROPPED_BITS)) + 1;

// Returns beside each other lie in the same bin, and each count would wait for the one before: so they are counted by turns in
// TURNS histograms.
constexpr std::size_t TURNS = 4;

// Reach of a sensor whose returns show nothing, and least reach of one that has supported returns: the median of the shipped
// tables. What the returns show is the range within which BULK_SHARE of them lie, times REACH_TIMES.
constexpr double LEAST_REACH_M = 20.0, USUAL_REACH_M = 85.0, BULK_SHARE = 0.9, REACH_TIMES = 2.5;

// Returns of a part that is worth a thread.
constexpr std::size_t PART = 32768;

// Write the bin of each range of a block; the last one for those beyond most_m, negative ones, and what is no number.
MULTIVERSION void find_bins(const float* range_m, std::size_t count, float most_m, std::uint32_t* bins) {
    for (std::size_t k = 0; k < count; ++k) {
        const bool counts = (range_m[k] >= 0.0f) & (range_m[k] <= most_m);
        bins[k] = counts ? std::bit_cast<std::uint32_t>(range_m[k]) >> DROPPED_BITS : std::uint32_t(BINS - 1);
    }
}

}  // namespace

double range_quantile(View1<const float> range_m, View1<const bool> left_out, View1<const std::int32_t> rows, float most_m,
                      double share) {
    // 1. Count by bins.
    const std::size_t count = range_m.size, parts = count_parts(count, PART);
    Buffer<std::uint16_t> bin(count);
    Buffer<std::uint32_t> histograms(parts * TURNS * BINS);
    for_ranges(count, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        std::uint32_t* const histogram = &histograms[part * TURNS * BINS];
        std::fill_n(histogram, TURNS * BINS, 0u);
        std::uint32_t block[BLOCK];
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t size = std::min(BLOCK, end - start);
            find_bins(&range_m[start], size, most_m, block);
            for (std::size_t k = 0; k < size; ++k) {
                const std::size_t row = rows.size ? std::size_t(rows[start + k]) : start + k;
                bin[start + k] = std::uint16_t(left_out[row] ? BINS - 1 : block[k]);
            }
            for (std::size_t k = 0; k < size; ++k) ++histogram[k % TURNS * BINS + bin[start + k]];
        }
    });
    for (std::size_t k = 1; k < parts * TURNS; ++k) {
        for (std::size_t b = 0; b < BINS; ++b) histograms[b] += histograms[k * BINS + b];
    }
    const std::size_t total = count - histograms[BINS - 1];
    if (total == 0) return std::numeric_limits<double>::quiet_NaN();
    // 2. The two ranges that the quantile lies between, and their bins.
    const double place = share * double(total - 1);
    const auto low = std::size_t(place), high = std::min(low + 1, total - 1);
    std::size_t first = 0, before = 0;
    while (before + histograms[first] <= low) before += histograms[first++];
    std::size_t last = first, up_to = before + histograms[first];
    while (up_to <= high) up_to += histograms[++last];
    // 3. Sort what lies in these.
    std::vector<float> some;
    some.reserve(up_to - before);
    for (std::size_t k = 0; k < count; ++k) {
        if (bin[k] >= first && bin[k] <= last) some.push_back(range_m[k]);
    }
    const auto at = some.begin() + std::ptrdiff_t(low - before);
    std::nth_element(some.begin(), at, some.end());
    const double one = double(*at), other = high == low ? one : double(*std::min_element(at + 1, some.end()));
    return one + (other - one) * (place - double(low));
}

double sensing_reach(View1<const float> range_m, View1<const bool> left_out, View1<const std::int32_t> rows, double most_m) {
    const double quantile_m = range_quantile(range_m, left_out, rows, float(most_m), BULK_SHARE);
    if (std::isnan(quantile_m)) return std::min(LEAST_REACH_M, most_m);  // no return is supported
    const double shown_m = REACH_TIMES * quantile_m;
    return std::min(std::max(USUAL_REACH_M, std::cbrt(shown_m * USUAL_REACH_M * USUAL_REACH_M)), most_m);
}

}  // namespace viewshed
