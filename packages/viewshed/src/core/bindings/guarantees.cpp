#include "guarantees.hpp"

#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>

#include <cmath>
#include <optional>

#include "bindings.hpp"

namespace viewshed {
namespace {

void require_cells(const TargetColumns& of, std::size_t rows, std::size_t columns) {
    require(rows == of.rows && columns == of.grid_columns, "cells must be those of the beams that are sent");
}

View2<const float> checked(const SentBeams& sent, const In2<float>& nearest) {
    require(nearest.shape(0) == sent.of->rings && nearest.shape(1) == 2 * sent.of->columns,
            "nearest must be (rings, 2 * columns) of the same sensor");
    return view(nearest);
}

void check_cells(const SentBeams& sent, const In2<std::int32_t>& margins, const In2<bool>& counts) {
    require_cells(*sent.of, margins.shape(0), margins.shape(1));
    require_cells(*sent.of, counts.shape(0), counts.shape(1));
}

}  // namespace

void bind_guarantees(nb::module_& m) {
    nb::class_<TargetColumns>(m, "TargetColumns", "Azimuth columns that fall on a target in each cell.")
        .def(
            "__init__",
            [](TargetColumns* self, In2<float> range_m, In2<float> azimuth, std::size_t rings, std::size_t columns, double cell_m,
               double width_m, double farthest_m) {
                const std::size_t rows = range_m.shape(0), cells = range_m.shape(1);
                require(have_one_shape(range_m, azimuth), "range_m and azimuth must have one shape (cells, cells)");
                require(range_m.size() < (1u << 28), "cells must be fewer than 2^28");
                require(rings >= 1 && rings <= 4096, "rings must lie in [1, 4096]");
                require(columns >= 4 && columns <= 36000, "columns must lie in [4, 36000]");
                require(cell_m > 0 && width_m > 0 && std::isfinite(cell_m) && std::isfinite(width_m),
                        "cell_m and width_m must be positive and finite");
                const Buffer<float> ranges = copy_of(view(range_m).flat()), angles = copy_of(view(azimuth).flat());
                for (std::size_t n = 0; n < ranges.size(); ++n) {
                    require(ranges[n] >= 0 && std::isfinite(ranges[n]) && std::fabs(angles[n]) < 3.2f,
                            "range_m must be finite, not negative, and azimuth lie in [-pi, pi]");
                }
                new (self) TargetColumns({ranges.data(), rows, cells}, {angles.data(), rows, cells}, rings, columns, cell_m,
                                         width_m, farthest_m);
            },
            "range_m"_in, "azimuth"_in, "rings"_a, "columns"_a, "cell_m"_a, "width_m"_a, "farthest_m"_a);
    nb::class_<SentBeams>(m, "SentBeams", "Beams sent through a target in each cell.")
        .def(
            "__init__",
            [](SentBeams* self, std::shared_ptr<TargetColumns> columns, In2<float> low_m, In2<float> high_m, In2<float> slope,
               In1<float> start_m) {
                require_cells(*columns, low_m.shape(0), low_m.shape(1));
                require_cells(*columns, high_m.shape(0), high_m.shape(1));
                require(slope.shape(1) == columns->rings && slope.shape(0) > 0 && start_m.shape(0) == columns->rings,
                        "slope must be (sectors, rings) and start_m (rings,)");
                const nb::gil_scoped_release unlocked;
                new (self) SentBeams(std::move(columns), view(low_m), view(high_m), view(slope), view(start_m));
            },
            "columns"_a, "low_m"_in, "high_m"_in, "slope"_in, "start_m"_in);
    m.def(
        "nearest_returns",
        [](Points points, std::optional<In1<std::int16_t>> ring, In2<float> rotation, In1<float> tangent, In1<float> origin_m,
           std::size_t columns, double near_m, double far_m) {
            const std::size_t rings = tangent.shape(0);
            require(rings > 0 && rings <= 4096 && origin_m.shape(0) == rings, "tangent and origin_m must be (rings,)");
            require(rotation.shape(0) == 3 && rotation.shape(1) == 3, "rotation must be (3, 3)");
            require(columns >= 4 && columns <= 36000, "columns must lie in [4, 36000]");
            require(!ring || ring->shape(0) == points.shape(0), "ring must be (N,) like points");
            Buffer<std::int16_t> rows(0);
            if (ring) rows = indices_of(view(*ring), std::int16_t(0), std::int16_t(rings - 1), "ring");
            auto found = without_lock([&] {
                return nearest_returns(view(points), rows, view(rotation).flat(), view(tangent), view(origin_m), columns, near_m,
                                       far_m);
            });
            return array(std::move(found), {rings, 2 * columns});
        },
        "points"_in, "ring"_in.none(), "rotation"_in, "tangent"_in, "origin_m"_in, "columns"_a, "near_m"_a, "far_m"_a,
        "Return the horizontal range (rings, 2 * columns) of the nearest return of each beam, columns repeated once; "
        "+inf for none.");
    m.def(
        "envelope_margins",
        [](const SentBeams& sent, In2<float> nearest, std::int32_t least) {
            const View2<const float> ranges = checked(sent, nearest);
            auto [margin, claim] = without_lock([&] { return envelope_margins(sent, ranges, least); });
            const auto of_cells = [&](auto& found) { return array(std::move(found), {sent.of->rows, sent.of->grid_columns}); };
            return std::pair(of_cells(margin), of_cells(claim));
        },
        "sent"_a, "nearest"_in, "least"_a,
        "Return the number of beams (cells, cells) sent through a target and not blocked before it, and a mask where "
        "it is at least `least` with gaps closed.");
    m.def(
        "cells_of_beams",
        [](const SentBeams& sent, In2<float> nearest, In2<std::int32_t> margins, In2<bool> counts, std::int32_t least,
           std::int32_t most, bool opens) {
            const View2<const float> ranges = checked(sent, nearest);
            check_cells(sent, margins, counts);
            auto found = without_lock([&] {
                return cells_of_beams(sent, ranges, view(margins).flat(), view(counts).flat(), {least, opens}, most);
            });
            return array(std::move(found), {sent.of->rings, sent.of->columns});
        },
        "sent"_a, "nearest"_in, "margins"_in, "counts"_in, "least"_a, "most"_a, "opens"_a,
        "Return for each beam (rings, columns) the sum of 1 / beams needed over the cells that it helps to change.");
    m.def(
        "wedge_changes",
        [](const SentBeams& sent, In2<float> nearest, In2<std::int32_t> margins, In2<bool> counts, std::int32_t least,
           std::size_t wide, bool opens) {
            const View2<const float> ranges = checked(sent, nearest);
            check_cells(sent, margins, counts);
            require(wide >= 1 && wide <= sent.of->columns / 2, "wide must lie in [1, columns / 2]");
            Buffer<bool> changes(margins.size());
            const std::int64_t most = without_lock([&] {
                // Copy what bounds loops: another thread may write it meanwhile.
                const Buffer<std::int32_t> margin = copy_of(view(margins).flat());
                const Buffer<float> nearest_m = copy_of(ranges.flat());
                return wedge_changes(sent, {nearest_m.data(), ranges.rows, ranges.columns}, margin, view(counts).flat(),
                                     {least, opens}, wide, changes);
            });
            return std::pair(most, array(std::move(changes), {sent.of->rows, sent.of->grid_columns}));
        },
        "sent"_a, "nearest"_in, "margins"_in, "counts"_in, "least"_a, "wide"_a, "opens"_a,
        "Return the largest number of cells that one wedge of columns changes, and a mask (cells, cells) of those "
        "that any changes.");
}

}  // namespace viewshed
