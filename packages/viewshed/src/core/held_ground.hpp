// Ground that earlier sweeps of a stream saw, on the lattice of the present one; viewshed.preprocess.held_ground says more.
#pragma once

#include "arrays.hpp"
#include "ground_plane.hpp"

namespace viewshed {

// Ground of a sweep in its level frame: heights, standard deviations, and which nodes rest on returns (n, n).
struct SeenGround {
    View2<const float> heights_m, std_m;
    View2<const bool> seen;
    double half_m;
};

// Two upright frames, which turn about z alone: rows for x and y of the earlier frame (2, 4), and for z of the present (4,).
struct HeldPoses {
    float before_from_now[2][4], now_from_before[4];
};

// Write heights, deviations and seen nodes (n, n) of the present ground with what only the earlier sweep saw, where both agree
// around it; false if nothing was taken. Earlier ground is as sure as it was then, less the variance (m²) that time and
// distance add. The carrier's plane is that of the present level frame, the sensor at height_m.
bool hold_ground(const SeenGround& now, const SeenGround& before, const HeldPoses& poses, float variance_m2,
                 const Plane& carrier, float height_m, View1<float> heights_m, View1<float> std_m, View1<bool> seen);

}  // namespace viewshed
