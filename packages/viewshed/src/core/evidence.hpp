// Evidence of a sweep's beams about a target in each cell: probabilities, and the states that they support.

#pragma once

#include <array>

#include "arrays.hpp"
#include "visibility.hpp"

namespace viewshed {

// Codes of viewshed.fov.estimate.CellState.
constexpr std::uint8_t UNKNOWN = 0, FREE = 1, SURFACE = 2, HIDDEN = 3;

// Return P(N >= min_returns), N Poisson with mean k / STEPS, for k = 0, 1, 2 and so on, until it is 1.
Buffer<float> poisson_table(int min_returns);

// Write the probability (N,) at mean counts (N,), from a poisson_table.
void look_up(View1<const float> table, View1<const float> counts, View1<float> prob);

// A cell is visible from probability THRESHOLD on, and hidden if beams aim at it with probability SURE_AIM: one beam
// more or less must not decide. Ground with a larger standard deviation than UNSURE_M is unsure.
constexpr float THRESHOLD = 0.5f, SURE_AIM = 0.9f, UNSURE_M = 0.5f;

// Output arrays (N,), as in viewshed.preprocess.evidence.BeamEvidence; own_prob is the probability of visible on the estimated
// ground, for the likely depths. Cells beyond the reach may be too dark.
struct Evidence {
    float *measured, *inferred, *late, *aimed, *counted_prob, *own_prob;
    bool* within_reach;
};

// Write the evidence of the cells of a grid, for a sensor that sees dark targets up to reach_m.
void measure_evidence(const CellWindows& windows, const Beams& measured, const LostBeams& lost, const TargetGround& ground,
                      float target_height_m, View1<const float> table, float reach_m, const Evidence& to);

// Evidence (N,) that decides which claims hold.
struct SupportedCells {
    const float *measured, *late, *aimed, *visible_prob;
    const std::uint8_t* within_reach;  // 0 or 1
};

// Masks (N,) of cells that an estimator calls visible or denied, and of cells with an obstacle; 0 or 1.
struct Calls {
    const std::uint8_t *visible, *denied, *obstacle;
};

// Write the states (N,) of cells.
void write_states(const SupportedCells& cells, View1<const float> table, const Calls& calls, View1<std::uint8_t> state);

// Numbers of claimed cells: all, those over unsure ground, and those that measured beams alone would not support.
struct Claims {
    std::size_t all = 0, over_unsure_ground = 0, inferred = 0;
};

// Count the claims among states (N,). node (N,) indexes std_m, the standard deviation of the ground.
Claims count_claims(View1<const std::uint8_t> state, const float* measured, const std::int32_t* node,
                    View1<const float> std_m, View1<const float> table);

}  // namespace viewshed
