#include "calibration.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <iterator>

#include "evidence.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Network parameters: MEAN and SCALE of features, weights and bias of two layers, by `tools/fit_calibration.py fit`.
#include "calibration_network.inc"

constexpr std::size_t UNITS = std::size(FIRST_BIAS);
static_assert(std::size(MEAN) == SHOWN_FEATURES && std::size(SCALE) == SHOWN_FEATURES && std::size(SECOND_BIAS) == 1);
static_assert(std::size(FIRST) == SHOWN_FEATURES * UNITS && std::size(SECOND) == UNITS);

// Sweep features are clipped sooner than cell features: the fit saw few places, but many cells in each.
constexpr float MAX_SWEEP_DEVIATIONS = 2.0f;

// Added to the relief in meters: flatter ground makes no difference.
constexpr double MIN_RELIEF_M = 0.1;

// Half widths in cells of the box filter, which is applied twice.
constexpr std::size_t NEAR_CELLS = 2, WIDE_CELLS = 6;

// Limits of the range features: smaller shares and farther ranges carry no more information.
constexpr float MIN_SHARE = 0.05f, FARTHEST_M = 200.0f, MIN_RANGE_M = 0.5f;

// Offset that keeps logits of 0 and 1 finite.
constexpr float PROB_OFFSET = 0.01f;

// Fewest cells for which a part pays for its thread.
constexpr std::size_t PART = 8192;

INLINE float logit_of(float prob) {
    const float p = prob < 1.0f ? (prob > 0.0f ? prob : 0.0f) : 1.0f;
    return log2_of((p + PROB_OFFSET) / (1.0f + PROB_OFFSET - p));
}

// Write means (columns,) over 2 · half + 1 neighbors of a row; padded (columns + 2 · half,) repeats its ends.
MULTIVERSION void average_row(const float* __restrict padded, std::size_t columns, std::size_t half, float* __restrict means) {
    const float share = 1.0f / float(2 * half + 1);
    for (std::size_t c = 0; c < columns; ++c) means[c] = padded[c];
    for (std::size_t k = 1; k <= 2 * half; ++k) {
        for (std::size_t c = 0; c < columns; ++c) means[c] += padded[c + k];
    }
    for (std::size_t c = 0; c < columns; ++c) means[c] *= share;
}

// Write means of columns from their sums, then add the entering row to the sums and subtract the leaving one.
MULTIVERSION void move_sums(const float* __restrict entering, const float* __restrict leaving, std::size_t columns, float share,
                            double* __restrict sums, float* __restrict means) {
    for (std::size_t c = 0; c < columns; ++c) means[c] = float(sums[c]) * share;
    for (std::size_t c = 0; c < columns; ++c) sums[c] += double(entering[c]) - double(leaving[c]);
}

// Return values (rows, columns) averaged over squares, twice.
Buffer<float> averaged(View2<const float> values, std::size_t half) {
    Buffer<float> means(values.size()), rows_averaged(values.size());
    const std::size_t rows = values.rows, columns = values.columns;
    const float share = 1.0f / float(2 * half + 1);
    const std::size_t parts = count_parts(values.size(), PART);
    View2<const float> from = values;
    for (int pass = 0; pass < 2; ++pass) {
        for_ranges(rows, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
            Buffer<float> padded(columns + 2 * half);
            for (std::size_t r = begin; r < end; ++r) {
                std::fill_n(padded.data(), half, from(r, 0));
                std::copy_n(from[r], columns, padded.data() + half);
                std::fill_n(padded.data() + half + columns, half, from(r, columns - 1));
                average_row(padded.data(), columns, half, &rows_averaged[r * columns]);
            }
        });
        for_ranges(columns, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
            const auto row = [&](std::size_t r) { return &rows_averaged[std::min(r, rows - 1) * columns + begin]; };
            Buffer<double> sums(end - begin, 0.0);
            for (std::size_t k = 0; k <= 2 * half; ++k) {
                const float* const own = row(k < half ? 0 : k - half);
                for (std::size_t c = 0; c < end - begin; ++c) sums[c] += double(own[c]);
            }
            for (std::size_t r = 0; r < rows; ++r) {
                move_sums(row(r + half + 1), row(r < half ? 0 : r - half), end - begin, share, sums.data(),
                          &means[r * columns + begin]);
            }
        });
        from = {means.data(), rows, columns};
    }
    return means;
}

