// Ground in polar coordinates around the sensor: slopes by azimuth and range.
#pragma once

#include <array>
#include <numbers>

#include "arrays.hpp"
#include "leveling.hpp"
#include "vectors.hpp"

namespace viewshed {

// Azimuth sectors and ranges of the lookup; ranges go from 1 m to 128 m in equal ratios.
constexpr std::size_t GROUND_SECTORS = 128, GROUND_RANGES = 113;

// Stored range by range, so that a loop over sectors vectorizes.
struct PolarGround {
    std::array<double, GROUND_RANGES> range_m;
    // Steepest slope from the sensor to the ground up to each range.
    std::array<std::array<float, GROUND_SECTORS>, GROUND_RANGES> steepest;
    // Steepest slope to the top of a target at any range.
    std::array<float, GROUND_SECTORS> top;
};

// Return the sector of an azimuth in radians.
inline std::size_t ground_sector(float azimuth) {
    constexpr float per_rad = float(GROUND_SECTORS / (2 * std::numbers::pi));
    const int s = int((azimuth + PI) * per_rad);
    return std::size_t(s < 0 ? 0 : (s < int(GROUND_SECTORS) ? s : int(GROUND_SECTORS) - 1));
}

// Write the polar ground for a sensor height, and the slopes of the tops of targets of height top_m.
void find_polar_ground(const Ground& ground, float sensor_height_m, double top_m, PolarGround& polar);

// Return the range at which a beam first meets the ground, linear between ranges; +inf if it never does. `at` is the
// range index of the neighboring beam before, where the search starts; it is updated.
float meet_ground(const PolarGround& polar, std::size_t sector, float slope, std::size_t& at);

}  // namespace viewshed
