// Missing beams of a sweep, by ring: their pixels, the returns around them, and their directions.
#pragma once

#include <limits>

#include "arrays.hpp"
#include "depth_images.hpp"

namespace viewshed {

// A point may lie up to this many columns from its firing.
constexpr int JITTER_COLUMNS = 4;

// Missing beams of a ring by ascending column, and the column of the nearest pixel with a return before and after each,
// unwrapped around the circle (the beam's own column if there is none). The buffers hold all columns.
struct MissingBeams {
    explicit MissingBeams(std::size_t columns) : column(columns), before(columns), after(columns) {}

    std::size_t count = 0;
    Buffer<std::int32_t> column, before, after;
};

// Find the missing beams of a ring by its counts (columns,): pixels without a return, except one for each double return
// within JITTER_COLUMNS before or after.
void find_missing(View1<const std::uint8_t> counts, MissingBeams& beams);

// Return the depth of a neighboring return of a beam in its ring (columns,), +inf for none.
inline float depth_around(const Depth* ring, std::int32_t columns, std::int32_t column, std::int32_t at) {
    if (at == column) return std::numeric_limits<float>::infinity();
    return ring[at < 0 ? at + columns : (at < columns ? at : at - columns)].nearest_m;
}

// Cosine and sine of the azimuth of each column's edge.
struct Turn {
    explicit Turn(std::size_t columns);

    Buffer<double> cos, sin;
};

// Write azimuth and slope in `level` of beams of one ring, from their columns, the ring's phase, the tangent of its
// elevation, and the rotation (3, 3) from the sensor.
void aim_beams(const Turn& turn, View1<const std::int32_t> column, double phase, double tangent, const double* rotation,
               float* azimuth, float* slope);

}  // namespace viewshed
