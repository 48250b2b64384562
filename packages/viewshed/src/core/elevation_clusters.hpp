// Rings without a table: find the elevations at which the returns of an unknown sensor cluster.
#pragma once

#include <optional>

#include "ring_recovery.hpp"

namespace viewshed {

// Beams found in a cloud: elevation in radians, ascending; height of each above the sensor's origin at range 0; and the
// share of returns at the beams in excess of chance.
struct ElevationClusters {
    std::vector<double> elevation, origin_m;
    double sharpness;
};

// Return the elevations at which returns cluster, or none.
//
// The scatter of a beam's returns is unknown: windows of several widths are tried, and the narrowest one is chosen
// whose clusters explain about as many returns as those of any other.
std::optional<ElevationClusters> find_clusters(const Directions& directions);

// Return rings by elevation clusters, from the lowest to the highest, without beams that have no returns; -1 far from
// all.
struct ClusteredRings {
    Rings rings;
    ElevationClusters clusters;
};
std::optional<ClusteredRings> rings_by_clusters(const Directions& directions);

}  // namespace viewshed
