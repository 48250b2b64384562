// Level a sweep: range image, attitude, ground and points above it, as documented in viewshed.preprocess.leveling.
#pragma once

#include <array>
#include <numbers>
#include <optional>

#include "arrays.hpp"
#include "leveling.hpp"
#include "range_image.hpp"

namespace viewshed {

// With an unknown attitude, a ground plane steeper than this is taken as the sensor's tilt.
constexpr double LEVEL_TILT = 6.0 * std::numbers::pi / 180.0;

// Smallest share of the near ground on the fitted plane for which the estimated sensor height is trusted.
constexpr double MIN_HEIGHT_SUPPORT = 0.4;

// Rows of a rotation (3, 3).
using Rotation = std::array<double, 9>;

// Ground around the sensor on a lattice (n, n); the fields are documented in viewshed.fov.height_map.HeightMap.
struct GroundMap {
    std::size_t nodes;
    double half_m;
    Buffer<float> heights_m, std_m;
    Buffer<bool> seen;
    std::array<double, 3> plane;
    double support;

    Ground view() const { return {{heights_m.data(), nodes, nodes}, float(half_m)}; }
};

// Inputs of leveling.
struct UnleveledSweep {
    View2<const float> points;                      // (N, 3) in the sensor's frame
    std::optional<View1<const std::int16_t>> ring;  // (N,) in [-1, rings), if known
    std::size_t rings, columns;                     // of the range image
    float near_m, far_m;                            // returns outside do not count
    std::optional<Rotation> attitude;               // from the sensor to level
    std::optional<double> height_m, yaw;            // sensor height above the ground, yaw of the own vehicle
    double half_extent_m;                           // of the requested ground
};

// A sweep in its level frame.
struct SweepLevel {
    std::optional<RangeImage> image;  // if rings are known
    Rotation rotation;                // from the sensor to level
    double height_m;                  // of the sensor above the ground below it
    GroundMap ground;                 // z from the ground below the sensor
    LevelPoints level;
};

// Level a sweep. Unknown attitude: upright unless the ground is clearly tilted; unknown height: from the ground.
SweepLevel level_sweep(const UnleveledSweep& sweep);

}  // namespace viewshed
