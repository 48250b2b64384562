// One return of each beam, of a sensor that reports several: the farthest, for the light went on past leaves, wires and rain.
#pragma once

#include <optional>

#include "arrays.hpp"

namespace viewshed {

// The rows, ascending, of the farthest return of each beam among points (N, 3); none where each beam has one return. Returns of a
// beam lie in one direction from the sensor and, where rings (N,) are known, on one ring; the first of those that are as far
// counts.
std::optional<Buffer<std::int32_t>> farthest_returns(View2<const float> points, std::optional<View1<const std::int16_t>> ring);

}  // namespace viewshed
