// What a network is given to guess the ground that no return shows, and the ground that its answer stands for;
// viewshed.preprocess.ground says how the two belong together.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Maps of the lattice that the network is given, and numbers a node that it answers with.
constexpr std::size_t GUESS_INPUTS = 12, GUESS_OUTPUTS = 5;

// Maps are folded FOLD × FOLD: a network sees and answers so many nodes at one position, map after map, row after row.
constexpr std::size_t FOLD = 4;

// Level points (M, 3) of a sweep with azimuth and horizontal range (M,) from the sensor.
struct LevelReturns {
    View2<const float> points;
    View1<const float> azimuth, range_m;
};

// Ground that returns show (n, n), z of the level frame, and where (n, n) they do; other heights do not matter.
struct ShownGround {
    View2<const float> heights_m;
    View2<const bool> seen;
    float half_m;
};

// Write a first guess (n, n) of the ground: a plane through what is shown that levels off with the range, and above it
// averages over coarser and coarser nodes (pull-push; Gortler et al., The Lumigraph, SIGGRAPH 1996).
void base_ground(const ShownGround& shown, View1<float> base_m);

// Write the inputs (GUESS_INPUTS · FOLD², n / FOLD, n / FOLD) of the network.
void guess_inputs(const LevelReturns& returns, const ShownGround& shown, float sensor_height_m, View1<float> inputs);

// Write the median (n, n) of the ground, z of the level frame, and half of the width that holds it with 68 %, for outputs
// (GUESS_OUTPUTS · FOLD², n / FOLD, n / FOLD) of the network and the inputs that it was given. Where returns show the ground
// it is theirs; it lies nowhere above the lowest beam that passes over it.
void guessed_ground(View1<const float> outputs, View1<const float> inputs, const ShownGround& shown, View1<float> heights_m,
                    View1<float> std_m);

}  // namespace viewshed
