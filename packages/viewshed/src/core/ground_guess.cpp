#include "ground_guess.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <numbers>
#include <vector>

#include "ground_lattice.hpp"
#include "ground_plane.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();

// Azimuths, and ranges in nodes, by which the lowest passing beam is kept.
constexpr std::size_t BINS = 1024, RANGES = 100;

// A beam passes over what lies this number of nodes before its end, or more.
constexpr float BEFORE_END = 2.0f;

// Half the width in nodes of what a beam must cross to pass over a node.
constexpr float HALF_NODE = 0.35f;

// Heights farther above or below the base are cut off; the network counts that of the base, and ranges, in these units.
constexpr float MOST_ABOVE_M = 15.0f, BASE_UNIT_M = 4.0f, RANGE_UNIT_M = 64.0f;

// Nodes within about this range decide on the plane of the base, by how well they fit it; it leans to level ground.
constexpr double NEAR_M = 30.0, FITS_M = 0.15, LEAN_M2 = 50.0, LEAN = 1e-3;
constexpr int REFITS = 2;

// From this range on the plane's slope fades, over this distance; within so many nodes of the sensor, where no beam meets the
// ground, the plane counts with this weight.
constexpr float PLANE_M = 60.0f, TILT_M = 20.0f, BLIND_NODES = 2.5f, BLIND_WEIGHT = 0.9f;

// Bounds of the logarithm of a mode's mean deviation.
constexpr float LEAST_LOG_M = -3.0f, MOST_LOG_M = 3.0f;

// The ground may lie this far above the lowest beam that passes over a node: the node is not one point.
constexpr float OVER_BEAM_M = 0.1f;

// Heights are whole multiples of this: the last bits of a network's sums differ between processors.
constexpr float STEP_M = 1.0f / 256;

// Deviation of ground that returns show.
constexpr float SHOWN_STD_M = 0.05f;

// Steps by which a quantile is bracketed: to a thousandth of the distance of the modes.
constexpr int HALVINGS = 10;

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

INLINE float cut(float above) {
    return std::clamp(above, -MOST_ABOVE_M, MOST_ABOVE_M);
}

// The plane z = a x + b y + c through ground that is shown: least squares, leaning to level ground, and again with the weights
// of a Cauchy distribution.
Plane plane_of(const ShownGround& shown) {
    const std::size_t n = shown.heights_m.rows;
    const double node_m = 2.0 * double(shown.half_m) / double(n);
    struct Node {
        double x, y, z, near;
    };
    std::vector<Node> nodes;
    for (std::size_t at = 0; at < n * n; ++at) {
        if (!shown.seen.data[at]) continue;
        const double x = (double(at / n) + 0.5) * node_m - double(shown.half_m);
        const double y = (double(at % n) + 0.5) * node_m - double(shown.half_m);
        const double r2 = (x * x + y * y) / (NEAR_M * NEAR_M);
        nodes.push_back({x, y, double(shown.heights_m.data[at]), 1.0 / (1.0 + r2 * r2)});
    }
    double a = 0.0, b = 0.0, c = 0.0;
    for (int step = 0; step <= REFITS; ++step) {
        double xx = LEAN_M2, xy = 0.0, yy = LEAN_M2, x = 0.0, y = 0.0, one = LEAN, xz = 0.0, yz = 0.0, z = 0.0;
        for (const Node& p : nodes) {
            const double off = (p.z - a * p.x - b * p.y - c) / FITS_M;
            const double w = step > 0 ? p.near / (1.0 + off * off) : p.near;
            xx += w * p.x * p.x, xy += w * p.x * p.y, yy += w * p.y * p.y;
            x += w * p.x, y += w * p.y, one += w;
            xz += w * p.x * p.z, yz += w * p.y * p.z, z += w * p.z;
        }
        // Without the mean, two equations are left.
        xx -= x * x / one, xy -= x * y / one, yy -= y * y / one;
        xz -= x * z / one, yz -= y * z / one;
        const double area = xx * yy - xy * xy;
        a = (xz * yy - yz * xy) / area;
        b = (yz * xx - xz * xy) / area;
        c = (z - a * x - b * y) / one;
    }
    return {float(a), float(b), float(c)};
}

