// Height of the ground on a square lattice, bilinear in between; viewshed.fov.height_map.HeightMap.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Where points lie on a lattice of `nodes` a side: the node before each, and how far beyond it in i and in j.
struct LatticePositions {
    Buffer<std::int32_t> node;
    Buffer<double> down, right;
};

// The positions of points (N, 2+) in meters on a lattice that spans ±half_extent_m; those beyond the edge lie on it.
LatticePositions lattice_positions(View2<const float> xy, float half_extent_m, std::size_t nodes);

// The heights (N,) at positions: bilinear between the four nodes around each.
void interpolate(View2<const float> heights_m, View1<const std::int32_t> node, View1<const double> down,
                 View1<const double> right, View1<float> out);

}  // namespace viewshed
