#include "guarantees.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float INFINITE = std::numeric_limits<float>::infinity();

// Fewest rows of cells for which a part pays for its thread.
constexpr std::size_t ROWS = 32;

// Tolerance in firings when the width of a window is rounded down.
constexpr double ROUNDING = 1e-6;

// Nearest returns (rings, 2 * columns); the columns are repeated once so that no window wraps.
using Nearest = View2<const float>;

// Rings that are counted at once in vectors.
constexpr std::size_t LANES = 16;
using Ranges [[gnu::vector_size(4 * LANES), gnu::aligned(4), gnu::may_alias]] = float;
using Counts [[gnu::vector_size(4 * LANES)]] = std::int32_t;
using Weights [[gnu::vector_size(8 * LANES), gnu::aligned(8), gnu::may_alias]] = double;
using Bits64 [[gnu::vector_size(8 * LANES)]] = std::int64_t;

// Transpose nearest ranges to (2 * columns, rings + LANES): the rings of a column are contiguous.
Buffer<float> by_column(Nearest nearest) {
    const std::size_t padded = nearest.rows + LANES;
    Buffer<float> turned(nearest.columns * padded, INFINITE);
    const std::size_t columns = nearest.columns / 2;
    for (std::size_t first = 0; first < columns; first += LANES) {
        const std::size_t last = std::min(first + LANES, columns);
        for (std::size_t ring = 0; ring < nearest.rows; ++ring) {
            for (std::size_t k = first; k < last; ++k) turned[k * padded + ring] = nearest(ring, k);
        }
    }
    std::copy(turned.data(), turned.data() + columns * padded, turned.data() + columns * padded);
    return turned;
}

// Write the margins of cells [first, last), and mark those whose margin with closed gaps is at least `least`. Both
// ranges of a beam are counted in one pass, for LANES rings at once.
MULTIVERSION void count_margins(const SentBeams& sent, const float* nearest, const float* closed, std::int32_t least,
                                std::size_t first, std::size_t last, std::int32_t* margin, bool* claim) {
    const std::size_t padded = sent.of->rings + LANES;
    for (std::size_t cell = first; cell < last; ++cell) {
        const TargetColumns::Window& at = sent.of->windows[cell];
        std::int32_t sum = 0, closed_sum = 0;
        for (std::size_t begin = sent.ring[cell]; begin < sent.ring_end[cell]; begin += LANES) {
            Counts blocked{}, closed_blocked{};
            const float *range_m = nearest + at.begin * padded + begin, *closed_m = closed + at.begin * padded + begin;
            for (std::size_t k = 0; k < at.width; ++k, range_m += padded, closed_m += padded) {
                // A true vector comparison is -1.
                blocked -= *reinterpret_cast<const Ranges*>(range_m) < at.near_m;
                closed_blocked -= *reinterpret_cast<const Ranges*>(closed_m) < at.near_m;
            }
            for (std::size_t n = 0; n < LANES && begin + n < sent.ring_end[cell]; ++n) {
                sum += std::max(at.firings - blocked[n], 0);
                closed_sum += std::max(at.firings - closed_blocked[n], 0);
            }
        }
        margin[cell] = sum;
        claim[cell] = closed_sum >= least;
    }
}

// Write the rings that pass between a target's foot and its top in cells [first, last). Rings ascend, so they form an
// interval; its ends move a step or two from cell to cell.
void find_rings(SentBeams& sent, const float* low_m, const float* high_m, View2<const float> slope, const float* start_m,
                std::size_t first, std::size_t last) {
    const double per_rad = double(slope.rows) / (2 * std::numbers::pi);
    const std::size_t rings = sent.of->rings;
    std::size_t ring = 0, ring_end = 0;
    for (std::size_t cell = first; cell < last; ++cell) {
        if (sent.of->windows[cell].firings == 0) continue;
        const float r = sent.of->range_m[cell], low = low_m[cell], high = high_m[cell];
        const auto turned = std::size_t(std::max((double(sent.of->azimuth[cell]) + std::numbers::pi) * per_rad, 0.0));
        const float* const of_sector = slope[std::min(turned, slope.rows - 1)];
        const auto z_m = [&](std::size_t k) { return start_m[k] + r * of_sector[k]; };
        while (ring > 0 && z_m(ring - 1) >= low) --ring;
        while (ring < rings && z_m(ring) < low) ++ring;
        while (ring_end > 0 && z_m(ring_end - 1) > high) --ring_end;
        while (ring_end < rings && z_m(ring_end) <= high) ++ring_end;
        sent.ring[cell] = std::uint16_t(ring);
        sent.ring_end[cell] = std::uint16_t(std::max(ring, ring_end));
    }
}

