// Keep one return of each beam of a multi-return sensor: the farthest, since light passes leaves, wires and rain.
#pragma once

#include <optional>

#include "arrays.hpp"

namespace viewshed {

// Return the ascending rows of the farthest return of each beam among points (N, 3); none if each beam has one return.
// Returns of a beam have the same direction and, if rings (N,) are known, the same ring. The first of a tie is kept.
std::optional<Buffer<std::int32_t>> farthest_returns(View2<const float> points, std::optional<View1<const std::int16_t>> ring);

}  // namespace viewshed
