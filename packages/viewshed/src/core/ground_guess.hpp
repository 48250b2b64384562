// What a network is given to guess the ground that no return shows; viewshed_lab.training.ground_prior says more.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Numbers a node.
constexpr std::size_t GUESS_INPUTS = 13;

// Level points (M, 3) of a sweep with azimuth and horizontal range (M,) from the sensor.
struct LevelReturns {
    View2<const float> points;
    View1<const float> azimuth, range_m;
};

// Ground as it was found from returns (n, n): heights, z of the level frame, their standard deviations, and where returns
// show it.
struct FoundOnLattice {
    View2<const float> heights_m, std_m;
    View2<const bool> seen;
    float half_m;
};

// Write the inputs (GUESS_INPUTS, n, n).
void guess_inputs(const LevelReturns& returns, const FoundOnLattice& ground, float sensor_height_m, View1<float> inputs);

}  // namespace viewshed