// A cell that an attack changes, and the weight of each beam needed there.
struct Share {
    std::size_t cell;
    double of_beam;
};

// Add to each beam (columns, LANES) of the rings from `begin` on the weights of the cells that it helps to change.
MULTIVERSION void share_cells(const SentBeams& sent, const float* nearest, const std::vector<Share>& shares, bool opens,
                              std::size_t begin, double* weight) {
    const std::size_t columns = sent.of->columns, padded = sent.of->rings + LANES;
    const Bits64 flip = Bits64{} - std::int64_t(!opens);
    for (const Share& one : shares) {
        if (begin >= sent.ring_end[one.cell] || begin + LANES <= sent.ring[one.cell]) continue;
        Weights share{};
        for (std::size_t n = 0; n < LANES; ++n) {
            share[n] = begin + n >= sent.ring[one.cell] && begin + n < sent.ring_end[one.cell] ? one.of_beam : 0.0;
        }
        const TargetColumns::Window& at = sent.of->windows[one.cell];
        for (std::size_t k = at.begin; k < at.begin + at.width; ++k) {
            const Counts before = *reinterpret_cast<const Ranges*>(nearest + k * padded + begin) < at.near_m;
            const Bits64 can_change = __builtin_convertvector(before, Bits64) ^ flip;
            *reinterpret_cast<Weights*>(weight + (k < columns ? k : k - columns) * LANES) += Weights(can_change & Bits64(share));
        }
    }
}

// Mark the cells that a wedge of `wide` columns can change, and add to `more` (4 * columns + 1) how many more cells a
// wedge that begins in a column changes than one that begins a column before; index 0 is column -columns.
MULTIVERSION void count_starts(const SentBeams& sent, Nearest nearest, const std::int32_t* margin, const bool* counts,
                               const Attack& rule, std::size_t wide, std::size_t first_cell, std::size_t last_cell,
                               bool* changes, std::int64_t* more) {
    const auto columns = std::int64_t(sent.of->columns);
    std::vector<std::int32_t> of_column(sent.of->columns);
    for (std::size_t cell = first_cell; cell < last_cell; ++cell) {
        changes[cell] = false;
        const std::int32_t needed = rule.needed(margin[cell]);
        if (needed == 0 || !counts[cell]) continue;
        const TargetColumns::Window at = sent.of->windows[cell];
        // Count the beams of each column that can change.
        std::fill_n(of_column.begin(), at.width, 0);
        for (std::size_t ring = sent.ring[cell]; ring < sent.ring_end[cell]; ++ring) {
            const float* const range_m = nearest[ring] + at.begin;
            for (std::size_t k = 0; k < at.width; ++k) of_column[k] += std::int32_t((range_m[k] < at.near_m) == rule.opens);
        }
        // Maximize over the positions of the wedge.
        std::int32_t covered = 0, most = 0;
        for (std::size_t k = 0; k < at.width; ++k) {
            covered += of_column[k] - (k >= wide ? of_column[k - wide] : 0);
            most = std::max(most, covered);
        }
        if (most < needed) continue;
        // The wedge must reach the column up to which enough beams can change from the left, and begin no later than
        // the corresponding column from the right.
        std::int32_t left = 0, right = 0;
        std::size_t reach = 0, begin = at.width;
        while (left < needed) left += of_column[reach++];
        while (right < needed) right += of_column[--begin];
        const auto first = std::int64_t(at.begin + reach) - std::int64_t(wide);
        auto last = std::int64_t(at.begin + begin);
        if (first > last) continue;
        changes[cell] = true;
        // Limit the starts to one turn, so that no start counts a cell twice.
        last = std::min(last, first + columns - 1);
        ++more[first + columns];
        --more[last + columns + 1];
    }
}

// Squared range limits of returns.
struct Limits {
    float near_m2, far_m2;
};

// Write the horizontal ranges of points (count, 3), +inf outside the range limits, and their azimuths in columns.
MULTIVERSION void find_columns(const float* __restrict points, std::size_t count, const float* __restrict turn, Limits limits,
                               float per_rad, float* __restrict range_m, float* __restrict turned) {
    for (std::size_t k = 0; k < count; ++k) {
        const float x = points[3 * k], y = points[3 * k + 1], z = points[3 * k + 2], square_m2 = x * x + y * y + z * z;
        const float lx = turn[0] * x + turn[1] * y + turn[2] * z, ly = turn[3] * x + turn[4] * y + turn[5] * z;
        const float flat_m = std::sqrt(lx * lx + ly * ly);
        range_m[k] = square_m2 >= limits.near_m2 && square_m2 <= limits.far_m2 ? flat_m : INFINITE;
        turned[k] = (azimuth_of(ly, lx) + PI) * per_rad;
    }
}

