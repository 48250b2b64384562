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
    Buffer<float> x_m, y_m, z_m;   // z is +inf where a node has no return; x and y have no value there
    Buffer<float> rise_m;          // from that point up to the highest return of the node
    std::vector<std::int32_t> some;  // the nodes that have returns, ascending
};

// The vehicle that carries the sensor: its own returns are no ground. (cosine, sine) of its heading in the level frame, half
// its length and width; what lies in that box is its own if it is less than `hood_m` below the sensor.
struct OwnVehicle {
    float cosine, sine, half_length_m, half_width_m, hood_m;
};

// The second-lowest of points (N, 3) in each node (the lowest where it is alone, so that one return below the ground does not
// count), after the rotation (3, 3). Those in isolated (N,) or out of [near_m, far_m] do not count. The order of the points
// does not matter.
Lows lowest_returns(View2<const float> points, View1<const bool> isolated, View2<const float> rotation, float near_m,
                    float far_m, const OwnVehicle& vehicle, float half_m, std::size_t nodes);

}  // namespace viewshed
