#include "mc_dropout.hpp"

#include <algorithm>
#include <cmath>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Fewest values for which a part pays for its thread.
constexpr std::size_t PART = 65536;

// Compute the moments of a block of cells, with passes `stride` apart. Sums are of differences to the first pass, since
// squares of the values would cancel in float32. Both sums stay in the L1 cache while the passes stream by.
MULTIVERSION void find_block_moments(const float* values, std::size_t passes, std::size_t stride, std::size_t count,
                                     float* mean, float* deviation) {
    float total[BLOCK], squares[BLOCK];
    std::fill_n(total, count, 0.0f);
    std::fill_n(squares, count, 0.0f);
    for (std::size_t pass = 1; pass < passes; ++pass) {
        for (std::size_t k = 0; k < count; ++k) {
            const float difference = values[pass * stride + k] - values[k];
            total[k] += difference;
            squares[k] += difference * difference;
        }
    }
    const auto number = float(passes);
    for (std::size_t k = 0; k < count; ++k) {
        const float shift = total[k] / number, variance = squares[k] / number - shift * shift;
        mean[k] = values[k] + shift;
        deviation[k] = std::sqrt(variance > 0.0f ? variance : 0.0f);
    }
}

}  // namespace

void find_moments(View2<const float> probability, View1<float> mean, View1<float> deviation) {
    const std::size_t cells = probability.columns, passes = probability.rows;
    for_ranges(cells, count_parts(cells * passes, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t count = std::min(BLOCK, end - start);
            find_block_moments(&probability.data[start], passes, cells, count, &mean[start], &deviation[start]);
        }
    });
}

}  // namespace viewshed
