// Sensor identification: the rings of a cloud, and the beam table that agrees with them, or none.
#pragma once

#include <optional>

#include "ring_recovery.hpp"

namespace viewshed {

using BeamTables = std::vector<BeamTable>;

// No table explains a cloud.
constexpr int NO_TABLE = -1;

// The rings (N,) of a sweep, where they are not its own or are counted otherwise, and the number of its table.
struct SensorId {
    std::optional<Buffer<std::int16_t>> ring;
    int table = NO_TABLE;
};

// The rings and the table of points (N, 3) whose rings (N,) are known. A table that is expected is looked at first, on a
// small sample: where that leaves no doubt, no other is looked at.
SensorId identify_by_rings(View2<const float> points, View1<const std::int16_t> ring, const BeamTables& tables,
                           int expected = NO_TABLE);

// The rings and the table that bare points (N, 3) show; none where they show none. The same of an expected table.
SensorId identify_by_points(View2<const float> points, const BeamTables& tables, int expected = NO_TABLE);

// The rings (N,) that bare points show, by their order or else by their elevations.
std::optional<Buffer<std::int16_t>> rings_of_points(View2<const float> points);

// The beam of each point (N, 3) of a sensor that is known; none where the points do not gather at its beams.
std::optional<Buffer<std::int16_t>> beams_of_sensor(View2<const float> points, const BeamTable& table);

// The table that explains points best, by their rings where these are known, and its score in [0, 1].
std::pair<int, double> infer_sensor(View2<const float> points, std::optional<View1<const std::int16_t>> ring,
                                    const BeamTables& tables);

}  // namespace viewshed
