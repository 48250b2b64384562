#include "guarantees.hpp"

#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float INFINITE = std::numeric_limits<float>::infinity();

// Rows of cells that are worth a thread.
constexpr std::size_t ROWS = 32;

// A window this many firings wide has that many, whatever its rounding.
constexpr double ROUNDING = 1e-6;

// Nearest returns (rings, 2 * columns) of the beams, the circle twice, so that no window is cut.
using Nearest = View2<const float>;

// How many of some beams are blocked before a target.
INLINE std::int32_t count_before(const float* __restrict range_m, std::size_t width, float near_m) {
    std::int32_t count = 0;
    for (std::size_t k = 0; k < width; ++k) count += range_m[k] < near_m;
    return count;
}

// Write the margins of the cells of some rows: over the rings that pass, the firings sent less the beams blocked, not below 0.
MULTIVERSION void count_margins(const SentBeams& sent, Nearest nearest, std::size_t first, std::size_t last, std::int32_t* margin) {
    for (std::size_t cell = first; cell < last; ++cell) {
        const TargetColumns::Window& at = sent.of->windows[cell];
        std::int32_t sum = 0;
        for (std::size_t ring = sent.ring[cell]; ring < sent.ring_end[cell]; ++ring) {
            if (!sent.passes(cell, ring)) continue;
            const std::int32_t left = sent.of->firings(at, ring) - count_before(nearest[ring] + at.begin, at.width, at.near_m);
            sum += left > 0 ? left : 0;
        }
        margin[cell] = sum;
    }
}

// Add to each beam of a ring the cells that it helps to change, each shared by the beams that are needed there.
void share_cells(const SentBeams& sent, Nearest nearest, View1<const std::int32_t> margin, View1<const bool> counts,
                 const Attack& rule, std::int32_t most, std::size_t ring, double* weight) {
    const std::size_t columns = sent.of->columns;
    for (std::size_t cell = 0; cell < sent.ring.size(); ++cell) {
        const TargetColumns::Window& at = sent.of->windows[cell];
        const std::int32_t needed = rule.needed(margin[cell]);
        if (needed == 0 || needed > most || !counts[cell] || !sent.passes(cell, ring)) continue;
        const double share = 1.0 / needed;
        const float* const range_m = nearest[ring] + at.begin;
        for (std::size_t k = 0; k < at.width; ++k) {
            const std::size_t column = at.begin + k;
            weight[column < columns ? column : column - columns] += ((range_m[k] < at.near_m) == rule.opens) ? share : 0.0;
        }
    }
}

// Whether a wedge of `wide` columns anywhere can change a cell, and between which of its starts, see wedge_changes.
bool wedge_starts(const SentBeams& sent, Nearest nearest, std::size_t cell, std::int32_t needed, bool opens, std::size_t wide,
                  std::vector<std::int32_t>& changes, std::int64_t& first, std::int64_t& last) {
    const TargetColumns::Window& at = sent.of->windows[cell];
    // The beams of each column that can change.
    changes.assign(at.width, 0);
    for (std::size_t ring = sent.ring[cell]; ring < sent.ring_end[cell]; ++ring) {
        if (!sent.passes(cell, ring)) continue;
        const float* const range_m = nearest[ring] + at.begin;
        for (std::size_t k = 0; k < at.width; ++k) changes[k] += (range_m[k] < at.near_m) == opens;
    }
    // The most that a wedge covers.
    std::int32_t covered = 0, most = 0;
    for (std::size_t k = 0; k < at.width; ++k) {
        covered += changes[k] - (k >= wide ? changes[k - wide] : 0);
        most = std::max(most, covered);
    }
    if (most < needed) return false;
    // It must reach the column up to which enough can change from the left, and begin no later than that from the right.
    std::int32_t left = 0, right = 0;
    std::size_t reach = 0, begin = at.width;
    while (left < needed) left += changes[reach++];
    while (right < needed) right += changes[--begin];
    first = std::int64_t(at.begin + reach) - std::int64_t(wide);
    last = std::int64_t(at.begin + begin);
    return first <= last;
}

// The rings of the points by elevation: the beam whose line passes nearest at the point's range.
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