// Ranges by NARROWEST_BINS, repeated from the wider bins that the returns fill.
struct Limits {
    Buffer<float> blocker_m{NARROWEST_BINS}, farthest_m{NARROWEST_BINS};

    explicit Limits(const LeveledReturns& returns) {
        const BinRanges filled = find_ranges(returns, 0);
        for (std::size_t b = 0; b < NARROWEST_BINS; ++b) {
            const std::size_t of = b * filled.bins() / NARROWEST_BINS;
            blocker_m[b] = std::min(filled.nearest_m[of], FARTHEST_M), farthest_m[b] = filled.farthest_m[of];
        }
    }
};

// Inputs of the cell features.
struct Scene {
    const CellWindows& windows;
    const CellEvidence& evidence;
    Limits limits;
    Buffer<float> near, wide;

    Scene(const CellWindows& of, const CellEvidence& cells, const LeveledReturns& returns)
        : windows(of),
          evidence(cells),
          limits(returns),
          near(averaged({cells.counted_prob, of.grid_rows, of.grid_columns}, NEAR_CELLS)),
          wide(averaged({near.data(), of.grid_rows, of.grid_columns}, WIDE_CELLS)) {}
};

constexpr std::size_t CELLS = CellCounts::BLOCK;

// Write features (size,), each in its own loop over non-overlapping arrays, so that it vectorizes.
MULTIVERSION void write_logits(const float* __restrict prob, std::size_t size, float* __restrict feature) {
    for (std::size_t n = 0; n < size; ++n) feature[n] = logit_of(prob[n]);
}

MULTIVERSION void write_logs(const float* __restrict counts, std::size_t size, float* __restrict feature) {
    for (std::size_t n = 0; n < size; ++n) feature[n] = log2_of(1.0f + (counts[n] > 0.0f ? counts[n] : 0.0f));
}

MULTIVERSION void add(const float* __restrict a, const float* __restrict b, std::size_t size, float* __restrict sum) {
    for (std::size_t n = 0; n < size; ++n) sum[n] = a[n] + b[n];
}

// Write log ratios of limit ranges to cell ranges.
MULTIVERSION void write_shares(const float* __restrict limit_m, const float* __restrict cell_range_m, std::size_t size,
                               float* __restrict feature) {
    for (std::size_t n = 0; n < size; ++n) {
        const float range_m = cell_range_m[n] > MIN_RANGE_M ? cell_range_m[n] : MIN_RANGE_M;
        const float share = limit_m[n] / range_m;
        feature[n] = log2_of(share > MIN_SHARE ? share : MIN_SHARE);
    }
}

MULTIVERSION void write_away(const float* __restrict limit_m, const float* __restrict cell_range_m, std::size_t size,
                             float* __restrict feature) {
    for (std::size_t n = 0; n < size; ++n) {
        const float away_m = limit_m[n] - cell_range_m[n], size_m = away_m < 0.0f ? -away_m : away_m;
        const float log = log2_of(1.0f + size_m);
        feature[n] = away_m < 0.0f ? -log : log;
    }
}

// Write the features of cells from `first` on, one row of CELLS each.
void describe_block(const Scene& scene, std::size_t first, std::size_t size, float* feature) {
    const CellEvidence& of = scene.evidence;
    const float* const range_m = &scene.windows.cell_range_m[first];
    const auto row = [&](CellFeature k) { return feature + k * CELLS; };
    float blocker_m[CELLS], farthest_m[CELLS], likely[CELLS], late[CELLS];
    for (std::size_t n = 0; n < size; ++n) {
        const auto bin = std::size_t(scene.windows.cell_bin[first + n]);
        blocker_m[n] = scene.limits.blocker_m[bin], farthest_m[n] = scene.limits.farthest_m[bin];
    }
    add(of.measured + first, of.inferred + first, size, likely);
    add(of.measured + first, of.late + first, size, late);
    write_logits(of.counted_prob + first, size, row(CELL_PROB));
    write_logits(&scene.near[first], size, row(CELL_PROB_NEAR));
    write_logits(&scene.wide[first], size, row(CELL_PROB_WIDE));
    write_logits(of.own_prob + first, size, row(CELL_OWN_PROB));
    write_shares(blocker_m, range_m, size, row(CELL_BLOCKER));
    write_away(blocker_m, range_m, size, row(CELL_BLOCKER_AWAY));
    write_shares(farthest_m, range_m, size, row(CELL_FARTHEST));
    write_logs(of.aimed + first, size, row(CELL_BEAMS_AIMED));
    write_logs(of.measured + first, size, row(CELL_BEAMS_MEASURED));
    write_logs(likely, size, row(CELL_BEAMS_LIKELY));
    write_logs(late, size, row(CELL_BEAMS_LATE));
    write_logs(range_m, size, row(CELL_RANGE));
}

