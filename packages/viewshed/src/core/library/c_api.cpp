// C interface: arguments are checked here, and no exception leaves it.
#include "viewshed.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <exception>
#include <limits>
#include <memory>
#include <mutex>
#include <new>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <unordered_map>

#include "estimate_sweep.hpp"
#include "mask_regions.hpp"
#include "mask_rings.hpp"
#include "parallel.hpp"

namespace {

using namespace viewshed;

constexpr std::size_t MAX_POINTS = 20'000'000, MAX_STEP = 1 << 20, MAX_CELLS = 4096, MAX_RETURNS = 10'000;
constexpr int MAX_RINGS = 4096;
constexpr double MAX_HEIGHT_M = 100.0, MAX_EXTENT_M = 1e4, UNIT_TOLERANCE = 1e-3;

// A stream: its estimator, and the expected sensor of the next sweep.
struct Stream {
    Stream(const BevGrid& grid, const Target& target, const SensorModel* model, bool infers_sensor)
        : estimator(grid, target), model(model), infers_sensor(infers_sensor) {}

    std::mutex mutex;
    SweepEstimator estimator;
    const SensorModel* model;
    bool infers_sensor;
    const SensorModel* expected = nullptr;
    std::optional<Buffer<bool>> visible;  // of the last estimate
};

// Open streams by number; numbers are never reused. The map is never deleted: a thread may use it at process exit.
std::mutex streams_mutex;
auto& streams = *new std::unordered_map<viewshed_stream, std::shared_ptr<Stream>>;
viewshed_stream last_stream = 0;

thread_local char error_text[256] = "";

struct NoStream : std::exception {};
struct NoRoom : std::exception {};

void set_error(const char* text) noexcept {
    std::strncpy(error_text, text, sizeof error_text - 1);
    error_text[sizeof error_text - 1] = '\0';
}

// Run a call, and convert exceptions to a status.
template <typename Call>
viewshed_status guarded(const Call& call) noexcept {
    try {
        call();
        set_error("");
        return VIEWSHED_OK;
    } catch (const NoStream&) {
        set_error("stream must be open, got one that is closed or was never opened");
        return VIEWSHED_ERROR_STREAM;
    } catch (const NoRoom&) {
        set_error("corners_m, begin and region must have room for the outline; the counts say for how much");
        return VIEWSHED_ERROR_ROOM;
    } catch (const std::bad_alloc&) {
        set_error("there is not enough memory");
        return VIEWSHED_ERROR_MEMORY;
    } catch (const std::invalid_argument& error) {
        set_error(error.what());
        return VIEWSHED_ERROR_ARGUMENT;
    } catch (const std::exception& error) {
        set_error(error.what());
        return VIEWSHED_ERROR_INTERNAL;
    } catch (...) {
        set_error("unknown");
        return VIEWSHED_ERROR_INTERNAL;
    }
}

template <typename Value>
void require_that(bool holds, const char* rule, const Value& got) {
    if (holds) return;
    std::ostringstream text;
    text << rule << ", got " << got;
    throw std::invalid_argument(text.str());
}

std::shared_ptr<Stream> stream_of(viewshed_stream number) {
    const std::lock_guard lock(streams_mutex);
    const auto found = streams.find(number);
    if (found == streams.end()) throw NoStream();
    return found->second;
}

// Return the rotation of a unit quaternion w, x, y, z.
Rotation rotation_of(const double* quaternion) {
    double q[4], squares = 0.0;
    std::copy_n(quaternion, 4, q);
    for (const double part : q) squares += part * part;
    const double norm = std::sqrt(squares);
    require_that(std::fabs(norm - 1.0) <= UNIT_TOLERANCE, "attitude must be a unit quaternion w, x, y, z of norm 1", norm);
    const double w = q[0] / norm, x = q[1] / norm, y = q[2] / norm, z = q[3] / norm;
    return {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
            2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
}

// Copies of the finite points of a sweep and their rings: the caller's arrays may change meanwhile.
struct Rows {
    std::size_t count = 0;
    Buffer<float> points;
    std::optional<Buffer<std::int16_t>> ring;
};

Rows rows_of(const viewshed_sweep& sweep, int rings) {
    const std::size_t step = sweep.point_step == 0 ? 3 * sizeof(float) : sweep.point_step;
    const std::size_t ring_step = sweep.ring_step == 0 ? sizeof(std::uint16_t) : sweep.ring_step;
    require_that(sweep.count <= MAX_POINTS, "count must be at most 20 million points", sweep.count);
    require_that(sweep.points != nullptr || sweep.count == 0, "points must not be null", "null");
    require_that(step >= 3 * sizeof(float) && step <= MAX_STEP, "point_step must lie in [12, 1048576]", step);
    require_that(ring_step >= sizeof(std::uint16_t) && ring_step <= MAX_STEP, "ring_step must lie in [2, 1048576]", ring_step);
    Rows rows{0, Buffer<float>(3 * sweep.count), std::nullopt};
    if (sweep.ring != nullptr) rows.ring.emplace(sweep.count);
    const auto* point = static_cast<const unsigned char*>(sweep.points);
    const auto* ring = static_cast<const unsigned char*>(sweep.ring);
    for (std::size_t n = 0; n < sweep.count; ++n) {
        float* const to = &rows.points[3 * rows.count];
        std::memcpy(to, point + n * step, 3 * sizeof(float));
        if (!(std::isfinite(to[0]) && std::isfinite(to[1]) && std::isfinite(to[2]))) continue;
        if (ring != nullptr) {
            std::uint16_t beam;
            std::memcpy(&beam, ring + n * ring_step, sizeof beam);
            require_that(beam < rings, "ring must be less than the number of the sensor's beams", beam);
            (*rows.ring)[rows.count] = std::int16_t(beam);
        }
        ++rows.count;
    }
    return rows;
}

}  // namespace

extern "C" {

const char* viewshed_version(void) { return VIEWSHED_CORE_VERSION; }

const char* viewshed_error(void) { return error_text; }

viewshed_status viewshed_set_threads(size_t count) {
    return guarded([&] {
        require_that(count >= 1 && count <= 4, "count must lie in [1, 4]", count);
        set_threads(count);
    });
}

viewshed_options viewshed_defaults(void) { return {256, 64.0, {0.0, 0.0}, 1.8, 1.5, 5, nullptr}; }

viewshed_sweep viewshed_no_sweep(void) { return {0, nullptr, 0, nullptr, 0, nullptr, NAN, NAN}; }

viewshed_status viewshed_open(const viewshed_options* options, viewshed_stream* stream) {
    return guarded([&] {
        require_that(stream != nullptr, "stream must not be null", "null");
        *stream = 0;
        require_that(options != nullptr, "options must not be null", "null");
        const viewshed_options o = *options;
        require_that(o.cells >= 1 && o.cells <= MAX_CELLS, "cells must lie in [1, 4096]", o.cells);
        require_that(o.half_extent_m >= 0.01 && o.half_extent_m <= MAX_EXTENT_M, "half_extent_m must lie in [0.01, 10000]", o.half_extent_m);
        for (const double offset : o.offset_m) {
            require_that(std::fabs(offset) <= MAX_EXTENT_M, "offset_m must lie within 10000 m", offset);
        }
        const auto is_size = [](double size) { return size > 0.0 && size <= 100.0; };
        require_that(is_size(o.target_width_m), "target_width_m must lie in (0, 100]", o.target_width_m);
        require_that(is_size(o.target_height_m), "target_height_m must lie in (0, 100]", o.target_height_m);
        require_that(o.min_returns >= 1 && o.min_returns <= MAX_RETURNS, "min_returns must lie in [1, 10000]", o.min_returns);
        const std::string name = o.sensor == nullptr ? "" : std::string(o.sensor, strnlen(o.sensor, 64));
        const SensorModel* const model = find_sensor(name);
        require_that(model != nullptr || o.sensor == nullptr || name == "none",
                     "sensor must be null, \"none\", or a beam table as vlp16 or hdl32e", name);
        auto opened = std::make_shared<Stream>(BevGrid{o.cells, o.half_extent_m, o.offset_m[0], o.offset_m[1]},
                                             Target{o.target_width_m, o.target_height_m, int(o.min_returns)}, model,
                                             name != "none");
        const std::lock_guard lock(streams_mutex);
        streams.emplace(last_stream + 1, std::move(opened));
        *stream = ++last_stream;
    });
}

viewshed_status viewshed_estimate(viewshed_stream stream, const viewshed_sweep* sweep, uint8_t* state, float* visible_prob,
                                  size_t cells, viewshed_basis* basis) {
    return guarded([&] {
        const std::shared_ptr<Stream> of = stream_of(stream);
        require_that(sweep != nullptr, "sweep must not be null", "null");
        require_that(state != nullptr, "state must not be null", "null");
        require_that(cells == of->estimator.grid().size(), "cells must be those of the stream's grid, cells * cells", cells);
        const viewshed_sweep s = *sweep;
        const Rows rows = rows_of(s, of->model == nullptr ? MAX_RINGS : int(of->model->beams.rings()));
        SweepInput input{{rows.points.data(), rows.count, 3}, std::nullopt, of->model, of->infers_sensor,
                         std::nullopt, std::nullopt, std::nullopt};
        if (rows.ring) input.ring = View1<const std::int16_t>{rows.ring->data(), rows.count};
        if (s.attitude != nullptr) input.attitude = rotation_of(s.attitude);
        if (!std::isnan(s.sensor_height_m)) {
            require_that(s.sensor_height_m > 0.0 && s.sensor_height_m < MAX_HEIGHT_M, "sensor_height_m must lie in (0, 100)",
                         s.sensor_height_m);
            input.height_m = s.sensor_height_m;
        }
        if (!std::isnan(s.vehicle_yaw)) {
            require_that(std::fabs(s.vehicle_yaw) <= 1e6, "vehicle_yaw must be finite radians", s.vehicle_yaw);
            input.yaw = s.vehicle_yaw;
        }
        const std::lock_guard lock(of->mutex);
        const SweepEstimate found = of->estimator.estimate(input, of->expected);
        of->expected = found.sensor;
        Buffer<bool> visible(cells);
        for (std::size_t n = 0; n < cells; ++n) visible[n] = found.visible_prob[n] >= 0.5f;
        of->visible = std::move(visible);
        std::copy_n(found.state.data(), cells, state);
        if (visible_prob != nullptr) std::copy_n(found.visible_prob.data(), cells, visible_prob);
        if (basis == nullptr) return;
        const Basis& b = found.basis;
        *basis = {b.sensor_height_m, int32_t(b.height_source), b.ground_support, b.unsure_ground_share, b.inferred_share,
                  b.reach_m, {}, s.count - rows.count, {}};
        std::copy(found.level_from_sensor.begin(), found.level_from_sensor.end(), basis->level_from_sensor);
        if (found.sensor != nullptr) std::strncpy(basis->sensor, found.sensor->key.c_str(), sizeof basis->sensor - 1);
    });
}

viewshed_status viewshed_outline(viewshed_stream stream, double* corners_m, size_t corner_room, int64_t* begin, int32_t* region,
                                 size_t ring_room, size_t* corner_count, size_t* ring_count) {
    return guarded([&] {
        const std::shared_ptr<Stream> of = stream_of(stream);
        require_that(corner_count != nullptr && ring_count != nullptr, "corner_count and ring_count must not be null", "null");
        const std::lock_guard lock(of->mutex);
        require_that(of->visible.has_value(), "an outline must follow an estimate", "a stream without one");
        const BevGrid& grid = of->estimator.grid();
        const std::size_t cells = grid.cells;
        const View2<const bool> mask{of->visible->data(), cells, cells};
        Buffer<std::int32_t> labels(grid.size());
        label_regions(mask, false, labels.view(cells, cells));
        const MaskRings rings = trace_rings(mask, {labels.data(), cells, cells});
        *corner_count = rings.corners.size() / 2;
        *ring_count = rings.region.size();
        if (*corner_count > corner_room || *ring_count > ring_room) throw NoRoom();
        if (begin != nullptr) *begin = 0;
        if (*ring_count == 0) return;
        require_that(corners_m != nullptr && begin != nullptr && region != nullptr, "corners_m, begin and region must not be null", "null");
        for (std::size_t k = 0; k < *corner_count; ++k) {
            corners_m[2 * k] = grid.x0_m() + rings.corners[2 * k] * grid.cell_m();
            corners_m[2 * k + 1] = grid.y0_m() + rings.corners[2 * k + 1] * grid.cell_m();
        }
        std::copy(rings.begin.begin(), rings.begin.end(), begin);
        std::copy(rings.region.begin(), rings.region.end(), region);
    });
}

viewshed_status viewshed_close(viewshed_stream stream) {
    return guarded([&] {
        std::shared_ptr<Stream> last;  // destroyed after the lock is released and pending calls have ended
        const std::lock_guard lock(streams_mutex);
        const auto found = streams.find(stream);
        if (found == streams.end()) throw NoStream();
        last = std::move(found->second);
        streams.erase(found);
    });
}

}  // extern "C"
