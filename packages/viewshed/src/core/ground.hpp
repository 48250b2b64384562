// Find the ground on which returns lie, from the second-lowest return of each node of a lattice around the sensor.
//
// 1. Fit a plane through the nodes around the sensor (ground_plane.hpp).
// 2. Find patches: nodes on one plane with their neighbors.
// 3. Walk outward from the sensor, with height and slope. A node is ground if the step to it is possible for ground: up to
//    the height of a curb, any height along a large patch that starts at the ground, down to a height on which returns
//    agree or that is clearly lower, because nothing lies below ground.
// 4. Add nodes that continue accepted ground sideways, and walk again with these.
//
// Nodes without ground are left open: a network predicts them (unseen_ground.hpp).
#pragma once

#include "arrays.hpp"
#include "ground_lattice.hpp"
#include "ground_plane.hpp"
#include "lowest_returns.hpp"

namespace viewshed {

// Ground on a lattice (n, n), z relative to the sensor.
struct FoundGround {
    Buffer<float> heights_m;  // of the seen nodes
    Buffer<bool> seen;        // the height rests on returns
    CarrierPlane carrier;
    // z of assumed level ground if no ground is seen, else NaN.
    double level_m;
};

// Find the ground from a low point of each node; the sensor's height is known or NaN.
FoundGround estimate_ground(const Lattice& lattice, const Lows& lows, double height_m);

}  // namespace viewshed
