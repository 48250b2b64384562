// Continuous ray trace: visible up to the farthest return in an azimuth window.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Slices at either end of a window whose returns are compared exactly.
constexpr std::size_t END_SLICES = 3;

// Range, azimuth and fine azimuth bin ("slice") of each cell.
struct PolarCells {
    View1<const float> range_m, azimuth;
    View1<const std::int16_t> slice;
};

// Write 1 for each cell with a return (M,) whose azimuth differs by at most `window` and whose range plus margin_m is
// at least the cell's, else 0. A window has at least one whole slice, and with END_SLICES on either end at most all.
void trace_windows(View1<const float> azimuth, View1<const float> range_m, std::size_t slices, double window,
                   double margin_m, const PolarCells& cells, View1<float> visible);

// Return how many whole slices a window covers to either side.
std::size_t whole_slices(std::size_t slices, double window);

}  // namespace viewshed
