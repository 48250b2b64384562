// Rings without a table: the elevations at which the returns of an unknown sensor gather.
#pragma once

#include <optional>

#include "ring_recovery.hpp"

namespace viewshed {

// Beams that a cloud shows: elevation in radians, ascending, height of each above the sensor's origin at range 0, and the
// share of the returns that lie at the beams, less what chance gives.
struct ElevationClusters {
    std::vector<double> elevation, origin_m;
    double sharpness;
};

// The elevations at which returns gather, or none where they do not gather at any.
//
// How far the returns of a beam scatter is not known before: windows of several widths are tried, and the narrowest one
// is taken whose clusters explain about as many returns as those of any other.
std::optional<ElevationClusters> find_clusters(const Directions& seen);

// The rings by the elevations at which the returns gather: the clusters from the lowest to the highest, so that a
// beam without returns has none; -1 far from all of them.
struct ClusteredRings {
    Rings rings;
    ElevationClusters clusters;
};
std::optional<ClusteredRings> rings_by_clusters(const Directions& seen);

}  // namespace viewshed
