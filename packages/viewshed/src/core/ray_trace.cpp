#include "ray_trace.hpp"

#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include "azimuth_bins.hpp"
#include "first_blocker.hpp"
#include "parallel.hpp"
#include "stages.hpp"

namespace viewshed {
namespace {

constexpr double TURN = 2.0 * std::numbers::pi;
constexpr float NO_RETURN = -1.0f;

// A cell is in doubt if returns of the END_SLICES slices at either end of its window decide.
constexpr std::size_t END_SLICES = 3;

// Returns, and cells, of a part that is worth a thread.
constexpr std::size_t PART = 16384;

enum State : std::uint8_t { HIDDEN, VISIBLE, IN_DOUBT };

MULTIVERSION void find_slices(const float* azimuth, std::size_t count, std::size_t slices, std::int16_t* slice) {
    const double per_rad = bins_per_rad(slices), last = double(slices - 1);
    for (std::size_t n = 0; n < count; ++n) slice[n] = std::int16_t(azimuth_bin(azimuth[n], per_rad, last));
}

// The values (slices,) with `reach` more on either side, around the circle; at most as many as there are.
std::vector<float> with_ends(const float* values, std::size_t slices, std::size_t reach) {
    std::vector<float> around(values + slices - reach, values + slices);
    around.insert(around.end(), values, values + slices);
    around.insert(around.end(), values, values + reach);
    return around;
}

MULTIVERSION void raise_to(const float* values, std::size_t count, float* maxima) {
    for (std::size_t s = 0; s < count; ++s) maxima[s] = maxima[s] < values[s] ? values[s] : maxima[s];
}

MULTIVERSION void lower_to(const float* values, std::size_t count, float* minima) {
    for (std::size_t s = 0; s < count; ++s) minima[s] = values[s] < minima[s] ? values[s] : minima[s];
}

// The greatest of the values up to `reach` slices away, around the circle.
void find_sliding_maxima(const float* values, std::size_t slices, std::size_t reach, float* maxima) {
    const std::vector<float> around = with_ends(values, slices, reach);
    std::copy_n(around.data(), slices, maxima);
    for (std::size_t offset = 1; offset <= 2 * reach; ++offset) raise_to(around.data() + offset, slices, maxima);
}

// The greatest range r in float32 with r - margin_m <= reached_m in double; -1 where nothing was reached.
float limit_of(float reached_m, double margin_m) {
    const float far = std::numeric_limits<float>::infinity();
    if (!(reached_m >= 0.0f)) return NO_RETURN;
    if (reached_m > 1e30f) return far;
    float limit_m = float(double(reached_m) + margin_m);
    while (double(limit_m) - margin_m > double(reached_m)) limit_m = std::nextafter(limit_m, -far);
    while (double(std::nextafter(limit_m, far)) - margin_m <= double(reached_m)) limit_m = std::nextafter(limit_m, far);
    return limit_m;
}

// What is compared becomes vectors, what is looked up does not.
MULTIVERSION void compare(const float* range_m, const float* inner_m, const float* outer_m, std::size_t count,
                          std::uint8_t* state) {
    for (std::size_t k = 0; k < count; ++k) {
        const int inner = range_m[k] <= inner_m[k] ? 1 : 0, outer = range_m[k] <= outer_m[k] ? 1 : 0;
        state[k] = std::uint8_t(inner * VISIBLE + (outer & ~inner) * IN_DOUBT);
    }
}

// Returns that may decide a cell in doubt, by slice: those of slice s are [start[s], start[s + 1]).
struct Candidates {
    std::vector<std::uint32_t> start;
    std::vector<float> azimuth, range_m;
};

// Sort the returns by slice (M,) that lie farther than what their slice's limit (slices,) says.
Candidates find_candidates(View1<const float> azimuth, View1<const float> range_m, View1<const std::int16_t> slice,
                           View1<const float> least_m) {
    const std::size_t parts = count_parts(azimuth.size, PART);
    std::vector<std::vector<std::uint32_t>> chosen(parts);
    for_ranges(azimuth.size, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        for (std::size_t n = begin; n < end; ++n) {
            if (range_m[n] > least_m[slice[n]]) chosen[part].push_back(std::uint32_t(n));
        }
    });
    Candidates found{std::vector<std::uint32_t>(least_m.size + 1, 0), {}, {}};
    for (const auto& of_part : chosen) {
        for (const std::uint32_t n : of_part) ++found.start[slice[n] + 1];
    }
    for (std::size_t s = 0; s < least_m.size; ++s) found.start[s + 1] += found.start[s];
    found.azimuth.resize(found.start.back());
    found.range_m.resize(found.start.back());
    std::vector<std::uint32_t> next = found.start;
    for (const auto& of_part : chosen) {
        for (const std::uint32_t n : of_part) {
            const std::uint32_t at = next[slice[n]]++;
            found.azimuth[at] = azimuth[n];
            found.range_m[at] = range_m[n];
        }
    }
    return found;
}

// Whether a candidate at either end of a cell's window lies in it, and far enough.
bool is_reached(const Candidates& candidates, float azimuth, double need_m, std::size_t slice, std::size_t whole,
                double window) {
    const std::size_t slices = candidates.start.size() - 1;
    for (std::size_t offset = whole; offset < whole + END_SLICES; ++offset) {
        for (const std::size_t s : {(slice + slices - offset) % slices, (slice + offset) % slices}) {
            for (std::uint32_t k = candidates.start[s]; k < candidates.start[s + 1]; ++k) {
                const double away = std::fabs(double(candidates.azimuth[k]) - double(azimuth));
                if (candidates.range_m[k] >= need_m && std::min(away, TURN - away) <= window) return true;
            }
        }
    }
    return false;
}

}  // namespace

