// Fuzz libviewshed under sanitizers: make fuzz-library
//
// The input bytes choose calls, options, steps and points: sizes that do not fit, streams closed twice, points of any value.
// Every call must return a status. Pointers and sizes given as memory are always valid: a C interface cannot check them.
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "viewshed.h"

namespace {

// The rest of the input.
struct Bytes {
    const std::uint8_t* data;
    std::size_t size;

    template <typename T>
    T take() {
        T value{};
        const std::size_t count = size < sizeof(T) ? size : sizeof(T);
        std::memcpy(&value, data, count);
        data += count, size -= count;
        return value;
    }
    // The usual value, or in one of four cases any value.
    double number(double usual) { return take<std::uint8_t>() % 4 == 0 ? take<double>() : usual; }
};

[[noreturn]] void fail() { __builtin_trap(); }

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    Bytes bytes{data, size};
    // 1. Open a stream for a small grid; a refused one must leave no stream.
    viewshed_options options = viewshed_defaults();
    static const char* const SENSORS[] = {nullptr, "none", "vlp16", "HDL-32E", "mid360", "no such", ""};
    options.cells = bytes.take<std::uint8_t>() % 40;
    options.half_extent_m = bytes.number(16.0);
    for (double& offset : options.offset_m) offset = bytes.number(0.0);
    options.target_width_m = bytes.number(1.8);
    options.target_height_m = bytes.number(1.5);
    options.min_returns = bytes.take<std::uint8_t>();
    options.sensor = SENSORS[bytes.take<std::uint8_t>() % 7];
    viewshed_stream stream = 99;
    const viewshed_status opened = viewshed_open(&options, &stream);
    if ((opened == VIEWSHED_OK) != (stream != 0)) fail();
    const std::size_t cells = std::size_t(options.cells) * options.cells;
    std::vector<std::uint8_t> state(cells + 1, 77);
    std::vector<float> prob(cells + 1);
    viewshed_basis basis;

    // 2. Calls in any order, with sweeps made of the remaining bytes.
    std::size_t corners = 0, rings = 0;
    std::vector<double> corner_m(2 * 256);
    std::vector<std::int64_t> begin(65);
    std::vector<std::int32_t> region(64);
    for (int call = 0; call < 4; ++call) {
        const std::uint8_t which = bytes.take<std::uint8_t>();
        if (which % 8 == 7) {
            viewshed_outline(stream, corner_m.data(), 256, begin.data(), region.data(), 64, &corners, &rings);
            viewshed_outline(stream, nullptr, which % 3, nullptr, nullptr, which % 5, &corners, which % 2 ? &rings : nullptr);
            continue;
        }
        if (which % 32 == 6) viewshed_close(stream);
        viewshed_sweep sweep = viewshed_no_sweep();
        sweep.point_step = which % 4 == 0 ? 0 : 12 + bytes.take<std::uint8_t>() % 8;
        const std::size_t step = sweep.point_step == 0 ? 12 : sweep.point_step;
        const std::size_t here = bytes.size < 6000 ? bytes.size : 6000;
        // Copy exactly the bytes that the sweep states, so that the sanitizer reports every read beyond them.
        std::vector<std::uint8_t> points(bytes.data, bytes.data + here);
        sweep.count = here / step;
        sweep.points = points.data();
        std::vector<std::uint8_t> ring(2 * sweep.count);
        if (which & 16) {
            for (std::size_t n = 0; n < sweep.count; ++n) ring[2 * n] = std::uint8_t(points[n * step] % 32);
            sweep.ring = ring.data();
        }
        double attitude[4] = {bytes.number(1.0), bytes.number(0.0), bytes.number(0.0), bytes.number(0.0)};
        if (which & 32) sweep.attitude = attitude;
        if (which & 64) sweep.sensor_height_m = bytes.number(1.8);
        if (which & 128) sweep.vehicle_yaw = bytes.number(0.5);
        const viewshed_status status =
            viewshed_estimate(stream, &sweep, state.data(), which % 3 ? prob.data() : nullptr, cells, &basis);
        if (status == VIEWSHED_ERROR_INTERNAL || state[cells] != 77) fail();
        if (status == VIEWSHED_OK) {
            for (std::size_t n = 0; n < cells; ++n) {
                if (state[n] > VIEWSHED_HIDDEN) fail();
                if (which % 3 && !(prob[n] >= 0.0f && prob[n] <= 1.0f)) fail();
            }
        }
        sweep.count = bytes.take<std::uint64_t>() | std::uint64_t{1} << 40;
        if (viewshed_estimate(stream, &sweep, state.data(), nullptr, cells, &basis) == VIEWSHED_OK) fail();
    }
    // 3. A stream can be closed only once.
    viewshed_close(stream);
    if (viewshed_close(stream) == VIEWSHED_OK || viewshed_error()[0] == '\0') fail();
    return 0;
}
