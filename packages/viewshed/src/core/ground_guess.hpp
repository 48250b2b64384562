// Ground that no return shows, as a small network guesses it; viewshed.preprocess.ground says how.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Numbers a node that the network is given, and that it answers with; nodes along a side of what it sees as one position.
constexpr std::size_t GUESS_INPUTS = 13, GUESS_OUTPUTS = 3, FOLD = 4;

// A lattice must have a multiple of this number of nodes a side: positions are halved three times.
constexpr std::size_t LEAST_GUESSED_NODES = 8 * FOLD;

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

// Write what the network is given: (n / FOLD, n / FOLD, FOLD, FOLD, GUESS_INPUTS).
void guess_inputs(const LevelReturns& returns, const FoundOnLattice& ground, float sensor_height_m, View1<float> inputs);

// Write the median (n, n) of the ground, z of the level frame, and its standard deviation. Where returns show the ground both
// are as they were found; nowhere does it lie above the lowest beam that passes over it.
void guess_ground(const LevelReturns& returns, const FoundOnLattice& ground, float sensor_height_m, View2<float> heights_m,
                  View2<float> std_m);

}  // namespace viewshed
