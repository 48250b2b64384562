#include "guarantees.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
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

// Rings that are counted side by side, in one register or more.
constexpr std::size_t LANES = 16;
using Ranges [[gnu::vector_size(4 * LANES), gnu::aligned(4), gnu::may_alias]] = float;
using Counts [[gnu::vector_size(4 * LANES)]] = std::int32_t;
using Weights [[gnu::vector_size(8 * LANES), gnu::aligned(8), gnu::may_alias]] = double;
using Bits64 [[gnu::vector_size(8 * LANES)]] = std::int64_t;

// Nearest ranges by column, (2 * columns, rings + LANES): the rings of a column lie side by side.
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

// Write both margins of the cells of some rows: over the rings that pass, the firings sent less the beams blocked, not below 0.
// The two ranges of a beam are counted side by side, for LANES rings at once.
MULTIVERSION void count_margins(const SentBeams& sent, const float* nearest, const float* closed, std::size_t first,
                                std::size_t last, std::int32_t* margin, std::int32_t* closed_margin) {
    const std::size_t padded = sent.of->rings + LANES;
    for (std::size_t cell = first; cell < last; ++cell) {
        const TargetColumns::Window& at = sent.of->windows[cell];
        std::int32_t sum = 0, closed_sum = 0;
        for (std::size_t begin = sent.ring[cell]; begin < sent.ring_end[cell]; begin += LANES) {
            Counts blocked{}, closed_blocked{};
            const float *range_m = nearest + at.begin * padded + begin, *closed_m = closed + at.begin * padded + begin;
            for (std::size_t k = 0; k < at.width; ++k, range_m += padded, closed_m += padded) {
                // A comparison that holds is -1.
                blocked -= *reinterpret_cast<const Ranges*>(range_m) < at.near_m;
                closed_blocked -= *reinterpret_cast<const Ranges*>(closed_m) < at.near_m;
            }
            for (std::size_t n = 0; n < LANES && begin + n < sent.ring_end[cell]; ++n) {
                if (!sent.passes(cell, begin + n)) continue;
                const std::int32_t firings = sent.of->firings(at, begin + n);
                sum += std::max(firings - blocked[n], 0);
                closed_sum += std::max(firings - closed_blocked[n], 0);
            }
        }
        margin[cell] = sum;
        closed_margin[cell] = closed_sum;
    }
}

// Write which rings pass between a target's foot and its top in the cells of some rows; `rising`: no ring is below the one
// before, in any sector.
MULTIVERSION void find_rings(SentBeams& sent, const float* low_m, const float* high_m, View2<const float> slope,
                             const float* start_m, bool rising, std::size_t first, std::size_t last) {
    const double per_rad = double(slope.rows) / (2 * std::numbers::pi);
    const std::size_t rings = sent.of->rings;
    std::uint8_t passes[64] = {};
    std::size_t ring = 0, ring_end = 0;
    for (std::size_t cell = first; cell < last; ++cell) {
        if (sent.of->windows[cell].firings == 0) continue;
        const float r = sent.of->range_m[cell], low = low_m[cell], high = high_m[cell];
        const auto turned = std::size_t(std::max((double(sent.of->azimuth[cell]) + std::numbers::pi) * per_rad, 0.0));
        const float* const of_sector = slope[std::min(turned, slope.rows - 1)];
        if (rising) {
            // Each ring is above the one before, so that those between are a stretch: a step or two from the last cell's.
            const auto z_m = [&](std::size_t k) { return start_m[k] + r * of_sector[k]; };
            while (ring > 0 && z_m(ring - 1) >= low) --ring;
            while (ring < rings && z_m(ring) < low) ++ring;
            while (ring_end > 0 && z_m(ring_end - 1) > high) --ring_end;
            while (ring_end < rings && z_m(ring_end) <= high) ++ring_end;
            if (ring >= ring_end) continue;
            for (std::size_t word = ring / 64; word * 64 < ring_end; ++word) {
                const std::size_t from = std::max(ring, word * 64), end = std::min(ring_end, word * 64 + 64);
                sent.bits[cell * sent.words + word] = ~std::uint64_t(0) >> (64 - (end - from)) << (from % 64);
            }
            sent.ring[cell] = std::uint16_t(ring);
            sent.ring_end[cell] = std::uint16_t(ring_end);
            continue;
        }
        for (std::size_t word = 0; word < sent.words; ++word) {
            const std::size_t begin = word * 64, count = std::min(rings - begin, std::size_t(64));
            for (std::size_t k = 0; k < count; ++k) {
                const float z_m = start_m[begin + k] + r * of_sector[begin + k];
                passes[k] = std::uint8_t(z_m >= low) & std::uint8_t(z_m <= high);
            }
            std::fill(passes + count, passes + 64, std::uint8_t(0));
            // Eight bytes to eight bits: the product moves each to its place in the top byte.
            std::uint64_t bits = 0;
            for (std::size_t k = 0; k < 8; ++k) {
                std::uint64_t eight;
                std::memcpy(&eight, passes + 8 * k, 8);
                bits |= (eight * 0x0102040810204080u >> 56) << (8 * k);
            }
            sent.bits[cell * sent.words + word] = bits;
            if (bits == 0) continue;
            if (sent.ring_end[cell] == 0) sent.ring[cell] = std::uint16_t(begin + std::size_t(std::countr_zero(bits)));
            sent.ring_end[cell] = std::uint16_t(begin + 64 - std::size_t(std::countl_zero(bits)));
        }
    }
}

// A cell that an attack changes, and the share in it of each beam that is needed there.
struct Share {
    std::size_t cell;
    double of_beam;
};