// Sums of values times weights, and weights of at most 1, of n × n nodes.
struct Level {
    explicit Level(std::size_t side) : n(side), sum(side * side), weight(side * side) {}
    std::size_t n;
    Buffer<float> sum, weight;
};

// Fill what the weights of nodes lack from nodes twice as large, which are filled first; their sums are heights then.
MULTIVERSION void pull_push(Level& fine) {
    const std::size_t n = fine.n;
    if (n == 1) {
        fine.sum[0] /= std::max(fine.weight[0], 1e-6f);
        return;
    }
    Level coarse(n / 2);
    for (std::size_t p = 0; p < n / 2; ++p) {
        const float *z0 = &fine.sum[2 * p * n], *z1 = z0 + n, *w0 = &fine.weight[2 * p * n], *w1 = w0 + n;
        for (std::size_t q = 0; q < n / 2; ++q) {
            const float weight = w0[2 * q] + w0[2 * q + 1] + w1[2 * q] + w1[2 * q + 1];
            const float per = 1.0f / (weight > 1.0f ? weight : 1.0f);
            coarse.sum[p * (n / 2) + q] = (z0[2 * q] + z0[2 * q + 1] + z1[2 * q] + z1[2 * q + 1]) * per;
            coarse.weight[p * (n / 2) + q] = weight * per;
        }
    }
    pull_push(coarse);
    // Bilinear: a node lies a quarter of a large one off the middle of that.
    const std::size_t half = n / 2;
    std::vector<float> between(half + 2);
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t near = i / 2, far = i % 2 == 0 ? near - (near > 0) : near + (near + 1 < half);
        const float *a = &coarse.sum[near * half], *b = &coarse.sum[far * half];
        for (std::size_t q = 0; q < half; ++q) between[q + 1] = 0.75f * a[q] + 0.25f * b[q];
        between[0] = between[1];
        between[half + 1] = between[half];
        float *sum = &fine.sum[i * n], *weight = &fine.weight[i * n];
        for (std::size_t q = 0; q < half; ++q) {
            sum[2 * q] += (1.0f - weight[2 * q]) * (0.25f * between[q] + 0.75f * between[q + 1]);
            sum[2 * q + 1] += (1.0f - weight[2 * q + 1]) * (0.75f * between[q + 1] + 0.25f * between[q + 2]);
        }
    }
}

// Where the value of a node stands in a folded map.
INLINE std::size_t folded(std::size_t map, std::size_t i, std::size_t j, std::size_t n) {
    const std::size_t part = n / FOLD;
    return ((map * FOLD + i % FOLD) * FOLD + j % FOLD) * part * part + (i / FOLD) * part + j / FOLD;
}

// e^x for x ≤ 0, within 1e-5 of it, without branches; 0 below -80.
INLINE float exp_of(float x) {
    const float bounded = x > -80.0f ? x : -80.0f;
    const float t = bounded * std::numbers::log2e_v<float>;
    const auto whole = std::int32_t(t - 0.5f);  // rounded, t is not positive
    const float f = (t - float(whole)) * std::numbers::ln2_v<float>;
    float p = f * (1.0f / 120) + (1.0f / 24);
    p = p * f + (1.0f / 6);
    p = p * f + 0.5f;
    p = p * f + 1.0f;
    p = p * f + 1.0f;
    return p * std::bit_cast<float>((whole + 127) << 23);
}

// The probability that a Laplace distribution of mean 0 and mean deviation 1 lies below u.
INLINE float laplace_below(float u) {
    const float tail = 0.5f * exp_of(u < 0.0f ? u : -u);
    return u < 0.0f ? tail : 1.0f - tail;
}

