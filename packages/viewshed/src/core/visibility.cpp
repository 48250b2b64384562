#include "visibility.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <utility>

#include "azimuth_bins.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Beams may pass this far below the estimated ground, the tolerance for ground height.
constexpr float BELOW_GROUND_M = 0.3f;

// Histogram of beam slopes, for beams that aim at a target: SLOPE_BINS bins over ±SLOPE_LIMIT.
constexpr std::size_t SLOPE_BINS = 512;
constexpr float SLOPE_LIMIT = 1.0f, PER_SLOPE = float(SLOPE_BINS / (2 * SLOPE_LIMIT));

// Range bins are padded to a multiple of this vector length.
constexpr std::size_t VECTOR = 16;

// Cells must be nearer than this many cell sizes.
constexpr double MAX_RANGE_BINS = 1e6;

// Fewest beams for which a part pays for its thread; fewest beams and cells for which a sweep does.
constexpr std::size_t PART = 8192, WORTH = 32768;

constexpr float INFINITE = std::numeric_limits<float>::infinity();

// Rows of slope limits of a sector: the slopes of a target's foot and top, for each of three grounds.
constexpr std::size_t LIMITS = 6;

// A beam of an azimuth column: its slope, and the last range bin that it reaches with each of its depths, -1 for none.
template <std::size_t COUNT>
struct Beam {
    float slope;
    std::int32_t last[COUNT];
};

// Beams sorted by column; beams above every target come after the last column.
template <std::size_t COUNT>
struct Columns {
    const Beam<COUNT>* beams;
    const std::uint32_t* first;  // (AZIMUTH_COLUMNS + 1,)
};

// Concatenate two vectors of four by __builtin_shufflevector.
#define JOINED 0, 1, 2, 3, 4, 5, 6, 7

// Inputs and outputs of the segment sums.
struct Job {
    const CellWindows* windows;
    Columns<1> measured;
    Columns<DEPTHS> lost;
    const float* limits;  // (GROUND_SECTORS, LIMITS, stride)
    const float* spans;   // (GROUND_SECTORS, 2, stride / VECTOR), see write_spans
    bool shifted;
    Row* rows;
    Row* totals;
};

INLINE float clamped(float at, float last) {
    at = at > 0.0f ? at : 0.0f;
    return at < last ? at : last;
}

// 1. Slopes.

// Interpolate lattice values bilinearly at the positions of a block.
INLINE void mix_nodes(const float* __restrict values, std::uint32_t nodes, std::size_t size, const std::int32_t* __restrict at,
                      const float* __restrict down, const float* __restrict right, float* __restrict out) {
    for (std::size_t k = 0; k < size; ++k) {
        const float* const above = values + at[k];
        const float* const under = above + nodes;
        const float low = above[0] + right[k] * (above[1] - above[0]), high = under[0] + right[k] * (under[1] - under[0]);
        out[k] = low + down[k] * (high - low);
    }
}

