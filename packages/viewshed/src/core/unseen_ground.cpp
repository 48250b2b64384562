#include "unseen_ground.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <numbers>
#include <vector>

#include "parallel.hpp"
#include "polar_network.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// The network's weights, by `tools/fit_ground.py fit`.
#include "ground_network.inc"

constexpr float NONE = std::numeric_limits<float>::infinity();

// Heights enter and leave the network in units that grow with range, and are clipped to this many of them.
constexpr float UNIT_M = 0.25f, UNIT_PER_M = 0.04f, MAX_UNITS = 6.0f;

// Ground may lie this far above a beam that passes: the tolerance of bins.
constexpr float OVER_BEAM_M = 0.1f;

// A beam that ends this far below the line of sight over seen ground did not go straight: it was mirrored, or moved.
constexpr float BURIED_M = 0.3f;

// Standard deviations of a normal distribution between its quantiles .15 and .85. The predicted ones are widened: in scenes
// unlike those of the fit the network is too sure. The development set's roads chose the factor (`tools/fit_calibration.py
// judge`); surveyed ground would ask for more.
constexpr float DEVIATIONS_APART = 2.073f, WIDER = 1.6f;

// The network sees 2 × 2 bins as one pixel; channels of a bin, and its outputs.
constexpr std::size_t FOLD = 2, CHANNELS = 13, OUTPUTS = 3;

// Fewest bins or nodes for which a part pays for its thread.
constexpr std::size_t PART = 4096;

// Slopes flatter than this aim at no ground.
constexpr float FLAT_SLOPE = 1e-3f, MIN_RANGE_M = 1e-3f;

// Middle of each bin: range, its logarithm, unit of heights, direction.
struct Bins {
    std::array<float, RANGE_BINS> range_m, unit_m, log_range;
    std::array<float, AZIMUTH_BINS> cos, sin;

    Bins() {
        for (std::size_t k = 0; k < RANGE_BINS; ++k) {
            range_m[k] = NEAREST_M * std::exp2((float(k) + 0.5f) / float(BINS_OF_OCTAVE));
            unit_m[k] = UNIT_M + UNIT_PER_M * range_m[k];
            log_range[k] = std::log(range_m[k]);
        }
        for (std::size_t a = 0; a < AZIMUTH_BINS; ++a) {
            const double azimuth = (double(a) + 0.5) * (2 * std::numbers::pi / AZIMUTH_BINS) - std::numbers::pi;
            cos[a] = float(std::cos(azimuth));
            sin[a] = float(std::sin(azimuth));
        }
    }
};

const Bins& bins() {
    static const Bins bins;
    return bins;
}

INLINE float range_place(float range_m) {
    constexpr float LOG_NEAREST = 0.5849625f;
    return float(BINS_OF_OCTAVE) * (log2_of(range_m > MIN_RANGE_M ? range_m : MIN_RANGE_M) - LOG_NEAREST);
}

// Return the bin of a range: -1 before the first, RANGE_BINS after the last.
INLINE std::int32_t range_bin(float range_m) {
    const float place = range_place(range_m), most = float(RANGE_BINS);
    return std::int32_t(place < 0.0f ? -1.0f : (place < most ? place : most));
}

INLINE float azimuth_place(float azimuth) { return (azimuth + PI) * float(AZIMUTH_BINS / (2 * std::numbers::pi)); }

// Bins of the returns of a block: of azimuth, of range, and of the range of level ground at which the beam aims.
struct Places {
    std::int32_t azimuth[BLOCK], range[BLOCK], aim[BLOCK];
    float slope[BLOCK];
};

MULTIVERSION void find_places(const float* points, const float* azimuth, const float* range_m, std::size_t count,
                              float sensor_height_m, Places& places) {
    for (std::size_t k = 0; k < count; ++k) {
        const float place = azimuth_place(azimuth[k]), last = float(AZIMUTH_BINS - 1);
        places.azimuth[k] = std::int32_t(place > 0.0f ? (place < last ? place : last) : 0.0f);
        places.range[k] = range_bin(range_m[k]);
        const float range = range_m[k] > MIN_RANGE_M ? range_m[k] : MIN_RANGE_M;
        const float slope = (points[3 * k + 2] - sensor_height_m) / range;
        const float down = slope < -FLAT_SLOPE ? -slope : FLAT_SLOPE;
        places.slope[k] = slope;
        places.aim[k] = range_bin(slope < -FLAT_SLOPE ? sensor_height_m / down : 1e6f);
    }
}

