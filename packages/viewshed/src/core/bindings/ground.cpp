#include "ground.hpp"

#include <nanobind/stl/array.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "bindings.hpp"
#include "unseen_ground.hpp"

namespace viewshed {

namespace {

// Copy and check low points (n, n, 3) and the rise of their nodes (n, n).
Lows lows_of(const In3<float>& points, const In2<float>& rise_m, double half_m) {
    const std::size_t n = points.shape(0);
    require(points.shape(1) == n && points.shape(2) == 3, "lows_m must be (n, n, 3)");
    require(rise_m.shape(0) == n && rise_m.shape(1) == n, "rise_m must be (n, n) as lows_m");
    require_lattice(n, half_m);
    const Buffer<float> own = copy_of(View1<const float>{points.data(), points.size()});
    Lows lows(n);
    const double reach_m = half_m * (1.0 + 0.5 / double(n));  // rounding may move points out of the outermost nodes
    for (std::size_t at = 0; at < n * n; ++at) {
        const float x = own[3 * at], y = own[3 * at + 1], z = own[3 * at + 2];
        lows.z_m[at] = std::isfinite(z) ? z : std::numeric_limits<float>::infinity();
        lows.rise_m[at] = rise_m.data()[at];
        lows.x_m[at] = lows.y_m[at] = 0.0f;
        if (!std::isfinite(z)) continue;
        require(std::fabs(double(x)) <= reach_m && std::fabs(double(y)) <= reach_m && std::fabs(z) <= MAX_M,
                "lows_m must lie on the lattice");
        lows.x_m[at] = x;
        lows.y_m[at] = y;
        lows.occupied.push_back(std::int32_t(at));
    }
    return lows;
}

}  // namespace

void bind_ground(nb::module_& m) {
    m.def(
        "ground_of_lows",
        [](In3<float> lows_m, In2<float> rise_m, double half_m, double height_m) {
            const Lows lows = lows_of(lows_m, rise_m, half_m);
            const std::size_t n = lows.nodes;
            FoundGround found = without_lock([&] { return estimate_ground(*lattice_of(n, half_m), lows, height_m); });
            for (std::size_t at = 0; at < n * n; ++at) {
                if (!found.seen[at]) found.heights_m[at] = std::numeric_limits<float>::quiet_NaN();
            }
            const auto& [a, b, c] = found.carrier.plane;
            return tuple_of(array(std::move(found.heights_m), {n, n}), array(std::move(found.seen), {n, n}),
                            tuple_of(a, b, c), found.carrier.support, found.level_m);
        },
        "lows_m"_in, "rise_m"_in, "half_m"_a, "height_m"_a,
        "Return heights (n, n), NaN where none is seen, which nodes are seen (n, n), plane, support, and level (or NaN) of the "
        "ground, from low points (n, n, 3) and the rise (n, n) to the highest return of each node.");
    m.def(
        "map_returns",
        [](Points points, In1<float> azimuth, In1<float> range_m, float sensor_height_m, In2<float> heights_m, In2<bool> seen,
           float half_m) {
            const std::size_t n = heights_m.shape(0);
            require(are_as_long(points, azimuth, range_m), "points, azimuth and range_m must be as long");
            require(heights_m.shape(1) == n && have_one_shape(heights_m, seen), "heights_m and seen must be (n, n)");
            require_lattice(n, half_m);
            require(std::fabs(sensor_height_m) <= MAX_M, "sensor_height_m must be finite");
            Buffer<float> maps = without_lock([&] {
                return map_returns({view(points), view(azimuth), view(range_m), {nullptr, 0}, sensor_height_m},
                                   {view(heights_m), view(seen), half_m});
            });
            return array(std::move(maps), {std::size_t(MAPS), AZIMUTH_BINS, RANGE_BINS});
        },
        "points"_in, "azimuth"_in, "range_m"_in, "sensor_height_m"_a, "heights_m"_in, "seen"_in, "half_m"_a,
        "Return what level points (M, 3) and seen ground (n, n) show in polar bins: maps (8, azimuths, ranges).");
    m.def(
        "predict_ground",
        [](In3<float> maps, float sensor_height_m) {
            require(maps.shape(0) == MAPS && maps.shape(1) == AZIMUTH_BINS && maps.shape(2) == RANGE_BINS,
                    "maps must be those of map_returns");
            require(std::fabs(sensor_height_m) <= MAX_M, "sensor_height_m must be finite");
            PredictedGround predicted =
                without_lock([&] { return predict_ground({maps.data(), maps.size()}, sensor_height_m); });
            const auto made = [](Buffer<float>& of) { return array(std::move(of), {AZIMUTH_BINS, RANGE_BINS}); };
            return tuple_of(made(predicted.low_m), made(predicted.height_m), made(predicted.high_m));
        },
        "maps"_in, "sensor_height_m"_a,
        "Return the quantiles .15, .5 and .85 of the ground's height (azimuths, ranges) in meters.");
    m.def(
        "complete_ground",
        [](Points points, In1<float> azimuth, In1<float> range_m, std::optional<In1<bool>> left_out, In1<std::int32_t> rows,
           float sensor_height_m, In2<float> heights_m, In2<float> std_m, In2<bool> seen, double half_m) {
            const std::size_t n = heights_m.shape(0), count = points.shape(0);
            require(are_as_long(points, azimuth, range_m) && are_as_long(points, rows), "points, azimuth, range_m and rows must be as long");
            require(heights_m.shape(1) == n && have_one_shape(heights_m, std_m, seen), "heights_m, std_m and seen must be (n, n)");
            require_lattice(n, half_m);
            require_bounded(view(heights_m).flat(), "heights_m must be finite");
            require(std::fabs(sensor_height_m) <= MAX_M, "sensor_height_m must be finite");
            Buffer<std::uint8_t> mask(left_out ? count : 0);
            if (left_out) {
                require(count == 0 || left_out->shape(0) > 0, "left_out must have an element for each row");
                const auto last = std::int32_t(std::max<std::size_t>(left_out->shape(0), 1) - 1);
                const Buffer<std::int32_t> own = indices_of<std::int32_t>(view(rows), 0, last, "rows");
                for (std::size_t k = 0; k < count; ++k) mask[k] = left_out->data()[own[k]];
            }
            Buffer<float> completed_m = copy_of(view(heights_m).flat()), completed_std_m = copy_of(view(std_m).flat());
            const Buffer<bool> own_seen = copy_of(view(seen).flat());
            without_lock([&] {
                complete_ground({view(points), view(azimuth), view(range_m), mask, sensor_height_m}, *lattice_of(n, half_m),
                                own_seen, completed_m, completed_std_m);
            });
            return tuple_of(array(std::move(completed_m), {n, n}), array(std::move(completed_std_m), {n, n}));
        },
        "points"_in, "azimuth"_in, "range_m"_in, "left_out"_in.none(), "rows"_in, "sensor_height_m"_a, "heights_m"_in,
        "std_m"_in, "seen"_in, "half_m"_a,
        "Return heights and standard deviations (n, n) of the ground, predicted where it is not seen, from level points "
        "(M, 3), except for those whose rows are left_out.");
    m.def(
        "free_plane",
        [](Points points) {
            const FreePlane found = without_lock([&] { return free_plane(view(points)); });
            Buffer<float> normal(3);
            std::copy_n(found.normal.data(), 3, normal.data());
            return tuple_of(array(std::move(normal)), found.support);
        },
        "points"_in,
        "Return the unit normal (3,) of the ground below a sensor tilted by up to 60°, and the share of the area of "
        "points (n, 3) on it.");
}

}  // namespace viewshed
