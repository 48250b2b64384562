// File columns: rows of float32, points moved between frames, and PCD compression.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Split rows of x, y, z, intensity into points (3 N,) and intensity (N,).
void split_four(const float* rows, std::size_t count, float* points, float* intensity);

// Split rows of x, y, z, intensity, ring; return how many rings are not 16-bit integers (they become 0). With
// quarter_turn, points are (y, -x, z).
std::int32_t split_five(const float* rows, std::size_t count, bool quarter_turn, float* points, float* intensity,
                        std::int16_t* ring);

// Check that all values are finite.
bool are_finite(const float* values, std::size_t count);

// Check if rows of 4 or 5 columns are plausible as meters, an intensity and a ring. Non-finite rows are ignored.
bool is_plausible(const float* rows, std::size_t count, std::size_t columns);

// Decode an LZF stream; return the bytes written, or -1 if it is corrupt. Never reads or writes out of bounds.
std::int64_t unpack_lzf(View1<const std::uint8_t> packed, View1<std::uint8_t> unpacked);

// Ring differences between neighboring returns, seen from the origin, independent of frame and order.
struct RingSpread {
    std::size_t count;         // returns in the sectors
    double elevation_std;      // standard deviation of their elevations in radians
    double beside, any_two;    // mean ring difference: of neighbors, and of any two returns
};

// Compute the spread in four narrow sectors (ahead, behind, left, right); neighbors are adjacent in elevation within a
// degree of azimuth. half_width is the tangent of half a sector.
RingSpread spread_of_rings(View2<const float> points, View1<const std::int16_t> ring, float half_width);

// Replace points (N, 3) by rotation (3, 3) @ point + shift (3,), computed in float64.
void move_points(View2<float> points, const double* rotation, const double* shift);

}  // namespace viewshed