// Write heights of seen ground and whether it is seen: the seen ones of the four nodes around the middle of each bin.
void map_seen(const SeenNodes& nodes, float* seen, float* height_m) {
    const Bins& at = bins();
    const auto n = std::int32_t(nodes.seen.rows);
    const float half_m = nodes.half_extent_m, per_m = float(n) / (2.0f * half_m), last = float(n) - 1.001f;
    for (std::size_t a = 0; a < AZIMUTH_BINS; ++a) {
        for (std::size_t k = 0; k < RANGE_BINS; ++k) {
            const float x = at.cos[a] * at.range_m[k], y = at.sin[a] * at.range_m[k];
            const std::size_t bin = a * RANGE_BINS + k;
            seen[bin] = height_m[bin] = 0.0f;
            if (!(std::fabs(x) < half_m && std::fabs(y) < half_m)) continue;
            const float u = (x + half_m) * per_m, v = (y + half_m) * per_m;
            if (!nodes.seen(std::min(std::size_t(u), std::size_t(n) - 1), std::min(std::size_t(v), std::size_t(n) - 1))) continue;
            const float p = std::clamp(u - 0.5f, 0.0f, last), q = std::clamp(v - 0.5f, 0.0f, last);
            const auto i = std::size_t(p), j = std::size_t(q);
            const float down = p - float(i), right = q - float(j);
            float sum = 0.0f, weights = 0.0f;
            for (std::size_t corner = 0; corner < 4; ++corner) {
                const std::size_t row = i + corner / 2, column = j + corner % 2;
                if (!nodes.seen(row, column)) continue;
                const float weight = (corner / 2 ? down : 1.0f - down) * (corner % 2 ? right : 1.0f - right);
                sum += weight * nodes.heights_m(row, column);
                weights += weight;
            }
            seen[bin] = 1.0f;
            height_m[bin] = sum / weights;
        }
    }
}

// Base surface: the seen heights, and between them averages over ever coarser bins (pull-push).
class Pyramid {
public:
    Pyramid(const float* seen, const float* height_m) {
        levels_.emplace_back(AZIMUTH_BINS, RANGE_BINS);
        for (std::size_t bin = 0; bin < POLAR_BINS; ++bin) {
            levels_[0].weight[bin] = seen[bin];
            levels_[0].height_m[bin] = seen[bin] * height_m[bin];
        }
        while (levels_.back().rows > 1 || levels_.back().columns > 1) pull();
        for (std::size_t k = levels_.size() - 1; k-- > 0;) push(levels_[k + 1], levels_[k]);
    }
    const Buffer<float>& base_m() const { return levels_[0].height_m; }

private:
    struct Level {
        Level(std::size_t rows_, std::size_t columns_)
            : rows(rows_), columns(columns_), height_m(rows * columns), weight(rows * columns) {}
        std::size_t rows, columns;
        Buffer<float> height_m, weight;
    };

    static std::size_t ratio_of(std::size_t size) { return size % 2 == 0 ? 2 : (size % 3 == 0 ? 3 : 1); }

    // Add a coarser level: weighted means, and weights of at most 1.
    void pull() {
        const Level& fine = levels_.back();
        const std::size_t down = fine.rows % 2 == 0 ? 2 : 1, across = ratio_of(fine.columns);
        Level coarse(fine.rows / down, fine.columns / across);
        for (std::size_t i = 0; i < coarse.rows; ++i) {
            for (std::size_t j = 0; j < coarse.columns; ++j) {
                float sum = 0.0f, weights = 0.0f;
                for (std::size_t p = i * down; p < (i + 1) * down; ++p) {
                    for (std::size_t q = j * across; q < (j + 1) * across; ++q) {
                        const float weight = fine.weight[p * fine.columns + q];
                        sum += weight * fine.height_m[p * fine.columns + q];
                        weights += weight;
                    }
                }
                coarse.height_m[i * coarse.columns + j] = weights > 0.0f ? sum / weights : 0.0f;
                coarse.weight[i * coarse.columns + j] = std::min(weights, 1.0f);
            }
        }
        levels_.push_back(std::move(coarse));
    }

