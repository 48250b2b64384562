// Infer the motion of a spinning sensor during a sweep from its points alone.
#pragma once

#include <array>
#include <optional>

#include "arrays.hpp"

namespace viewshed {

// Uniform motion during one counter-clockwise revolution: displacement from begin to end in the frame of the points;
// azimuth of begin and end; and the fraction of the turn at which the sensor was at the origin.
struct SensorMotion {
    std::array<double, 3> shift_m;
    double seam, reference;
};

// Return the motion without which the elevations of points cluster most; none if they never cluster.
//
// Motion-compensated points lie in one frame, though the sensor moved while it measured them, so the elevations of a
// beam are blurred when seen from one place. A sensor turns uniformly: its position follows from the azimuth.
std::optional<SensorMotion> find_motion(View2<const float> points);

// Write points (N, 3) as the sensor measured them, each in its frame at that time: motion compensation is undone.
void undo_motion(View2<const float> points, const SensorMotion& motion, View2<float> measured);

}  // namespace viewshed
