// The vehicle that carries the sensor: where its own returns lie, however the sensor is turned on it.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Half length and half width of the vehicle below the sensor.
constexpr double EGO_LENGTH_M = 2.7, EGO_WIDTH_M = 1.1;

// Sensor heights at which such a vehicle is assumed; lower ones are robots, higher ones stand at the roadside.
constexpr double LEAST_EGO_HEIGHT_M = 1.2, MOST_EGO_HEIGHT_M = 3.0;

// The heading of the own vehicle in radians from the sensor's x, from points (N, 3) in the sensor's frame and the
// rotation (3, 3) from there to a level frame: that of the returns near the sensor, if they are a hood and a trunk
// across its x axis; else 0. Ahead and behind are not distinguished: a vehicle's box has no front.
double vehicle_heading(View2<const float> points, View2<const float> rotation);

}  // namespace viewshed