    // Fill the missing weight of the finer level, bilinear between the coarser means.
    static void push(const Level& coarse, Level& fine) {
        const std::size_t down = fine.rows / coarse.rows, across = fine.columns / coarse.columns;
        for (std::size_t i = 0; i < fine.rows; ++i) {
            // The coarse row that holds this one weighs 3/4, the next one on its side 1/4; rows wrap around.
            const std::size_t near = i / down, step = i % 2 == 0 ? coarse.rows - 1 : 1;
            const std::size_t far = down == 2 ? (near + step) % coarse.rows : near;
            const float *at = &coarse.height_m[near * coarse.columns], *beside = &coarse.height_m[far * coarse.columns];
            for (std::size_t j = 0; j < fine.columns; ++j) {
                const std::size_t left = j / across;
                std::size_t right = left;
                if (across == 2) right = j % 2 == 0 ? left - (left > 0) : left + (left + 1 < coarse.columns);
                const float here = 0.75f * at[left] + 0.25f * beside[left];
                const float next = 0.75f * at[right] + 0.25f * beside[right];
                const std::size_t node = i * fine.columns + j;
                const float weight = fine.weight[node];
                fine.height_m[node] = weight * fine.height_m[node] + (1.0f - weight) * (0.75f * here + 0.25f * next);
            }
        }
    }

    std::vector<Level> levels_;
};

INLINE float clipped(float value) {
    value = value > -MAX_UNITS ? value : -MAX_UNITS;
    return value < MAX_UNITS ? value : MAX_UNITS;
}

constexpr float LN2 = std::numbers::ln2_v<float>;

// Write the channels (CHANNELS, RANGE_BINS) of the bins of one azimuth.
MULTIVERSION void describe_azimuth(const float* maps, const float* base_m, const Bins& at, float sensor_height_m, float log_height,
                                   float (*to)[RANGE_BINS]) {
    const auto map = [maps](Map which) { return maps + std::size_t(which) * POLAR_BINS; };
    const float *count = map(RETURNS), *lowest = map(LOWEST), *second = map(SECOND_LOWEST), *highest = map(HIGHEST);
    const float *seen = map(SEEN), *passing = map(PASSING), *aimed = map(AIMED);
    for (std::size_t k = 0; k < RANGE_BINS; ++k) {
        const float base = base_m[k], per_unit = 1.0f / at.unit_m[k], has = count[k] > 0.0f ? 1.0f : 0.0f;
        const float passes = passing[k] < NONE ? 1.0f : 0.0f;
        to[0][k] = has;
        to[1][k] = log2_of(1.0f + count[k]) * (LN2 / 3.0f);
        to[2][k] = has * clipped((lowest[k] - base) * per_unit);
        to[3][k] = has * clipped((second[k] - base) * per_unit);
        to[4][k] = has * clipped((highest[k] - base) * per_unit);
        to[5][k] = seen[k];
        to[6][k] = clipped((passing[k] - base) * per_unit);
        to[7][k] = passes;
        to[8][k] = log2_of(1.0f + aimed[k]) * (LN2 / 2.0f);
        to[9][k] = clipped(base * per_unit);
        to[10][k] = clipped((sensor_height_m - base) * per_unit);
        to[11][k] = log_height;
        to[12][k] = at.log_range[k] * 0.5f - 1.2f;
    }
}

INLINE float softplus(float x) { return x > 20.0f ? x : LN2 * log2_of(1.0f + exp_of(x)); }

// Write the quantiles of the bins of one azimuth, from outputs (OUTPUTS, RANGE_BINS).
MULTIVERSION void read_azimuth(const float (*from)[RANGE_BINS], const float* passing, const float* base_m, const Bins& at,
                               float* low_m, float* height_m, float* high_m) {
    for (std::size_t k = 0; k < RANGE_BINS; ++k) {
        const float median = from[0][k], most = passing[k] + OVER_BEAM_M, unit = at.unit_m[k], base = base_m[k];
        const float low = base + unit * (median - softplus(from[1][k] - 1.0f)), middle = base + unit * median;
        const float high = base + unit * (median + softplus(from[2][k] - 1.0f));
        low_m[k] = low < most ? low : most;
        height_m[k] = middle < most ? middle : most;
        high_m[k] = high < most ? high : most;
    }
}

