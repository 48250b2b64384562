// Azimuth bins: what the geometric estimators share. Returns by bin, and limits in range.
#pragma once

#include <numbers>

#include "arrays.hpp"
#include "vectors.hpp"

namespace viewshed {

// The most bins that tables of cells can name.
constexpr std::size_t MOST_BINS = 32767;

// The narrowest bins that the returns of a sensor are counted in; each number of bins that may be measured divides it.
constexpr std::size_t NARROWEST_BINS = 1080;

// The azimuth bin of an azimuth in [-π, π), half-open; in double, as viewshed.preprocess.azimuth_bins computes that of
// cells. An azimuth that is no number is in the first.
INLINE std::int32_t azimuth_bin(float azimuth, double per_rad, double last) {
    double position = (double(azimuth) + std::numbers::pi) * per_rad;
    position = position > 0.0 ? position : 0.0;
    return std::int32_t(position < last ? position : last);
}
inline double bins_per_rad(std::size_t bins) { return double(bins) / (2.0 * std::numbers::pi); }

// How many azimuth bins returns fill without gaps, by which of the NARROWEST_BINS they occupy.
std::size_t bins_filled(View1<const bool> occupied);
// The same by the azimuths of the returns (M,).
std::size_t bins_filled_by(View1<const float> azimuth);

// The returns (M,) of a leveled sweep: where they are, and which of them are obstacles.
struct LeveledReturns {
    View1<const float> azimuth, range_m;
    View1<const float> height_m;  // empty where obstacles do not matter
    float low_m, high_m;          // an obstacle lies between these heights above local ground
};

// By azimuth bin, the range of the farthest return, -1 where none, and of the nearest obstacle, +inf where none.
struct BinRanges {
    explicit BinRanges(std::size_t bins) : farthest_m(bins), nearest_m(bins) {}
    std::size_t bins() const { return farthest_m.size(); }

    Buffer<float> farthest_m, nearest_m;
};

// The ranges of a number of bins; of as many as the returns fill where `bins` is 0.
BinRanges find_ranges(const LeveledReturns& returns, std::size_t bins);

// The ranges of as many bins as the returns fill, from those of the NARROWEST_BINS.
BinRanges ranges_of_filled(const LeveledReturns& returns, const BinRanges& narrowest);

// Write the range (bins,) of the farthest return but `drop` of each bin; -1 where there are no more than that.
void find_farthest_but(View1<const float> azimuth, View1<const float> range_m, std::size_t drop, View1<float> limit_m);

// Write the range (bins,) of the obstacle of each bin at a rank of range, 1 the nearest; +inf for none.
void find_nearest_obstacle(const LeveledReturns& returns, std::size_t rank, View1<float> limit_m);

// Write 1 where the range of a cell is at most the limit (bins,) of its bin, 0 elsewhere.
void find_cells_within(View1<const float> limit_m, View1<const float> cell_range_m, View1<const std::int16_t> cell_bin,
                       View1<float> visible);

}  // namespace viewshed
