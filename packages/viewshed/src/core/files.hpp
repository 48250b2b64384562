// Columns of files: rows of float32, points moved between frames, and the packing of PCD.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Split rows of x, y, z, intensity into points (3 N,) and intensity (N,).
void split_four(const float* rows, std::size_t count, float* points, float* intensity);

// Split rows of x, y, z, intensity, ring, and return how many rings are no 16-bit whole numbers; those become 0. With
// quarter_turn points are (y, -x, z).
std::int32_t split_five(const float* rows, std::size_t count, bool quarter_turn, float* points, float* intensity,
                        std::int16_t* ring);

// Whether all values are numbers: the exponent of what is none has all its bits set.
bool are_finite(const float* values, std::size_t count);

// Whether rows of 4 or 5 columns read as meters, an intensity and a ring. Rows that are not finite say nothing.
bool is_plausible(const float* rows, std::size_t count, std::size_t columns);

// Decode an LZF stream; return the bytes written, or -1 where the stream is damaged. No index leaves either array.
std::int64_t unpack_lzf(View1<const std::uint8_t> packed, View1<std::uint8_t> unpacked);

// How the rings of returns beside each other differ, seen from the origin, in whatever frame and order.
struct RingSpread {
    std::size_t count;         // returns that were looked at
    double elevation_std;      // their elevations' standard deviation in radians
    double beside, any_two;    // mean difference of rings: of returns beside each other, and of any two
};

// Four narrow sectors, ahead, behind and aside, with all of their returns: those above each other in a degree of azimuth
// are neighbors. half_width is the tangent of half of a sector.
RingSpread spread_of_rings(View2<const float> points, View1<const std::int16_t> ring, float half_width);

// Replace points (N, 3) by rotation (3, 3) @ point + shift (3,), computed in float64.
void move_points(View2<float> points, const double* rotation, const double* shift);

}  // namespace viewshed
