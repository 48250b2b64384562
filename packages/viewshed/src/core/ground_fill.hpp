// Interpolate and extrapolate ground heights, with standard deviations.
//
// Heights above a base surface are averaged over ever coarser nodes, and nodes without returns take the height of the
// finest level with data (pull-push; Gortler et al., The Lumigraph, SIGGRAPH 1996). The standard deviation is the
// spread of the averaged heights plus a term that grows with the node size. Only the merged ground of several sweeps is
// filled so: it has few gaps (viewshed.preprocess.ground.ground_of_lows).
//
// A level seen only in a narrow sector is not extended sideways: a wedge of false returns must not move half the
// ground.
#pragma once

#include "arrays.hpp"
#include "ground_lattice.hpp"
#include "ground_plane.hpp"

namespace viewshed {

// Write ground heights (n, n) at the nodes' centers, z relative to the sensor, and their standard deviations (n, n).
// walked_m (n, n) are the heights of accepted nodes (n, n), i.e. those with returns on the ground; others are ignored.
void fill_ground(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted, const Plane& carrier,
                 View1<float> heights_m, View1<float> std_m);

// Mark accepted nodes (n, n) on a level that no other direction confirms.
void find_unconfirmed_levels(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted,
                             const Plane& carrier, View1<bool> unconfirmed);

}  // namespace viewshed
