#include "ground_guess.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <mutex>
#include <numbers>
#include <string_view>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// The network: WIDTHS of its levels, the finest first; then layer by layer a SCALES and a BIASES for each of its outputs, and
// WEIGHTS in the order (tap, input, output), a letter each. `tools/fit_ground.py fit` writes them.
#include "ground_network.inc"

constexpr std::size_t LEVELS = std::size(WIDTHS);

constexpr float NONE = std::numeric_limits<float>::infinity();

// Azimuths, and ranges in nodes, by which the lowest passing beam is kept.
constexpr std::size_t BINS = 1024, RANGES = 100;

// A beam passes over what lies this number of nodes before its end, or more.
constexpr float BEFORE_END = 2.0f;

// Half the width in nodes of what a beam must cross to pass over a node.
constexpr float HALF_NODE = 0.35f;

// Heights farther above or below the ground as it was found are cut off; units of height and range.
constexpr float MOST_ABOVE_M = 15.0f, GROUND_UNIT_M = 4.0f, RANGE_UNIT_M = 64.0f;

// The network's heights are GUESS_UNIT_M · sinh(output), so that it tells small ones well; outputs are cut off.
constexpr float GUESS_UNIT_M = 0.3f, MOST_OUTPUT = 5.0f;

// The quantiles .15 and .85 of a normal distribution lie this many standard deviations away from its median.
constexpr float OUTER_STDS = 1.0364334f;

// The ground may lie this far above the lowest beam that passes over a node: the node is not one point.
constexpr float OVER_BEAM_M = 0.1f;

// Heights are whole multiples of this: the last bits of a network's sums differ between processors.
constexpr float STEP_M = 1.0f / 256;

// Outputs of a layer are computed so many at a time, for so many positions: they stay in registers.
constexpr std::size_t LANES = 16, POSITIONS = 4;
typedef float Vector __attribute__((vector_size(LANES * sizeof(float))));

// What a lattice of n × n nodes shows from its middle, whatever the size of its nodes.
struct Sight {
    std::size_t nodes;
    std::vector<float> range;              // (n, n) in nodes
    std::vector<std::int16_t> first, last;  // (n, n) bins of azimuth that a beam over the node lies in; first may be negative
};

std::shared_ptr<const Sight> sight_of(std::size_t n) {
    static std::mutex mutex;
    static std::shared_ptr<const Sight> kept;
    std::lock_guard lock(mutex);
    if (kept && kept->nodes == n) return kept;
    auto made = std::make_shared<Sight>(Sight{n, {}, {}, {}});
    constexpr double PER_RAD = BINS / (2 * std::numbers::pi);
    for (std::size_t at = 0; at < n * n; ++at) {
        const double u = double(at / n) + 0.5 - double(n) / 2, v = double(at % n) + 0.5 - double(n) / 2;
        const double range = std::hypot(u, v), middle = std::atan2(v, u) + std::numbers::pi;
        const double wide = double(HALF_NODE) / std::max(range, 0.5);
        made->range.push_back(float(range));
        made->first.push_back(std::int16_t(std::floor((middle - wide) * PER_RAD)));
        made->last.push_back(std::int16_t(std::floor((middle + wide) * PER_RAD)));
    }
    return kept = made;
}

// Returns of each node: how many, z of the two lowest and of the highest; +inf, +inf and -inf for none.
struct Columns {
    explicit Columns(std::size_t size) : count(size, 0.0f), second(size, NONE), lowest(size, NONE), highest(size, -NONE) {}
    Buffer<float> count, second, lowest, highest;
};

