#include "concave_hull.hpp"

#include <cmath>

#include "bindings.hpp"
#include "files.hpp"

namespace viewshed {
namespace {

SquareGrid checked_grid(double x_m, double y_m, double cell_m, std::size_t cells) {
    require(std::isfinite(x_m) && std::isfinite(y_m) && cell_m > 0.0 && std::isfinite(cell_m), "a grid must be finite");
    require(cells >= 1 && cells <= 4096, "cells must lie in [1, 4096]");
    return {x_m, y_m, cell_m, cells};
}

// Check and thin out returns, without the GIL.
std::vector<PlanePoint> thin_checked(const Points& points, const In1<float>& range_m, const SquareGrid& grid) {
    require(points.shape(0) == range_m.shape(0), "points and range_m must be as long");
    nb::gil_scoped_release unlocked;
    const Buffer<float> own = copy_of(View1<const float>{points.data(), points.size()});
    require(are_finite(own.data(), own.size()), "points must be finite");
    return thin_returns({own.data(), points.shape(0), 3}, view(range_m), grid);
}

}  // namespace

void bind_concave_hull(nb::module_& m) {
    m.def(
        "concave_hull",
        [](Points points, In1<float> range_m, double concavity, double length_m, double x_m, double y_m, double cell_m,
           std::size_t cells) {
            require(concavity > 0.0 && length_m >= 0.0, "concavity must be positive, and length_m not negative");
            const SquareGrid grid = checked_grid(x_m, y_m, cell_m, cells);
            const std::vector<PlanePoint> thinned = thin_checked(points, range_m, grid);
            Buffer<bool> inside(cells * cells);
            Buffer<float> visible(cells * cells);
            without_lock([&] {
                std::vector<Edge> edges;
                if (span_area(thinned)) {
                    const std::vector<PlanePoint> ring = concave_hull(thinned, concavity, length_m);
                    for (std::size_t k = 0; k < ring.size(); ++k) edges.push_back({ring[k], ring[(k + 1) % ring.size()]});
                }
                fill_rings(edges, grid, inside.view(cells, cells));
                for (std::size_t k = 0; k < visible.size(); ++k) visible[k] = inside[k] ? 1.0f : 0.0f;
            });
            return array(std::move(visible), {cells, cells});
        },
        "points"_in, "range_m"_in, "concavity"_a, "length_m"_a, "x_m"_a, "y_m"_a, "cell_m"_a,
        "cells"_a, "Return 1 for cells (cells, cells) inside the concave hull of returns (M, 3), else 0.");
    m.def(
        "thin_returns",
        [](Points points, In1<float> range_m, double x_m, double y_m, double cell_m) {
            const std::vector<PlanePoint> thinned = thin_checked(points, range_m, checked_grid(x_m, y_m, cell_m, 1));
            Buffer<double> xy(2 * thinned.size());
            for (std::size_t k = 0; k < thinned.size(); ++k) {
                xy[2 * k] = thinned[k].x;
                xy[2 * k + 1] = thinned[k].y;
            }
            const bool spans = span_area(thinned);
            return tuple_of(array(std::move(xy), {thinned.size(), std::size_t{2}}), spans);
        },
        "points"_in, "range_m"_in, "x_m"_a, "y_m"_a, "cell_m"_a,
        "Return points (K, 2) in meters, the farthest of each cell; and whether they are three or more, not on one "
        "line.");
    m.def(
        "fill_rings",
        [](In2<double> edges, double x_m, double y_m, double cell_m, std::size_t cells) {
            require(edges.shape(1) == 4, "edges must be (E, 4)");
            const SquareGrid grid = checked_grid(x_m, y_m, cell_m, cells);
            Buffer<bool> inside(cells * cells);
            without_lock([&] {
                const auto given = view(edges);
                std::vector<Edge> all;
                all.reserve(given.rows);
                for (std::size_t e = 0; e < given.rows; ++e) {
                    all.push_back({{given(e, 0), given(e, 1)}, {given(e, 2), given(e, 3)}});
                }
                fill_rings(all, grid, inside.view(cells, cells));
            });
            return array(std::move(inside), {cells, cells});
        },
        "edges"_in, "x_m"_a, "y_m"_a, "cell_m"_a, "cells"_a,
        "Return a mask (cells, cells) of cells inside closed rings of edges (E, 4), by the even-odd rule.");
}

}  // namespace viewshed
