// The probability that a cell is visible: that by counting beams, corrected by a small network fitted to exact truth.
#pragma once

#include "arrays.hpp"
#include "azimuth_bins.hpp"
#include "visibility.hpp"

namespace viewshed {

// Features of a cell; all logarithms have base 2.
enum CellFeature {
    CELL_PROB,            // logit of the probability by counting
    CELL_PROB_NEAR,       // of its mean over about two cells around, ...
    CELL_PROB_WIDE,       // ... and about five cells around
    CELL_OWN_PROB,        // of the probability for the estimated ground and likely depths
    CELL_BLOCKER,         // log of (range of the azimuth's nearest obstacle / range of the cell)
    CELL_BLOCKER_AWAY,    // signed log of 1 + meters of that obstacle beyond the cell
    CELL_FARTHEST,        // log of (range of the azimuth's farthest return / range of the cell)
    CELL_BEAMS_AIMED,     // log of 1 + beams that aim there, ...
    CELL_BEAMS_MEASURED,  // ... 1 + expected returns of measured beams, ...
    CELL_BEAMS_LIKELY,    // ... 1 + those plus no-return beams at their likely depth, ...
    CELL_BEAMS_LATE,      // ... or at their late depth
    CELL_RANGE,           // log of 1 + range of the cell in meters
    CELL_FEATURES
};

// Features of the sweep: the means of the cell features over all cells at which beams aim, and the relief of the
// ground. They describe the kind of place: inference is more often wrong on slopes than on plains.
constexpr std::size_t SWEEP_RELIEF = CELL_FEATURES, SWEEP_FEATURES = CELL_FEATURES + 1;
constexpr std::size_t SHOWN_FEATURES = CELL_FEATURES + SWEEP_FEATURES;

// Evidence (N,) of cells.
struct CellEvidence {
    const float *measured, *inferred, *late, *aimed, *counted_prob, *own_prob;
};

// Write the features (SHOWN_FEATURES, N) of cells: their own, then those of the sweep, equal for all. `returns` are all
// of the leveled sweep, heights_m is the ground on its lattice.
void describe_cells(const CellWindows& windows, const CellEvidence& evidence, const LeveledReturns& returns,
                    View2<const float> heights_m, View2<float> feature);

// Write the probability (N,) that a cell is visible. It is 0 without any beams, and below the threshold unless the cell is
// within_reach (N,) and enough beams reach a target on the estimated ground: the network has seen few walls that absorb
// light, and would look behind them. Where enough do, it does not take back what the count claims.
void calibrate(const CellWindows& windows, const CellEvidence& evidence, const bool* within_reach,
               const LeveledReturns& returns, View2<const float> heights_m, View1<float> prob);

}  // namespace viewshed
