#include "ray_trace.hpp"

#include <numbers>
#include <optional>

#include "azimuth_bins.hpp"
#include "bindings.hpp"
#include "first_blocker.hpp"
#include "stages.hpp"

namespace viewshed {

LeveledReturns returns_of(const In1<float>& azimuth, const In1<float>& range_m, const In1<float>& height_m, float low_m,
                          float high_m) {
    require(are_as_long(azimuth, range_m, height_m), "azimuth, range_m and height_m must be as long");
    return {view(azimuth), view(range_m), view(height_m), low_m, high_m};
}

namespace {

void require_bins(std::size_t bins) { require(bins >= 1 && bins <= MAX_BINS, "bins must lie in [1, 32767]"); }

}  // namespace

void bind_ray_trace(nb::module_& m) {
    m.def(
        "azimuth_bins_filled",
        [](In1<float> azimuth) {
            nb::gil_scoped_release unlocked;
            return bins_filled_by(view(azimuth));
        },
        "azimuth"_in, "Return how many azimuth bins returns (M,) fill without gaps.");
    m.def(
        "farthest_in_bins",
        [](In1<float> azimuth, In1<float> range_m, std::optional<std::size_t> bins, std::size_t drop) {
            require(azimuth.shape(0) == range_m.shape(0), "azimuth and range_m must be as long");
            if (bins) require_bins(*bins);
            require(drop <= 1000, "drop must lie in [0, 1000]");
            require(bins || drop == 0, "bins must be given where returns are dropped");
            std::optional<Buffer<float>> limit_m;
            {
                nb::gil_scoped_release unlocked;
                if (drop > 0) {
                    find_farthest_but(view(azimuth), view(range_m), drop, limit_m.emplace(*bins));
                } else {
                    const LeveledReturns returns{view(azimuth), view(range_m), {nullptr, 0}, 0.0f, 0.0f};
                    limit_m = find_ranges(returns, bins.value_or(0)).farthest_m;
                }
            }
            return array(std::move(*limit_m));
        },
        "azimuth"_in, "range_m"_in, "bins"_a.none(), "drop"_a,
        "Return the range (bins,) of the farthest return of each azimuth bin after dropping `drop`; -1 if there are "
        "no more.");
    m.def(
        "first_blocker",
        [](In1<float> azimuth, In1<float> range_m, In1<float> height_m, float low_m, float high_m,
           std::optional<std::size_t> bins, std::size_t rank, std::size_t median_bins, std::optional<float> reach_m,
           float margin_m) {
            const LeveledReturns returns = returns_of(azimuth, range_m, height_m, low_m, high_m);
            if (bins) require_bins(*bins);
            require(rank >= 1 && rank <= 1000, "rank must lie in [1, 1000]");
            require(median_bins <= 999, "median_bins must lie in [0, 999]");
            auto limit_m = without_lock(
                [&] { return first_blocker(returns, bins.value_or(0), {rank, median_bins, reach_m, margin_m}); });
            return array(std::move(limit_m));
        },
        "azimuth"_in, "range_m"_in, "height_m"_in, "low_m"_a, "high_m"_a, "bins"_a.none(), "rank"_a, "median_bins"_a,
        "reach_m"_a.none(), "margin_m"_a,
        "Return the range (bins,) up to which each azimuth is visible before its blocker; -1 without a return.");
    m.def(
        "cells_within",
        [](In1<float> limit_m, In2<float> cell_range_m, In2<std::int16_t> cell_bin) {
            const std::size_t rows = cell_range_m.shape(0), columns = cell_range_m.shape(1);
            require(have_one_shape(cell_range_m, cell_bin), "cell_range_m and cell_bin must have one shape");
            require_bins(limit_m.shape(0));
            const auto bin = indices_of<std::int16_t>(view(cell_bin).flat(), 0, std::int16_t(limit_m.shape(0) - 1), "cell_bin");
            Buffer<float> visible(rows * columns);
            without_lock([&] { find_cells_within(view(limit_m), view(cell_range_m).flat(), bin, visible); });
            return array(std::move(visible), {rows, columns});
        },
        "limit_m"_in, "cell_range_m"_in, "cell_bin"_in,
        "Return 1 for cells (rows, columns) within the limit (bins,) of their azimuth bin, else 0.");
    m.def(
        "trace_windows",
        [](In1<float> azimuth, In1<float> range_m, std::size_t slices, double window, double margin_m,
           In2<float> cell_range_m, In2<float> cell_azimuth, In2<std::int16_t> cell_slice) {
            const std::size_t rows = cell_range_m.shape(0), columns = cell_range_m.shape(1);
            require(azimuth.shape(0) == range_m.shape(0), "azimuth and range_m must be as long");
            require(have_one_shape(cell_range_m, cell_azimuth, cell_slice),
                    "cell_range_m, cell_azimuth and cell_slice must have one shape");
            require_bins(slices);
            require(window > 0.0 && window < 2 * std::numbers::pi, "window must lie between 0 and a turn");
            require(margin_m >= 0.0 && margin_m < 1e6, "margin_m must lie in [0, 1e6)");
            const std::size_t whole = whole_slices(slices, window);
            require(whole >= 1 && 2 * (whole + END_SLICES) <= slices, "slices must be finer than the window, and more");
            const auto slice = indices_of<std::int16_t>(view(cell_slice).flat(), 0, std::int16_t(slices - 1), "cell_slice");
            Buffer<float> visible(rows * columns);
            const PolarCells cells{view(cell_range_m).flat(), view(cell_azimuth).flat(), slice};
            without_lock([&] { trace_windows(view(azimuth), view(range_m), slices, window, margin_m, cells, visible); });
            return array(std::move(visible), {rows, columns});
        },
        "azimuth"_in, "range_m"_in, "slices"_a, "window"_a, "margin_m"_a, "cell_range_m"_in, "cell_azimuth"_in,
        "cell_slice"_in,
        "Return 1 for cells (rows, columns) that a return within a window of their azimuth reaches, else 0.");
    m.def(
        "any_return_on",
        [](Points points, In1<float> range_m, float far_m, float low_m, float high_m, float sensor_m, double x0_m,
           double y0_m, double cells_per_m, double cells) {
            require(points.shape(0) == range_m.shape(0), "points and range_m must be as long");
            nb::gil_scoped_release unlocked;
            const auto at = view(points);
            for (std::size_t n = 0; n < at.rows; ++n) {
                const float z = at(n, 2) - sensor_m;
                if (!(range_m.data()[n] <= far_m && low_m <= z && z <= high_m)) continue;
                const double u = (double(at(n, 0)) - x0_m) * cells_per_m, v = (double(at(n, 1)) - y0_m) * cells_per_m;
                if (0.0 <= u && u < cells && 0.0 <= v && v < cells) return true;
            }
            return false;
        },
        "points"_in, "range_m"_in, "far_m"_a, "low_m"_a, "high_m"_a, "sensor_m"_a, "x0_m"_a, "y0_m"_a, "cells_per_m"_a,
        "cells"_a,
        "Check if a return within limits of range, and of height relative to the sensor, lies on a grid of cells².");
}

}  // namespace viewshed
