#include "ground.hpp"

#include <nanobind/stl/array.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "bindings.hpp"
#include "ground_fill.hpp"

namespace viewshed {

namespace {

// Convert to heights, standard deviations, seen nodes, plane, support, and the z of assumed level ground (NaN if seen).
auto as_tuple(FoundGround& ground, std::size_t n) {
    const auto& [a, b, c] = ground.carrier.plane;
    return tuple_of(array(std::move(ground.heights_m), {n, n}), array(std::move(ground.std_m), {n, n}),
                    array(std::move(ground.seen), {n, n}), tuple_of(a, b, c), ground.carrier.support,
                    ground.level_m);
}

Plane plane_of(const In1<float>& plane) {
    require(plane.shape(0) == 3, "plane must be (a, b, c)");
    require_bounded(view(plane), "plane must be finite");
    return {plane.data()[0], plane.data()[1], plane.data()[2]};
}

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
            FoundGround found = without_lock([&] { return estimate_ground(*lattice_of(lows.nodes, half_m), lows, height_m); });
            return as_tuple(found, lows.nodes);
        },
        "lows_m"_in, "rise_m"_in, "half_m"_a, "height_m"_a,
        "Return heights, standard deviations, seen nodes (n, n), plane, support, and level (or NaN) of the ground, "
        "from low points (n, n, 3) and the rise (n, n) to the highest return of each node.");
    m.def(
        "fill_ground",
        [](In2<float> walked_m, In2<bool> accepted, In1<float> plane, double half_m) {
            const std::size_t n = walked_m.shape(0);
            require(walked_m.shape(1) == n && have_one_shape(walked_m, accepted),
                    "walked_m and accepted must be (n, n)");
            require_lattice(n, half_m);
            const Plane carrier = plane_of(plane);
            for (std::size_t at = 0; at < n * n; ++at) {
                require(!accepted.data()[at] || std::fabs(walked_m.data()[at]) <= MAX_M, "walked_m must be finite");
            }
            Buffer<float> heights_m(n * n), std_m(n * n);
            without_lock([&] {
                fill_ground(*lattice_of(n, half_m), view(walked_m).flat(), view(accepted).flat(), carrier, heights_m, std_m);
            });
            return tuple_of(array(std::move(heights_m), {n, n}), array(std::move(std_m), {n, n}));
        },
        "walked_m"_in, "accepted"_in, "plane"_in, "half_m"_a,
        "Return heights and standard deviations (n, n) of the ground, filled between and beyond the accepted nodes "
        "(n, n).");
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