// The least slope by range (RANGES + 1) and azimuth (BINS) of the beams that end well beyond that range.
Buffer<float> sort_returns(const LevelReturns& returns, std::size_t n, float half_m, float sensor_m, Columns& columns) {
    const float per_m = float(n) / (2.0f * half_m), side = float(n);
    constexpr float PER_RAD = float(BINS / (2 * std::numbers::pi));
    Buffer<float> slopes((RANGES + 1) * BINS, NONE);
    for (std::size_t k = 0; k < returns.range_m.size; ++k) {
        const float* p = returns.points[k];
        const float z = p[2], u = (p[0] + half_m) * per_m, v = (p[1] + half_m) * per_m;
        if (u >= 0.0f && v >= 0.0f && u < side && v < side) {
            const std::size_t at = std::size_t(u) * n + std::size_t(v);
            columns.count[at] += 1.0f;
            columns.second[at] = std::min(columns.second[at], std::max(columns.lowest[at], z));
            columns.lowest[at] = std::min(columns.lowest[at], z);
            columns.highest[at] = std::max(columns.highest[at], z);
        }
        const float range_m = returns.range_m[k], turned = (returns.azimuth[k] + PI) * PER_RAD;
        const float before_end = range_m * per_m - BEFORE_END;
        if (!(before_end >= 0.0f && turned >= 0.0f)) continue;  // nor what is no number
        const auto beyond = std::size_t(std::min(before_end, float(RANGES)));
        float& slope = slopes[beyond * BINS + std::size_t(std::min(turned, float(BINS - 1)))];
        slope = std::min(slope, (z - sensor_m) / range_m);
    }
    for (std::size_t b = RANGES; b-- > 0;) {
        float *here = &slopes[b * BINS], *beyond = here + BINS;
        for (std::size_t a = 0; a < BINS; ++a) here[a] = beyond[a] < here[a] ? beyond[a] : here[a];
    }
    return slopes;
}

// The least slope of the beams over a node; +inf for none.
INLINE float lowest_slope(const Buffer<float>& slopes, const Sight& sight, std::size_t at) {
    float least = NONE;
    if (sight.range[at] >= float(RANGES + 1)) return least;
    const float* row = &slopes[std::size_t(sight.range[at]) * BINS];
    for (int a = sight.first[at]; a <= sight.last[at]; ++a) least = std::min(least, row[std::size_t(a) % BINS]);
    return least;
}

INLINE float cut(float above) {
    return std::clamp(above, -MOST_ABOVE_M, MOST_ABOVE_M);
}

// Values (side, side, channels) with a border of zeros.
struct Maps {
    Maps(std::size_t side_, std::size_t channels_) : side(side_), channels(channels_), values((side + 2) * (side + 2) * channels) {
        std::fill_n(values.data(), values.size(), 0.0f);
    }
    float* at(std::size_t i, std::size_t j) { return &values[((i + 1) * (side + 2) + j + 1) * channels]; }
    const float* at(std::size_t i, std::size_t j) const { return const_cast<Maps*>(this)->at(i, j); }
    std::size_t side, channels;
    Buffer<float> values;
};

// A convolution of size × size taps: weights (taps, inputs, outputs) and bias (outputs,), outputs filled up to whole LANES.
struct Layer {
    std::size_t size, inputs, outputs, lanes;
    std::vector<float> weights, bias;
};

// The whole number that a letter of WEIGHTS stands for: the letters go from # to ~, without those that C++ escapes.
int number_of(char letter) {
    return letter - '#' - (letter > '?') - (letter > '\\') - 44;
}

// Layers in the order in which they run: folded nodes; two of each level on the way down; two of each on the way up; the last.
const std::vector<Layer>& layers() {
    static const std::vector<Layer> all = [] {
        std::vector<Layer> made;
        std::string_view letters = WEIGHTS;
        std::size_t outputs_before = 0;
        const auto add = [&](std::size_t size, std::size_t inputs, std::size_t outputs) {
            const std::size_t lanes = (outputs + LANES - 1) / LANES * LANES, rows = size * size * inputs;
            Layer layer{size, inputs, outputs, lanes, std::vector<float>(rows * lanes), std::vector<float>(lanes)};
            std::copy_n(BIASES + outputs_before, outputs, layer.bias.begin());
            for (std::size_t row = 0; row < rows; ++row) {
                for (std::size_t k = 0; k < outputs; ++k) {
                    layer.weights[row * lanes + k] = SCALES[outputs_before + k] * float(number_of(letters[row * outputs + k]));
                }
            }
            letters.remove_prefix(rows * outputs);
            outputs_before += outputs;
            made.push_back(std::move(layer));
        };
        add(1, GUESS_INPUTS * FOLD * FOLD, WIDTHS[0]);
        for (std::size_t level = 0; level < LEVELS; ++level) {
            add(3, WIDTHS[level == 0 ? 0 : level - 1], WIDTHS[level]);
            add(3, WIDTHS[level], WIDTHS[level]);
        }
        for (std::size_t level = LEVELS - 1; level-- > 0;) {
            add(3, WIDTHS[level + 1] + WIDTHS[level], WIDTHS[level]);
            add(3, WIDTHS[level], WIDTHS[level]);
        }
        add(1, WIDTHS[0], GUESS_OUTPUTS * FOLD * FOLD);
        return made;
    }();
    return all;
}