// Write the sums (CELL_FEATURES + 1,) of features (CELL_FEATURES, CELLS) over cells at which beams aim, and their
// number last. Lanes are summed one by one, so that sums are equal on every processor; features beyond `size` are 0.
MULTIVERSION void sum_aimed(const float* __restrict feature, const float* __restrict aimed, std::size_t size, double* sums) {
    float counts[CELLS] = {};
    for (std::size_t n = 0; n < size; ++n) counts[n] = aimed[n] > 0.0f ? 1.0f : 0.0f;
    for (std::size_t k = 0; k <= CELL_FEATURES; ++k) {
        Lanes sum{};
        for (std::size_t n = 0; n < CELLS; n += AT_ONCE) {
            Lanes count, value = Lanes{} + 1.0f;
            std::memcpy(&count, counts + n, sizeof(Lanes));
            if (k < CELL_FEATURES) std::memcpy(&value, feature + k * CELLS + n, sizeof(Lanes));
            sum += count * value;
        }
        sums[k] = 0.0;
        for (std::size_t j = 0; j < AT_ONCE; ++j) sums[k] += double(sum[j]);
    }
}

// Return the standard deviation of the ground heights.
double relief_of(View2<const float> heights_m) {
    double sum = 0.0, squares = 0.0;
    for (const float height_m : heights_m.flat()) sum += double(height_m), squares += double(height_m) * double(height_m);
    const double count = double(std::max<std::size_t>(heights_m.size(), 1)), mean = sum / count;
    return std::sqrt(std::max(squares / count - mean * mean, 0.0));
}

// Features of cells, block by block (CELL_FEATURES, CELLS), and of the sweep.
struct Description {
    std::size_t blocks;
    Buffer<float> cells;
    float sweep[SWEEP_FEATURES];

    Description(const Scene& scene, View2<const float> heights_m)
        : blocks((scene.windows.cells() + CELLS - 1) / CELLS), cells(blocks * CELL_FEATURES * CELLS) {
        constexpr std::size_t SUMS = CELL_FEATURES + 1;
        const std::size_t count = scene.windows.cells();
        Buffer<double> sums(blocks * SUMS);
        for_ranges(blocks, count_parts(count, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
            for (std::size_t block = begin; block < end; ++block) {
                const std::size_t at = block * CELLS, size = std::min(CELLS, count - at);
                if (size < CELLS) std::fill_n(of(block), CELL_FEATURES * CELLS, 0.0f);
                describe_block(scene, at, size, of(block));
                sum_aimed(of(block), scene.evidence.aimed + at, size, &sums[block * SUMS]);
            }
        });
        double all[SUMS] = {};
        for (std::size_t n = 0; n < blocks * SUMS; ++n) all[n % SUMS] += sums[n];
        for (std::size_t k = 0; k < CELL_FEATURES; ++k) sweep[k] = float(all[k] / std::max(all[CELL_FEATURES], 1.0));
        sweep[SWEEP_RELIEF] = log2_of(float(MIN_RELIEF_M + relief_of(heights_m)));
    }

    float* of(std::size_t block) { return &cells[block * CELL_FEATURES * CELLS]; }
};

// Standardize and clip a feature.
INLINE float standardized(float feature, std::size_t k, float limit) {
    const float value = (feature - MEAN[k]) * SCALE[k];
    const float high = value < limit ? value : limit;
    return high > -limit ? high : -limit;
}

// Return the first layer's bias for a sweep: the sweep features contribute equally to all its cells.
std::array<float, UNITS> bias_of(const float* sweep) {
    std::array<float, UNITS> bias;
    std::copy_n(FIRST_BIAS, UNITS, bias.begin());
    for (std::size_t k = 0; k < SWEEP_FEATURES; ++k) {
        const float value = standardized(sweep[k], CELL_FEATURES + k, MAX_SWEEP_DEVIATIONS);
        for (std::size_t u = 0; u < UNITS; ++u) bias[u] += value * FIRST[(CELL_FEATURES + k) * UNITS + u];
    }
    return bias;
}

