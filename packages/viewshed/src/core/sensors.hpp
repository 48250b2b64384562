// Beam tables shipped with the library; CMake generates them from viewshed/beam_tables/*.toml.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "beam_matching.hpp"

namespace viewshed {

// A sensor; the fields are documented in viewshed.sensors.LidarModel.
struct SensorModel {
    std::string key, name;  // key of its table, and full name
    BeamTable beams;
    double min_range_m, max_range_m;
    std::optional<double> reach_m;
    bool fires_rings, is_inferred;
};

// Default range in meters up to which a sensor sees a dark target: the median of the shipped sensors.
constexpr double USUAL_REACH_M = 85.0;

// Return all shipped sensors, in the order of their keys.
const std::vector<SensorModel>& shipped_sensors();

// Return the sensor of a key, ignoring case and punctuation; null if there is none.
const SensorModel* find_sensor(const std::string& name);

}  // namespace viewshed
