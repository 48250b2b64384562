// Bindings of cell polygons. Arrays are checked here.
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "mask_regions.hpp"
#include "mask_rings.hpp"
#include "sector_polygons.hpp"
#include "stages.hpp"
#include "star_polygons.hpp"

namespace viewshed {
namespace {

constexpr std::size_t MAX_CELLS = 4096, MAX_BINS = 7200, MAX_SECTORS = 256;
constexpr double FARTHEST_M = 1e9;

void require_square(std::size_t rows, std::size_t columns) {
    require(rows == columns && rows >= 1 && rows <= MAX_CELLS, "a mask must be square, of 1 to 4096 cells a side");
}

// Check and copy the starts (R + 1,) of closed rings of points (V, 2).
Buffer<std::int64_t> checked_begin(const In2<double>& points, const In1<std::int64_t>& begin) {
    Buffer<std::int64_t> from = copy_of(view(begin));
    require(points.shape(1) == 2, "points must be (V, 2)");
    require(from.size() >= 1 && from[0] == 0 && from[from.size() - 1] == std::int64_t(points.shape(0)) &&
                std::is_sorted(from.begin(), from.end()),
            "begin must ascend from 0 to the number of points");
    return from;
}

// Return the cells that a function of closed rings marks.
template <typename Mark>
Out<bool> cells_of(const In2<double>& points, const In1<std::int64_t>& begin, std::size_t cells, Mark mark) {
    require(cells >= 1 && cells <= MAX_CELLS, "cells must lie in [1, 4096]");
    const Buffer<std::int64_t> from = checked_begin(points, begin);
    Buffer<bool> marked(cells * cells);
    without_lock([&] { mark({view(points), from}, marked.view(cells, cells)); });
    return array(std::move(marked), {cells, cells});
}

// Check and copy ranges of wedges.
Buffer<double> checked_ranges(const In1<double>& ranges) {
    Buffer<double> values = copy_of(view(ranges));
    require(values.size() >= 3 && values.size() <= MAX_BINS, "there must be 3 to 7200 ranges");
    for (const double value : values) require(value >= 0.0 && std::isfinite(value), "ranges must be finite, and not negative");
    return values;
}

}  // namespace

void bind_polygons(nb::module_& m) {
    m.def(
        "label_regions",
        [](In2<bool> mask, bool diagonal) {
            const std::size_t rows = mask.shape(0), columns = mask.shape(1);
            Buffer<std::int32_t> labels(rows * columns);
            without_lock([&] { label_regions(view(mask), diagonal, labels.view(rows, columns)); });
            return array(std::move(labels), {rows, columns});
        },
        "mask"_in, "diagonal"_a, "Return the number (rows, columns) of each cell's connected region, 0 for none.");
    m.def(
        "squared_depth",
        [](In2<bool> mask) {
            const std::size_t rows = mask.shape(0), columns = mask.shape(1);
            Buffer<std::int64_t> depth(rows * columns);
            without_lock([&] { find_squared_depth(view(mask), depth.view(rows, columns)); });
            return array(std::move(depth), {rows, columns});
        },
        "mask"_in, "Return the squared distance (rows, columns) to the nearest false cell, in cells.");
    m.def(
        "rings_of_mask",
        [](In2<bool> mask, In2<std::int32_t> regions) {
            require_square(mask.shape(0), mask.shape(1));
            require(have_one_shape(mask, regions), "regions must have the mask's shape");
            const std::size_t cells = mask.shape(0);
            const Buffer<bool> inside = copy_of(view(mask).flat());
            const Buffer<std::int32_t> numbers =
                indices_of<std::int32_t>(view(regions).flat(), 0, std::numeric_limits<std::int32_t>::max(), "regions");
            auto rings = without_lock(
                [&] { return trace_rings({inside.data(), cells, cells}, {numbers.data(), cells, cells}); });
            const std::size_t corners = rings.corners.size() / 2;
            return tuple_of(array_of(rings.corners, {corners, 2}), array_of(rings.begin), array_of(rings.region));
        },
        "mask"_in, "regions"_in,
        "Return corners (V, 2) of the rings around a mask's true cells, starts of rings (R + 1,), and region of each "
        "(R,), negative for a hole.");
    m.def(
        "cells_inside",
        [](In2<double> points, In1<std::int64_t> begin, std::size_t cells) {
            return cells_of(points, begin, cells, fill_closed_rings);
        },
        "points"_in, "begin"_in, "cells"_a,
        "Return a mask (cells, cells) of cells whose center lies inside closed rings of points (V, 2), by the "
        "even-odd rule.");
    m.def(
        "cells_met",
        [](In2<double> points, In1<std::int64_t> begin, std::size_t cells) {
            return cells_of(points, begin, cells, find_cells_met);
        },
        "points"_in, "begin"_in, "cells"_a,
        "Return a mask (cells, cells) of cells that an edge of closed rings of points (V, 2) crosses or touches.");
    m.def(
        "best_sectors",
        [](In1<double> ranges, std::size_t sectors, double inner) {
            const Buffer<double> checked = checked_ranges(ranges);
            require(sectors >= 1 && sectors <= MAX_SECTORS, "sectors must lie in [1, 256]");
            require(inner >= 0.0 && std::isfinite(inner), "inner must be finite, and not negative");
            const BestSectors found = without_lock([&] { return best_sectors(checked, sectors, inner); });
            return tuple_of(array_of(found.first), array_of(found.end), array_of(found.range));
        },
        "ranges"_in, "sectors"_a, "inner"_a,
        "Return first bin, end bin and range of the sectors below ranges (bins,) with the largest union.");
    m.def(
        "free_ranges",
        [](In2<bool> mask, double x_m, double y_m, double cell_m, double apex_x_m, double apex_y_m, double half_m,
           std::size_t bins, bool is_solid) {
            require_square(mask.shape(0), mask.shape(1));
            const auto is_near = [](double at_m) { return std::fabs(at_m) <= FARTHEST_M; };
            require(is_near(x_m) && is_near(y_m) && cell_m > 0.0 && is_near(cell_m), "a grid must lie within 1e9 m");
            require(is_near(apex_x_m) && is_near(apex_y_m), "apex must lie within 1e9 m");
            require(half_m > 0.0 && is_near(half_m), "half_m must lie in (0, 1e9]");
            require(bins >= 4 && bins <= MAX_BINS, "bins must lie in [4, 7200]");
            Buffer<double> ranges(bins);
            without_lock([&] {
                find_free_ranges(view(mask), {x_m, y_m, cell_m, mask.shape(0)}, {apex_x_m, apex_y_m}, half_m, is_solid,
                    ranges);
            });
            return array(std::move(ranges));
        },
        "mask"_in, "x_m"_a, "y_m"_a, "cell_m"_a, "apex_x_m"_a, "apex_y_m"_a, "half_m"_a, "bins"_a,
        "is_solid"_a,
        "Return the free range (bins,) of each wedge from an apex to boxes around the false cells of a mask.");
    m.def(
        "star_vertices",
        [](In1<double> ranges, double price_m2) {
            const Buffer<double> checked = checked_ranges(ranges);
            require(std::isfinite(price_m2), "price_m2 must be finite");
            auto found = without_lock([&] { return star_vertices(checked, price_m2); });
            Buffer<double> vertices(2 * found.size());
            for (std::size_t k = 0; k < found.size(); ++k) {
                vertices[2 * k] = found[k].angle;
                vertices[2 * k + 1] = found[k].range;
            }
            return array(std::move(vertices), {found.size(), std::size_t{2}});
        },
        "ranges"_in, "price_m2"_a,
        "Return angle and range (V, 2) of the star polygon below ranges (bins,) with the most area less a price per "
        "vertex.");
}

}  // namespace viewshed
