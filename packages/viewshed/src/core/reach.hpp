// What the ranges of a sweep's returns show of its sensor's reach.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// The quantile of the ranges (M,) up to most_m, linearly between two of them; NaN where none counts. Those that are left out,
// by themselves (M,) or by their rows (N,), do not count.
double range_quantile(View1<const float> range_m, View1<const bool> left_out, View1<const std::int32_t> rows, float most_m,
                      double share);

// Up to which range in meters a sensor sees a dark target, from the ranges of its returns: of a sensor that has no reach in a
// table, but perhaps a maximum range.
double sensing_reach(View1<const float> range_m, View1<const bool> left_out, View1<const std::int32_t> rows, double most_m);

}  // namespace viewshed
