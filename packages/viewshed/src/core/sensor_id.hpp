// Sensor identification: the rings of a cloud, and the beam table that agrees with them, or none.
#pragma once

#include <optional>

#include "ring_recovery.hpp"
#include "sensors.hpp"

namespace viewshed {

// No sensor explains a cloud.
constexpr int NO_SENSOR = -1, OTHER_BEAMS = -2;

// The sensors that may be inferred; they are meant by their number in it.
const std::vector<const SensorModel*>& inferable_sensors();

// The rings (N,) of a sweep, where they are not its own or are counted otherwise, and the number of the inferred sensor. Of
// rings that no table explains the layout by which they are counted, how many the sweep itself shows, and whether it is counted
// by the layout that was expected.
struct SensorId {
    std::optional<Buffer<std::int16_t>> ring;
    int sensor = NO_SENSOR;
    std::optional<BeamTable> layout = std::nullopt;
    std::size_t shown = 0;
    bool is_held = false;
};

// What the sweeps before in a stream showed: the number of their sensor, or the layout of rings that no table explains.
struct Expected {
    int sensor = NO_SENSOR;
    const BeamTable* layout = nullptr;
};

// The rings of points (N, 3) that have none or whose sensor is not known, and the sensor where it may be inferred.
//
// With a table, of a sensor that is known, its beams; rings that are none of them, with OTHER_BEAMS, where the points gather
// elsewhere. Else the sensor that the rings (N,) agree with; of bare points first the
// rings that their order or their elevations show. None of these where nothing shows them. A sensor that is expected is looked
// at first, on a small sample: where that leaves no doubt, no other is looked at. A layout that is expected counts the rings,
// and nothing else is looked at, where those of the order go together with it, or the returns gather at its elevations.
SensorId identify_sensor(View2<const float> points, std::optional<View1<const std::int16_t>> ring, const BeamTable* table,
                         bool is_inferred, Expected expected);

// The sensor that explains points best, by their rings where these are known, and its score in [0, 1].
std::pair<int, double> infer_sensor(View2<const float> points, std::optional<View1<const std::int16_t>> ring);

}  // namespace viewshed
