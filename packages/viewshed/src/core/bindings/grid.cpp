#include "grid.hpp"

#include "bindings.hpp"

namespace viewshed {

void bind_grid(nb::module_& m) {
    m.def(
        "count_points",
        [](Points points, In2<float> rotation, In1<float> translation, std::size_t cells, double cell_m,
           double origin_x_m, double origin_y_m, float low_m, float high_m, double max_range_m, double null_range_m) {
            require(rotation.shape(0) == 3 && rotation.shape(1) == 3, "rotation must have shape (3, 3)");
            require(translation.shape(0) == 3, "translation must have shape (3,)");
            require(cells >= 1 && cells <= 16384, "cells must lie in [1, 16384]");
            require(cell_m > 0, "cell_m must be positive");
            const float most_m2 = float(max_range_m * max_range_m), null_m2 = float(null_range_m * null_range_m);
            const Counted counted{float(origin_x_m), float(origin_y_m), float(1.0 / cell_m), float(cells),
                                  low_m,             high_m,            most_m2,             null_m2};
            Buffer<std::int32_t> counts(cells * cells);
            without_lock([&] { count_points(view(points), rotation.data(), translation.data(), counted, counts); });
            return array(std::move(counts), {cells, cells});
        },
        "points"_in, "rotation"_in, "translation"_in, nb::kw_only(), "cells"_a, "cell_m"_a, "origin_x_m"_a, "origin_y_m"_a,
        "low_m"_a, "high_m"_a, "max_range_m"_a, "null_range_m"_a,
        "Count points (N, 3) per cell (cells, cells) int32 after a transform to level, within limits of height there "
        "and of range.");
    m.def(
        "polar_of_cells",
        [](std::size_t cells, double cell_m, double x0_m, double y0_m) {
            require(cells >= 1 && cells <= 16384, "cells must lie in [1, 16384]");
            Buffer<float> range_m(cells * cells), azimuth(cells * cells);
            without_lock([&] { polar_of_cells({cells, cell_m, x0_m, y0_m}, range_m, azimuth); });
            return tuple_of(array(std::move(range_m), {cells, cells}), array(std::move(azimuth), {cells, cells}));
        },
        "cells"_a, "cell_m"_a, "x0_m"_a, "y0_m"_a,
        "Return range in meters and azimuth in [-pi, pi) (cells, cells) of cell centers.");
}

}  // namespace viewshed