std::size_t whole_slices(std::size_t slices, double window) { return std::size_t(window / (TURN / double(slices))); }

void trace_windows(View1<const float> azimuth, View1<const float> range_m, std::size_t slices, double window,
                   double margin_m, const PolarCells& cells, View1<float> visible) {
    const std::size_t count = azimuth.size, whole = whole_slices(slices, window);
    // 1. The farthest return of each slice.
    Buffer<std::int16_t> slice(count);
    const std::size_t parts = count_parts(count, PART);
    Buffer<float> farthest_m(parts * slices, NO_RETURN);
    for_ranges(count, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        find_slices(&azimuth[begin], end - begin, slices, &slice[begin]);
        float* far = &farthest_m[part * slices];
        for (std::size_t n = begin; n < end; ++n) far[slice[n]] = std::max(far[slice[n]], range_m[n]);
    });
    for (std::size_t part = 1; part < parts; ++part) raise_to(&farthest_m[part * slices], slices, farthest_m.data());
    // 2. Every return of the inner slices of a window lies within it, and none beyond the outer ones does.
    Buffer<float> inner_m(slices), outer_m(slices);
    find_sliding_maxima(farthest_m.data(), slices, whole - 1, inner_m.data());
    find_sliding_maxima(farthest_m.data(), slices, whole + END_SLICES - 1, outer_m.data());
    // 3. Of the other returns only those matter that lie farther than the inner ones of a window at whose end they are.
    Buffer<float> least_m(slices, std::numeric_limits<float>::infinity());
    const std::size_t reach = whole + END_SLICES - 1;
    const std::vector<float> around_m = with_ends(inner_m.data(), slices, reach);
    for (std::size_t offset = whole; offset <= reach; ++offset) {
        lower_to(&around_m[reach - offset], slices, least_m.data());
        lower_to(&around_m[reach + offset], slices, least_m.data());
    }
    const Candidates candidates = find_candidates(azimuth, range_m, slice, least_m);
    // 4. Decide cells by whole slices where they agree, and by candidates where they do not.
    for (std::size_t s = 0; s < slices; ++s) inner_m[s] = limit_of(inner_m[s], margin_m);
    for (std::size_t s = 0; s < slices; ++s) outer_m[s] = limit_of(outer_m[s], margin_m);
    for_ranges(visible.size, count_parts(visible.size, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        std::uint8_t state[BLOCK];
        float inner_of[BLOCK], outer_of[BLOCK];
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t size = std::min(BLOCK, end - start);
            for (std::size_t k = 0; k < size; ++k) inner_of[k] = inner_m[std::size_t(cells.slice[start + k])];
            for (std::size_t k = 0; k < size; ++k) outer_of[k] = outer_m[std::size_t(cells.slice[start + k])];
            compare(&cells.range_m[start], inner_of, outer_of, size, state);
            for (std::size_t k = 0; k < size; ++k) {
                const std::size_t cell = start + k;
                visible[cell] = state[k] == VISIBLE;
                if (state[k] == IN_DOUBT) {
                    visible[cell] = is_reached(candidates, cells.azimuth[cell], double(cells.range_m[cell]) - margin_m,
                                               std::size_t(cells.slice[cell]), whole, window);
                }
            }
        }
    });
}

