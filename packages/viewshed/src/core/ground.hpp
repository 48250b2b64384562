// Local ground, and how sure it is; viewshed.preprocess.ground says how it is found.
#pragma once

#include "arrays.hpp"
#include "ground_lattice.hpp"
#include "ground_plane.hpp"
#include "lowest_returns.hpp"

namespace viewshed {

// Ground on a lattice (n, n), z from the sensor.
struct FoundGround {
    Buffer<float> heights_m, std_m;
    Buffer<bool> seen;    // the height rests on returns
    CarrierPlane carrier;
    // NaN, or where the ground is not seen the z at which to take it as level.
    double level_m;
};

// The ground by a low point of each node; the sensor's height is known or NaN.
FoundGround estimate_ground(const Lattice& lattice, const Lows& lows, double height_m);

}  // namespace viewshed
