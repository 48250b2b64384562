#include "leveling.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "ego_vehicle.hpp"
#include "stages.hpp"

namespace viewshed {

LevelArrays level_arrays(LevelPoints&& level) {
    return tuple_of(array(std::move(level.points), {level.count, 3}), array(std::move(level.range_m)),
                    array(std::move(level.azimuth)), array(std::move(level.height_m)), array(std::move(level.rows)));
}

void bind_leveling(nb::module_& m) {
    m.attr("EGO_LENGTH_M") = EGO_LENGTH_M;
    m.attr("EGO_WIDTH_M") = EGO_WIDTH_M;
    m.attr("MIN_EGO_HEIGHT_M") = MIN_EGO_HEIGHT_M;
    m.attr("MAX_EGO_HEIGHT_M") = MAX_EGO_HEIGHT_M;
    using Rotation = nb::ndarray<const float, nb::shape<3, 3>, nb::c_contig, nb::device::cpu>;
    using Transform = nb::ndarray<const float, nb::shape<3, 4>, nb::c_contig, nb::device::cpu>;
    m.def(
        "vehicle_heading",
        [](Points points, Rotation rotation) {
            nb::gil_scoped_release unlocked;
            return vehicle_heading(view(points), {rotation.data(), 3, 3});
        },
        "points"_in, "rotation"_in,
        "Return the heading of the own vehicle in radians, from points (N, 3) and the rotation (3, 3) to a level "
        "frame.");
    m.def(
        "level_points",
        [](Points points, std::optional<In1<bool>> clutter, Transform level_from_sensor, float near_m, float far_m,
           double heading, In2<float> ground_m, float half_extent_m) {
            const std::size_t nodes = ground_m.shape(0);
            require(!clutter || clutter->shape(0) == points.shape(0), "clutter must be as long as points");
            require(ground_m.shape(1) == nodes, "ground_m must be (n, n)");
            require(nodes >= 2 && nodes <= 4096, "ground_m must have 2 to 4096 nodes a side");
            require(half_extent_m > 0.0f, "half_extent_m must be positive");
            require(std::isfinite(heading), "heading must be finite");
            require(points.shape(0) < std::numeric_limits<std::int32_t>::max(), "points must be fewer than 2^31");
            const View1<const bool> mask = clutter ? view(*clutter) : View1<const bool>{nullptr, 0};
            return level_arrays(without_lock([&] {
                LevelPoints level =
                    level_points(view(points), mask, {level_from_sensor.data(), 3, 4}, near_m, far_m, heading);
                measure_heights(level, {view(ground_m), half_extent_m});
                return level;
            }));
        },
        "points"_in, "clutter"_in.none(), "level_from_sensor"_in, "near_m"_a, "far_m"_a, "heading"_a, "ground_m"_in,
        "half_extent_m"_a,
        "Return level points (M, 3), range, azimuth, height above the ground and row (M,) of the kept points of (N, "
        "3).");
    m.def(
        "beam_slopes",
        [](Points points, In1<float> range_m, float sensor_height_m, std::optional<In1<bool>> left_out,
           In1<std::int32_t> rows) {
            const std::size_t count = points.shape(0);
            require(are_as_long(points, range_m, rows), "points, range_m and rows must be as long");
            View1<const bool> mask{nullptr, 0};
            Buffer<std::int32_t> of_point(count);  // unused without a mask
            if (left_out) {
                mask = view(*left_out);
                require(count == 0 || mask.size > 0, "left_out must have an element for each row");
                of_point = indices_of<std::int32_t>(view(rows), 0, std::int32_t(std::max<std::size_t>(mask.size, 1) - 1), "rows");
            }
            Buffer<float> slope(count);
            without_lock([&] { beam_slopes(view(points), view(range_m), sensor_height_m, mask, of_point, slope); });
            return array(std::move(slope));
        },
        "points"_in, "range_m"_in, "sensor_height_m"_a, "left_out"_in.none(),
        "rows"_in, "Return the slope (M,) of level points (M, 3); +inf for left-out rows.");
    m.def(
        "obstacle_cells",
        [](Points points, In1<float> height_m, float x0_m, float y0_m, float cells_per_m, float low_m, float high_m,
           std::int32_t cells) {
            const std::size_t count = points.shape(0);
            require(height_m.shape(0) == count, "points and height_m must be as long");
            require(cells >= 1 && cells <= 32768, "cells must lie in [1, 32768]");
            Buffer<bool> mask(std::size_t(cells) * cells + 1);
            without_lock([&] {
                mark_cells(view(points), view(height_m), {x0_m, y0_m, cells_per_m, low_m, high_m, cells}, mask);
            });
            return array(std::move(mask), {std::size_t(cells), std::size_t(cells)});
        },
        "points"_in, "height_m"_in, "x0_m"_a, "y0_m"_a, "cells_per_m"_a, "low_m"_a, "high_m"_a, "cells"_a,
        "Return a mask (cells, cells) of cells that hold a point (N, 3) between two heights above the ground.");
}

}  // namespace viewshed
