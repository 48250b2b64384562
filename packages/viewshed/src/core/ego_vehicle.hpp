// Heading of the vehicle that carries the sensor, from its own returns, for any mounting of the sensor.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// Half length and half width of the vehicle below the sensor.
constexpr double EGO_LENGTH_M = 2.7, EGO_WIDTH_M = 1.1;

// Sensor heights at which such a vehicle is assumed; lower sensors are on robots, higher ones at the roadside.
constexpr double MIN_EGO_HEIGHT_M = 1.2, MAX_EGO_HEIGHT_M = 3.0;

// Return the heading of the own vehicle in radians from the sensor's x axis, by points (N, 3) in the sensor's frame and
// the rotation (3, 3) to a level frame: the axis of the returns near the sensor if they are a hood and a trunk across
// its x axis, else 0. Front and rear are not distinguished: the vehicle's box is symmetric.
double vehicle_heading(View2<const float> points, View2<const float> rotation);

}  // namespace viewshed
