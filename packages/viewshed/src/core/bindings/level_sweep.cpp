#include "level_sweep.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "ego_vehicle.hpp"
#include "farthest_returns.hpp"
#include "ground_lattice.hpp"
#include "stages.hpp"

namespace viewshed {

void bind_level_sweep(nb::module_& m) {
    m.attr("LEVEL_TILT") = LEVEL_TILT;
    m.attr("MIN_HEIGHT_SUPPORT") = MIN_HEIGHT_SUPPORT;
    m.def(
        "farthest_returns",
        [](Points points, std::optional<In1<std::int16_t>> ring) {
            require(points.shape(0) < (std::size_t{1} << 31), "a sweep must have fewer than 2^31 points");
            std::optional<View1<const std::int16_t>> rings;
            if (ring) {
                require(ring->shape(0) == points.shape(0), "ring must have one row for each point");
                rings = view(*ring);
            }
            return array_or_none(without_lock([&] { return farthest_returns(view(points), rings); }));
        },
        "points"_in, "ring"_in.none(),
        "Return the rows of the farthest return of each beam of points (N, 3); None if each beam has one return.");
    using RotationArray = nb::ndarray<const double, nb::shape<3, 3>, nb::c_contig, nb::device::cpu>;
    m.def(
        "level_sweep",
        [](Points points, std::optional<In1<std::int16_t>> ring, std::size_t rings, std::size_t columns, float near_m,
           float far_m, std::optional<RotationArray> attitude, std::optional<double> height_m, std::optional<double> yaw,
           double half_extent_m) {
            require(points.shape(0) < (std::size_t{1} << 31), "a sweep must have fewer than 2^31 points");
            require(far_m <= MAX_M, "far_m must be at most 1e6 m");
            require(!height_m || std::isfinite(*height_m), "height_m must be finite");
            require(!yaw || std::isfinite(*yaw), "yaw must be finite");
            require_lattice(2, half_extent_m);
            UnleveledSweep sweep{view(points), std::nullopt, rings, columns, near_m, far_m, std::nullopt, height_m, yaw, half_extent_m};
            std::optional<Buffer<std::int16_t>> own;
            if (ring && points.shape(0) > 0) {
                require(ring->shape(0) == points.shape(0), "ring must have one row for each point");
                require_image(rings, columns);
                own = indices_of<std::int16_t>(view(*ring), -1, std::int16_t(rings - 1), "ring");
                sweep.ring = View1<const std::int16_t>(*own);
            }
            if (attitude) {
                std::copy_n(attitude->data(), 9, sweep.attitude.emplace().begin());
                const auto is_bounded = [](double value) { return std::fabs(value) <= MAX_M; };
                require(std::all_of(sweep.attitude->begin(), sweep.attitude->end(), is_bounded), "attitude must be finite");
            }
            auto made = without_lock([&] { return level_sweep(sweep); });
            // Range image, rotation, height, ground, and level points.
            std::optional<RangeImageArrays> image;
            if (made.image) image = range_image_arrays(std::move(*made.image));
            Buffer<double> rotation(9);
            std::copy(made.rotation.begin(), made.rotation.end(), rotation.begin());
            GroundMap& ground = made.ground;
            const std::size_t n = ground.nodes;
            const auto [a, b, c] = ground.plane;
            LevelPoints& level = made.level;
            return tuple_of(
                image, array(std::move(rotation), {3, 3}), made.height_m,
                tuple_of(array(std::move(ground.heights_m), {n, n}), array(std::move(ground.std_m), {n, n}),
                         array(std::move(ground.seen), {n, n}), tuple_of(a, b, c), ground.support),
                level_arrays(std::move(level)));
        },
        "points"_in, "ring"_in.none(), "rings"_a, "columns"_a, "near_m"_a, "far_m"_a, "attitude"_in.none(),
        "height_m"_a.none(), "yaw"_a.none(), "half_extent_m"_a,
        "Return the range image (as range_image does, or None), rotation (3, 3) to level, sensor height, ground "
        "(heights, standard deviations, seen nodes, plane, support), and level points (as level_points does) of "
        "points (N, 3).");
}

}  // namespace viewshed
