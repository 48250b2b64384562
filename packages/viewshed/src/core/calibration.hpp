// How often a cell is visible of which the beams say so much: a small network that was fitted to exact truth.
#pragma once

#include "arrays.hpp"
#include "azimuth_bins.hpp"
#include "visibility.hpp"

namespace viewshed {

// What the network is shown of a cell; all logarithms have the base 2.
enum CellFeature {
    CELL_PROB,            // logit of the probability by counting
    CELL_PROB_NEAR,       // of its mean about two cells around, ...
    CELL_PROB_WIDE,       // ... and about five cells around
    CELL_OWN_PROB,        // of the probability on the ground as it was estimated, to the likely ends of beams
    CELL_BLOCKER,         // range of the nearest obstacle of the azimuth over that of the cell
    CELL_BLOCKER_AWAY,    // how many meters that lies beyond the cell: logarithm of one more, with its sign
    CELL_FARTHEST,        // range of the farthest return of the azimuth over that of the cell
    CELL_BEAMS_AIMED,     // of one more than the beams that aim there, ...
    CELL_BEAMS_MEASURED,  // ... than the expected returns by measured beams, ...
    CELL_BEAMS_LIKELY,    // ... by these and by those without a return that likely went so far, ...
    CELL_BEAMS_LATE,      // ... and that went so far if they ended late
    CELL_RANGE,           // of one meter more than the range of the cell
    CELL_FEATURES
};

// What it is shown of the sweep: the means of these over all cells at which beams aim, and how uneven the ground is. They say
// in what kind of place the sensor stands: what is guessed on a plain is seldom wrong, and often on a slope.
constexpr std::size_t SWEEP_RELIEF = CELL_FEATURES, SWEEP_FEATURES = CELL_FEATURES + 1;
constexpr std::size_t SHOWN_FEATURES = CELL_FEATURES + SWEEP_FEATURES;

// The evidence (N,) of cells.
struct CellEvidence {
    const float *measured, *inferred, *late, *aimed, *visible_prob;
};

// Write the features (SHOWN_FEATURES, N) of cells: their own, and those of the sweep, the same for each. LeveledReturns are all
// of the leveled sweep; the table is that of poisson_table; heights_m are those of the ground, on its lattice.
void describe_cells(const CellWindows& windows, const CellEvidence& evidence, const LeveledReturns& returns,
                    View1<const float> table, View2<const float> heights_m, View2<float> feature);

// Write the probability (N,) that a cell is visible. It lies on the side of the threshold on which the counted one lies, for
// the beams decide what is claimed; it is 0 where no beam says anything.
void calibrate(const CellWindows& windows, const CellEvidence& evidence, const LeveledReturns& returns, View1<const float> table,
               View2<const float> heights_m, View1<float> prob);

}  // namespace viewshed
