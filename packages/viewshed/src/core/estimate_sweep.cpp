#include "estimate_sweep.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "calibration.hpp"
#include "depth_images.hpp"
#include "evidence.hpp"
#include "farthest_returns.hpp"
#include "grid.hpp"
#include "height_map.hpp"
#include "no_return.hpp"
#include "sensor_id.hpp"

namespace viewshed {
namespace {

// Same values as in viewshed.preprocess.leveling.
constexpr double NULL_RANGE_M = 0.5, MAX_RANGE_M = 250.0;
constexpr float LOW_M = 0.3f, HIGH_M = 3.0f;

// Columns of a revolution for an unknown sensor.
constexpr std::size_t DEFAULT_COLUMNS = 1024;

// Rings (N,) of a sweep, its own or recovered ones, and its sensor; either may be missing.
struct Identity {
    std::optional<Buffer<std::int16_t>> recovered;
    std::optional<View1<const std::int16_t>> own;
    const SensorModel* model = nullptr;

    std::optional<View1<const std::int16_t>> ring() const {
        return recovered ? std::optional(View1<const std::int16_t>(*recovered)) : own;
    }
};

Identity identify(const SweepInput& sweep, const SensorModel* expected) {
    const SensorModel* const model = sweep.model;
    if (model != nullptr && !model->fires_rings) return {std::nullopt, std::nullopt, model};
    const auto& sensors = inferable_sensors();
    const auto at = std::find(sensors.begin(), sensors.end(), expected);
    SensorId found = identify_sensor(sweep.points, sweep.ring, model == nullptr ? nullptr : &model->beams, sweep.infers_sensor,
                                     {at == sensors.end() ? NO_SENSOR : int(at - sensors.begin()), nullptr});
    if (found.sensor == OTHER_BEAMS && found.ring) return {std::move(found.ring), sweep.ring, nullptr};
    return {std::move(found.ring), sweep.ring, found.sensor < 0 ? model : sensors[std::size_t(found.sensor)]};
}

// A sweep reduced to the farthest return of each beam.
struct OneReturnABeam {
    SweepInput sweep;
    std::optional<Buffer<float>> points;
    std::optional<Buffer<std::int16_t>> ring;

