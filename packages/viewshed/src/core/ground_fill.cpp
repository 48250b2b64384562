#include "ground_fill.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <vector>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Standard deviation where returns lie on the ground.
constexpr float SEEN_STD_M = 0.05f;

// Doubt of a node's height per meter of its side, before it is calibrated.
constexpr double GROWTH = 0.015;

// The deviation of unseen ground: STD_SCALE · (that of the averages)^STD_POWER · (the roughness of what is seen +
// LEAST_ROUGHNESS_M)^ROUGHNESS_POWER, the most likely one of Laplace distributions on simulated land, streets and rooms
// (tools/fit_ground.py deviation).
constexpr float STD_SCALE = 5.7f, STD_POWER = 1.3f, ROUGHNESS_POWER = 0.49f, LEAST_ROUGHNESS_M = 0.02f;

// Ground this far above or below the carrier's plane is a level of its own, which another direction must confirm.
constexpr float LEVEL_M = 0.3f;

// It does if its own ground is as high to within this, and this slope across, at about the same range and 9 to 40 sectors
// away (13° to 56°): a wedge cannot confirm itself.
constexpr float CONFIRM_M = 0.4f, CONFIRM_SLOPE = 0.02f;
constexpr int CONFIRM_FROM = 9, CONFIRM_TO = 40;

// Weight of the carrier's plane where returns show a level that no other direction confirms, and in the nodes below the
// sensor, which no beam meets.
constexpr float UNCONFIRMED_WEIGHT = 0.1f, BLIND_WEIGHT = 0.9f;

constexpr float UNSEEN = std::numeric_limits<float>::quiet_NaN();

// Known heights over the base by range in nodes and sector (bins, SECTORS), NaN for none.
struct Profiles {
    explicit Profiles(std::size_t b) : bins(b), seen(b * SECTORS, UNSEEN) {}
    std::size_t bins;
    Buffer<float> seen;
};

// Call body(at) for each node that is marked. Most are not: eight are looked at together.
template <typename Body>
INLINE void for_marked(View1<const bool> marked, const Body& body) {
    constexpr std::size_t STEP = 8;
    for (std::size_t start = 0; start < marked.size; start += STEP) {
        const std::size_t end = std::min(start + STEP, marked.size);
        std::uint64_t any = 0;
        std::memcpy(&any, marked.data + start, end - start);
        if (any == 0) continue;
        for (std::size_t at = start; at < end; ++at) {
            if (marked[at]) body(at);
        }
    }
}

// Write the base (n, n), which is the carrier's plane that levels off.
MULTIVERSION void find_base(const float* middle_m, const float* fade, std::size_t n, const Plane& carrier, float* base) {
    const float a = carrier[0], b = carrier[1], c = carrier[2];
    for (std::size_t i = 0; i < n; ++i) {
        const float along = middle_m[i] * a;
        const float* faded = fade + i * n;
        float* row = base + i * n;
        for (std::size_t j = 0; j < n; ++j) row[j] = (along + middle_m[j] * b) * faded[j] + c;
    }
}

// The base, and accepted heights above it, else 0.
struct OverBase {
    OverBase(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted, const Plane& carrier)
        : base(lattice.size()), above(lattice.size(), 0.0f) {
        find_base(lattice.middle_m.data(), lattice.fade.data(), lattice.nodes, carrier, base.data());
        for_marked(accepted, [&](std::size_t at) { above[at] = walked_m[at] - base[at]; });
    }
    Buffer<float> base, above;
};

// Of several nodes in a bin the lowest counts: what lies above it may stand on it.
Profiles find_profiles(const Lattice& lattice, View1<const float> above, View1<const bool> known) {
    Profiles profiles(lattice.bins);
    for_marked(known, [&](std::size_t at) {
        const std::size_t row = std::size_t(lattice.bin[at]) * SECTORS;
        // A node covers every sector that it lies in.
        for (int k = lattice.first[at]; k <= lattice.last[at]; ++k) {
            const std::size_t cell = row + std::size_t(k & (SECTORS - 1));
            if (profiles.seen[cell] <= above[at]) continue;
            profiles.seen[cell] = above[at];
        }
    });
    return profiles;
}

// Whether one of the heights of `count` sectors is about as high.
INLINE bool has_level(const float* seen, int count, float level, float tolerance) {
    int found = 0;
    for (int k = 0; k < count; ++k) found |= std::fabs(seen[k] - level) < tolerance;
    return found != 0;
}

// Whether one of the heights of `count` sectors from `first` on around the turn is about as high.
INLINE bool has_level_around(const float* row, int first, int count, float level, float tolerance) {
    first &= SECTORS - 1;
    const int before_end = std::min(count, SECTORS - first);
    return has_level(row + first, before_end, level, tolerance) || has_level(row, count - before_end, level, tolerance);
}