// Two Laplace distributions, a block of nodes.
struct ModesOfBlock {
    float first[BLOCK], second[BLOCK], per_first[BLOCK], per_second[BLOCK], share[BLOCK];
};

// Write the heights below which the ground lies with a probability; `away` is the quantile of a single mode in deviations.
// It lies between those of the two modes.
MULTIVERSION void write_quantiles(const ModesOfBlock& m, std::size_t size, float probability, float away, float* out) {
    float low[BLOCK], high[BLOCK];
    for (std::size_t k = 0; k < size; ++k) {
        const float a = m.first[k] + away / m.per_first[k], b = m.second[k] + away / m.per_second[k];
        low[k] = a < b ? a : b;
        high[k] = a < b ? b : a;
    }
    for (int step = 0; step < HALVINGS; ++step) {
        for (std::size_t k = 0; k < size; ++k) {
            const float middle = 0.5f * (low[k] + high[k]);
            const float below = m.share[k] * laplace_below((middle - m.first[k]) * m.per_first[k]) +
                                (1.0f - m.share[k]) * laplace_below((middle - m.second[k]) * m.per_second[k]);
            low[k] = below < probability ? middle : low[k];
            high[k] = below < probability ? high[k] : middle;
        }
    }
    for (std::size_t k = 0; k < size; ++k) out[k] = 0.5f * (low[k] + high[k]);
}

}  // namespace

void base_ground(const ShownGround& shown, View1<float> base_m) {
    const std::size_t n = shown.heights_m.rows;
    const auto sight = sight_of(n);
    const float node_m = 2.0f * shown.half_m / float(n);
    // 1. The plane, whose slope fades.
    const Plane plane = plane_of(shown);
    for (std::size_t i = 0; i < n; ++i) {
        const float x = (float(i) + 0.5f) * node_m - shown.half_m;
        for (std::size_t j = 0; j < n; ++j) {
            const float y = (float(j) + 0.5f) * node_m - shown.half_m, range_m = sight->range[i * n + j] * node_m;
            const float beyond = std::max(range_m - PLANE_M, 0.0f);
            const float fade = beyond > 0.0f ? 1.0f - (beyond + TILT_M * std::expm1(-beyond / TILT_M)) / range_m : 1.0f;
            base_m[i * n + j] = (plane[0] * x + plane[1] * y) * fade + plane[2];
        }
    }
    // 2. Heights above it in between.
    Level above(n);
    for (std::size_t at = 0; at < n * n; ++at) {
        const bool seen = shown.seen.data[at];
        above.sum[at] = seen ? shown.heights_m.data[at] - base_m[at] : 0.0f;
        above.weight[at] = seen ? 1.0f : (sight->range[at] < BLIND_NODES ? BLIND_WEIGHT : 0.0f);
    }
    pull_push(above);
    for (std::size_t at = 0; at < n * n; ++at) base_m[at] += above.sum[at];
}

