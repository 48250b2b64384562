#include "visibility.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <utility>

#include "parallel.hpp"
#include "stages.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Beams may pass so far below the ground: the tolerance of a measured ground.
constexpr float BELOW_GROUND_M = 0.3f;

// Beams that aim at a target are counted by slope, in so many bins from -limit to limit.
constexpr std::size_t SLOPE_BINS = 512;
constexpr float SLOPE_LIMIT = 1.0f, PER_SLOPE = float(SLOPE_BINS / (2 * SLOPE_LIMIT));

// Range bins are counted in whole vectors of this many.
constexpr std::size_t VECTOR = 16;

// A cell farther than so many of its sides has no bins.
constexpr double MOST_BINS = 1e6;

// Beams of a part that is worth a thread; beams and cells of a sweep that is.
constexpr std::size_t PART = 8192, WORTH = 32768;

constexpr float INFINITE = std::numeric_limits<float>::infinity();

// The slopes of beams that pass a target's foot and its top: rows of a sector's limits, one pair for each ground.
constexpr std::size_t LIMITS = 6;

// A beam of a column: its slope, and the last range bin that it reaches, -1 for none.
struct Beam {
    float slope;
    std::int32_t last;
};

// The beams of one kind by column; those above every target lie behind the last one.
struct SortedKind {
    const Beam* beams;
    const std::uint32_t* first;  // (AZIMUTH_COLUMNS + 1,)
};

// What the segments are counted from, and where.
struct Job {
    const CellWindows* windows;
    std::array<SortedKind, 3> kinds;
    const float* limits;  // (GROUND_SECTORS, LIMITS, stride)
    bool shifted;
    Row* rows;
    Row* totals;
};

INLINE float clamped(float at, float last) {
    at = at > 0.0f ? at : 0.0f;
    return at < last ? at : last;
}

// 1. Slopes.

// Write the limits (LIMITS, stride) of one sector, and return the steepest slope of a target's top.
MULTIVERSION float write_limits(const CellWindows& windows, const TargetGround& ground, float target_height_m,
                                const float* deviations, std::size_t sector, float* limits) {
    const double azimuth = (double(sector) + 0.5) * (2 * std::numbers::pi / GROUND_SECTORS) - std::numbers::pi;
    const auto x = float(std::cos(azimuth)), y = float(std::sin(azimuth));
    const auto nodes = std::uint32_t(ground.heights_m.columns);
    const float half_m = ground.half_extent_m, per_m = float(nodes) / (2.0f * half_m), last = float(nodes) - 1.001f;
    const float *heights_m = ground.heights_m.data, *std_m = ground.std_m.data;
    const float *range_m = windows.bin_range_m.data(), *per_range = windows.per_range.data();
    const std::size_t bins = windows.bins, stride = windows.stride;
    const float less = deviations == nullptr ? 0.0f : deviations[0], more = deviations == nullptr ? 0.0f : deviations[1];
    float highest = -INFINITE;
    for (std::size_t k = 0; k < bins; ++k) {
        // The ground and its deviation, bilinear between four nodes.
        const float u = clamped((x * range_m[k] + half_m) * per_m - 0.5f, last);
        const float v = clamped((y * range_m[k] + half_m) * per_m - 0.5f, last);
        const auto i = std::int32_t(u), j = std::int32_t(v);
        const float down = u - float(i), right = v - float(j);
        const std::uint32_t at = std::uint32_t(i) * nodes + std::uint32_t(j), under = at + nodes;
        const float low = heights_m[at] * (1 - right) + heights_m[at + 1] * right;
        const float high = heights_m[under] * (1 - right) + heights_m[under + 1] * right;
        const float foot_m = low * (1 - down) + high * down - ground.sensor_height_m;
        const float low_std = std_m[at] * (1 - right) + std_m[at + 1] * right;
        const float high_std = std_m[under] * (1 - right) + std_m[under + 1] * right;
        const float deviation_m = low_std * (1 - down) + high_std * down;
        // As slopes, at each height of the ground.
        const float lower_m = foot_m + less * deviation_m, higher_m = foot_m + more * deviation_m;
        limits[k] = (foot_m - BELOW_GROUND_M) * per_range[k];
        limits[stride + k] = (foot_m + target_height_m) * per_range[k];
        limits[2 * stride + k] = (lower_m - BELOW_GROUND_M) * per_range[k];
        limits[3 * stride + k] = (lower_m + target_height_m) * per_range[k];
        limits[4 * stride + k] = (higher_m - BELOW_GROUND_M) * per_range[k];
        limits[5 * stride + k] = (higher_m + target_height_m) * per_range[k];
    }
    for (std::size_t row = 1; row < LIMITS; row += 2) {
        for (std::size_t k = 0; k < bins; ++k) {
            const float top = limits[row * stride + k];
            highest = top > highest ? top : highest;
        }
    }
    // Nothing passes between the foot and the top of the bins that fill the last vector.
    for (std::size_t row = 0; row < LIMITS; ++row) {
        for (std::size_t k = bins; k < stride; ++k) limits[row * stride + k] = row % 2 == 0 ? INFINITE : -INFINITE;
    }
    return highest;
}

