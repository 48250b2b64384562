// Isolated returns: no neighboring pixel of the range image has a similar range.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Mark isolated returns (N,), and those of them behind another return of their own pixel (N,).
//
// squared_m2 (N,) is -1 for unused returns; nearest_m2 (rings, columns) is the minimum of each pixel, +inf for none. A
// pixel confirms by its nearest return. A return without any return around it is not isolated, unless its column is
// silent (columns,), i.e. hardly fired.
void find_isolated_returns(View1<const std::int16_t> ring, View1<const std::int32_t> column,
                           View1<const float> squared_m2, View2<const float> nearest_m2, View1<const bool> silent,
                           View1<bool> isolated, View1<bool> behind);

// Check if so many returns (N,) are isolated that random returns look similar by chance.
bool is_cluttered(View1<const bool> isolated);

// Mark the returns (N,) of a cluttered sweep that too few pixels around confirm.
//
// Returns at random ranges confirm each other by chance, more often the more of them have similar ranges. Their number
// around a return is Poisson; its mean follows from the isolated returns. A return is clutter unless more returns
// confirm it than chance allows (an a contrario test, Desolneux et al. 2000). near_m is the smallest range in use.
void find_clutter(View1<const std::int16_t> ring, View1<const std::int32_t> column, View1<const float> squared_m2,
                  View2<const float> nearest_m2, View1<const bool> isolated, float near_m, View1<bool> clutter);

}  // namespace viewshed