void guess_inputs(const LevelReturns& returns, const ShownGround& shown, float sensor_height_m, View1<float> inputs) {
    const std::size_t n = shown.heights_m.rows;
    const auto sight = sight_of(n);
    Buffer<float> base_m(n * n);
    base_ground(shown, base_m);
    Columns columns(n * n);
    const Buffer<float> slopes = sort_returns(returns, n, shown.half_m, sensor_height_m, columns);
    const float node_m = 2.0f * shown.half_m / float(n);
    for_ranges(n, count_parts(n, 32), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            for (std::size_t j = 0; j < n; ++j) {
                const std::size_t at = i * n + j;
                const float range = sight->range[at], count = columns.count[at];
                // The lowest beam over the node.
                float least = NONE;
                if (range < float(RANGES + 1)) {
                    const float* row = &slopes[std::size_t(range) * BINS];
                    for (int a = sight->first[at]; a <= sight->last[at]; ++a) {
                        least = std::min(least, row[std::size_t(a) % BINS]);
                    }
                }
                const bool is_met = count > 0.0f, is_passed = least < NONE;
                const float second = count == 1.0f ? columns.lowest[at] : columns.second[at], base = base_m[at];
                const std::array<float, GUESS_INPUTS> values{
                    is_met ? 1.0f : 0.0f,
                    is_met ? cut(second - base) : 0.0f,
                    is_met ? cut(columns.lowest[at] - base) : 0.0f,
                    is_met ? cut(columns.highest[at] - base) : 0.0f,
                    std::log1p(count) / 3.0f,
                    is_passed ? cut(sensor_height_m + least * range * node_m - base) : 0.0f,
                    is_passed ? 1.0f : 0.0f,
                    shown.seen(i, j) ? 1.0f : 0.0f,
                    base / BASE_UNIT_M,
                    range * node_m / RANGE_UNIT_M,
                    sensor_height_m / 2.0f,
                    node_m,
                };
                for (std::size_t c = 0; c < GUESS_INPUTS; ++c) inputs[folded(c, i, j, n)] = values[c];
            }
        }
    });
}

void guessed_ground(View1<const float> outputs, View1<const float> inputs, const ShownGround& shown, View1<float> heights_m,
                    View1<float> std_m) {
    const std::size_t n = shown.heights_m.rows;
    static_assert(FOLD * FOLD <= BLOCK);
    for_ranges(n, count_parts(n, 16), [&](std::size_t, std::size_t begin, std::size_t end) {
        ModesOfBlock modes;
        float median[BLOCK], low[BLOCK], high[BLOCK];
        for (std::size_t i = begin; i < end; ++i) {
            for (std::size_t start = 0; start < n; start += BLOCK) {
                const std::size_t size = std::min(BLOCK, n - start);
                // 1. The modes of a row: the second one is not above the first.
                for (std::size_t k = 0; k < size; ++k) {
                    std::array<float, GUESS_OUTPUTS> o;
                    for (std::size_t c = 0; c < GUESS_OUTPUTS; ++c) o[c] = outputs[folded(c, i, start + k, n)];
                    const float apart = o[1] > 20.0f ? o[1] : std::log1p(std::exp(o[1]));
                    modes.first[k] = o[0];
                    modes.second[k] = o[0] - apart;
                    modes.per_first[k] = std::exp(-std::clamp(o[2], LEAST_LOG_M, MOST_LOG_M));
                    modes.per_second[k] = std::exp(-std::clamp(o[3], LEAST_LOG_M, MOST_LOG_M));
                    modes.share[k] = 1.0f / (1.0f + std::exp(-o[4]));
                }
                // 2. Its median, and half the width that holds 68 %.
                constexpr float TAIL = 0.16f, TAIL_AWAY = -1.1394343f;  // ln(2 · 0.16)
                write_quantiles(modes, size, 0.5f, 0.0f, median);
                write_quantiles(modes, size, TAIL, TAIL_AWAY, low);
                write_quantiles(modes, size, 1.0f - TAIL, -TAIL_AWAY, high);
                // 3. What returns and passing beams show.
                for (std::size_t k = 0; k < size; ++k) {
                    const std::size_t j = start + k, at = i * n + j;
                    const bool is_passed = inputs[folded(6, i, j, n)] > 0.0f;
                    const float over = inputs[folded(5, i, j, n)], base = BASE_UNIT_M * inputs[folded(8, i, j, n)];
                    const float most = is_passed && over < MOST_ABOVE_M ? over + OVER_BEAM_M : NONE;
                    const float rounded = std::nearbyint((base + std::min(median[k], most)) / STEP_M) * STEP_M;
                    heights_m[at] = shown.seen(i, j) ? shown.heights_m(i, j) : rounded;
                    std_m[at] = shown.seen(i, j) ? SHOWN_STD_M : 0.5f * (high[k] - low[k]);
                }
            }
        }
    });
}

}  // namespace viewshed
