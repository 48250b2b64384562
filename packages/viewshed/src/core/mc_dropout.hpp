// Monte Carlo dropout: mean and standard deviation over a network's passes.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Write mean and population standard deviation (cells,) of probabilities (passes, cells).
void find_moments(View2<const float> probability, View1<float> mean, View1<float> deviation);

}  // namespace viewshed
