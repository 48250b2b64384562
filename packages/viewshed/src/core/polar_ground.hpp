// The ground as a sensor sees it: slopes by azimuth and range.
#pragma once

#include <array>
#include <numbers>

#include "arrays.hpp"
#include "leveling.hpp"
#include "vectors.hpp"

namespace viewshed {

// Sectors of azimuth in which the local ground is looked up, and ranges from 1 m to 128 m in equal ratios.
constexpr std::size_t GROUND_SECTORS = 128, GROUND_RANGES = 113;

// Range by range, so that a loop over sectors vectorizes.
struct PolarGround {
    std::array<double, GROUND_RANGES> range_m;
    // The steepest slope from the sensor to the ground up to each range.
    std::array<std::array<float, GROUND_SECTORS>, GROUND_RANGES> steepest;
    // The steepest slope to the top of a target, wherever it stands.
    std::array<float, GROUND_SECTORS> top;
};

// The sector of an azimuth.
inline std::size_t ground_sector(float azimuth) {
    constexpr float per_rad = float(GROUND_SECTORS / (2 * std::numbers::pi));
    const int s = int((azimuth + PI) * per_rad);
    return std::size_t(s < 0 ? 0 : (s < int(GROUND_SECTORS) ? s : int(GROUND_SECTORS) - 1));
}

// Write the ground as seen from a sensor at this height, and the tops of targets of height top_m.
void find_polar_ground(const Ground& ground, float sensor_height_m, double top_m, PolarGround& polar);

// The range at which a beam first meets the ground, between its ranges linearly; +inf where it does not. `at` is the
// range that answered the beam before, which is beside it: the search begins there.
float meet_ground(const PolarGround& polar, std::size_t sector, float slope, std::size_t& at);

}  // namespace viewshed
