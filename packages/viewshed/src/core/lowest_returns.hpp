// The lowest returns of each node of the ground's lattice: where ground may be.
#pragma once

#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// A low point of each node of a lattice (n, n), in meters from the sensor.
struct Lows {
    explicit Lows(std::size_t n)
        : nodes(n), x_m(n * n), y_m(n * n), z_m(n * n), rise_m(n * n) {}

    std::size_t nodes;             // n
    Buffer<float> x_m, y_m, z_m;   // z is +inf where a node has no return; the others are 0 there
    Buffer<float> rise_m;          // from that point up to the highest return of the node
    std::vector<std::int32_t> some;  // the nodes that have returns, ascending
};

// The second-lowest of points (N, 3) in each node (the lowest where it is alone, so that one return below the ground does not
// count), after the rotation (3, 3). Those in isolated (N,), out of [near_m, far_m] or on the own vehicle, which is turned by
// `heading`, do not count. The order of the points does not matter.
Lows lowest_returns(View2<const float> points, View1<const bool> isolated, View2<const float> rotation, float near_m,
                    float far_m, double heading, float half_m, std::size_t nodes);

}  // namespace viewshed