// Write the slope limits (LIMITS, stride) of one sector.
MULTIVERSION void write_limits(const CellWindows& windows, const TargetGround& ground, float target_height_m,
                               const float* deviations, std::size_t sector, float* limits) {
    const double azimuth = (double(sector) + 0.5) * (2 * std::numbers::pi / GROUND_SECTORS) - std::numbers::pi;
    const auto x = float(std::cos(azimuth)), y = float(std::sin(azimuth));
    const auto nodes = std::uint32_t(ground.heights_m.columns);
    const float half_m = ground.half_extent_m, per_m = float(nodes) / (2.0f * half_m), last = float(nodes) - 1.001f;
    const std::size_t bins = windows.bins, stride = windows.stride;
    for (std::size_t start = 0; start < stride; start += BLOCK) {
        const std::size_t size = std::min(BLOCK, stride - start);
        const float *range_m = windows.bin_range_m.data() + start, *per_range = windows.per_range.data() + start;
        // Interpolate the ground and its standard deviation bilinearly.
        std::int32_t at[BLOCK];
        float down[BLOCK], right[BLOCK], foot_m[BLOCK], deviation_m[BLOCK];
        for (std::size_t k = 0; k < size; ++k) {
            const float u = clamped((x * range_m[k] + half_m) * per_m - 0.5f, last);
            const float v = clamped((y * range_m[k] + half_m) * per_m - 0.5f, last);
            const auto i = std::int32_t(u), j = std::int32_t(v);
            at[k] = i * std::int32_t(nodes) + j;
            down[k] = u - float(i);
            right[k] = v - float(j);
        }
        mix_nodes(ground.heights_m.data, nodes, size, at, down, right, foot_m);
        for (std::size_t k = 0; k < size; ++k) foot_m[k] -= ground.sensor_height_m;
        if (deviations != nullptr) mix_nodes(ground.std_m.data, nodes, size, at, down, right, deviation_m);
        // Convert to slopes: for the estimated ground, a lower and a higher one.
        for (std::size_t pair = 0; pair < LIMITS / 2; ++pair) {
            float *const foot = limits + 2 * pair * stride + start, *const top = foot + stride;
            const float shift = pair == 0 || deviations == nullptr ? 0.0f : deviations[pair - 1];
            for (std::size_t k = 0; k < size; ++k) {
                const float shifted_m = shift == 0.0f ? foot_m[k] : foot_m[k] + shift * deviation_m[k];
                foot[k] = (shifted_m - BELOW_GROUND_M) * per_range[k];
                top[k] = (shifted_m + target_height_m) * per_range[k];
            }
        }
    }
    // The bins that pad the last vector match no beam.
    for (std::size_t row = 0; row < LIMITS; ++row) {
        for (std::size_t k = bins; k < stride; ++k) limits[row * stride + k] = row % 2 == 0 ? INFINITE : -INFINITE;
    }
}

// Write, for each vector of bins of a sector, the highest top of a target in the bins up to it and the lowest foot in
// the bins from it on: a beam above that top passes over every target up to there, and a beam below that foot ends
// before every target from there on. Return the highest top of all.
MULTIVERSION float write_spans(const float* limits, std::size_t stride, float* highest_top, float* lowest_foot) {
    const std::size_t vectors = stride / VECTOR;
    for (std::size_t v = 0; v < vectors; ++v) {
        float top[VECTOR], foot[VECTOR];
        for (std::size_t k = 0; k < VECTOR; ++k) {
            const float* at = limits + v * VECTOR + k;
            const float foot_low = at[2 * stride] < at[0] ? at[2 * stride] : at[0];
            const float top_low = at[3 * stride] > at[stride] ? at[3 * stride] : at[stride];
            foot[k] = at[4 * stride] < foot_low ? at[4 * stride] : foot_low;
            top[k] = at[5 * stride] > top_low ? at[5 * stride] : top_low;
        }
        highest_top[v] = *std::max_element(top, top + VECTOR);
        lowest_foot[v] = *std::min_element(foot, foot + VECTOR);
    }
    for (std::size_t v = 1; v < vectors; ++v) highest_top[v] = std::max(highest_top[v], highest_top[v - 1]);
    for (std::size_t v = vectors - 1; v-- > 0;) lowest_foot[v] = std::min(lowest_foot[v], lowest_foot[v + 1]);
    return highest_top[vectors - 1];
}

// 2. Beams by column.

// Write the azimuth column of each beam of a block, AZIMUTH_COLUMNS for beams above slope `highest`.
MULTIVERSION void find_columns(const float* azimuth, const float* slope, std::size_t count, float highest,
                               std::uint16_t* column) {
    constexpr float PER_RAD = float(AZIMUTH_COLUMNS / (2 * std::numbers::pi));
    for (std::size_t n = 0; n < count; ++n) {
        const auto at = std::int32_t(clamped((azimuth[n] + PI) * PER_RAD, float(AZIMUTH_COLUMNS - 1)));
        column[n] = std::uint16_t(slope[n] <= highest ? at : std::int32_t(AZIMUTH_COLUMNS));
    }
}