// Write the predicted heights and standard deviations (n, n) of the nodes that are not seen.
void fill_unseen(const PredictedGround& predicted, const Lattice& lattice, View1<const bool> seen, View1<float> heights_m,
                 View1<float> std_m) {
    constexpr float PER_SECTOR = float(AZIMUTH_BINS) / float(SECTORS);
    const auto fill = [&](std::size_t node) {
        if (seen[node]) return;
        // Bilinear between the middles of bins; azimuths wrap around.
        const float turn = lattice.azimuth[node] * PER_SECTOR + float(AZIMUTH_BINS) - 0.5f;
        const float place = std::clamp(range_place(lattice.range_m[node]) - 0.5f, 0.0f, float(RANGE_BINS) - 1.001f);
        const auto a = std::size_t(turn), k = std::size_t(place);
        const float across = turn - float(a), along = place - float(k);
        const std::size_t row = a % AZIMUTH_BINS * RANGE_BINS + k, next = (a + 1) % AZIMUTH_BINS * RANGE_BINS + k;
        const auto between = [&](const Buffer<float>& of) {
            const float here = of[row] + along * (of[row + 1] - of[row]), there = of[next] + along * (of[next + 1] - of[next]);
            return here + across * (there - here);
        };
        heights_m[node] = between(predicted.height_m);
        std_m[node] = (between(predicted.high_m) - between(predicted.low_m)) * (WIDER / DEVIATIONS_APART);
    };
    for_ranges(lattice.size(), count_parts(lattice.size(), PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t node = begin; node < end; ++node) fill(node);
    });
}

}  // namespace

Buffer<float> map_returns(const ReturnsAround& returns, const SeenNodes& nodes) {
    Buffer<float> maps(MAPS * POLAR_BINS, 0.0f);
    const auto map = [&maps](Map which) { return &maps[std::size_t(which) * POLAR_BINS]; };
    float *count = map(RETURNS), *lowest = map(LOWEST), *second = map(SECOND_LOWEST), *highest = map(HIGHEST);
    float *passing = map(PASSING), *aimed = map(AIMED);
    constexpr std::size_t ENDS = RANGE_BINS + 2;
    // 1. Slopes by the bin in which a beam ends; the first and the last element are nearer and farther than all bins. The
    // seen ground before that bin bounds the slope of a straight beam.
    map_seen(nodes, map(SEEN), map(SEEN_HEIGHT));
    Buffer<float> least(AZIMUTH_BINS * ENDS, NONE), bound(AZIMUTH_BINS * ENDS);
    for (std::size_t a = 0; a < AZIMUTH_BINS; ++a) {
        float steepest = -NONE;
        bound[a * ENDS] = bound[a * ENDS + 1] = steepest;
        for (std::size_t k = 0; k < RANGE_BINS; ++k) {
            const std::size_t bin = a * RANGE_BINS + k;
            if (map(SEEN)[bin] > 0.0f) {
                const float low_m = map(SEEN_HEIGHT)[bin] - BURIED_M - returns.sensor_height_m;
                steepest = std::max(steepest, low_m / bins().range_m[k]);
            }
            bound[a * ENDS + k + 2] = steepest;
        }
    }
    // 2. Count the returns.
    Places places;
    const std::size_t size = returns.azimuth.size;
    for (std::size_t start = 0; start < size; start += BLOCK) {
        const std::size_t number = std::min(BLOCK, size - start);
        const float* const points = returns.points[start];
        find_places(points, &returns.azimuth[start], &returns.range_m[start], number, returns.sensor_height_m, places);
        for (std::size_t k = 0; k < number; ++k) {
            const auto a = std::size_t(places.azimuth[k]);
            const std::size_t end = a * ENDS + std::size_t(places.range[k] + 1);
            if ((returns.left_out.size && returns.left_out[start + k]) || places.slope[k] < bound[end]) continue;
            least[end] = std::min(least[end], places.slope[k]);
            if (places.aim[k] >= 0 && places.aim[k] < int(RANGE_BINS)) ++aimed[a * RANGE_BINS + std::size_t(places.aim[k])];
            if (places.range[k] < 0 || places.range[k] >= int(RANGE_BINS)) continue;
            const std::size_t bin = a * RANGE_BINS + std::size_t(places.range[k]);
            const float z = points[3 * k + 2];
            if (count[bin] == 0.0f) {
                lowest[bin] = second[bin] = highest[bin] = z;
            } else {
                highest[bin] = std::max(highest[bin], z);
                const float higher = std::max(lowest[bin], z);
                second[bin] = count[bin] == 1.0f ? higher : std::min(second[bin], higher);
                lowest[bin] = std::min(lowest[bin], z);
            }
            ++count[bin];
        }
    }
    // 3. A beam passes over the bins before that of its end; its height there grows with its slope.
    for (std::size_t a = 0; a < AZIMUTH_BINS; ++a) {
        float slope = NONE;
        for (std::size_t k = RANGE_BINS; k-- > 0;) {
            slope = std::min(slope, least[a * ENDS + k + 2]);
            passing[a * RANGE_BINS + k] = slope < NONE ? returns.sensor_height_m + slope * bins().range_m[k] : NONE;
        }
    }
    return maps;
}

