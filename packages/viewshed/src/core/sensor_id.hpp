// Identify the sensor of a cloud: its rings, and the beam table that matches them.
#pragma once

#include <optional>

#include "ring_recovery.hpp"
#include "sensors.hpp"

namespace viewshed {

// Results of identification that are no sensor: none found, or rings that are no beams of the given table.
constexpr int NO_SENSOR = -1, OTHER_BEAMS = -2;

// Return the sensors that may be inferred; a sensor's number is its index here.
const std::vector<const SensorModel*>& inferable_sensors();

// Result: rings (N,) if they differ from the sweep's own, and the number of the inferred sensor. For rings without a
// matching table also their layout, the number of rings that the sweep shows, and whether the expected layout was used.
struct SensorId {
    std::optional<Buffer<std::int16_t>> ring;
    int sensor = NO_SENSOR;
    std::optional<BeamTable> layout = std::nullopt;
    std::size_t shown = 0;
    bool is_held = false;
};

// What earlier sweeps of a stream showed: the number of their sensor, or the layout of rings without a matching table.
struct Expected {
    int sensor = NO_SENSOR;
    const BeamTable* layout = nullptr;
};

// Recover the rings of points (N, 3) if they are missing or their sensor is unknown, and infer the sensor if allowed.
//
// With a table of a known sensor: rings are its beams, or OTHER_BEAMS if the points cluster at other elevations.
// Otherwise: find the sensor that matches the rings (N,); bare points first get rings from their order or elevations.
// Nothing is returned if no evidence is found. An expected sensor is tested first, on a small sample, and accepted if
// there is no doubt. So is an expected layout, if the rings by order or the elevations match it.
SensorId identify_sensor(View2<const float> points, std::optional<View1<const std::int16_t>> ring, const BeamTable* table,
                         bool is_inferred, Expected expected);

// Return the sensor that matches the points best (by their rings, if known), and its score in [0, 1].
std::pair<int, double> infer_sensor(View2<const float> points, std::optional<View1<const std::int16_t>> ring);

}  // namespace viewshed