// Write the last range bin that each beam of a block reaches: the cell's range is at most its depth plus one cell.
MULTIVERSION void find_last_bins(const float* depth_m, std::size_t count, float cell_m, float farthest, std::int32_t* last) {
    for (std::size_t n = 0; n < count; ++n) {
        float bin = depth_m[n] / cell_m + 0.5f;
        bin = bin > -1.0f ? bin : -1.0f;
        last[n] = std::int32_t(bin < farthest ? bin : farthest);
    }
}

// Beams sorted by column, up to slope `highest`. Their order within a column does not matter: the counts are integers.
template <std::size_t COUNT>
struct SortedBeams {
    Buffer<Beam<COUNT>> beams;
    Buffer<std::uint32_t> first;  // where each column begins

    static constexpr std::size_t BUCKETS = AZIMUTH_COLUMNS + 1;  // the last one for beams above every target

    SortedBeams(View1<const float> azimuth, View1<const float> slope, const std::array<View1<const float>, COUNT>& depth_m,
                float highest, const CellWindows& windows)
        : beams(azimuth.size), first(BUCKETS) {
        const std::size_t size = azimuth.size, parts = count_parts(size, PART);
        Buffer<std::uint16_t> column(size);
        Buffer<std::uint32_t> counts(parts * BUCKETS);
        // Each part counts its beams by column. Its position in a column follows those of the parts before it.
        for_ranges(parts, parts, [&](std::size_t part, std::size_t, std::size_t) {
            const std::size_t begin = size * part / parts, end = size * (part + 1) / parts;
            std::uint32_t* const count = &counts[part * BUCKETS];
            std::fill_n(count, BUCKETS, 0);
            find_columns(azimuth.data + begin, slope.data + begin, end - begin, highest, column.data() + begin);
            for (std::size_t n = begin; n < end; ++n) ++count[column[n]];
        });
        std::uint32_t place = 0;
        for (std::size_t bucket = 0; bucket < BUCKETS; ++bucket) {
            first[bucket] = place;
            for (std::size_t part = 0; part < parts; ++part) {
                std::uint32_t& count = counts[part * BUCKETS + bucket];
                place += std::exchange(count, place);
            }
        }
        for_ranges(parts, parts, [&](std::size_t part, std::size_t, std::size_t) {
            std::uint32_t* const next = &counts[part * BUCKETS];
            std::int32_t last[COUNT][BLOCK];
            for (std::size_t n = size * part / parts, end = size * (part + 1) / parts; n < end; n += BLOCK) {
                const std::size_t block_size = std::min(BLOCK, end - n);
                for (std::size_t d = 0; d < COUNT; ++d) {
                    find_last_bins(depth_m[d].data + n, block_size, windows.cell_m, float(windows.bins - 1), last[d]);
                }
                for (std::size_t k = 0; k < block_size; ++k) {
                    Beam<COUNT>& beam = beams[next[column[n + k]]++];
                    beam.slope = slope[n + k];
                    for (std::size_t d = 0; d < COUNT; ++d) beam.last[d] = last[d][k];
                }
            }
        });
    }

    Columns<COUNT> columns() const { return {beams.data(), first.data()}; }
};

// 3. Sums over columns.

// Return the number of vectors that cover the bins up to `bin`.
INLINE std::size_t vectors_to(std::int32_t bin) { return std::size_t(bin + std::int32_t(VECTOR)) / VECTOR; }

