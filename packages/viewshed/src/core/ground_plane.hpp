// Robust planes through points: RANSAC with a fixed random sequence, hence deterministic.
#pragma once

#include <array>

#include "arrays.hpp"
#include "lowest_returns.hpp"

namespace viewshed {

// A plane less far below the sensor is a desk, a hood or the sensor's own nearly level beams, not the ground.
constexpr double MIN_HEIGHT_M = 0.25;

// (a, b, c) of the plane z = a x + b y + c.
using Plane = std::array<float, 3>;

struct CarrierPlane {
    Plane plane;
    double support;  // share of near nodes on it; 0 for no plane
};

// Fit the plane that carries the sensor, whose height is known or NaN. The best plane has many nodes on it and few
// below; least squares on its nodes refines it. Near nodes weigh more: a vehicle stands on the ground around it, not on
// lower fields.
CarrierPlane carrier_plane(const Lows& lows, double height_m);

struct FreePlane {
    std::array<float, 3> normal;
    double support;  // share of the area on it
};

// Return the unit normal of the ground below a sensor tilted by up to 60°. Points (n, 3) are in the sensor frame,
// weighted by squared distance (the area that a beam stands for). The sensor is above the plane, and few returns below.
FreePlane free_plane(View2<const float> points);

}  // namespace viewshed
