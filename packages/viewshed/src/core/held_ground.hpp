// Carry ground seen by earlier sweeps of a stream over to the present lattice; see viewshed.preprocess.held_ground.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Ground of a sweep in its level frame: heights, standard deviations, and a mask of nodes that rest on returns (n, n).
struct SeenGround {
    View2<const float> heights_m, std_m;
    View2<const bool> seen;
    double half_m;
};

// Transforms between upright frames (rotated about z): rows for x, y of the earlier (2, 4), for z of the present (4,).
struct HeldPoses {
    float before_from_now[2][4], now_from_before[4];
};

// Write heights, standard deviations and seen nodes (n, n) of the present ground, with nodes that only the earlier
// sweep saw if both agree around them; false if nothing was carried over. `variance_m2` is added for elapsed time and
// distance.
bool hold_ground(const SeenGround& now, const SeenGround& before, const HeldPoses& poses, float variance_m2,
                 View1<float> heights_m, View1<float> std_m, View1<bool> seen);

}  // namespace viewshed