// Count the beams of a column in the range bins that they hit: their slope lies between foot and top, and they ended no
// nearer. `own` (COUNT, stride) gets the counts for each depth; `lower` and `higher` get those of the first depth on
// other ground. `spans` belongs to the sector. Return the number of bins visited.
template <bool SHIFTED, std::size_t COUNT>
INLINE std::size_t count_column(const Columns<COUNT>& columns, std::size_t column, const float* __restrict limits,
                                std::size_t stride, const float* __restrict spans, std::int32_t* __restrict own,
                                std::int32_t* __restrict lower, std::int32_t* __restrict higher) {
    const std::size_t vectors = stride / VECTOR;
    const float *highest_top = spans, *lowest_foot = spans + vectors;
    std::size_t most = 0;
    for (std::uint32_t n = columns.first[column]; n < columns.first[column + 1]; ++n) {
        const Beam<COUNT>& beam = columns.beams[n];
        const float s = beam.slope;
        std::int32_t last[COUNT], farthest = -1;
        for (std::size_t d = 0; d < COUNT; ++d) {
            last[d] = beam.last[d];
            farthest = last[d] > farthest ? last[d] : farthest;
        }
        // Process whole vectors and mask the bins beyond the last. Most beams pass above the first, or end early.
        std::size_t begin = 0, end = vectors_to(farthest);
        while (begin < end && s > highest_top[begin]) ++begin;
        while (begin < end && s < lowest_foot[end - 1]) --end;
        if constexpr (SHIFTED) {
            const std::size_t likely_end = std::min(vectors_to(last[0]), end);
            for (std::size_t k = begin * VECTOR; k < likely_end * VECTOR; ++k) {
                const bool reaches = std::int32_t(k) <= last[0];
                lower[k] += (s >= limits[2 * stride + k]) & (s <= limits[3 * stride + k]) & reaches;
                higher[k] += (s >= limits[4 * stride + k]) & (s <= limits[5 * stride + k]) & reaches;
            }
        }
        for (std::size_t k = begin * VECTOR; k < end * VECTOR; ++k) {
            const bool aims = (s >= limits[k]) & (s <= limits[stride + k]);
            for (std::size_t d = 0; d < COUNT; ++d) own[d * stride + k] += aims & (std::int32_t(k) <= last[d]);
        }
        most = end > most ? end : most;
    }
    return most * VECTOR;
}

// Transpose four vectors of four.
INLINE void transpose(Four& a, Four& b, Four& c, Four& d) {
    const Four ab_low = __builtin_shufflevector(a, b, 0, 4, 1, 5), ab_high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
    const Four cd_low = __builtin_shufflevector(c, d, 0, 4, 1, 5), cd_high = __builtin_shufflevector(c, d, 2, 6, 3, 7);
    a = __builtin_shufflevector(ab_low, cd_low, 0, 1, 4, 5);
    b = __builtin_shufflevector(ab_low, cd_low, 2, 3, 6, 7);
    c = __builtin_shufflevector(ab_high, cd_high, 0, 1, 4, 5);
    d = __builtin_shufflevector(ab_high, cd_high, 2, 3, 6, 7);
}

// Convert four counts to float and reset them to 0.
INLINE void take_counts(std::int32_t* counts, Four& taken) {
    typedef std::int32_t Ints __attribute__((vector_size(sizeof(Four))));
    Ints ints;
    std::memcpy(&ints, counts, sizeof(ints));
    taken = __builtin_convertvector(ints, Four);
    std::memset(counts, 0, sizeof(ints));
}

// Add the beams of a sector to a histogram of their slopes.
template <std::size_t COUNT>
INLINE void add_slopes(const Columns<COUNT>& columns, std::size_t sector, std::uint32_t* bins) {
    const std::uint32_t* first = columns.first + sector * SECTOR_COLUMNS;
    for (std::uint32_t n = first[0]; n < first[SECTOR_COLUMNS]; ++n) {
        const float q = (columns.beams[n].slope + SLOPE_LIMIT) * PER_SLOPE;
        if (q >= 0.0f && q < float(SLOPE_BINS)) ++bins[std::size_t(q)];
    }
}

// Write how many beams of a sector lie below the lower edge of each slope bin.
INLINE void count_slopes(const Job& job, std::size_t sector, std::uint32_t* below) {
    for (std::size_t q = 0; q <= SLOPE_BINS; ++q) below[q] = 0;
    add_slopes(job.measured, sector, below + 1);
    add_slopes(job.lost, sector, below + 1);
    for (std::size_t q = 0; q < SLOPE_BINS; ++q) below[q + 1] += below[q];
}