    explicit OneReturnABeam(const SweepInput& given) : sweep(given) {
        const auto rows = farthest_returns(given.points, given.ring);
        if (!rows) return;
        points.emplace(3 * rows->size());
        for (std::size_t k = 0; k < rows->size(); ++k) std::copy_n(given.points[std::size_t((*rows)[k])], 3, &(*points)[3 * k]);
        sweep.points = {points->data(), rows->size(), 3};
        if (!given.ring) return;
        ring.emplace(rows->size());
        for (std::size_t k = 0; k < rows->size(); ++k) (*ring)[k] = (*given.ring)[std::size_t((*rows)[k])];
        sweep.ring = View1<const std::int16_t>(*ring);
    }
};

// A range image and the directions of its beams.
struct BeamImage {
    View1<const std::int16_t> ring;
    const RangeImage* image;
    View1<const double> elevation, origin_m;
};

// The slopes of measured beams, and the beams without a return.
struct SplitBeams {
    Buffer<float> slope;
    std::optional<NoReturnBeams> missing;
};

View1<const bool> clutter_of(const SweepLevel& at) {
    return at.image && at.image->clutter ? View1<const bool>(*at.image->clutter) : View1<const bool>{nullptr, 0};
}

SplitBeams split_by_image(const BeamImage& beams, const SweepLevel& at, double top_m) {
    const LevelPoints& level = at.level;
    const RangeImage& image = *beams.image;
    const float height_m = float(at.height_m), steep_m = float(STEEP * at.height_m);
    SplitBeams split{Buffer<float>(level.count), std::nullopt};
    const Pixels pixels{beams.ring, image.column, {image.counts.data(), image.rings, image.columns}, image.isolated, clutter_of(at)};
    const DepthImages depths = depth_images(pixels, {level.range_m, level.height_m, level.rows}, LOW_M, steep_m);
    beam_slopes({level.points.data(), level.count, 3}, level.range_m, height_m, image.isolated, level.rows, split.slope);
    const RingAims aims{image.phase, beams.elevation, beams.origin_m, at.rotation.data()};
    split.missing = guess_no_return_beams(depths, aims, at.ground.view(), height_m, top_m, steep_m);
    return split;
}

// Split the beams of a sweep by what is known of their depth; see viewshed.preprocess.no_return.beams_by_evidence.
SplitBeams split_beams(const SweepInput& sweep, const UnleveledSweep& limits, const Identity& identity, const SweepLevel& at,
                       double top_m) {
    const bool is_sure_of_height = sweep.height_m || at.ground.support >= MIN_HEIGHT_SUPPORT;
    if (const auto ring = identity.ring(); ring && is_sure_of_height) {
        // 1. Use the range image if its pixels are beams: known elevations, and about one return per column in full
        // rings.
        if (identity.model != nullptr && at.image && at.image->has_full_rings) {
            const BeamTable& table = identity.model->beams;
            const View1<const double> elevation{table.elevation.data(), table.rings()};
            return split_by_image({*ring, &*at.image, elevation, {table.origin_m.data(), table.rings()}}, at, top_m);
        }
        // 2. Else build one from its rings, with columns and elevations measured from the points.
        const BeamTable* table = identity.model == nullptr ? nullptr : &identity.model->beams;
        const RingAssignment found = recover_rings(sweep.points, ring, table);
        if (found.source != RingSource::ELEVATION_BINS) {
            const std::size_t rings = found.elevation.size();
            const RangeImage image =
                range_image(sweep.points, found.ring, found.columns, rings, limits.near_m, limits.far_m);
            const Buffer<double> origin_m(rings, 0.0);
            return split_by_image({found.ring, &image, found.elevation, origin_m}, at, top_m);
        }
    }
    // 3. With doubtful ground or unknown missing beams, use measured beams only.
    SplitBeams split{Buffer<float>(at.level.count), std::nullopt};
    beam_slopes({at.level.points.data(), at.level.count, 3}, at.level.range_m, float(at.height_m), {nullptr, 0}, at.level.rows,
                split.slope);
    return split;
}

LostBeams lost_beams(const std::optional<NoReturnBeams>& beams) {
    if (!beams) return {};
    const auto some = [&](const Buffer<float>& all) { return View1<const float>{all.data(), beams->count}; };
    return {some(beams->azimuth), some(beams->slope), {some(beams->depth_m), some(beams->early_m), some(beams->late_m)}};
}

// Return the range in meters up to which the sensor sees a dark target.
double reach_of(const SensorModel* model) {
    if (model == nullptr) return USUAL_REACH_M;
    return model->reach_m.value_or(std::min(USUAL_REACH_M, model->max_range_m));
}

CellWindows windows_of(const BevGrid& grid, const Target& target) {
    Buffer<float> range_m(grid.size()), azimuth(grid.size());
    polar_of_cells({grid.cells, grid.cell_m(), grid.x0_m(), grid.y0_m()}, range_m, azimuth);
    const std::size_t n = grid.cells;
    return CellWindows({range_m.data(), n, n}, {azimuth.data(), n, n}, grid.cell_m(), target.width_m);
}

}  // namespace

SweepEstimator::SweepEstimator(const BevGrid& grid, const Target& target)
    : grid_(grid),
      target_(target),
      probabilities_(poisson_table(target.min_returns)),
      windows_(windows_of(grid, target)) {}

View1<const std::int32_t> SweepEstimator::nodes_of_cells(std::size_t nodes) const {
    const std::lock_guard lock(mutex_);
    const auto found = nodes_of_cells_.find(nodes);
    if (found != nodes_of_cells_.end()) return found->second;
    Buffer<float> xy(2 * grid_.size());
    for (std::size_t i = 0; i < grid_.cells; ++i) {
        for (std::size_t j = 0; j < grid_.cells; ++j) {
            float* const at = &xy[2 * (i * grid_.cells + j)];
            at[0] = float(grid_.x0_m() + (double(i) + 0.5) * grid_.cell_m());
            at[1] = float(grid_.y0_m() + (double(j) + 0.5) * grid_.cell_m());
        }
    }
    const double half_m = grid_.half_extent_m + std::max(std::fabs(grid_.offset_x_m), std::fabs(grid_.offset_y_m));
    LatticePositions at = lattice_positions({xy.data(), grid_.size(), 2}, float(half_m), nodes);
    return nodes_of_cells_.emplace(nodes, std::move(at.node)).first->second;
}

SweepEstimate SweepEstimator::estimate(const SweepInput& given, const SensorModel* expected) const {
    // 1. Keep one return of each beam; identify rings and sensor.
    const OneReturnABeam one(given);
    const SweepInput& sweep = one.sweep;
    const Identity identity = identify(sweep, expected);
    const SensorModel* const model = identity.model;
    const auto ring = identity.ring();
    // 2. Level the sweep: range image, attitude, ground, points above it.
    const std::size_t ring_count = ring && ring->size > 0 ? std::size_t(*std::max_element(ring->begin(), ring->end()) + 1) : 0;
    const UnleveledSweep unleveled{
        sweep.points,
        ring,
        model == nullptr ? ring_count : model->beams.rings(),
        model == nullptr ? DEFAULT_COLUMNS : std::size_t(model->beams.columns),
        float(sweep.model == nullptr ? NULL_RANGE_M : std::max(NULL_RANGE_M, sweep.model->min_range_m)),
        float(sweep.model == nullptr ? MAX_RANGE_M : sweep.model->max_range_m),
        sweep.attitude,
        sweep.height_m,
        sweep.yaw,
        grid_.half_extent_m + std::max(std::fabs(grid_.offset_x_m), std::fabs(grid_.offset_y_m)),
    };
    const SweepLevel at = level_sweep(unleveled);
    // 3. Split beams by what is known of their depth; determine the sensor's reach.
    const SplitBeams split = split_beams(sweep, unleveled, identity, at, target_.height_m);
    const double reach_m = reach_of(sweep.model == nullptr ? model : sweep.model);
    // 4. Compute the evidence of each cell.
    const std::size_t cells = grid_.size();
    Buffer<float> measured(cells), inferred(cells), late(cells), aimed(cells), counted_prob(cells), own_prob(cells),
        visible_prob(cells);
    Buffer<bool> within_reach(cells);
    const std::size_t nodes = at.ground.nodes;
    const Ground ground = at.ground.view();
    const View2<const float> std_m{at.ground.std_m.data(), nodes, nodes};
    measure_evidence(windows_, {at.level.azimuth, split.slope, at.level.range_m}, lost_beams(split.missing),
                     {ground.heights_m, std_m, ground.half_extent_m, float(at.height_m)},
                     float(target_.height_m), probabilities_, float(reach_m),
                     {measured.data(), inferred.data(), late.data(), aimed.data(), counted_prob.data(), own_prob.data(),
                      within_reach.data()});
    calibrate(windows_, {measured.data(), inferred.data(), late.data(), aimed.data(), counted_prob.data(), own_prob.data()},
              within_reach.data(), {at.level.azimuth, at.level.range_m, at.level.height_m, LOW_M, HIGH_M}, ground.heights_m,
              visible_prob);
    // 5. Decide states from the cells that the evidence claims or denies.
    Buffer<bool> obstacle(cells + 1);
    const SquareCells square{float(grid_.x0_m()), float(grid_.y0_m()), float(1.0 / grid_.cell_m()), LOW_M, HIGH_M,
                             std::int32_t(grid_.cells)};
    mark_cells({at.level.points.data(), at.level.count, 3}, at.level.height_m, square, obstacle);
    Buffer<std::uint8_t> visible(cells), denied(cells), state(cells);
    for (std::size_t n = 0; n < cells; ++n) visible[n] = visible_prob[n] >= THRESHOLD;
    for (std::size_t n = 0; n < cells; ++n) denied[n] = !visible[n];
    const auto bytes = [](const Buffer<bool>& mask) { return reinterpret_cast<const std::uint8_t*>(mask.data()); };
    write_states({measured.data(), late.data(), aimed.data(), visible_prob.data(), bytes(within_reach)}, probabilities_,
                 {visible.data(), denied.data(), bytes(obstacle)}, state);
    // 6. Summarize what the estimate is based on.
    const Claims claims = count_claims(state, measured.data(), nodes_of_cells(nodes).data, std_m.flat(), probabilities_);
    const double claimed = double(std::max<std::size_t>(claims.all, 1));
    const HeightSource source = sweep.height_m                 ? HeightSource::GIVEN
                                : at.ground.support > 0.0 ? HeightSource::ESTIMATED
                                                          : HeightSource::ASSUMED;
    const Basis basis{at.height_m, source, std::min(at.ground.support, 1.0), double(claims.over_unsure_ground) / claimed,
                      double(claims.inferred) / claimed, reach_m};
    return {std::move(state), std::move(visible_prob), basis, model, at.rotation};
}

}  // namespace viewshed
