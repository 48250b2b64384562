// Ground without returns: its height and the uncertainty of that, predicted by a network from the returns around it.
//
// The network sees a polar image around the sensor, because beams are straight lines from there: bins of equal azimuth
// and of equal ratios of range, so that a scene of twice the size looks the same, only farther away. It is fitted by
// tools/fit_ground.py to the exact ground of simulated scenes (viewshed_lab.training.unseen_ground).
#pragma once

#include "arrays.hpp"
#include "ground_lattice.hpp"
#include "leveling.hpp"

namespace viewshed {

// Bins of azimuth from -π on, and of range from NEAREST_M on, BINS_OF_OCTAVE for each doubling.
constexpr std::size_t AZIMUTH_BINS = 128, RANGE_BINS = 96, BINS_OF_OCTAVE = 16, POLAR_BINS = AZIMUTH_BINS * RANGE_BINS;
constexpr float NEAREST_M = 1.5f;

// Maps of a sweep (MAPS, AZIMUTH_BINS, RANGE_BINS), heights in meters in `level`: number of returns; their lowest,
// second-lowest and highest height, 0 without any; whether ground is seen, and its height; height of the lowest beam that
// passes over the bin and returns from farther away, +inf for none; number of returned beams that aim at the bin over
// level ground.
enum Map { RETURNS, LOWEST, SECOND_LOWEST, HIGHEST, SEEN, SEEN_HEIGHT, PASSING, AIMED, MAPS };

// A leveled sweep: points (M, 3), their azimuth and range, whether each is left out (M,; may be empty), and the sensor's
// height.
struct ReturnsAround {
    View2<const float> points;
    View1<const float> azimuth, range_m;
    View1<const std::uint8_t> left_out;
    float sensor_height_m;
};

// Heights of the ground (n, n) on a lattice, and which of them are seen.
struct SeenNodes {
    View2<const float> heights_m;
    View2<const bool> seen;
    float half_extent_m;
};

// Return the maps of a sweep. Returns below the seen ground before them, which no straight beam reaches, are left out.
Buffer<float> map_returns(const ReturnsAround& returns, const SeenNodes& nodes);

// Height of the ground in each bin (AZIMUTH_BINS, RANGE_BINS) in meters: quantiles .15, .5 and .85.
struct PredictedGround {
    PredictedGround() : low_m(POLAR_BINS), height_m(POLAR_BINS), high_m(POLAR_BINS) {}
    Buffer<float> low_m, height_m, high_m;
};

// Return the network's prediction from maps. It does not lie above beams that pass.
PredictedGround predict_ground(View1<const float> maps, float sensor_height_m);

// Write the predicted heights and standard deviations (n, n) of the nodes that are not seen.
void complete_ground(const ReturnsAround& returns, const Lattice& lattice, View1<const bool> seen, View1<float> heights_m,
                     View1<float> std_m);

}  // namespace viewshed