// 2. Beams by column.

// Write the column of each beam of a block, AZIMUTH_COLUMNS for one above `highest`.
MULTIVERSION void find_columns(const float* azimuth, const float* slope, std::size_t count, float highest,
                               std::uint16_t* column) {
    constexpr float PER_RAD = float(AZIMUTH_COLUMNS / (2 * std::numbers::pi));
    for (std::size_t n = 0; n < count; ++n) {
        const auto at = std::int32_t(clamped((azimuth[n] + PI) * PER_RAD, float(AZIMUTH_COLUMNS - 1)));
        column[n] = std::uint16_t(slope[n] <= highest ? at : std::int32_t(AZIMUTH_COLUMNS));
    }
}

// Write slope and last bin of each beam of a block. A beam reaches a cell if its depth does, less one cell.
MULTIVERSION void find_last_bins(const float* slope, const float* depth_m, std::size_t count, float cell_m, float farthest,
                                 Beam* beams) {
    for (std::size_t n = 0; n < count; ++n) {
        float bin = depth_m[n] / cell_m + 0.5f;
        bin = bin > -1.0f ? bin : -1.0f;
        beams[n] = {slope[n], std::int32_t(bin < farthest ? bin : farthest)};
    }
}

// The beams of all kinds by column, those up to the slope `highest`. The order within a column does not matter: what is
// counted are whole numbers.
struct SortedBeams {
    std::size_t total, parts;
    Buffer<Beam> beams;
    Buffer<std::uint32_t> first;  // (kinds, BUCKETS) where each column begins

    static constexpr std::size_t BUCKETS = AZIMUTH_COLUMNS + 1;  // the last one for beams above every target

    SortedBeams(const std::array<Beams, 3>& kinds, float highest, float cell_m, std::size_t bins)
        : total(kinds[0].azimuth.size + kinds[1].azimuth.size + kinds[2].azimuth.size), parts(count_parts(total, PART)),
          beams(total), first(3 * BUCKETS) {
        Buffer<std::uint16_t> column(total);
        Buffer<std::uint32_t> counts(parts * 3 * BUCKETS);
        // Each part counts its share of every kind; then its place in a column lies behind those of the parts before.
        const auto each_block = [&](std::size_t part, const auto& body) {
            std::size_t begin = 0;
            for (std::size_t kind = 0; kind < 3; begin += kinds[kind].azimuth.size, ++kind) {
                const std::size_t size = kinds[kind].azimuth.size, end = size * (part + 1) / parts;
                for (std::size_t n = size * part / parts; n < end; n += BLOCK) {
                    body(kinds[kind], n, std::min(BLOCK, end - n), &column[begin + n],
                         &counts[(part * 3 + kind) * BUCKETS]);
                }
            }
        };
        for_ranges(parts, parts, [&](std::size_t part, std::size_t, std::size_t) {
            std::fill_n(&counts[part * 3 * BUCKETS], 3 * BUCKETS, 0);
            each_block(part, [&](const Beams& of, std::size_t n, std::size_t size, std::uint16_t* at, std::uint32_t* count) {
                find_columns(of.azimuth.data + n, of.slope.data + n, size, highest, at);
                for (std::size_t k = 0; k < size; ++k) ++count[at[k]];
            });
        });
        std::uint32_t place = 0;
        for (std::size_t bucket = 0; bucket < 3 * BUCKETS; ++bucket) {
            first[bucket] = place;
            for (std::size_t part = 0; part < parts; ++part) {
                std::uint32_t& count = counts[part * 3 * BUCKETS + bucket];
                place += std::exchange(count, place);
            }
        }
        for_ranges(parts, parts, [&](std::size_t part, std::size_t, std::size_t) {
            Beam block[BLOCK];
            each_block(part, [&](const Beams& of, std::size_t n, std::size_t size, std::uint16_t* at, std::uint32_t* next) {
                find_last_bins(of.slope.data + n, of.depth_m.data + n, size, cell_m, float(bins - 1), block);
                for (std::size_t k = 0; k < size; ++k) beams[next[at[k]]++] = block[k];
            });
        });
    }

