// Returns and beams: azimuth, slope and range of points, and how well the beams of a table explain them.
#pragma once

#include <cmath>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Least `excess` of a match from which a beam table is believed to explain a cloud.
constexpr double EXPLAINED = 0.3;

// Returns nearer than this do not tell elevations.
constexpr float NEAR_M = 1.0f;

// The N returns of a sweep seen from its origin: azimuth in [-π, π), slope z / range, 0 at range 0, and horizontal range.
struct Directions {
    Buffer<float> azimuth, slope, range_m;

    explicit Directions(std::size_t count) : azimuth(count), slope(count), range_m(count) {}
    std::size_t size() const { return slope.size(); }
};

Directions directions_of(View2<const float> points);

// The slope of one point, as above.
inline float slope_of(const float* point) {
    const float r = std::sqrt(point[0] * point[0] + point[1] * point[1]);
    return r > 0.0f ? point[2] / r : 0.0f;
}

// The same of some rows of the points, without their azimuth.
struct Elevations {
    std::vector<float> slope, range_m;
};
Elevations elevations_of(View2<const float> points, const std::vector<std::uint32_t>& rows);

// The beams of a sensor from the lowest to the highest.
struct BeamTable {
    // elevation in radians, ascending; origin_m: height of each beam at range 0; columns of a revolution.
    BeamTable(std::vector<double> elevation, std::vector<double> origin_m, int columns);

    std::size_t rings() const { return elevation.size(); }
    // The beam nearest to an elevation, the lower of two.
    std::size_t nearest_to(double angle) const;

    std::vector<double> elevation, origin_m;
    std::vector<double> gap;  // to the nearer of the two beams beside, in radians
    double mean_origin_m;
    int columns;
};

// How beams fit: nearest beam of each return (N,), -1 beyond 0.15° and 5 cm; returns close to each beam (rings,); and
// their share less what chance gives. Close is within a quarter of the gap to the next beam, and within 0.1° and 1.5 cm;
// chance is the share of the gap that this covers. Of returns beyond NEAR_M.
struct BeamMatch {
    Buffer<std::int16_t> ring;
    std::vector<std::int64_t> hits;
    double excess;
};

BeamMatch match_beams(View1<const float> slope, View1<const float> range_m, const BeamTable& table);

}  // namespace viewshed
