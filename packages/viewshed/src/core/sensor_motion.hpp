// How a spinning sensor moved while it measured, inferred from its points alone.
#pragma once

#include <array>
#include <optional>

#include "arrays.hpp"

namespace viewshed {

// An even motion during one revolution: the way from its beginning to its end, counter-clockwise, in the frame of the
// points; the azimuth at which it begins and ends; the part of the turn at which the sensor was at the origin.
struct SensorMotion {
    std::array<double, 3> way_m;
    double seam, reference;
};

// The motion by which the elevations of points gather most; none where they gather by none.
//
// Points that were put straight lie in one frame, though each was measured from where the sensor was at its time. Seen from
// one place the elevations of a beam are blurred then. A sensor turns evenly, so its place follows from the azimuth.
std::optional<SensorMotion> find_motion(View2<const float> points);

// Points (N, 3) as the sensor measured them, each in its frame at that time; the azimuth at which each was measured
// follows from the result.
void undo_motion(View2<const float> points, const SensorMotion& motion, View2<float> measured);

}  // namespace viewshed