// Interpolate the number of beams below a slope linearly between bin edges.
INLINE float beams_below(const float* below, float slope) {
    const float at = clamped((slope + SLOPE_LIMIT) * PER_SLOPE, float(SLOPE_BINS) - 0.001f);
    const auto q = std::int32_t(at);
    return below[q] + (at - float(q)) * (below[q + 1] - below[q]);
}

// Sum the beams of one segment cumulatively over its columns, by range bin, and write the sum at each end of a window.
MULTIVERSION void sum_segment(const Job& job, std::size_t segment) {
    const CellWindows& windows = *job.windows;
    const std::size_t bins = windows.bins, stride = windows.stride;
    constexpr std::size_t SECTORS = SEGMENT_COLUMNS / SECTOR_COLUMNS;
    const std::size_t vectors = stride / VECTOR;
    // Cumulative sums (stride,) over the columns so far, the current column's part of them, and the same by lane.
    Buffer<Row> sums(stride), added(stride);
    Buffer<std::int32_t> counts(AIMED * stride);
    Buffer<float> aimed(stride);
    for (std::size_t k = 0; k < stride; ++k) sums[k] = added[k] = Row{};
    std::memset(counts.data(), 0, counts.size() * sizeof(std::int32_t));
    for (std::size_t k = bins; k < stride; ++k) aimed[k] = 0.0f;
    std::size_t filled = 0;  // bins of `added` that are not 0
    // Cumulative slope histograms of the previous, the current and the next sector.
    std::uint32_t below[3][SLOPE_BINS + 1];
    float smooth[SLOPE_BINS + 1];
    const std::size_t first_sector = segment * SECTORS;
    count_slopes(job, (first_sector + GROUND_SECTORS - 1) % GROUND_SECTORS, below[0]);
    count_slopes(job, first_sector, below[1]);

    for (std::size_t step = 0; step < SECTORS; ++step) {
        const std::size_t sector = first_sector + step;
        const float* const limits = job.limits + sector * LIMITS * stride;
        const float* const spans = job.spans + sector * 2 * vectors;
        // Beams that aim at a target in each bin: those below its top minus those below its foot. The sector weighs 1/2
        // and each neighbor 1/4, since firings do not divide evenly among sectors; columns share it equally.
        const std::uint32_t *before = below[step % 3], *own = below[(step + 1) % 3];
        std::uint32_t* const after = below[(step + 2) % 3];
        count_slopes(job, (sector + 1) % GROUND_SECTORS, after);
        for (std::size_t q = 0; q <= SLOPE_BINS; ++q) smooth[q] = 0.25f * float(2 * own[q] + before[q] + after[q]);
        for (std::size_t k = 0; k < bins; ++k) {
            aimed[k] = beams_below(smooth, limits[stride + k]) - beams_below(smooth, limits[k]);
        }
        for (std::size_t k = 0; k < bins; ++k) added[k][AIMED] = aimed[k];

        for (std::size_t c = 0; c < SECTOR_COLUMNS; ++c) {
            const std::size_t column = sector * SECTOR_COLUMNS + c;
            // Count the column's beams, then interleave the lanes of each bin.
            std::int32_t *const lower = &counts[LOWER * stride], *const higher = &counts[HIGHER * stride];
            std::int32_t *const own = &counts[MEASURED * stride], *const lost = &counts[INFERRED * stride];
            std::size_t most, of_lost;
            if (job.shifted) {
                most = count_column<true>(job.measured, column, limits, stride, spans, own, lower, higher);
                of_lost = count_column<true>(job.lost, column, limits, stride, spans, lost, lower, higher);
            } else {
                most = count_column<false>(job.measured, column, limits, stride, spans, own, lower, higher);
                of_lost = count_column<false>(job.lost, column, limits, stride, spans, lost, lower, higher);
            }
            most = of_lost > most ? of_lost : most;
            const Row counted = {1, 1, 1, 1, 1, 1, 0, 0};
            for (std::size_t k = 0; k < most; k += FOUR) {
                Four measured, inferred, early, late, lower_four, higher_four, aimed_four, none{};
                take_counts(&counts[MEASURED * stride + k], measured);
                take_counts(&counts[INFERRED * stride + k], inferred);
                take_counts(&counts[EARLY * stride + k], early);
                take_counts(&counts[LATE * stride + k], late);
                take_counts(lower + k, lower_four);
                take_counts(higher + k, higher_four);
                std::memcpy(&aimed_four, &aimed[k], sizeof(Four));
                transpose(measured, inferred, early, late);
                transpose(lower_four, higher_four, aimed_four, none);
                Row* const to = &added[k];
                to[0] = __builtin_shufflevector(measured, lower_four, JOINED);
                to[1] = __builtin_shufflevector(inferred, higher_four, JOINED);
                to[2] = __builtin_shufflevector(early, aimed_four, JOINED);
                to[3] = __builtin_shufflevector(late, none, JOINED);
                for (std::size_t b = 0; b < FOUR; ++b) sums[k + b] += counted * to[b];
            }
            const Row aims = {0, 0, 0, 0, 0, 0, 1, 0};
            for (std::size_t k = most; k < filled; ++k) added[k] *= aims;
            filled = most;
            // Interpolate the sum at each window edge in this column: the sum after the column minus the part of the
            // column beyond the edge. AIMED counts are spread over the sector, and summed after it.
            const float share = 1.0f / SECTOR_COLUMNS;
            const Row scale = {1, 1, 1, 1, 1, 1, share, 0}, offset = {-1, -1, -1, -1, -1, -1, float(c) * share, 0};
            for (std::size_t e = windows.first_begin[column]; e < windows.first_begin[column + 1]; ++e) {
                const CellWindows::End& end = windows.begins[e];
                job.rows[end.row] = -(sums[end.bin] + (scale * end.part + offset) * added[end.bin]);
            }
            for (std::size_t e = windows.first_end[column]; e < windows.first_end[column + 1]; ++e) {
                const CellWindows::End& end = windows.ends[e];
                // The end of a crossing window has its own row, since another thread may write its begin.
                const Row before = end.row < windows.cells() ? job.rows[end.row] : Row{};
                job.rows[end.row] = before + (sums[end.bin] + (scale * end.part + offset) * added[end.bin]);
            }
        }
        for (std::size_t k = 0; k < bins; ++k) sums[k][AIMED] += aimed[k];
    }
    std::memcpy(static_cast<void*>(job.totals + segment * bins), sums.data(), bins * sizeof(Row));
}

}  // namespace

