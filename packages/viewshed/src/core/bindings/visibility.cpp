#include "visibility.hpp"

#include <cmath>

#include "bindings.hpp"

namespace viewshed {

void bind_visibility(nb::module_& m) {
    m.attr("AZIMUTH_COLUMNS") = AZIMUTH_COLUMNS;
    m.attr("GROUND_SECTORS") = GROUND_SECTORS;
    nb::class_<CellWindows>(m, "CellWindows", "Azimuth windows of a target in each cell of a grid.")
        .def(
            "__init__",
            [](CellWindows* self, In2<float> range_m, In2<float> azimuth, double cell_m, double width_m) {
                const std::size_t rows = range_m.shape(0), columns = range_m.shape(1);
                require(have_one_shape(range_m, azimuth), "range_m and azimuth must have one shape (cells, cells)");
                require(range_m.size() >= 1 && range_m.size() < (1u << 28), "cells must be one or more, and fewer than 2^28");
                require(std::isfinite(cell_m) && cell_m > 0, "cell_m must be positive and finite");
                require(std::isfinite(width_m) && width_m > 0, "width_m must be positive and finite");
                const Buffer<float> ranges = copy_of(view(range_m).flat()), angles = copy_of(view(azimuth).flat());
                for (std::size_t n = 0; n < ranges.size(); ++n) {
                    require(ranges[n] >= 0 && std::isfinite(ranges[n]), "range_m must be finite, not negative");
                    require(std::fabs(angles[n]) < 3.2f, "azimuth must lie in [-pi, pi]");
                }
                new (self) CellWindows({ranges.data(), rows, columns}, {angles.data(), rows, columns}, cell_m, width_m);
            },
            "range_m"_in, "azimuth"_in, "cell_m"_a, "width_m"_a);
}

}  // namespace viewshed
