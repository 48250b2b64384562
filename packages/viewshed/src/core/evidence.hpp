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

// What evidence weighs: the weights of the ground's own height, and of the lower and the higher one; those of early and of
// late ends of the beams without a return; the probability from which a claim is supported, and the largest one below it;
// and the reach.
struct Rule {
    float own, lower, higher, early, late;
    float threshold, below_threshold;
    float reach_m;
};

// The arrays (N,) of viewshed.preprocess.evidence.BeamEvidence.
struct Evidence {
    float *measured, *inferred, *late, *aimed, *visible_prob;
    bool* within_reach;
};

// Write the evidence of the cells of a grid, from the kinds of beams. Lower and higher ground lie
// `deviations` standard deviations away.
void measure_evidence(const CellWindows& windows, const Beams& measured, const LostBeams& lost, const TargetGround& ground,
                      float target_height_m, const std::array<float, 2>& deviations, View1<const float> table,
                      const Rule& rule, const Evidence& to);

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
void write_states(const SupportedCells& cells, View1<const float> table, float threshold, float sure_aim,
                  const Calls& calls, View1<std::uint8_t> state);

// How many cells are claimed, how many of these lie over ground whose height is unsure by more than unsure_m, and how many
// measured beams alone would not support.
struct Claims {
    std::size_t all = 0, over_unsure_ground = 0, inferred = 0;
};

// Count the claims among states (N,); the node of each cell says whether the ground's deviation is more than unsure_m.
Claims count_claims(View1<const std::uint8_t> state, const float* measured, const std::int32_t* node,
                    View1<const float> std_m, float unsure_m, View1<const float> table, float threshold);

}  // namespace viewshed
