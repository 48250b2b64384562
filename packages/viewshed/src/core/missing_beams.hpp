// The beams that a sweep lacks, ring by ring: their pixels, the returns around them and where they aimed.
#pragma once

#include <limits>

#include "arrays.hpp"
#include "depth_images.hpp"

namespace viewshed {

// A point may lie this many columns from the firing that it belongs to.
constexpr int JITTER_COLUMNS = 4;

// The beams of a ring that did not return, by ascending column. Of the nearest pixel with a return before and after:
// its column, unwrapped around the circle (the beam's own stands for none). There is room for all columns.
struct MissingBeams {
    explicit MissingBeams(std::size_t columns) : column(columns), before(columns), after(columns) {}

    std::size_t count = 0;
    Buffer<std::int32_t> column, before, after;
};

// Find those of one ring's counts (columns,): pixels without a return, less one for each double within JITTER_COLUMNS
// before or after it.
void find_missing(View1<const std::uint8_t> counts, MissingBeams& beams);

// The depth of the nearest return around a beam in its ring (columns,), +inf for none.
inline float depth_around(const Depth* ring, std::int32_t columns, std::int32_t column, std::int32_t at) {
    if (at == column) return std::numeric_limits<float>::infinity();
    return ring[at < 0 ? at + columns : (at < columns ? at : at - columns)].nearest_m;
}

// Cosine and sine of the azimuth at which each column begins.
struct Turn {
    explicit Turn(std::size_t columns);

    Buffer<double> cos, sin;
};

// Write azimuth and slope in `level` of beams of one ring: by column, the ring's phase in its columns, the tangent of
// its elevation and the rotation (3, 3) from the sensor.
void aim_beams(const Turn& turn, View1<const std::int32_t> column, double phase, double tangent, const double* rotation,
               float* azimuth, float* slope);

}  // namespace viewshed
