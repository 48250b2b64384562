// Ground between and beyond the returns that lie on it, with a standard deviation.
//
// Heights above a base surface are averaged over coarser and coarser nodes, and nodes without returns take the height of the
// finest level that has some (pull-push; Gortler et al., The Lumigraph, SIGGRAPH 1996). The deviation is the spread of what
// was averaged, plus a doubt that grows with the size of the nodes. Along a line of sight it is at least half of the
// difference between the heights before and behind a gap: an edge hides what lies below it.
//
// A level that only a narrow sector shows is not carried to its sides: one wedge of false returns would move the ground of
// half the view.
#pragma once

#include "arrays.hpp"
#include "ground_lattice.hpp"
#include "ground_plane.hpp"

namespace viewshed {

// Write heights (n, n) of the ground at the middle of each node, z from the sensor, and their standard deviations (n, n).
// walked_m (n, n) are heights of the nodes that are accepted (n, n), those on which returns lie; others do not matter.
void fill_ground(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted, const Plane& carrier,
                 View1<float> heights_m, View1<float> std_m);

// Mark the accepted nodes (n, n) that lie on a level which no other direction confirms.
void find_unconfirmed_levels(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted,
                             const Plane& carrier, View1<bool> alone);

}  // namespace viewshed