// Combine GAP + 1 consecutive values: (count + GAP,) to (count,).
template <typename Combine>
void over_stretches(const float* __restrict from, float* __restrict to, std::size_t count, Combine combine) {
    std::copy(from, from + count, to);
    for (std::size_t step = 1; step <= GAP; ++step) {
        for (std::size_t k = 0; k < count; ++k) to[k] = combine(to[k], from[k + step]);
    }
}

// Return the ring whose beam passes nearest to a point at its range.
std::size_t ring_of(float x, float y, float z, View1<const float> tangent, View1<const float> origin_m) {
    const float range_m = std::max(std::sqrt(x * x + y * y), 1e-6f);
    const auto miss = [&](std::size_t ring) { return std::fabs(z - origin_m[ring] - range_m * tangent[ring]); };
    std::size_t ring = std::size_t(std::lower_bound(tangent.begin(), tangent.end(), z / range_m) - tangent.begin());
    ring = std::min(ring, tangent.size - 1);
    while (ring > 0 && miss(ring - 1) <= miss(ring)) --ring;
    while (ring + 1 < tangent.size && miss(ring + 1) < miss(ring)) ++ring;
    return ring;
}

}  // namespace

TargetColumns::TargetColumns(View2<const float> range, View2<const float> azimuth_, std::size_t rings_, std::size_t columns_,
                             double cell_m, double width_m, double farthest_m)
    : rows(range.rows), grid_columns(range.columns), rings(rings_), columns(columns_),
      range_m(range.data, range.data + range.size()), azimuth(azimuth_.data, azimuth_.data + range.size()),
      windows(range.size()) {
    constexpr double TURN = 2 * std::numbers::pi;
    for (std::size_t cell = 0; cell < windows.size(); ++cell) {
        const float r = range_m[cell], near_m = r - float(cell_m);
        if (near_m <= 0.0f || r > float(farthest_m)) continue;
        const double half = std::atan2(width_m / 2, double(r)) / TURN * double(columns);
        const double left = (double(azimuth[cell]) + std::numbers::pi) / TURN * double(columns) - half;
        const auto begin = std::int64_t(std::ceil(left - 0.5)), end = std::int64_t(std::floor(left + 2 * half - 0.5)) + 1;
        const auto turn = std::int64_t(columns), firings = std::int64_t(std::floor(2 * half + ROUNDING));
        if (end <= begin || firings == 0) continue;
        windows[cell] = {std::uint32_t((begin + turn) % turn), std::uint32_t(std::min(end - begin, turn)),
                         std::int32_t(firings), near_m};
    }
}

SentBeams::SentBeams(std::shared_ptr<const TargetColumns> columns, View2<const float> low_m, View2<const float> high_m,
                     View2<const float> slope, View1<const float> start_m)
    : of(std::move(columns)), ring(of->windows.size(), 0), ring_end(of->windows.size(), 0) {
    // If rings ascend at the nearest possible target, and so do their slopes, they ascend at every range.
    float nearest_m = INFINITE;
    for (std::size_t cell = 0; cell < of->windows.size(); ++cell) {
        if (of->windows[cell].firings > 0) nearest_m = std::min(nearest_m, of->range_m[cell]);
    }
    for (std::size_t sector = 0; sector < slope.rows; ++sector) {
        for (std::size_t k = 1; k < slope.columns; ++k) {
            const float apart = slope(sector, k) - slope(sector, k - 1);
            require(apart >= 0.0f && start_m[k] - start_m[k - 1] + nearest_m * apart >= 0.0f,
                    "each ring must be above the one before wherever a target may stand");
        }
    }
    for_ranges(of->rows, count_parts(of->rows, ROWS), [&](std::size_t, std::size_t first_row, std::size_t end_row) {
        find_rings(*this, low_m.data, high_m.data, slope, start_m.data, first_row * of->grid_columns,
                   end_row * of->grid_columns);
    });
}

Buffer<float> nearest_returns(View2<const float> points, View1<const std::int16_t> row, View1<const float> turn,
                              View1<const float> tangent, View1<const float> origin_m, std::size_t columns, double near_m,
                              double far_m) {
    Buffer<float> nearest(tangent.size * 2 * columns, INFINITE);
    const float per_rad = float(double(columns) / (2 * std::numbers::pi));
    const Limits limits{float(near_m * near_m), float(far_m * far_m)};
    float range_m[BLOCK], turned[BLOCK];
    for (std::size_t first = 0; first < points.rows; first += BLOCK) {
        const std::size_t count = std::min(BLOCK, points.rows - first);
        find_columns(points[first], count, turn.data, limits, per_rad, range_m, turned);
        for (std::size_t k = 0; k < count; ++k) {
            if (range_m[k] == INFINITE) continue;
            const float* const p = points[first + k];
            const std::size_t ring = row.size > 0 ? std::size_t(row[first + k]) : ring_of(p[0], p[1], p[2], tangent, origin_m);
            float& at = nearest[ring * 2 * columns + std::min(std::size_t(turned[k]), columns - 1)];
            at = std::min(at, range_m[k]);
        }
    }
    // Repeat the columns.
    for (std::size_t ring = 0; ring < tangent.size; ++ring) {
        float* const of = nearest.data() + ring * 2 * columns;
        std::copy(of, of + columns, of + columns);
    }
    return nearest;
}

