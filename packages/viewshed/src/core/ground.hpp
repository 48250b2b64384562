// Find the ground on which returns lie; the method is documented in viewshed.preprocess.ground.
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