    SortedKind kind(std::size_t number) const { return {beams.data(), first.data() + number * BUCKETS}; }
};

// 3. Sums over columns.

// Count the beams [begin, end) in the range bins that they reach: their slope lies between foot and top, and they ended no
// nearer. Return how many bins were looked at.
template <bool SHIFTED>
INLINE std::size_t count_kind(const SortedKind& kind, std::size_t column, const float* __restrict limits, std::size_t stride,
                              std::int32_t* __restrict own, std::int32_t* __restrict lower,
                              std::int32_t* __restrict higher) {
    std::size_t most = 0;
    for (std::uint32_t n = kind.first[column]; n < kind.first[column + 1]; ++n) {
        const float s = kind.beams[n].slope;
        const std::int32_t last = kind.beams[n].last;
        // Whole vectors: the bins beyond the last one are masked.
        const std::size_t whole = std::size_t(last + std::int32_t(VECTOR)) / VECTOR * VECTOR;
        for (std::size_t k = 0; k < whole; ++k) {
            const bool reaches = std::int32_t(k) <= last;
            own[k] += (s >= limits[k]) & (s <= limits[stride + k]) & reaches;
            if constexpr (SHIFTED) {
                lower[k] += (s >= limits[2 * stride + k]) & (s <= limits[3 * stride + k]) & reaches;
                higher[k] += (s >= limits[4 * stride + k]) & (s <= limits[5 * stride + k]) & reaches;
            }
        }
        most = whole > most ? whole : most;
    }
    return most;
}

