// Lowest returns of each node of the ground lattice: candidates for ground.
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
    Buffer<float> x_m, y_m, z_m;   // z is +inf for nodes without returns; x and y are 0 there
    Buffer<float> rise_m;          // height from it to the highest return of the node
    std::vector<std::int32_t> occupied;  // nodes with returns, ascending
};

// Return the second-lowest of points (N, 3) in each node after the rotation (3, 3), so that one return below the ground
// is ignored (the lowest if it is the only one). Returns in isolated (N,), outside [near_m, far_m] or on the own
// vehicle, whose box is turned by `heading`, are ignored. The result does not depend on the order of the points.
Lows lowest_returns(View2<const float> points, View1<const bool> isolated, View2<const float> rotation, float near_m,
                    float far_m, double heading, float half_m, std::size_t nodes);

}  // namespace viewshed