PredictedGround predict_ground(View1<const float> maps, float sensor_height_m) {
    static const PolarNetwork network(GROUND_NETWORK);
    const Bins& at = bins();
    const auto map = [&maps](Map which) { return &maps[std::size_t(which) * POLAR_BINS]; };
    const Pyramid pyramid(map(SEEN), map(SEEN_HEIGHT));
    const Buffer<float>& base_m = pyramid.base_m();
    // 1. Describe the bins; the channels of 2 × 2 bins are those of one pixel.
    constexpr std::size_t PIXELS = FOLD * FOLD;
    PolarImage input(AZIMUTH_BINS / FOLD, RANGE_BINS / FOLD, CHANNELS * PIXELS);
    const float log_height = std::log(std::max(sensor_height_m, 0.05f) / 1.8f);
    const std::size_t parts = count_parts(POLAR_BINS, PART);
    for_ranges(AZIMUTH_BINS, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        float channels[CHANNELS][RANGE_BINS];
        for (std::size_t a = begin; a < end; ++a) {
            describe_azimuth(&maps[a * RANGE_BINS], &base_m[a * RANGE_BINS], at, sensor_height_m, log_height, channels);
            for (std::size_t k = 0; k < RANGE_BINS; ++k) {
                float* const to = input(a / FOLD, k / FOLD) + a % FOLD * FOLD + k % FOLD;
                for (std::size_t c = 0; c < CHANNELS; ++c) to[c * PIXELS] = channels[c][k];
            }
        }
    });
    // 2. Run the network, and read the quantiles of each bin.
    const PolarImage output = network.run(input);
    PredictedGround predicted;
    for_ranges(AZIMUTH_BINS, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        float outputs[OUTPUTS][RANGE_BINS];
        for (std::size_t a = begin; a < end; ++a) {
            for (std::size_t k = 0; k < RANGE_BINS; ++k) {
                const float* const from = output(a / FOLD, k / FOLD) + a % FOLD * FOLD + k % FOLD;
                for (std::size_t c = 0; c < OUTPUTS; ++c) outputs[c][k] = from[c * PIXELS];
            }
            const std::size_t row = a * RANGE_BINS;
            read_azimuth(outputs, map(PASSING) + row, &base_m[row], at, &predicted.low_m[row], &predicted.height_m[row],
                         &predicted.high_m[row]);
        }
    });
    return predicted;
}

void complete_ground(const ReturnsAround& returns, const Lattice& lattice, View1<const bool> seen, View1<float> heights_m,
                     View1<float> std_m) {
    const std::size_t n = lattice.nodes;
    const Buffer<float> maps = map_returns(returns, {{heights_m.data, n, n}, {seen.data, n, n}, float(lattice.half_m)});
    fill_unseen(predict_ground(maps, returns.sensor_height_m), lattice, seen, heights_m, std_m);
}

}  // namespace viewshed