// Turn eight rows of eight into their columns.
INLINE void transpose(Lanes* r) {
    const Lanes t0 = __builtin_shufflevector(r[0], r[1], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes t1 = __builtin_shufflevector(r[0], r[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const Lanes t2 = __builtin_shufflevector(r[2], r[3], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes t3 = __builtin_shufflevector(r[2], r[3], 2, 10, 3, 11, 6, 14, 7, 15);
    const Lanes t4 = __builtin_shufflevector(r[4], r[5], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes t5 = __builtin_shufflevector(r[4], r[5], 2, 10, 3, 11, 6, 14, 7, 15);
    const Lanes t6 = __builtin_shufflevector(r[6], r[7], 0, 8, 1, 9, 4, 12, 5, 13);
    const Lanes t7 = __builtin_shufflevector(r[6], r[7], 2, 10, 3, 11, 6, 14, 7, 15);
    const Lanes s0 = __builtin_shufflevector(t0, t2, 0, 1, 8, 9, 4, 5, 12, 13);
    const Lanes s1 = __builtin_shufflevector(t0, t2, 2, 3, 10, 11, 6, 7, 14, 15);
    const Lanes s2 = __builtin_shufflevector(t1, t3, 0, 1, 8, 9, 4, 5, 12, 13);
    const Lanes s3 = __builtin_shufflevector(t1, t3, 2, 3, 10, 11, 6, 7, 14, 15);
    const Lanes s4 = __builtin_shufflevector(t4, t6, 0, 1, 8, 9, 4, 5, 12, 13);
    const Lanes s5 = __builtin_shufflevector(t4, t6, 2, 3, 10, 11, 6, 7, 14, 15);
    const Lanes s6 = __builtin_shufflevector(t5, t7, 0, 1, 8, 9, 4, 5, 12, 13);
    const Lanes s7 = __builtin_shufflevector(t5, t7, 2, 3, 10, 11, 6, 7, 14, 15);
    r[0] = __builtin_shufflevector(s0, s4, 0, 1, 2, 3, 8, 9, 10, 11);
    r[1] = __builtin_shufflevector(s1, s5, 0, 1, 2, 3, 8, 9, 10, 11);
    r[2] = __builtin_shufflevector(s2, s6, 0, 1, 2, 3, 8, 9, 10, 11);
    r[3] = __builtin_shufflevector(s3, s7, 0, 1, 2, 3, 8, 9, 10, 11);
    r[4] = __builtin_shufflevector(s0, s4, 4, 5, 6, 7, 12, 13, 14, 15);
    r[5] = __builtin_shufflevector(s1, s5, 4, 5, 6, 7, 12, 13, 14, 15);
    r[6] = __builtin_shufflevector(s2, s6, 4, 5, 6, 7, 12, 13, 14, 15);
    r[7] = __builtin_shufflevector(s3, s7, 4, 5, 6, 7, 12, 13, 14, 15);
}

// Write how many beams of the sector, measured or inferred, lie below the edge of each bin of slope.
INLINE void count_slopes(const Job& job, std::size_t sector, std::uint32_t* below) {
    for (std::size_t q = 0; q <= SLOPE_BINS; ++q) below[q] = 0;
    for (std::size_t kind = 0; kind < 2; ++kind) {
        const std::uint32_t* first = job.kinds[kind].first + sector * SECTOR_COLUMNS;
        for (std::uint32_t n = first[0]; n < first[SECTOR_COLUMNS]; ++n) {
            const float q = (job.kinds[kind].beams[n].slope + SLOPE_LIMIT) * PER_SLOPE;
            if (q >= 0.0f && q < float(SLOPE_BINS)) ++below[std::size_t(q) + 1];
        }
    }
    for (std::size_t q = 0; q < SLOPE_BINS; ++q) below[q + 1] += below[q];
}

// The beams below a slope, linearly between the edges of two bins.
INLINE float beams_below(const float* below, float slope) {
    const float at = clamped((slope + SLOPE_LIMIT) * PER_SLOPE, float(SLOPE_BINS) - 0.001f);
    const auto q = std::int32_t(at);
    return below[q] + (at - float(q)) * (below[q + 1] - below[q]);
}

// Sum the beams of one segment over its columns, bin by bin, and write the sum before each end of a window there.
MULTIVERSION void sum_segment(const Job& job, std::size_t segment) {
    const CellWindows& windows = *job.windows;
    const std::size_t bins = windows.bins, stride = windows.stride;
    constexpr std::size_t SECTORS = SEGMENT_COLUMNS / SECTOR_COLUMNS;
    // The sums over the columns before (stride,), what the column at hand adds to them, and the same lane by lane.
    Buffer<Row> sums(stride), added(stride);
    Buffer<std::int32_t> counts(AIMED * stride);
    Buffer<float> aimed(stride);
    for (std::size_t k = 0; k < stride; ++k) sums[k].lanes = added[k].lanes = Lanes{};
    std::memset(counts.data(), 0, counts.size() * sizeof(std::int32_t));
    for (std::size_t k = bins; k < stride; ++k) aimed[k] = 0.0f;
    std::size_t filled = 0;  // bins of `added` that are not 0
    // The beams below each slope, in the sector before, the sector itself, and the one behind it.
    std::uint32_t below[3][SLOPE_BINS + 1];
    float smooth[SLOPE_BINS + 1];
    const std::size_t first_sector = segment * SECTORS;
    count_slopes(job, (first_sector + GROUND_SECTORS - 1) % GROUND_SECTORS, below[0]);
    count_slopes(job, first_sector, below[1]);

    for (std::size_t step = 0; step < SECTORS; ++step) {
        const std::size_t sector = first_sector + step;
        const float* const limits = job.limits + sector * LIMITS * stride;
        // Beams that aim at a target in each bin: those below its top, less those below its foot. A sector weighs 1/2 and
        // its neighbors 1/4, since firings do not divide evenly among sectors; each of its columns has an equal share.
        const std::uint32_t *before = below[step % 3], *own = below[(step + 1) % 3];
        std::uint32_t* const after = below[(step + 2) % 3];
        count_slopes(job, (sector + 1) % GROUND_SECTORS, after);
        for (std::size_t q = 0; q <= SLOPE_BINS; ++q) smooth[q] = 0.25f * float(2 * own[q] + before[q] + after[q]);
        for (std::size_t k = 0; k < bins; ++k) {
            aimed[k] = beams_below(smooth, limits[stride + k]) - beams_below(smooth, limits[k]);
        }
        for (std::size_t k = 0; k < bins; ++k) added[k].lanes[AIMED] = aimed[k];

        for (std::size_t c = 0; c < SECTOR_COLUMNS; ++c) {
            const std::size_t column = sector * SECTOR_COLUMNS + c;
            // Count the column's beams, then put the lanes of a bin side by side.
            std::int32_t *const lower = &counts[LOWER * stride], *const higher = &counts[HIGHER * stride];
            std::size_t most = 0;
            for (std::size_t kind = MEASURED; kind <= INFERRED; ++kind) {
                const std::size_t looked_at =
                    job.shifted
                        ? count_kind<true>(job.kinds[kind], column, limits, stride, &counts[kind * stride], lower, higher)
                        : count_kind<false>(job.kinds[kind], column, limits, stride, &counts[kind * stride], lower, higher);
                most = looked_at > most ? looked_at : most;
            }
            const std::size_t looked_at = count_kind<false>(job.kinds[UNRESOLVED], column, limits, stride,
                                                            &counts[UNRESOLVED * stride], lower, higher);
            most = looked_at > most ? looked_at : most;
            const std::size_t packed = most > filled ? most : filled;
            for (std::size_t k = 0; k < packed; k += LANES) {
                Lanes rows[LANES];
                for (std::size_t lane = 0; lane < AIMED; ++lane) {
                    for (std::size_t b = 0; b < LANES; ++b) rows[lane][b] = float(counts[lane * stride + k + b]);
                }
                std::memcpy(&rows[AIMED], &aimed[k], sizeof(Lanes));
                rows[6] = rows[7] = Lanes{};
                transpose(rows);
                for (std::size_t b = 0; b < LANES; ++b) added[k + b].lanes = rows[b];
            }
            for (std::size_t lane = 0; lane < AIMED; ++lane) {
                std::memset(&counts[lane * stride], 0, most * sizeof(std::int32_t));
            }
            filled = most;
            // The sum before each window that begins or ends in this column; beams that aim are spread over the sector.
            const Lanes scale = {1, 1, 1, 1, 1, 1.0f / SECTOR_COLUMNS, 0, 0};
            const Lanes offset = {0, 0, 0, 0, 0, float(c) / SECTOR_COLUMNS, 0, 0};
            for (std::size_t e = windows.first_begin[column]; e < windows.first_begin[column + 1]; ++e) {
                const CellWindows::End& end = windows.begins[e];
                job.rows[end.row].lanes = -(sums[end.bin].lanes + (scale * end.part + offset) * added[end.bin].lanes);
            }
            for (std::size_t e = windows.first_end[column]; e < windows.first_end[column + 1]; ++e) {
                const CellWindows::End& end = windows.ends[e];
                const Lanes sum = sums[end.bin].lanes + (scale * end.part + offset) * added[end.bin].lanes;
                // The end of a window that crosses stands apart, since another thread may write its begin.
                job.rows[end.row].lanes = end.row < windows.cells() ? job.rows[end.row].lanes + sum : sum;
            }
            const Lanes counted = {1, 1, 1, 1, 1, 0, 0, 0};
            for (std::size_t k = 0; k < filled; ++k) sums[k].lanes += counted * added[k].lanes;
        }
        for (std::size_t k = 0; k < bins; ++k) sums[k].lanes[AIMED] += aimed[k];
    }
    std::memcpy(static_cast<void*>(job.totals + segment * bins), sums.data(), bins * sizeof(Row));
}

}  // namespace

CellWindows::CellWindows(View2<const float> range, View2<const float> azimuth_, double cell_m_, double width_m)
    : grid_rows(range.rows), grid_columns(range.columns), cell_m(float(cell_m_)),
      cell_range_m(range.data, range.data + range.size()) {
    const View1<const float> range_m = range.flat(), azimuth = azimuth_.flat();
    constexpr double PER_RAD = AZIMUTH_COLUMNS / (2 * std::numbers::pi);
    float farthest_m = 0.0f;
    for (const float r : cell_range_m) farthest_m = std::max(farthest_m, r);
    require(double(farthest_m) / cell_m_ < MOST_BINS, "cells must lie within a million sides of a cell");
    bins = std::size_t(std::ceil(double(farthest_m) / cell_m_)) + 1;
    stride = (bins + VECTOR - 1) / VECTOR * VECTOR;
    // The middles of the range bins, and half of the target's width there, in columns.
    std::vector<double> half(bins);
    for (std::size_t k = 0; k < stride; ++k) {
        const double middle_m = (double(k) + 0.5) * cell_m_;
        bin_range_m.push_back(float(middle_m));
        per_range.push_back(float(1.0 / middle_m));
        if (k < bins) half[k] = std::atan2(width_m / 2, middle_m) * PER_RAD;
    }
    // Both ends of each window, in columns from the first turn on.
    struct Placed {
        std::uint32_t cell, bin;
        std::uint32_t column[2];
        std::int32_t segment[2];
        float part[2];
    };
    std::vector<Placed> placed(cells());
    first_begin.assign(AZIMUTH_COLUMNS + 1, 0);
    first_end.assign(AZIMUTH_COLUMNS + 1, 0);
    for (std::uint32_t n = 0; n < cells(); ++n) {
        Placed& at = placed[n];
        at.cell = n;
        at.bin = std::uint32_t(std::min(range_m[n] / cell_m, float(bins - 1)));
        const double center = (double(azimuth[n]) + std::numbers::pi) * PER_RAD;
        for (int side = 0; side < 2; ++side) {
            const double edge = center + (side == 0 ? -half[at.bin] : half[at.bin]);
            const double turn = std::floor(edge / AZIMUTH_COLUMNS), within = edge - turn * AZIMUTH_COLUMNS;
            at.column[side] = std::min(std::uint32_t(within), std::uint32_t(AZIMUTH_COLUMNS - 1));
            at.part[side] = float(within - at.column[side]);
            at.segment[side] = std::int32_t(turn) * std::int32_t(SEGMENTS) +
                               std::int32_t(at.column[side] / SEGMENT_COLUMNS);
        }
        ++first_begin[at.column[0] + 1];
        ++first_end[at.column[1] + 1];
    }
    for (std::size_t c = 0; c < AZIMUTH_COLUMNS; ++c) {
        first_begin[c + 1] += first_begin[c];
        first_end[c + 1] += first_end[c];
    }
    // By column; in a column by cell.
    begins.resize(cells());
    ends.resize(cells());
    std::vector<std::uint32_t> next_begin = first_begin, next_end = first_end;
    for (const Placed& at : placed) {
        std::uint32_t end_row = at.cell;
        if (at.segment[0] != at.segment[1]) {
            end_row = std::uint32_t(rows());
            const auto first = std::uint32_t(at.segment[0] + std::int32_t(SEGMENTS)) % std::uint32_t(SEGMENTS);
            crossings.push_back({at.cell, at.bin, first, std::uint32_t(at.segment[1] - at.segment[0])});
        }
        begins[next_begin[at.column[0]]++] = {at.cell, at.bin, at.part[0]};
        ends[next_end[at.column[1]]++] = {end_row, at.bin, at.part[1]};
    }
}

MULTIVERSION void CellCounts::read(std::size_t first, std::size_t count, float (*lanes)[BLOCK]) const {
    for (std::size_t n = 0; n < count; n += LANES) {
        Lanes block[LANES];
        for (std::size_t b = 0; b < LANES; ++b) block[b] = rows[first + n + b].lanes;
        transpose(block);
        for (std::size_t lane = 0; lane < LANES_USED; ++lane) std::memcpy(&lanes[lane][n], &block[lane], sizeof(Lanes));
    }
    // Windows that cross from one segment to another: their ends, and the segments between.
    const auto by_cell = [](const CellWindows::Crossing& a, std::size_t cell) { return a.cell < cell; };
    auto at = std::lower_bound(windows->crossings.begin(), windows->crossings.end(), first, by_cell);
    for (; at != windows->crossings.end() && at->cell < first + count; ++at) {
        Lanes sum = rows[windows->cells() + std::size_t(at - windows->crossings.begin())].lanes;
        for (std::uint32_t k = 0; k < at->count; ++k) {
            sum += totals[(at->first + k) % SEGMENTS * windows->bins + at->bin].lanes;
        }
        for (std::size_t lane = 0; lane < LANES_USED; ++lane) lanes[lane][at->cell - first] += sum[lane];
    }
}

CellCounts count_beams(const CellWindows& windows, const std::array<Beams, 3>& kinds, const TargetGround& ground,
                       float target_height_m, const std::array<float, 2>* deviations) {
    const std::size_t beams = kinds[0].azimuth.size + kinds[1].azimuth.size + kinds[2].azimuth.size;
    const std::size_t parts = count_parts(beams + windows.cells(), WORTH);

    // 1. The slopes of a target's foot and top, by sector and range.
    Buffer<float> limits(GROUND_SECTORS * LIMITS * windows.stride);
    std::array<float, GROUND_SECTORS> highest;
    for_ranges(GROUND_SECTORS, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t sector = begin; sector < end; ++sector) {
            highest[sector] = write_limits(windows, ground, target_height_m, deviations ? deviations->data() : nullptr,
                                           sector, &limits[sector * LIMITS * windows.stride]);
        }
    });
    // 2. Beams by column. Those above every target aim at none: by a bin of slope, which is interpolated.
    const float most = *std::max_element(highest.begin(), highest.end()) + 1.0f / PER_SLOPE;
    const SortedBeams sorted(kinds, most, windows.cell_m, windows.bins);
    // 3. Sums over the columns of each segment.
    CellCounts counts{&windows, Buffer<Row>(windows.rows() + LANES), Buffer<Row>(SEGMENTS * windows.bins)};
    const Job job{&windows, {sorted.kind(0), sorted.kind(1), sorted.kind(2)}, limits.data(), deviations != nullptr,
                  counts.rows.data(), counts.totals.data()};
    if (parts <= 1) {
        for (std::size_t segment = 0; segment < SEGMENTS; ++segment) sum_segment(job, segment);
    } else {
        run_parts(SEGMENTS, [&](std::size_t segment) { sum_segment(job, segment); });
    }
    return counts;
}

void bind_visibility(nb::module_& m) {
    nb::class_<CellWindows>(m, "CellWindows", "The windows of azimuth of a target in each cell of a grid.")
        .def(
            "__init__",
            [](CellWindows* self, In2<float> range_m, In2<float> azimuth, double cell_m, double width_m) {
                require(range_m.shape(0) == azimuth.shape(0) && range_m.shape(1) == azimuth.shape(1),
                        "range_m and azimuth must have one shape (cells, cells)");
                require(range_m.size() < (1u << 28), "cells must be fewer than 2^28");
                require(std::isfinite(cell_m) && cell_m > 0, "cell_m must be positive and finite");
                require(std::isfinite(width_m) && width_m > 0, "width_m must be positive and finite");
                for (std::size_t n = 0; n < range_m.size(); ++n) {
                    require(range_m.data()[n] >= 0 && range_m.data()[n] < INFINITE, "range_m must be finite, not negative");
                    require(std::fabs(azimuth.data()[n]) < 4.0f, "azimuth must lie in [-pi, pi]");
                }
                new (self) CellWindows(view(range_m), view(azimuth), cell_m, width_m);
            },
            "range_m"_a.noconvert(), "azimuth"_a.noconvert(), "cell_m"_a, "width_m"_a);
}

}  // namespace viewshed
