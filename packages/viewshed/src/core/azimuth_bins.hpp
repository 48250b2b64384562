// Azimuth bins of the geometric estimators: returns by bin, and range limits.
#pragma once

#include <numbers>

#include "arrays.hpp"
#include "vectors.hpp"

namespace viewshed {

// Largest number of bins that cell tables (int16) can hold.
constexpr std::size_t MAX_BINS = 32767;

// Number of the narrowest bins for returns; every number of bins on the ladder divides it.
constexpr std::size_t NARROWEST_BINS = 1080;

// Return the bin of an azimuth in [-π, π), half-open(in double, like viewshed.preprocess.azimuth_bins); NaN gives 0.
INLINE std::int32_t azimuth_bin(float azimuth, double per_rad, double last) {
    double position = (double(azimuth) + std::numbers::pi) * per_rad;
    position = position > 0.0 ? position : 0.0;
    return std::int32_t(position < last ? position : last);
}
inline double bins_per_rad(std::size_t bins) { return double(bins) / (2.0 * std::numbers::pi); }

// Return how many azimuth bins the returns fill without gaps, by their occupied NARROWEST_BINS.
std::size_t bins_filled(View1<const bool> occupied);
// The same by the azimuths of returns (M,).
std::size_t bins_filled_by(View1<const float> azimuth);

// Returns (M,) of a leveled sweep, and the height limits of obstacles.
struct LeveledReturns {
    View1<const float> azimuth, range_m;
    View1<const float> height_m;  // may be empty if obstacles are not needed
    float low_m, high_m;          // height limits of obstacles above local ground
};

// Range of the farthest return (-1 for none) and of the nearest obstacle (+inf for none) by azimuth bin.
struct BinRanges {
    explicit BinRanges(std::size_t bins) : farthest_m(bins), nearest_m(bins) {}
    std::size_t bins() const { return farthest_m.size(); }

    Buffer<float> farthest_m, nearest_m;
};

// Compute the ranges of `bins` bins; with 0, of as many as the returns fill.
BinRanges find_ranges(const LeveledReturns& returns, std::size_t bins);

// Merge the ranges of NARROWEST_BINS into as many bins as the returns fill.
BinRanges ranges_of_filled(const LeveledReturns& returns, const BinRanges& narrowest);

// Write the range (bins,) of the farthest return of each bin after dropping `drop` of them; -1 if there are no more.
void find_farthest_but(View1<const float> azimuth, View1<const float> range_m, std::size_t drop, View1<float> limit_m);

// Write the range (bins,) of the obstacle of a rank in each bin, 1 the nearest; +inf for none.
void find_nearest_obstacle(const LeveledReturns& returns, std::size_t rank, View1<float> limit_m);

// Write 1 for cells with a range up to the limit (bins,) of their bin, else 0.
void find_cells_within(View1<const float> limit_m, View1<const float> cell_range_m, View1<const std::int16_t> cell_bin,
                       View1<float> visible);

}  // namespace viewshed