// Write a row of a layer's outputs, LANES of them at WIDE positions at a time.
template <std::size_t WIDE>
INLINE void convolve_row(const Maps& in, const Layer& layer, std::size_t i, bool rectifies, Maps& out) {
    const std::size_t inputs = layer.inputs, lanes = layer.lanes, size = layer.size;
    for (std::size_t j = 0; j < in.side; j += WIDE) {
        for (std::size_t lane = 0; lane < lanes; lane += LANES) {
            Vector bias, sums[WIDE];
            std::memcpy(&bias, &layer.bias[lane], sizeof(bias));
            for (std::size_t p = 0; p < WIDE; ++p) sums[p] = bias;
            const float* weights = &layer.weights[lane];
            for (std::size_t tap = 0; tap < size * size; ++tap) {
                const std::size_t down = i + tap / size + 1 - size / 2, right = j + tap % size + 1 - size / 2;
                const float* from = &in.values[(down * (in.side + 2) + right) * inputs];
                for (std::size_t c = 0; c < inputs; ++c, weights += lanes) {
                    Vector weight;
                    std::memcpy(&weight, weights, sizeof(weight));
                    for (std::size_t p = 0; p < WIDE; ++p) sums[p] += from[p * inputs + c] * weight;
                }
            }
            const std::size_t some = std::min(LANES, layer.outputs - lane);
            for (std::size_t p = 0; p < WIDE; ++p) {
                float* const to = out.at(i, j + p) + lane;
                for (std::size_t k = 0; k < some; ++k) to[k] = rectifies && sums[p][k] < 0.0f ? 0.0f : sums[p][k];
            }
        }
    }
}

MULTIVERSION void convolve_rows(const Maps& in, const Layer& layer, std::size_t begin, std::size_t end, bool rectifies, Maps& out) {
    for (std::size_t i = begin; i < end; ++i) {
        if (in.side % POSITIONS == 0) {
            convolve_row<POSITIONS>(in, layer, i, rectifies, out);
        } else {
            convolve_row<1>(in, layer, i, rectifies, out);
        }
    }
}

Maps convolve(const Maps& in, const Layer& layer, bool rectifies = true) {
    Maps out(in.side, layer.outputs);
    for_ranges(in.side, count_parts(in.side, 8), [&](std::size_t, std::size_t begin, std::size_t end) {
        convolve_rows(in, layer, begin, end, rectifies, out);
    });
    return out;
}

// The greatest of each two by two.
Maps halved(const Maps& in) {
    Maps out(in.side / 2, in.channels);
    for (std::size_t i = 0; i < out.side; ++i) {
        for (std::size_t j = 0; j < out.side; ++j) {
            const float *a = in.at(2 * i, 2 * j), *b = in.at(2 * i + 1, 2 * j);
            float* const to = out.at(i, j);
            for (std::size_t c = 0; c < in.channels; ++c) {
                to[c] = std::max(std::max(a[c], a[in.channels + c]), std::max(b[c], b[in.channels + c]));
            }
        }
    }
    return out;
}

// Each value of the coarse maps four times, and those of the fine ones behind it.
Maps joined(const Maps& coarse, const Maps& fine) {
    Maps out(fine.side, coarse.channels + fine.channels);
    for (std::size_t i = 0; i < out.side; ++i) {
        for (std::size_t j = 0; j < out.side; ++j) {
            float* const to = std::copy_n(coarse.at(i / 2, j / 2), coarse.channels, out.at(i, j));
            std::copy_n(fine.at(i, j), fine.channels, to);
        }
    }
    return out;
}

// What the network answers for folded inputs: a U-Net (Ronneberger et al. 2015).
Maps network(const Maps& inputs) {
    const std::vector<Layer>& all = layers();
    auto layer = all.begin();
    Maps maps = convolve(inputs, *layer++);
    std::vector<Maps> fine;
    for (std::size_t level = 0; level < LEVELS; ++level) {
        if (level > 0) maps = halved(fine.emplace_back(std::move(maps)));
        maps = convolve(maps, *layer++);
        maps = convolve(maps, *layer++);
    }
    for (; !fine.empty(); fine.pop_back()) {
        maps = convolve(joined(maps, fine.back()), *layer++);
        maps = convolve(maps, *layer++);
    }
    return convolve(maps, *layer, false);
}

