// Isolated returns: no neighboring pixel of the range image has a similar range.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Mark the isolated returns (N,), and those of them behind another return of their own pixel (N,).
//
// squared_m2 (N,) is -1 where a return is not used; nearest_m2 (rings, columns) is the least of each pixel, +inf for none.
// A pixel confirms by its nearest return. A return around which nothing returned is not isolated, unless its column is
// silent (columns,): hardly fired.
void find_isolated_returns(View1<const std::int16_t> ring, View1<const std::int32_t> column,
                           View1<const float> squared_m2, View2<const float> nearest_m2, View1<const bool> silent,
                           View1<bool> isolated, View1<bool> behind);

// Whether the share of isolated returns (N,) is so large that chance makes others similar.
bool is_cluttered(View1<const bool> isolated);

// Mark the returns (N,) of a cluttered sweep that too few pixels around confirm.
//
// Returns at random ranges confirm each other by chance, and the more so the more of them have similar ranges: their
// number around a return is Poisson, and its mean follows from the isolated returns. A return is clutter unless more
// confirm it than chance allows (an a contrario test, Desolneux et al. 2000). near_m is the nearest range that is used.
void find_clutter(View1<const std::int16_t> ring, View1<const std::int32_t> column, View1<const float> squared_m2,
                  View2<const float> nearest_m2, View1<const bool> isolated, float near_m, View1<bool> clutter);

}  // namespace viewshed
