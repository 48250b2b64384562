#include "ray_trace.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "azimuth_bins.hpp"
#include "first_blocker.hpp"
#include "parallel.hpp"

namespace viewshed {
namespace {

constexpr double TURN = 2.0 * std::numbers::pi;
constexpr float NO_RETURN = -1.0f;

// Fewest returns or cells for which a part pays for its thread.
constexpr std::size_t PART = 16384;

enum State : std::uint8_t { HIDDEN, VISIBLE, IN_DOUBT };

MULTIVERSION void find_slices(const float* azimuth, std::size_t count, std::size_t slices, std::int16_t* slice) {
    const double per_rad = bins_per_rad(slices), last = double(slices - 1);
    for (std::size_t n = 0; n < count; ++n) slice[n] = std::int16_t(azimuth_bin(azimuth[n], per_rad, last));
}

// Pad values (slices,) by `reach` on either side around the circle, at most their number.
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

// Write the maximum over the slices within `reach`, around the circle.
void find_sliding_maxima(const float* values, std::size_t slices, std::size_t reach, float* maxima) {
    const std::vector<float> around = with_ends(values, slices, reach);
    std::copy_n(around.data(), slices, maxima);
    for (std::size_t offset = 1; offset <= 2 * reach; ++offset) raise_to(around.data() + offset, slices, maxima);
}

// Return the greatest float32 range r with r - margin_m <= reached_m in double; -1 if nothing was reached.
float limit_of(float reached_m, double margin_m) {
    const float far = std::numeric_limits<float>::infinity();
    if (!(reached_m >= 0.0f)) return NO_RETURN;
    if (reached_m > 1e30f) return far;
    float limit_m = float(double(reached_m) + margin_m);
    while (double(limit_m) - margin_m > double(reached_m)) limit_m = std::nextafter(limit_m, -far);
    while (double(std::nextafter(limit_m, far)) - margin_m <= double(reached_m)) limit_m = std::nextafter(limit_m, far);
    return limit_m;
}

// The comparison vectorizes, look-ups do not.
MULTIVERSION void compare(const float* range_m, const float* inner_m, const float* outer_m, std::size_t count,
                          std::uint8_t* state) {
    for (std::size_t k = 0; k < count; ++k) {
        const int inner = range_m[k] <= inner_m[k] ? 1 : 0, outer = range_m[k] <= outer_m[k] ? 1 : 0;
        state[k] = std::uint8_t(inner * VISIBLE + (outer & ~inner) * IN_DOUBT);
    }
}

// Returns that may decide a doubtful cell, by slice: those of slice s are [start[s], start[s + 1]).
struct Candidates {
    std::vector<std::uint32_t> start;
    std::vector<float> azimuth, range_m;
};

// Collect the returns (M,) beyond their slice's limit (slices,), sorted by slice.
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

// Check if a candidate at either end of a cell's window lies within it, and far enough.
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
    // 1. Find the farthest return of each slice.
    Buffer<std::int16_t> slice(count);
    const std::size_t parts = count_parts(count, PART);
    Buffer<float> farthest_m(parts * slices, NO_RETURN);
    for_ranges(count, parts, [&](std::size_t part, std::size_t begin, std::size_t end) {
        find_slices(&azimuth[begin], end - begin, slices, &slice[begin]);
        float* far = &farthest_m[part * slices];
        for (std::size_t n = begin; n < end; ++n) far[slice[n]] = std::max(far[slice[n]], range_m[n]);
    });
    for (std::size_t part = 1; part < parts; ++part) raise_to(&farthest_m[part * slices], slices, farthest_m.data());
    // 2. All returns of the inner slices lie within a window, and none beyond the outer slices does.
    Buffer<float> inner_m(slices), outer_m(slices);
    find_sliding_maxima(farthest_m.data(), slices, whole - 1, inner_m.data());
    find_sliding_maxima(farthest_m.data(), slices, whole + END_SLICES - 1, outer_m.data());
    // 3. Other returns matter only if they are farther than the inner maximum of a window at whose end they lie.
    Buffer<float> least_m(slices, std::numeric_limits<float>::infinity());
    const std::size_t reach = whole + END_SLICES - 1;
    const std::vector<float> around_m = with_ends(inner_m.data(), slices, reach);
    for (std::size_t offset = whole; offset <= reach; ++offset) {
        lower_to(&around_m[reach - offset], slices, least_m.data());
        lower_to(&around_m[reach + offset], slices, least_m.data());
    }
    const Candidates candidates = find_candidates(azimuth, range_m, slice, least_m);
    // 4. Decide cells by whole slices if inner and outer agree, else by candidates.
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

}  // namespace viewshed