// Add to each beam (columns, LANES) of the rings from `begin` on the cells that it helps to change, each shared by the beams
// that are needed there.
MULTIVERSION void share_cells(const SentBeams& sent, const float* nearest, const std::vector<Share>& shares, bool opens,
                              std::size_t begin, double* weight) {
    const std::size_t columns = sent.of->columns, padded = sent.of->rings + LANES;
    const Bits64 flip = Bits64{} - std::int64_t(!opens);
    for (const Share& one : shares) {
        if (begin >= sent.ring_end[one.cell] || begin + LANES <= sent.ring[one.cell]) continue;
        Weights share{};
        const std::size_t count = std::min(LANES, sent.of->rings - begin);
        for (std::size_t n = 0; n < count; ++n) share[n] = sent.passes(one.cell, begin + n) ? one.of_beam : 0.0;
        const TargetColumns::Window& at = sent.of->windows[one.cell];
        for (std::size_t k = at.begin; k < at.begin + at.width; ++k) {
            const Counts before = *reinterpret_cast<const Ranges*>(nearest + k * padded + begin) < at.near_m;
            const Bits64 can_change = __builtin_convertvector(before, Bits64) ^ flip;
            *reinterpret_cast<Weights*>(weight + (k < columns ? k : k - columns) * LANES) += Weights(can_change & Bits64(share));
        }
    }
}

// Count for each of some beams that it can change.
MULTIVERSION void add_changes(const float* __restrict range_m, std::size_t width, float near_m, bool opens,
                              std::int32_t* __restrict changes) {
    for (std::size_t k = 0; k < width; ++k) changes[k] += std::int32_t((range_m[k] < near_m) == opens);
}

// Whether a wedge of `wide` columns anywhere can change a cell, and between which of its starts, see wedge_changes.
bool wedge_starts(const SentBeams& sent, Nearest nearest, std::size_t cell, std::int32_t needed, bool opens, std::size_t wide,
                  std::vector<std::int32_t>& changes, std::int64_t& first, std::int64_t& last) {
    const TargetColumns::Window at = sent.of->windows[cell];
    // The beams of each column that can change.
    changes.assign(at.width, 0);
    for (std::size_t ring = sent.ring[cell]; ring < sent.ring_end[cell]; ++ring) {
        if (!sent.passes(cell, ring)) continue;
        add_changes(nearest[ring] + at.begin, at.width, at.near_m, opens, changes.data());
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

// Squares of the ranges within which a return is one.
struct Limits {
    float near_m2, far_m2;
};

// Write the horizontal ranges of some points (count, 3), +inf where they are no returns, and their azimuths in columns.
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

// Combine each GAP + 1 neighbors: (count + GAP,) to (count,).
template <typename Combine>
void over_stretches(const float* __restrict from, float* __restrict to, std::size_t count, Combine combine) {
    std::copy(from, from + count, to);
    for (std::size_t step = 1; step <= GAP; ++step) {
        for (std::size_t k = 0; k < count; ++k) to[k] = combine(to[k], from[k + step]);
    }
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
    bool rising = std::is_sorted(start_m.begin(), start_m.end());
    for (std::size_t sector = 0; rising && sector < slope.rows; ++sector) {
        rising = std::is_sorted(slope[sector], slope[sector] + slope.columns);
    }
    for_ranges(of->rows, count_parts(of->rows, ROWS), [&](std::size_t, std::size_t first_row, std::size_t end_row) {
        find_rings(*this, low_m.data, high_m.data, slope, start_m.data, rising, first_row * of->grid_columns,
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
    // The circle once more.
    for (std::size_t ring = 0; ring < tangent.size; ++ring) {
        float* const of = nearest.data() + ring * 2 * columns;
        std::copy(of, of + columns, of + columns);
    }
    return nearest;
}

Buffer<float> without_gaps(View2<const float> nearest, const TargetColumns* of) {
    const std::size_t columns = nearest.columns / 2;
    Buffer<float> closed(nearest.size());
    std::vector<float> around(columns + 2 * GAP), least(columns + GAP);
    for (std::size_t ring = 0; ring < nearest.rows; ++ring) {
        // The least of each stretch of GAP + 1 columns; a column takes the greatest of those that it lies in.
        std::copy(nearest[ring] + columns - GAP, nearest[ring] + 2 * columns, around.begin());
        std::copy(nearest[ring], nearest[ring] + GAP, around.begin() + std::ptrdiff_t(columns + GAP));
        over_stretches(around.data(), least.data(), least.size(), [](float a, float b) { return a < b ? a : b; });
        float* const to = closed.data() + ring * 2 * columns;
        over_stretches(least.data(), to, columns, [](float a, float b) { return a > b ? a : b; });
        for (std::size_t k = 0; of != nullptr && k < columns; ++k) {
            if (!of->is_fired(ring, k)) to[k] = INFINITE;
        }
        std::copy(to, to + columns, to + columns);
    }
    return closed;
}

std::pair<Buffer<std::int32_t>, Buffer<std::int32_t>> envelope_margins(const SentBeams& sent, View2<const float> nearest) {
    const TargetColumns& of = *sent.of;
    const Buffer<float> closed_m = without_gaps(nearest, &of);
    const Buffer<float> range_m = by_column(nearest);
    const Buffer<float> closed_range_m = by_column({closed_m.data(), nearest.rows, nearest.columns});
    Buffer<std::int32_t> margin(of.windows.size()), closed(of.windows.size());
    for_ranges(of.rows, count_parts(of.rows, ROWS), [&](std::size_t, std::size_t first, std::size_t last) {
        count_margins(sent, range_m.data(), closed_range_m.data(), first * of.grid_columns, last * of.grid_columns,
                      margin.data(), closed.data());
    });
    return {std::move(margin), std::move(closed)};
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
