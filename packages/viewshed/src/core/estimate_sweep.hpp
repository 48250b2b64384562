// Estimate the field of view of a sweep by the default method: identify the sensor, level, split beams by evidence,
// decide states. It does what viewshed.estimators.shadow_map does with one sweep.
#pragma once

#include <map>
#include <mutex>
#include <optional>

#include "level_sweep.hpp"
#include "sensors.hpp"
#include "visibility.hpp"

namespace viewshed {

// A square grid in the level frame; viewshed.grid.BevGrid.
struct BevGrid {
    std::size_t cells;  // per side
    double half_extent_m, offset_x_m, offset_y_m;

    double cell_m() const { return 2.0 * half_extent_m / double(cells); }
    double x0_m() const { return offset_x_m - half_extent_m; }
    double y0_m() const { return offset_y_m - half_extent_m; }
    std::size_t size() const { return cells * cells; }
};

// The target: width across the line of sight, height, and the number of returns from which it counts as seen.
struct Target {
    double width_m, height_m;
    int min_returns;
};

// Points (N, 3) of a sweep, which must be finite, and what else is known of it.
struct SweepInput {
    View2<const float> points;
    std::optional<View1<const std::int16_t>> ring;  // (N,), 0 the lowest beam
    const SensorModel* model = nullptr;             // null where it is not known
    bool infers_sensor = true;                      // from the points, where it is not known
    std::optional<Rotation> attitude;
    std::optional<double> height_m, yaw;
};

enum class HeightSource { GIVEN, ESTIMATED, ASSUMED };

// What an estimate rests on; viewshed.fov.estimate.Basis says what each is.
struct Basis {
    double sensor_height_m;
    HeightSource height_source;
    double ground_support, unsure_ground_share, inferred_share, reach_m;
};

struct SweepEstimate {
    Buffer<std::uint8_t> state;   // (cells, cells)
    Buffer<float> visible_prob;   // (cells, cells)
    Basis basis;
    const SensorModel* sensor;    // null where it is not known
    Rotation level_from_sensor;
};

// An estimator of a grid and a target: tables that depend on these are made once. Many threads may use one.
class SweepEstimator {
public:
    SweepEstimator(const BevGrid& grid, const Target& target);

    // The field of view of a sweep. A sensor that is expected, that of the sweep before, is looked at first; the result is the
    // same without.
    SweepEstimate estimate(const SweepInput& given, const SensorModel* expected = nullptr) const;

    const BevGrid& grid() const { return grid_; }

private:
    // The node (cells, cells) of a lattice of ground before each cell.
    View1<const std::int32_t> nodes_of_cells(std::size_t nodes) const;

    BevGrid grid_;
    Target target_;
    Buffer<float> probabilities_;
    CellWindows windows_;
    mutable std::mutex mutex_;
    mutable std::map<std::size_t, Buffer<std::int32_t>> nodes_of_cells_;
};

}  // namespace viewshed