// Write the logits of cells from their features (CELL_FEATURES, CELLS) and the sweep's bias, AT_ONCE at a time.
MULTIVERSION void run_network(const float* __restrict feature, const float* __restrict bias, std::size_t size,
                              float* __restrict logit) {
    for (std::size_t n = 0; n < size; n += AT_ONCE) {
        Lanes in[CELL_FEATURES];
        for (std::size_t k = 0; k < CELL_FEATURES; ++k) {
            float standard[AT_ONCE];
            for (std::size_t j = 0; j < AT_ONCE; ++j) standard[j] = standardized(feature[k * CELLS + n + j], k, MAX_DEVIATIONS);
            std::memcpy(&in[k], standard, sizeof(Lanes));
        }
        Lanes sum = Lanes{} + SECOND_BIAS[0];
        for (std::size_t u = 0; u < UNITS; ++u) {
            Lanes unit = Lanes{} + bias[u];
            for (std::size_t k = 0; k < CELL_FEATURES; ++k) unit += in[k] * FIRST[k * UNITS + u];
            unit = unit > 0.0f ? unit : Lanes{};
            sum += unit * SECOND[u];
        }
        std::memcpy(logit + n, &sum, sizeof(Lanes));
    }
}

// Write the probabilities of the cells from `first` on from their logits.
MULTIVERSION void decide(const float* __restrict logit, const CellEvidence& evidence, const std::uint8_t* __restrict within_reach,
                         std::size_t first, std::size_t size, float below, float* __restrict prob) {
    const float *__restrict counted = evidence.counted_prob + first, *__restrict aimed = evidence.aimed + first;
    const float* __restrict own = evidence.own_prob + first;
    for (std::size_t n = 0; n < size; ++n) {
        const float low = logit[n] < 20.0f ? logit[n] : 20.0f, x = low > -20.0f ? low : -20.0f;
        const float calibrated = 1.0f / (1.0f + exp_of(-x));
        const std::uint8_t supported = (own[n] >= THRESHOLD) & within_reach[n];
        const float least = supported & (counted[n] >= THRESHOLD) ? THRESHOLD : 0.0f, most = supported ? 1.0f : below;
        const float at_least = calibrated > least ? calibrated : least, said = at_least < most ? at_least : most;
        const bool is_silent = (counted[n] <= 0.0f) & (aimed[n] <= 0.0f);
        prob[n] = is_silent ? 0.0f : said;
    }
}

}  // namespace

void describe_cells(const CellWindows& windows, const CellEvidence& evidence, const LeveledReturns& returns,
                    View2<const float> heights_m, View2<float> feature) {
    Description description(Scene(windows, evidence, returns), heights_m);
    for (std::size_t k = 0; k < CELL_FEATURES; ++k) {
        for (std::size_t n = 0; n < windows.cells(); ++n) feature(k, n) = description.of(n / CELLS)[k * CELLS + n % CELLS];
    }
    for (std::size_t k = 0; k < SWEEP_FEATURES; ++k) {
        std::fill_n(feature[CELL_FEATURES + k], windows.cells(), description.sweep[k]);
    }
}

void calibrate(const CellWindows& windows, const CellEvidence& evidence, const bool* within_reach,
               const LeveledReturns& returns, View2<const float> heights_m, View1<float> prob) {
    Description description(Scene(windows, evidence, returns), heights_m);
    const auto bias = bias_of(description.sweep);
    const float below = std::nextafter(THRESHOLD, 0.0f);
    const auto* const is_within = reinterpret_cast<const std::uint8_t*>(within_reach);
    for_ranges(description.blocks, count_parts(windows.cells(), PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        float logit[CELLS];
        for (std::size_t block = begin; block < end; ++block) {
            const std::size_t at = block * CELLS, size = std::min(CELLS, windows.cells() - at);
            run_network(description.of(block), bias.data(), size, logit);
            decide(logit, evidence, is_within + at, at, size, below, &prob[at]);
        }
    });
}

}  // namespace viewshed