// Whether ground about as high over the base is seen (bins, SECTORS) on a side of sector `at`, at about this range in nodes.
MULTIVERSION bool confirms(const float* seen, int bins, int at, float range, float level, float node_m) {
    const int about = 2 + int(range) / 8;
    const float across_m = range * node_m * float(CONFIRM_FROM * 2 * std::numbers::pi / SECTORS);
    const float tolerance = CONFIRM_M + CONFIRM_SLOPE * across_m;
    const int first = CONFIRM_FROM + int(2 * half_width(range));  // near the sensor a node is as wide as some sectors
    const int count = CONFIRM_TO - CONFIRM_FROM, last = first + count - 1;
    for (int b = std::max(int(range) - about, 1); b < std::min(int(range) + about + 1, bins); ++b) {
        const float* row = seen + std::size_t(b) * SECTORS;
        if (has_level_around(row, at - last, count, level, tolerance)) return true;
        if (has_level_around(row, at + first, count, level, tolerance)) return true;
    }
    return false;
}

void find_unconfirmed(const Lattice& lattice, View1<const float> above, View1<const bool> accepted,
                      const Profiles& profiles, View1<bool> alone) {
    std::fill_n(alone.data, alone.size, false);
    for_marked(accepted, [&](std::size_t at) {
        alone[at] = std::fabs(above[at]) > LEVEL_M &&
                    !confirms(profiles.seen.data(), int(profiles.bins), int(lattice.azimuth[at]),
                              lattice.range_nodes[at], above[at], float(lattice.node_m));
    });
}

// Mean, weight in [0, 1] and variance (n, n) of the nodes of one size.
struct Level {
    std::size_t n;
    float *mean, *weight, *variance;
};

// Average each two by two nodes into the coarse ones, with the variance of all, plus `doubt`.
MULTIVERSION void pull(const Level& fine, float doubt, const Level& coarse) {
    const std::size_t n = fine.n, half = coarse.n;
    for (std::size_t p = 0; p < half; ++p) {
        float *mean = coarse.mean + p * half, *weight = coarse.weight + p * half, *variance = coarse.variance + p * half;
        for (std::size_t q = 0; q < half; ++q) mean[q] = weight[q] = variance[q] = 0.0f;
        for (std::size_t i = 2 * p; i < std::min(2 * p + 2, n); ++i) {
            const float *w = fine.weight + i * n, *z = fine.mean + i * n, *s = fine.variance + i * n;
            for (std::size_t q = 0; q < n / 2; ++q) {
                const float w0 = w[2 * q], w1 = w[2 * q + 1], z0 = z[2 * q], z1 = z[2 * q + 1];
                weight[q] = weight[q] + w0 + w1;
                mean[q] = mean[q] + w0 * z0 + w1 * z1;
                variance[q] = variance[q] + w0 * (s[2 * q] + z0 * z0) + w1 * (s[2 * q + 1] + z1 * z1);
            }
            if (n % 2 == 1) {
                const std::size_t j = n - 1, q = half - 1;
                weight[q] += w[j];
                mean[q] += w[j] * z[j];
                variance[q] += w[j] * (s[j] + z[j] * z[j]);
            }
        }
        for (std::size_t q = 0; q < half; ++q) {
            const float w = weight[q], per = w > 0.0f ? w : 1.0f;
            const float m = w > 0.0f ? mean[q] / per : mean[q];
            const float spread = variance[q] / per - m * m;
            mean[q] = m;
            variance[q] = (w > 0.0f ? (spread > 0.0f ? spread : 0.0f) : variance[q]) + doubt;
            weight[q] = w < 1.0f ? w : 1.0f;
        }
    }
}

// Values of a row of fine nodes between two rows of coarse ones, bilinear. Node i lies at i / 2 - 1/4 of them: between rows,
// and then between columns, by quarters.
INLINE void mix_rows(const float* near, const float* far, std::size_t half, float* between, float* mixed) {
    for (std::size_t q = 0; q < half; ++q) between[q + 1] = 0.75f * near[q] + 0.25f * far[q];
    between[0] = between[1];
    between[half + 1] = between[half];
    for (std::size_t q = 0; q < half; ++q) {
        mixed[2 * q] = 0.25f * between[q] + 0.75f * between[q + 1];
        mixed[2 * q + 1] = 0.75f * between[q + 1] + 0.25f * between[q + 2];
    }
}

// Fill what the weight of each node lacks from the coarse nodes around it. scratch holds 3 (n + 2) numbers.
MULTIVERSION void push(const Level& coarse, const Level& fine, float* scratch) {
    const std::size_t n = fine.n, half = coarse.n;
    float *between = scratch, *mean_around = between + n + 2, *variance_around = mean_around + n + 2;
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t near = i / 2, far = i % 2 == 0 ? near - (near > 0) : near + (near + 1 < half);
        mix_rows(coarse.mean + near * half, coarse.mean + far * half, half, between, mean_around);
        mix_rows(coarse.variance + near * half, coarse.variance + far * half, half, between, variance_around);
        float *mean = fine.mean + i * n, *weight = fine.weight + i * n, *variance = fine.variance + i * n;
        for (std::size_t j = 0; j < n; ++j) mean[j] = weight[j] * mean[j] + (1.0f - weight[j]) * mean_around[j];
        for (std::size_t j = 0; j < n; ++j) {
            variance[j] = weight[j] * variance[j] + (1.0f - weight[j]) * variance_around[j];
        }
    }
}