namespace {

Returns returns_of(const In1<float>& azimuth, const In1<float>& range_m, const In1<float>& height_m, float low_m,
                   float high_m) {
    require(azimuth.shape(0) == range_m.shape(0) && range_m.shape(0) == height_m.shape(0),
            "azimuth, range_m and height_m must be as long");
    return {view(azimuth), view(range_m), view(height_m), low_m, high_m};
}

void require_bins(std::size_t bins) { require(bins >= 1 && bins <= MOST_BINS, "bins must lie in [1, 32767]"); }

}  // namespace

// What Python calls: arrays are checked here, whatever hands them in.
void bind_ray_trace(nb::module_& m) {
    m.def(
        "azimuth_bins_filled",
        [](In1<float> azimuth) {
            nb::gil_scoped_release unlocked;
            return bins_filled_by(view(azimuth));
        },
        "azimuth"_a.noconvert(), "How many azimuth bins returns (M,) fill without gaps.");
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
                    const Returns returns{view(azimuth), view(range_m), {nullptr, 0}, 0.0f, 0.0f};
                    limit_m = find_ranges(returns, bins.value_or(0)).farthest_m;
                }
            }
            return std::move(*limit_m).array();
        },
        "azimuth"_a.noconvert(), "range_m"_a.noconvert(), "bins"_a.none(), "drop"_a,
        "Range (bins,) of the farthest return but `drop` of each azimuth bin; -1 where there are no more.");
    m.def(
        "first_blocker",
        [](In1<float> azimuth, In1<float> range_m, In1<float> height_m, float low_m, float high_m,
           std::optional<std::size_t> bins, std::size_t rank, std::size_t median_bins, std::optional<float> reach_m,
           float margin_m) {
            const Returns returns = returns_of(azimuth, range_m, height_m, low_m, high_m);
            if (bins) require_bins(*bins);
            require(rank >= 1 && rank <= 1000, "rank must lie in [1, 1000]");
            require(median_bins <= 999, "median_bins must lie in [0, 999]");
            std::optional<Buffer<float>> limit_m;
            {
                nb::gil_scoped_release unlocked;
                limit_m = first_blocker(returns, bins.value_or(0), {rank, median_bins, reach_m, margin_m});
            }
            return std::move(*limit_m).array();
        },
        "azimuth"_a.noconvert(), "range_m"_a.noconvert(), "height_m"_a.noconvert(), "low_m"_a, "high_m"_a,
        "bins"_a.none(), "rank"_a, "median_bins"_a, "reach_m"_a.none(), "margin_m"_a,
        "Range (bins,) up to which each azimuth is visible before its blocker; -1 without a return.");
    m.def(
        "ranges_in_bins",
        [](In1<float> azimuth, In1<float> range_m, In1<float> height_m, float low_m, float high_m) {
            const Returns returns = returns_of(azimuth, range_m, height_m, low_m, high_m);
            std::optional<BinRanges> found;
            {
                nb::gil_scoped_release unlocked;
                found = find_ranges(returns, 0);
            }
            return nb::make_tuple(std::move(found->farthest_m).array(), std::move(found->nearest_m).array());
        },
        "azimuth"_a.noconvert(), "range_m"_a.noconvert(), "height_m"_a.noconvert(), "low_m"_a, "high_m"_a,
        "Range (bins,) of the farthest return, -1 where none, and of the nearest obstacle, +inf where none, by the "
        "azimuth bins that the returns fill.");
    m.def(
        "cells_within",
        [](In1<float> limit_m, In2<float> cell_range_m, In2<std::int16_t> cell_bin) {
            const std::size_t rows = cell_range_m.shape(0), columns = cell_range_m.shape(1);
            require(cell_bin.shape(0) == rows && cell_bin.shape(1) == columns,
                    "cell_range_m and cell_bin must have one shape");
            require_bins(limit_m.shape(0));
            const auto bin = indices_of<std::int16_t>(view(cell_bin).flat(), 0, std::int16_t(limit_m.shape(0) - 1), "cell_bin");
            Buffer<float> visible(rows * columns);
            {
                nb::gil_scoped_release unlocked;
                find_cells_within(view(limit_m), view(cell_range_m).flat(), bin, visible);
            }
            return std::move(visible).array({rows, columns});
        },
        "limit_m"_a.noconvert(), "cell_range_m"_a.noconvert(), "cell_bin"_a.noconvert(),
        "1 in cells (rows, columns) no farther than the limit (bins,) of their azimuth bin, 0 elsewhere.");
    m.def(
        "trace_windows",
        [](In1<float> azimuth, In1<float> range_m, std::size_t slices, double window, double margin_m,
           In2<float> cell_range_m, In2<float> cell_azimuth, In2<std::int16_t> cell_slice) {
            const std::size_t rows = cell_range_m.shape(0), columns = cell_range_m.shape(1);
            require(azimuth.shape(0) == range_m.shape(0), "azimuth and range_m must be as long");
            require(cell_azimuth.shape(0) == rows && cell_azimuth.shape(1) == columns &&
                        cell_slice.shape(0) == rows && cell_slice.shape(1) == columns,
                    "cell_range_m, cell_azimuth and cell_slice must have one shape");
            require_bins(slices);
            require(window > 0.0 && window < TURN, "window must lie between 0 and a turn");
            require(margin_m >= 0.0 && margin_m < 1e6, "margin_m must lie in [0, 1e6)");
            const std::size_t whole = whole_slices(slices, window);
            require(whole >= 1 && 2 * (whole + END_SLICES) <= slices, "slices must be finer than the window, and more");
            const auto slice = indices_of<std::int16_t>(view(cell_slice).flat(), 0, std::int16_t(slices - 1), "cell_slice");
            Buffer<float> visible(rows * columns);
            {
                nb::gil_scoped_release unlocked;
                const PolarCells cells{view(cell_range_m).flat(), view(cell_azimuth).flat(), slice};
                trace_windows(view(azimuth), view(range_m), slices, window, margin_m, cells, visible);
            }
            return std::move(visible).array({rows, columns});
        },
        "azimuth"_a.noconvert(), "range_m"_a.noconvert(), "slices"_a, "window"_a, "margin_m"_a,
        "cell_range_m"_a.noconvert(), "cell_azimuth"_a.noconvert(), "cell_slice"_a.noconvert(),
        "1 in cells (rows, columns) that a return within a window of their azimuth reaches, 0 elsewhere.");
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
        "points"_a.noconvert(), "range_m"_a.noconvert(), "far_m"_a, "low_m"_a, "high_m"_a, "sensor_m"_a, "x0_m"_a,
        "y0_m"_a, "cells_per_m"_a, "cells"_a,
        "Whether a return within limits of range, and of height from the sensor, lies on a grid of cells².");
}

}  // namespace viewshed