TargetColumns::TargetColumns(View2<const float> range, View2<const float> azimuth_, View2<const std::uint8_t> fired,
                             std::size_t rings_, std::size_t columns_, double cell_m, double width_m, double farthest_m)
    : rows(range.rows), grid_columns(range.columns), rings(rings_), columns(columns_),
      range_m(range.data, range.data + range.size()), azimuth(azimuth_.data, azimuth_.data + range.size()),
      windows(range.size()) {
    constexpr double TURN = 2 * std::numbers::pi;
    if (fired.data != nullptr) {
        fired_before.resize(rings * (2 * columns + 1));
        for (std::size_t ring = 0; ring < rings; ++ring) {
            std::uint32_t* const before = &fired_before[ring * (2 * columns + 1)];
            for (std::size_t k = 0; k < 2 * columns; ++k) before[k + 1] = before[k] + (fired(ring, k % columns) != 0);
        }
    }
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
    : of(std::move(columns)), words((of->rings + 63) / 64), bits(of->windows.size() * words, 0), ring(of->windows.size(), 0),
      ring_end(of->windows.size(), 0) {
    const double per_rad = double(slope.rows) / (2 * std::numbers::pi);
    for_ranges(of->rows, count_parts(of->rows, ROWS), [&](std::size_t, std::size_t first_row, std::size_t end_row) {
        for (std::size_t cell = first_row * of->grid_columns; cell < end_row * of->grid_columns; ++cell) {
            if (of->windows[cell].firings == 0) continue;
            const float r = of->range_m[cell], low = low_m.data[cell], high = high_m.data[cell];
            const auto turned = std::size_t(std::max((double(of->azimuth[cell]) + std::numbers::pi) * per_rad, 0.0));
            const std::size_t sector = std::min(turned, slope.rows - 1);
            for (std::size_t k = 0; k < of->rings; ++k) {
                const float z_m = start_m[k] + r * slope(sector, k);
                if (!(z_m >= low && z_m <= high)) continue;
                bits[cell * words + k / 64] |= std::uint64_t(1) << (k % 64);
                if (ring_end[cell] == 0) ring[cell] = std::uint16_t(k);
                ring_end[cell] = std::uint16_t(k + 1);
            }
        }
    });
}

Buffer<float> nearest_returns(View2<const float> points, View1<const std::int16_t> row, View1<const float> turn,
                              View1<const float> tangent, View1<const float> origin_m, std::size_t columns, double near_m,
                              double far_m) {
    Buffer<float> nearest(tangent.size * 2 * columns, INFINITE);
    const float per_rad = float(double(columns) / (2 * std::numbers::pi));
    const auto near_m2 = float(near_m * near_m), far_m2 = float(far_m * far_m);
    for (std::size_t n = 0; n < points.rows; ++n) {
        const float x = points(n, 0), y = points(n, 1), z = points(n, 2), square_m2 = x * x + y * y + z * z;
        if (!(square_m2 >= near_m2 && square_m2 <= far_m2)) continue;
        const float lx = turn[0] * x + turn[1] * y + turn[2] * z, ly = turn[3] * x + turn[4] * y + turn[5] * z;
        const std::size_t ring = row.size > 0 ? std::size_t(row[n]) : ring_of(x, y, z, tangent, origin_m);
        const std::size_t half = std::min(std::size_t((azimuth_of(ly, lx) + PI) * per_rad), columns - 1);
        float& at = nearest[ring * 2 * columns + half];
        at = std::min(at, std::sqrt(lx * lx + ly * ly));
    }
    // The circle once more.
    for (std::size_t ring = 0; ring < tangent.size; ++ring) {
        float* const of = nearest.data() + ring * 2 * columns;
        std::copy(of, of + columns, of + columns);
    }
    return nearest;
}

Buffer<std::int32_t> envelope_margins(const SentBeams& sent, View2<const float> nearest) {
    const TargetColumns& of = *sent.of;
    Buffer<std::int32_t> margin(of.windows.size());
    for_ranges(of.rows, count_parts(of.rows, ROWS), [&](std::size_t, std::size_t first, std::size_t last) {
        count_margins(sent, nearest, first * of.grid_columns, last * of.grid_columns, margin.data());
    });
    return margin;
}

Buffer<double> cells_of_beams(const SentBeams& sent, View2<const float> nearest, View1<const std::int32_t> margin,
                              View1<const bool> counts, const Attack& rule, std::int32_t most) {
    const std::size_t rings = sent.of->rings, columns = sent.of->columns;
    Buffer<double> weight(rings * columns, 0.0);
    for_ranges(rings, count_parts(rings, 4), [&](std::size_t, std::size_t first, std::size_t last) {
        for (std::size_t ring = first; ring < last; ++ring) {
            share_cells(sent, nearest, margin, counts, rule, most, ring, weight.data() + ring * columns);
        }
    });
    return weight;
}

std::int64_t wedge_changes(const SentBeams& sent, View2<const float> nearest, View1<const std::int32_t> margin,
                           View1<const bool> counts, const Attack& rule, std::size_t wide, View1<bool> changes) {
    const auto columns = std::int64_t(sent.of->columns);
    // How many cells more a wedge changes that begins in a column than one before it; starts from -columns on.
    std::vector<std::int64_t> more(std::size_t(4 * columns + 1), 0), at(std::size_t(columns), 0);
    std::vector<std::int32_t> column;
    for (std::size_t cell = 0; cell < margin.size; ++cell) {
        changes[cell] = false;
        const std::int32_t needed = rule.needed(margin[cell]);
        std::int64_t first = 0, last = 0;
        if (needed == 0 || !counts[cell]) continue;
        if (!wedge_starts(sent, nearest, cell, needed, rule.opens, wide, column, first, last)) continue;
        changes[cell] = true;
        // No start counts a cell twice, however wide the wedge.
        last = std::min(last, first + columns - 1);
        ++more[std::size_t(first + columns)];
        --more[std::size_t(last + columns + 1)];
    }
    std::int64_t now = 0;
    for (std::size_t s = 0; s < std::size_t(4 * columns); ++s) {
        now += more[s];
        at[s % std::size_t(columns)] += now;
    }
    return *std::max_element(at.begin(), at.end());
}

}  // namespace viewshed
