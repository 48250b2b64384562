// A sweep leveled: its range image, attitude, ground, and points above it; viewshed.preprocess.leveling says how.
#pragma once

#include <array>
#include <numbers>
#include <optional>

#include "arrays.hpp"
#include "leveling.hpp"
#include "range_image.hpp"

namespace viewshed {

// A ground plane steeper than this is taken as the sensor's tilt where the attitude is not known.
constexpr double LEVEL_TILT = 6.0 * std::numbers::pi / 180.0;

// A height that was estimated from a plane with a smaller share of the near ground on it is doubtful.
constexpr double LEAST_SUPPORT = 0.4;

// Rows of a rotation (3, 3).
using Rotation = std::array<double, 9>;

// The ground about the sensor on a lattice (n, n); viewshed.fov.height_map.HeightMap says what each is.
struct GroundMap {
    std::size_t nodes;
    double half_m;
    Buffer<float> heights_m, std_m;
    Buffer<bool> seen;
    std::array<double, 3> plane;
    double support;

    Ground view() const { return {{heights_m.data(), nodes, nodes}, float(half_m)}; }
    // The height below a place in meters.
    float at(float x_m, float y_m) const;
};

// What is known of a sweep before it is leveled.
struct UnleveledSweep {
    View2<const float> points;                      // (N, 3) in the sensor's frame
    std::optional<View1<const std::int16_t>> ring;  // (N,) in [-1, rings), where the rings are known
    std::size_t rings, columns;                     // of the range image
    float near_m, far_m;                            // returns outside do not count
    std::optional<Rotation> attitude;               // from the sensor to level
    std::optional<double> height_m, yaw;            // of the sensor above the ground, of the own vehicle
    double half_extent_m;                           // of the ground that is wanted
};

// A sweep in its level frame.
struct SweepLevel {
    std::optional<RangeImage> image;  // where the rings are known
    Rotation rotation;                // from the sensor to level
    double height_m;                  // of the sensor above the ground below it
    GroundMap ground;                 // z from the ground below the sensor
    LevelPoints level;
};

// Level a sweep: the attitude is the known one, else upright unless the ground is clearly tilted; the height is the known one,
// else that above the ground.
SweepLevel level_sweep(const UnleveledSweep& sweep);

}  // namespace viewshed