CellWindows::CellWindows(View2<const float> range, View2<const float> azimuth_, double cell_m_, double width_m)
    : grid_rows(range.rows), grid_columns(range.columns), cell_m(float(cell_m_)),
      cell_range_m(range.data, range.data + range.size()) {
    const View1<const float> range_m = range.flat(), azimuth = azimuth_.flat();
    const double bins_a_radian = bins_per_rad(NARROWEST_BINS), last_bin = double(NARROWEST_BINS - 1);
    for (const float a : azimuth) cell_bin.push_back(std::int16_t(azimuth_bin(a, bins_a_radian, last_bin)));
    constexpr double PER_RAD = AZIMUTH_COLUMNS / (2 * std::numbers::pi);
    float farthest_m = 0.0f;
    for (const float r : cell_range_m) farthest_m = std::max(farthest_m, r);
    require(double(farthest_m) / cell_m_ < MAX_RANGE_BINS, "cells must lie within a million sides of a cell");
    bins = std::size_t(std::ceil(double(farthest_m) / cell_m_)) + 1;
    stride = (bins + VECTOR - 1) / VECTOR * VECTOR;
    // Centers of the range bins, and half of the target's width there in columns.
    std::vector<double> half(bins);
    for (std::size_t k = 0; k < stride; ++k) {
        const double middle_m = (double(k) + 0.5) * cell_m_;
        bin_range_m.push_back(float(middle_m));
        per_range.push_back(float(1.0 / middle_m));
        if (k < bins) half[k] = std::atan2(width_m / 2, middle_m) * PER_RAD;
    }
    // Both ends of each window, in columns; segments are numbered on across turns.
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
    // Sort the ends by column, then by cell.
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

void CellCounts::read(std::size_t first, std::size_t count, float (*lanes)[BLOCK]) const {
    for (std::size_t n = 0; n < count; n += FOUR) {
        const Row* const of = &rows[first + n];
        Four low[FOUR], high[FOUR];
        for (std::size_t k = 0; k < FOUR; ++k) {
            low[k] = __builtin_shufflevector(of[k], of[k], 0, 1, 2, 3);
            high[k] = __builtin_shufflevector(of[k], of[k], 4, 5, 6, 7);
        }
        transpose(low[0], low[1], low[2], low[3]);
        transpose(high[0], high[1], high[2], high[3]);
        for (std::size_t lane = 0; lane < LANES; ++lane) {
            std::memcpy(&lanes[lane][n], lane < FOUR ? &low[lane] : &high[lane - FOUR], sizeof(Four));
        }
    }
    // Add the ends of windows that cross segments, and the totals of the segments between.
    const auto by_cell = [](const CellWindows::Crossing& a, std::size_t cell) { return a.cell < cell; };
    auto at = std::lower_bound(windows->crossings.begin(), windows->crossings.end(), first, by_cell);
    for (; at != windows->crossings.end() && at->cell < first + count; ++at) {
        Row sum = rows[windows->cells() + std::size_t(at - windows->crossings.begin())];
        for (std::uint32_t k = 0; k < at->count; ++k) {
            sum += totals[(at->first + k) % SEGMENTS * windows->bins + at->bin];
        }
        const std::size_t n = at->cell - first;
        for (std::size_t lane = 0; lane < LANES; ++lane) lanes[lane][n] += sum[lane];
    }
}

CellCounts count_beams(const CellWindows& windows, const Beams& measured, const LostBeams& lost, const TargetGround& ground,
                       float target_height_m, const std::array<float, 2>* deviations) {
    const std::size_t parts = count_parts(measured.azimuth.size + lost.azimuth.size + windows.cells(), WORTH);

    // 1. The slopes of a target's foot and top, by sector and range.
    const std::size_t stride = windows.stride, vectors = stride / VECTOR;
    Buffer<float> limits(GROUND_SECTORS * LIMITS * stride), spans(GROUND_SECTORS * 2 * vectors);
    std::array<float, GROUND_SECTORS> highest;
    for_ranges(GROUND_SECTORS, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t sector = begin; sector < end; ++sector) {
            float *const of_sector = &limits[sector * LIMITS * stride], *const span = &spans[sector * 2 * vectors];
            write_limits(windows, ground, target_height_m, deviations ? deviations->data() : nullptr, sector, of_sector);
            highest[sector] = write_spans(of_sector, stride, span, span + vectors);
        }
    });
    // 2. Beams by column. Beams above every target aim at none; the margin of one slope bin covers the interpolation.
    const float most = *std::max_element(highest.begin(), highest.end()) + 1.0f / PER_SLOPE;
    const SortedBeams<1> by_column(measured.azimuth, measured.slope, {measured.depth_m}, most, windows);
    const SortedBeams<DEPTHS> lost_by_column(lost.azimuth, lost.slope, lost.depth_m, most, windows);
    // 3. Sums over the columns of each segment.
    CellCounts counts{&windows, Buffer<Row>(windows.rows() + FOUR), Buffer<Row>(SEGMENTS * windows.bins)};
    const Job job{&windows,
                  by_column.columns(),
                  lost_by_column.columns(),
                  limits.data(),
                  spans.data(),
                  deviations != nullptr,
                  counts.rows.data(),
                  counts.totals.data()};
    if (parts <= 1) {
        for (std::size_t segment = 0; segment < SEGMENTS; ++segment) sum_segment(job, segment);
    } else {
        run_parts(SEGMENTS, [&](std::size_t segment) { sum_segment(job, segment); });
    }
    return counts;
}

}  // namespace viewshed
