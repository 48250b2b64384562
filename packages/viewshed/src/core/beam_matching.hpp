// Match returns to beams: directions of points, and how well the beams of a table explain them.
#pragma once

#include <cmath>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Smallest `excess` of a match at which a beam table is accepted for a cloud.
constexpr double EXPLAINED = 0.3;

// Elevations of nearer returns are unreliable.
constexpr float NEAR_M = 1.0f;

// Directions of N returns from the origin: azimuth in [-π, π), slope z / range (0 at range 0), and horizontal range.
struct Directions {
    Buffer<float> azimuth, slope, range_m;

    explicit Directions(std::size_t count) : azimuth(count), slope(count), range_m(count) {}
    std::size_t size() const { return slope.size(); }
};

Directions directions_of(View2<const float> points);

// Return the slope of one point.
inline float slope_of(const float* point) {
    const float r = std::sqrt(point[0] * point[0] + point[1] * point[1]);
    return r > 0.0f ? point[2] / r : 0.0f;
}

// Slopes and ranges of selected points.
struct Elevations {
    std::vector<float> slope, range_m;
};
Elevations elevations_of(View2<const float> points, const std::vector<std::uint32_t>& rows);

// Beams of a sensor, from the lowest to the highest.
struct BeamTable {
    // Take elevations in radians, ascending; heights of the beams at range 0; columns of a revolution.
    BeamTable(std::vector<double> elevation, std::vector<double> origin_m, int columns);

    std::size_t rings() const { return elevation.size(); }
    // Return the beam nearest to an elevation, the lower one of a tie.
    std::size_t nearest_to(double angle) const;

    std::vector<double> elevation, origin_m;
    std::vector<double> gap;  // to the nearer neighboring beam, in radians
    double mean_origin_m;
    int columns;
};

// Result of a match: nearest beam of each return (N,), -1 beyond 0.15° and 5 cm; close returns of each beam (rings,);
// and the share of close returns in excess of chance. Close is within a quarter of the gap to the next beam, 0.1° and
// 1.5 cm; the chance is the share of the gap that this covers. Hits and excess count returns beyond NEAR_M.
struct BeamMatch {
    Buffer<std::int16_t> ring;
    std::vector<std::int64_t> hits;
    double excess;
};

BeamMatch match_beams(View1<const float> slope, View1<const float> range_m, const BeamTable& table);

}  // namespace viewshed
