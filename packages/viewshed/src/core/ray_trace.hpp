// The continuous ray trace: visible up to the farthest return in a window of azimuth.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// A cell is in doubt if returns of the END_SLICES slices at either end of its window decide.
constexpr std::size_t END_SLICES = 3;

// Cells by range, azimuth and fine azimuth bin ("slice"), each as many as there are cells.
struct PolarCells {
    View1<const float> range_m, azimuth;
    View1<const std::int16_t> slice;
};

// Write 1 in each cell whose range is at most that of a return (M,), and margin_m, whose azimuth differs by at most a
// window; 0 elsewhere. A window has at least one whole slice, and with two more on either end no more than there are.
void trace_windows(View1<const float> azimuth, View1<const float> range_m, std::size_t slices, double window,
                   double margin_m, const PolarCells& cells, View1<float> visible);

// How many whole slices a window reaches to either side.
std::size_t whole_slices(std::size_t slices, double window);

}  // namespace viewshed