// Fill nodes without weight from the level of nodes twice as large, which is filled first.
void fill(const Level& level, double node_m, Buffer<float>& scratch) {
    const std::size_t half = (level.n + 1) / 2;
    Buffer<float> values(3 * half * half);
    const Level coarse{half, values.data(), values.data() + half * half, values.data() + 2 * half * half};
    pull(level, float((GROWTH * node_m) * (GROWTH * node_m)), coarse);
    if (half > 1) fill(coarse, 2.0 * node_m, scratch);
    push(coarse, level, scratch.data());
}

// Write weights and which nodes are known: accepted, or so near to the sensor that no beam meets them.
MULTIVERSION void weigh(const std::uint8_t* accepted, const float* range_m, std::size_t size, float blind_m,
                        float* weight, std::uint8_t* known) {
    for (std::size_t at = 0; at < size; ++at) {
        weight[at] = accepted[at] != 0 ? 1.0f : (range_m[at] < blind_m ? BLIND_WEIGHT : 0.0f);
    }
    for (std::size_t at = 0; at < size; ++at) known[at] = weight[at] > 0.0f ? 1 : 0;
}

// The root mean square of seen heights over the base, without those that no other direction confirms.
float roughness_m(View1<const float> above, View1<const bool> accepted, View1<const bool> alone) {
    double sum = 0.0, count = 0.0;
    for_marked(accepted, [&](std::size_t at) {
        if (alone[at]) return;
        sum += double(above[at]) * double(above[at]);
        count += 1.0;
    });
    return count > 0.0 ? float(std::sqrt(sum / count)) : 0.0f;
}

}  // namespace

float fill_ground(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted, const Plane& carrier,
                  View1<float> heights_m, View1<float> std_m) {
    const std::size_t n = lattice.nodes, size = lattice.size();
    Buffer<float> weight(size), variance(size);
    Buffer<bool> known(size), alone(size);
    // 1. Accepted heights above the base. No beam meets the ground just below the sensor: there the base counts.
    const OverBase over(lattice, walked_m, accepted, carrier);
    float nearest_m = std::numeric_limits<float>::infinity();
    for_marked(accepted, [&](std::size_t at) { nearest_m = std::min(nearest_m, lattice.range_m[at]); });
    if (std::isinf(nearest_m)) nearest_m = 0.0f;
    const double node_m = lattice.node_m;
    const float blind_m = double(nearest_m) >= 2.0 * node_m ? nearest_m + float(0.5 * node_m) : float(2.5 * node_m);
    weigh(reinterpret_cast<const std::uint8_t*>(accepted.data), lattice.range_m.data(), size, blind_m, weight.data(),
          reinterpret_cast<std::uint8_t*>(known.data()));
    // 2. The base counts, weakly, also where returns show a level that no other direction confirms. They hold for their own
    //    nodes.
    const Profiles profiles = find_profiles(lattice, over.above, known);
    find_unconfirmed(lattice, over.above, accepted, profiles, alone);
    std::copy_n(over.above.data(), size, heights_m.data);
    std::fill_n(variance.data(), size, SEEN_STD_M * SEEN_STD_M);
    for_marked(alone, [&](std::size_t at) {
        weight[at] = UNCONFIRMED_WEIGHT;
        heights_m[at] = 0.0f;
        variance[at] = LEVEL_M * LEVEL_M;
    });
    // 3. Heights over the base and their variance in between.
    Buffer<float> scratch(3 * (n + 2));
    fill({n, heights_m.data, weight.data(), variance.data()}, node_m, scratch);
    // 4. Heights, and how unsure they are; what is seen holds for its own nodes.
    const float roughness = roughness_m(over.above, accepted, alone);
    const float scale = STD_SCALE * std::pow(roughness + LEAST_ROUGHNESS_M, ROUGHNESS_POWER);
    for (std::size_t at = 0; at < size; ++at) {
        heights_m[at] = accepted[at] ? walked_m[at] : heights_m[at] + over.base[at];
        const float doubt_m = scale * std::pow(variance[at], STD_POWER / 2);
        std_m[at] = accepted[at] ? SEEN_STD_M : std::max(doubt_m, SEEN_STD_M);
    }
    return roughness;
}

void find_unconfirmed_levels(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted,
                             const Plane& carrier, View1<bool> alone) {
    const OverBase over(lattice, walked_m, accepted, carrier);
    find_unconfirmed(lattice, over.above, accepted, find_profiles(lattice, over.above, accepted), alone);
}

}  // namespace viewshed
