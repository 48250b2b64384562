// The beam tables that travel with the library; CMake writes them from viewshed/beam_tables/*.toml.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "beam_matching.hpp"

namespace viewshed {

// What is known of a sensor; viewshed.sensors.LidarModel says what each is.
struct SensorModel {
    std::string key, name;  // of its table, and in full
    BeamTable beams;
    double min_range_m, max_range_m;
    std::optional<double> reach_m;
    bool fires_rings, is_inferred;
};

// Up to which range in meters a sensor sees a dark target where no table tells: the median of the shipped ones.
constexpr double USUAL_REACH_M = 85.0;

// All of them, in the order of their keys.
const std::vector<SensorModel>& shipped_sensors();

// The one that a key means, whatever its case and punctuation; null where there is none.
const SensorModel* find_sensor(const std::string& name);

}  // namespace viewshed
