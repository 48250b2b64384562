// Monte Carlo dropout: the mean and the deviation of a network's passes.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Write mean and standard deviation (cells,) of probabilities (passes, cells) over the passes, divided by their number.
void find_moments(View2<const float> probability, View1<float> mean, View1<float> deviation);

}  // namespace viewshed
