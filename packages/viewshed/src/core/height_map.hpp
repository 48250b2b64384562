// Ground height on a square lattice, bilinear in between; see viewshed.fov.height_map.HeightMap.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Positions of points on a lattice: index of the node before each, and fractional offsets in i and j.
struct LatticePositions {
    Buffer<std::int32_t> node;
    Buffer<double> down, right;
};

// Compute the positions of points (N, 2+) in meters on a lattice that spans ±half_extent_m, clamped to its edge.
LatticePositions lattice_positions(View2<const float> xy, float half_extent_m, std::size_t nodes);

// Write the heights (N,) at positions, bilinear between the four nodes around each.
void interpolate(View2<const float> heights_m, View1<const std::int32_t> node, View1<const double> down,
                 View1<const double> right, View1<float> out);

}  // namespace viewshed
