#include "visibility.hpp"

#include <cmath>

#include "bindings.hpp"

namespace viewshed {

void bind_visibility(nb::module_& m) {
    m.attr("AZIMUTH_COLUMNS") = AZIMUTH_COLUMNS;
    m.attr("GROUND_SECTORS") = GROUND_SECTORS;
    nb::class_<CellWindows>(m, "CellWindows", "The windows of azimuth of a target in each cell of a grid.")
        .def(
            "__init__",
            [](CellWindows* self, In2<float> range_m, In2<float> azimuth, double cell_m, double width_m) {
                require(range_m.shape(0) == azimuth.shape(0) && range_m.shape(1) == azimuth.shape(1),
                        "range_m and azimuth must have one shape (cells, cells)");
                require(range_m.size() < (1u << 28), "cells must be fewer than 2^28");
                require(std::isfinite(cell_m) && cell_m > 0, "cell_m must be positive and finite");
                require(std::isfinite(width_m) && width_m > 0, "width_m must be positive and finite");
                for (std::size_t n = 0; n < range_m.size(); ++n) {
                    require(range_m.data()[n] >= 0 && std::isfinite(range_m.data()[n]), "range_m must be finite, not negative");
                    require(std::fabs(azimuth.data()[n]) < 4.0f, "azimuth must lie in [-pi, pi]");
                }
                new (self) CellWindows(view(range_m), view(azimuth), cell_m, width_m);
            },
            "range_m"_in, "azimuth"_in, "cell_m"_a, "width_m"_a);
}

}  // namespace viewshed