Buffer<float> without_gaps(Nearest nearest) {
    const std::size_t columns = nearest.columns / 2;
    Buffer<float> closed(nearest.size());
    std::vector<float> around(columns + 2 * GAP), least(columns + GAP);
    for (std::size_t ring = 0; ring < nearest.rows; ++ring) {
        // Minimum over each stretch of GAP + 1 columns, then the maximum over the stretches that contain a column.
        std::copy(nearest[ring] + columns - GAP, nearest[ring] + 2 * columns, around.begin());
        std::copy(nearest[ring], nearest[ring] + GAP, around.begin() + std::ptrdiff_t(columns + GAP));
        over_stretches(around.data(), least.data(), least.size(), [](float a, float b) { return a < b ? a : b; });
        float* const to = closed.data() + ring * 2 * columns;
        over_stretches(least.data(), to, columns, [](float a, float b) { return a > b ? a : b; });
        std::copy(to, to + columns, to + columns);
    }
    return closed;
}

std::pair<Buffer<std::int32_t>, Buffer<bool>> envelope_margins(const SentBeams& sent, Nearest nearest, std::int32_t least) {
    const TargetColumns& of = *sent.of;
    const Buffer<float> closed_m = without_gaps(nearest);
    const Buffer<float> range_m = by_column(nearest);
    const Buffer<float> closed_range_m = by_column({closed_m.data(), nearest.rows, nearest.columns});
    Buffer<std::int32_t> margin(of.windows.size());
    Buffer<bool> claim(of.windows.size());
    for_ranges(of.rows, count_parts(of.rows, ROWS), [&](std::size_t, std::size_t first, std::size_t last) {
        count_margins(sent, range_m.data(), closed_range_m.data(), least, first * of.grid_columns, last * of.grid_columns,
                      margin.data(), claim.data());
    });
    return {std::move(margin), std::move(claim)};
}

Buffer<double> cells_of_beams(const SentBeams& sent, View2<const float> nearest, View1<const std::int32_t> margin,
                              View1<const bool> counts, const Attack& rule, std::int32_t most) {
    const std::size_t rings = sent.of->rings, columns = sent.of->columns;
    Buffer<double> weight(rings * columns, 0.0);
    std::vector<Share> shares;
    for (std::size_t cell = 0; cell < margin.size; ++cell) {
        const std::int32_t needed = rule.needed(margin[cell]);
        if (needed > 0 && needed <= most && counts[cell]) shares.push_back({cell, 1.0 / needed});
    }
    const Buffer<float> range_m = by_column(nearest);
    run_parts((rings + LANES - 1) / LANES, [&](std::size_t part) {
        const std::size_t first = part * LANES;
        Buffer<double> of_lanes(columns * LANES, 0.0);
        share_cells(sent, range_m.data(), shares, rule.opens, first, of_lanes.data());
        for (std::size_t ring = first; ring < std::min(first + LANES, rings); ++ring) {
            for (std::size_t k = 0; k < columns; ++k) weight[ring * columns + k] = of_lanes[k * LANES + ring - first];
        }
    });
    return weight;
}

std::int64_t wedge_changes(const SentBeams& sent, Nearest nearest, View1<const std::int32_t> margin, View1<const bool> counts,
                           const Attack& rule, std::size_t wide, View1<bool> changes) {
    const std::size_t columns = sent.of->columns, parts = count_parts(sent.of->rows, ROWS), starts = 4 * columns + 1;
    std::vector<std::int64_t> more(parts * starts, 0), at(columns, 0);
    for_ranges(sent.of->rows, parts, [&](std::size_t part, std::size_t first, std::size_t last) {
        count_starts(sent, nearest, margin.data, counts.data, rule, wide, first * sent.of->grid_columns,
                     last * sent.of->grid_columns, changes.data, &more[part * starts]);
    });
    std::int64_t now = 0;
    for (std::size_t s = 0; s + 1 < starts; ++s) {
        for (std::size_t part = 0; part < parts; ++part) now += more[part * starts + s];
        at[s % columns] += now;
    }
    return *std::max_element(at.begin(), at.end());
}

}  // namespace viewshed
