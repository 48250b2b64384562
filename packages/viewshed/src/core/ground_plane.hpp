// Robust planes through points: RANSAC with a fixed sequence, so that the same points give the same plane.
#pragma once

#include <array>

#include "arrays.hpp"
#include "lowest_returns.hpp"

namespace viewshed {

// A plane nearer below the sensor than this is a desk, a hood or its own nearly level beams, not the ground.
constexpr double MIN_HEIGHT_M = 0.25;

// (a, b, c) of the plane z = a x + b y + c.
using Plane = std::array<float, 3>;

struct CarrierPlane {
    Plane plane;
    double support;  // share of the near nodes on it; 0 where none was found
};

// The plane that carries the sensor, whose height is known or NaN. The best plane has many nodes on it and few below it;
// least squares on its nodes then refines it. Nodes count the more the nearer they are: a vehicle stands on what it sees
// around it, and not on the fields below the embankment.
CarrierPlane carrier_plane(const Lows& lows, double height_m);

struct FreePlane {
    std::array<float, 3> normal;
    double support;  // share of the area on it
};

// The unit normal of the ground below a sensor tilted by up to 60°. Points (n, 3) are in the sensor frame; they count by the
// square of their distance, as the area that a beam stands for. The sensor must lie above the plane and few returns below.
FreePlane free_plane(View2<const float> points);

}  // namespace viewshed