// log(1 + e^x)
INLINE float softplus(float x) { return x > 20.0f ? x : std::log1p(std::exp(x)); }

INLINE float height_of(float output) { return GUESS_UNIT_M * std::sinh(std::max(-MOST_OUTPUT, std::min(MOST_OUTPUT, output))); }

Maps inputs_of(const LevelReturns& returns, const FoundOnLattice& ground, float sensor_height_m) {
    const std::size_t n = ground.heights_m.rows;
    const auto sight = sight_of(n);
    Columns columns(n * n);
    const Buffer<float> slopes = sort_returns(returns, n, ground.half_m, sensor_height_m, columns);
    const float node_m = 2.0f * ground.half_m / float(n);
    Maps inputs(n / FOLD, GUESS_INPUTS * FOLD * FOLD);
    for_ranges(n, count_parts(n, 32), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            for (std::size_t j = 0; j < n; ++j) {
                const std::size_t at = i * n + j;
                const float range = sight->range[at], count = columns.count[at], z = ground.heights_m(i, j);
                const float least = lowest_slope(slopes, *sight, at);
                const bool is_met = count > 0.0f, is_passed = least < NONE;
                const float second = count == 1.0f ? columns.lowest[at] : columns.second[at];
                float* const to = inputs.at(i / FOLD, j / FOLD) + ((i % FOLD) * FOLD + j % FOLD) * GUESS_INPUTS;
                to[0] = is_met ? 1.0f : 0.0f;
                to[1] = is_met ? cut(second - z) : 0.0f;
                to[2] = is_met ? cut(columns.lowest[at] - z) : 0.0f;
                to[3] = is_met ? cut(columns.highest[at] - z) : 0.0f;
                to[4] = std::log1p(count) / 3.0f;
                to[5] = is_passed ? cut(sensor_height_m + least * range * node_m - z) : 0.0f;
                to[6] = is_passed ? 1.0f : 0.0f;
                to[7] = ground.seen(i, j) ? 1.0f : 0.0f;
                to[8] = z / GROUND_UNIT_M;
                to[9] = range * node_m / RANGE_UNIT_M;
                to[10] = sensor_height_m / 2.0f;
                to[11] = node_m;
                to[12] = std::min(ground.std_m(i, j), MOST_ABOVE_M);
            }
        }
    });
    return inputs;
}

}  // namespace

void guess_inputs(const LevelReturns& returns, const FoundOnLattice& ground, float sensor_height_m, View1<float> inputs) {
    const Maps maps = inputs_of(returns, ground, sensor_height_m);
    float* to = inputs.data;
    for (std::size_t i = 0; i < maps.side; ++i) to = std::copy_n(maps.at(i, 0), maps.side * maps.channels, to);
}

void guess_ground(const LevelReturns& returns, const FoundOnLattice& ground, float sensor_height_m, View2<float> heights_m,
                  View2<float> std_m) {
    const std::size_t n = ground.heights_m.rows;
    const Maps inputs = inputs_of(returns, ground, sensor_height_m), outputs = network(inputs);
    for_ranges(n, count_parts(n, 32), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            for (std::size_t j = 0; j < n; ++j) {
                const float z = ground.heights_m(i, j);
                const std::size_t node = (i % FOLD) * FOLD + j % FOLD;
                const float* const given = inputs.at(i / FOLD, j / FOLD) + node * GUESS_INPUTS;
                const float* const answer = outputs.at(i / FOLD, j / FOLD) + node * GUESS_OUTPUTS;
                heights_m(i, j) = z;
                std_m(i, j) = ground.std_m(i, j);
                if (ground.seen(i, j)) continue;
                const float low = height_of(answer[1] - softplus(answer[0])), high = height_of(answer[1] + softplus(answer[2]));
                // The lowest beam over the node bounds it.
                const float over = given[5], most = given[6] > 0.0f && over < MOST_ABOVE_M ? over + OVER_BEAM_M : NONE;
                heights_m(i, j) = std::nearbyint((z + std::min(height_of(answer[1]), most)) / STEP_M) * STEP_M;
                std_m(i, j) = 0.5f * (high - low) / OUTER_STDS;
            }
        }
    });
}

}  // namespace viewshed
