// What the beams of a sweep say about a target in each cell: probabilities, and the states that they support.

#pragma once

#include <array>

#include "arrays.hpp"
#include "visibility.hpp"

namespace viewshed {

// The codes of viewshed.fov.estimate.CellState.
constexpr std::uint8_t UNKNOWN = 0, FREE = 1, SURFACE = 2, HIDDEN = 3;

// P(N >= min_returns), N Poisson with the mean k / STEPS, for k = 0, 1, 2 and so on, until it is 1.
Buffer<float> poisson_table(int min_returns);

// Write the probability (N,) at mean counts (N,), from a poisson_table.
void look_up(View1<const float> table, View1<const float> counts, View1<float> prob);

// A cell counts as visible from this probability on, and as hidden if enough beams aim at it with that one: a beam more or less
// must not decide. Ground of a larger deviation is unsure.
constexpr float THRESHOLD = 0.5f, SURE_AIM = 0.9f, UNSURE_M = 0.5f;

// The arrays (N,) of viewshed.preprocess.evidence.BeamEvidence.
struct Evidence {
    float *measured, *inferred, *late, *aimed, *visible_prob;
    bool* within_reach;
};

// Write the evidence of the cells of a grid, from the beams of a sweep that sees dark targets up to reach_m.
void measure_evidence(const CellWindows& windows, const Beams& measured, const LostBeams& lost, const TargetGround& ground,
                      float target_height_m, View1<const float> table, float reach_m, const Evidence& to);

// The evidence (N,) that decides which claims hold.
struct SupportedCells {
    const float *measured, *late, *aimed, *visible_prob;
    const std::uint8_t* within_reach;  // 0 or 1
};

// Cells (N,) that an estimator calls visible, or not, and that hold an obstacle; 0 or 1.
struct Calls {
    const std::uint8_t *visible, *denied, *obstacle;
};

// Write the state (N,) of cells.
void write_states(const SupportedCells& cells, View1<const float> table, const Calls& calls, View1<std::uint8_t> state);

// How many cells are claimed, how many of these lie over unsure ground, and how many measured beams alone would not support.
struct Claims {
    std::size_t all = 0, over_unsure_ground = 0, inferred = 0;
};

// Count the claims among states (N,); the node of each cell says how unsure its ground is.
Claims count_claims(View1<const std::uint8_t> state, const float* measured, const std::int32_t* node,
                    View1<const float> std_m, View1<const float> table);

}  // namespace viewshed
