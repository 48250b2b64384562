#include "ground_fill.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Standard deviation per meter of node side.
constexpr double GROWTH = 0.015;

// Ground this far off the carrier plane is a separate level that another direction must confirm.
constexpr float LEVEL_M = 0.3f;

// Confirmation: similar height within this tolerance (plus this slope across) at similar range, 9 to 40 sectors (13° to
// 56°) away, so that a wedge cannot confirm itself.
constexpr float CONFIRM_M = 0.4f, CONFIRM_SLOPE = 0.02f;
constexpr int CONFIRM_FROM = 9, CONFIRM_TO = 40;

// Weights of the base at unconfirmed levels, and in the nodes below the sensor, which no beam meets.
constexpr float UNCONFIRMED_WEIGHT = 0.1f, BLIND_WEIGHT = 0.9f;

constexpr float UNSEEN = std::numeric_limits<float>::quiet_NaN();

// Known heights above the base by range bin and sector (bins, SECTORS), NaN for none.
struct Profiles {
    explicit Profiles(std::size_t b) : bins(b), seen(b * SECTORS, UNSEEN) {}
    std::size_t bins;
    Buffer<float> seen;
};

// Call body(at) for each marked node. Most are unmarked: eight are tested at once.
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

// Write the base surface (n, n): the carrier plane, leveling off with range.
MULTIVERSION void find_base(const float* middle_m, const float* fade, std::size_t n, const Plane& carrier, float* base) {
    const float a = carrier[0], b = carrier[1], c = carrier[2];
    for (std::size_t i = 0; i < n; ++i) {
        const float along = middle_m[i] * a;
        const float* faded = fade + i * n;
        float* row = base + i * n;
        for (std::size_t j = 0; j < n; ++j) row[j] = (along + middle_m[j] * b) * faded[j] + c;
    }
}

// The base, and the accepted heights above it, 0 elsewhere.
struct OverBase {
    OverBase(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted, const Plane& carrier)
        : base(lattice.size()), above(lattice.size(), 0.0f) {
        find_base(lattice.middle_m.data(), lattice.fade.data(), lattice.nodes, carrier, base.data());
        for_marked(accepted, [&](std::size_t at) { above[at] = walked_m[at] - base[at]; });
    }
    Buffer<float> base, above;
};

// Build profiles. The lowest node of a bin counts: higher ones may stand on it.
Profiles find_profiles(const Lattice& lattice, View1<const float> above, View1<const bool> known) {
    Profiles profiles(lattice.bins);
    for_marked(known, [&](std::size_t at) {
        const std::size_t row = std::size_t(lattice.bin[at]) * SECTORS;
        // A node counts in every sector that it covers.
        for (int k = lattice.first[at]; k <= lattice.last[at]; ++k) {
            const std::size_t cell = row + std::size_t(k & (SECTORS - 1));
            if (!(profiles.seen[cell] <= above[at])) profiles.seen[cell] = above[at];
        }
    });
    return profiles;
}

// Check if one of the heights of `count` sectors is similar.
INLINE bool has_level(const float* seen, int count, float level, float tolerance) {
    int found = 0;
    for (int k = 0; k < count; ++k) found |= std::fabs(seen[k] - level) < tolerance;
    return found != 0;
}

// The same from sector `first` on, wrapping around the turn.
INLINE bool has_level_around(const float* row, int first, int count, float level, float tolerance) {
    first &= SECTORS - 1;
    const int before_end = std::min(count, SECTORS - first);
    return has_level(row + first, before_end, level, tolerance) || has_level(row, count - before_end, level, tolerance);
}

// Check if ground of similar height above the base is seen (bins, SECTORS)beside sector `at`, at about this range.
MULTIVERSION bool confirms(const float* seen, int bins, int at, float range, float level, float node_m) {
    const int about = 2 + int(range) / 8;
    const float across_m = range * node_m * float(CONFIRM_FROM * 2 * std::numbers::pi / SECTORS);
    const float tolerance = CONFIRM_M + CONFIRM_SLOPE * across_m;
    const int first = CONFIRM_FROM + int(2 * half_width(range));  // near the sensor a node spans several sectors
    const int count = CONFIRM_TO - CONFIRM_FROM, last = first + count - 1;
    for (int b = std::max(int(range) - about, 1); b < std::min(int(range) + about + 1, bins); ++b) {
        const float* row = seen + std::size_t(b) * SECTORS;
        if (has_level_around(row, at - last, count, level, tolerance)) return true;
        if (has_level_around(row, at + first, count, level, tolerance)) return true;
    }
    return false;
}

void find_unconfirmed(const Lattice& lattice, View1<const float> above, View1<const bool> accepted,
                      const Profiles& profiles, View1<bool> unconfirmed) {
    std::fill_n(unconfirmed.data, unconfirmed.size, false);
    for_marked(accepted, [&](std::size_t at) {
        unconfirmed[at] = std::fabs(above[at]) > LEVEL_M &&
                    !confirms(profiles.seen.data(), int(profiles.bins), int(lattice.azimuth[at]),
                              lattice.range_nodes[at], above[at], float(lattice.node_m));
    });
}

// One pyramid level: mean, weight in [0, 1] and variance (n, n).
struct Level {
    std::size_t n;
    float *mean, *weight, *variance;
};

// Average 2 × 2 nodes into each coarse node, with their total variance plus `doubt`.
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

// Interpolate a row of fine nodes bilinearly from two coarse rows. Fine node i lies at coarse position i / 2 - 1/4, so
// the weights are quarters, first between rows, then between columns.
INLINE void mix_rows(const float* near, const float* far, std::size_t half, float* between, float* mixed) {
    for (std::size_t q = 0; q < half; ++q) between[q + 1] = 0.75f * near[q] + 0.25f * far[q];
    between[0] = between[1];
    between[half + 1] = between[half];
    for (std::size_t q = 0; q < half; ++q) {
        mixed[2 * q] = 0.25f * between[q] + 0.75f * between[q + 1];
        mixed[2 * q + 1] = 0.75f * between[q + 1] + 0.25f * between[q + 2];
    }
}

// Fill the missing weight of each node from the coarse nodes around it. scratch holds 3 (n + 2) floats.
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

// Relax nodes without weight to the mean of their four neighbors, forward and backward (Gauss-Seidel): straight lines
// between returns.
//
// Each node uses two updated neighbors and two old ones. Nodes on a diagonal are independent, so diagonals are stored
// as rows and vectorized one after the other.
MULTIVERSION void smooth_diagonals(float* mean, const float* missing, std::size_t n) {
    const auto relax = [&](std::size_t d) {
        const std::size_t begin = d > n - 2 ? d - (n - 2) : 1, end = std::min(n - 2, d - 1) + 1;
        float* here = mean + d * n;
        const float *before = mean + (d - 1) * n, *after = mean + (d + 1) * n, *lack = missing + d * n;
        for (std::size_t i = begin; i < end; ++i) {
            const float around = 0.25f * (before[i - 1] + after[i + 1] + before[i] + after[i]);
            here[i] += lack[i] * (around - here[i]);
        }
    };
    for (std::size_t d = 2; d <= 2 * n - 4; ++d) relax(d);
    for (std::size_t d = 2 * n - 4; d >= 2; --d) relax(d);
}

void smooth(const Level& level, Buffer<float>& scratch) {
    const std::size_t n = level.n;
    if (n < 3) return;
    constexpr std::size_t BLOCK_ROWS = 16;  // block of rows whose diagonals stay in the L1 cache
    float *mean = scratch.data(), *missing = mean + 2 * n * n;
    for (std::size_t start = 0; start < n; start += BLOCK_ROWS) {
        const std::size_t end = std::min(start + BLOCK_ROWS, n);
        for (std::size_t j = 0; j < n; ++j) {
            for (std::size_t i = start; i < end; ++i) {
                mean[(i + j) * n + i] = level.mean[i * n + j];
                missing[(i + j) * n + i] = 1.0f - level.weight[i * n + j];
            }
        }
    }
    smooth_diagonals(mean, missing, n);
    for (std::size_t start = 1; start < n - 1; start += BLOCK_ROWS) {
        const std::size_t end = std::min(start + BLOCK_ROWS, n - 1);
        for (std::size_t j = 1; j < n - 1; ++j) {
            for (std::size_t i = start; i < end; ++i) level.mean[i * n + j] = mean[(i + j) * n + i];
        }
    }
}

// Fill nodes without weight from the next coarser level, recursively.
void fill(const Level& level, double node_m, Buffer<float>& scratch) {
    const std::size_t half = (level.n + 1) / 2;
    Buffer<float> values(3 * half * half);
    const Level coarse{half, values.data(), values.data() + half * half, values.data() + 2 * half * half};
    pull(level, float((GROWTH * node_m) * (GROWTH * node_m)), coarse);
    if (half > 1) fill(coarse, 2.0 * node_m, scratch);
    push(coarse, level, scratch.data());
    smooth(level, scratch);
}

// Write weights and a mask of known nodes: accepted, or too near to the sensor for any beam.
MULTIVERSION void weigh(const std::uint8_t* accepted, const float* range_m, std::size_t size, float blind_m,
                        float* weight, std::uint8_t* known) {
    for (std::size_t at = 0; at < size; ++at) {
        weight[at] = accepted[at] != 0 ? 1.0f : (range_m[at] < blind_m ? BLIND_WEIGHT : 0.0f);
    }
    for (std::size_t at = 0; at < size; ++at) known[at] = weight[at] > 0.0f ? 1 : 0;
}

// Add the base to heights, and convert variances to standard deviations.
MULTIVERSION void add_base(const float* base, const float* variance, std::size_t size, float* heights_m, float* std_m) {
    for (std::size_t at = 0; at < size; ++at) heights_m[at] += base[at];
    for (std::size_t at = 0; at < size; ++at) std_m[at] = std::sqrt(variance[at]);
}

}  // namespace

void fill_ground(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted, const Plane& carrier,
                 View1<float> heights_m, View1<float> std_m) {
    const std::size_t n = lattice.nodes, size = lattice.size();
    Buffer<float> weight(size), variance(size);
    Buffer<bool> known(size), unconfirmed(size);
    // 1. Accepted heights above the base. The base counts just below the sensor, where no beam meets the ground.
    const OverBase over(lattice, walked_m, accepted, carrier);
    float nearest_m = std::numeric_limits<float>::infinity();
    for_marked(accepted, [&](std::size_t at) { nearest_m = std::min(nearest_m, lattice.range_m[at]); });
    if (std::isinf(nearest_m)) nearest_m = 0.0f;
    const double node_m = lattice.node_m;
    const float blind_m = double(nearest_m) >= 2.0 * node_m ? nearest_m + float(0.5 * node_m) : float(2.5 * node_m);
    weigh(reinterpret_cast<const std::uint8_t*>(accepted.data), lattice.range_m.data(), size, blind_m, weight.data(),
          reinterpret_cast<std::uint8_t*>(known.data()));
    // 2. The base also counts, weakly, at unconfirmed levels; their heights hold for their own nodes only.
    const Profiles profiles = find_profiles(lattice, over.above, known);
    find_unconfirmed(lattice, over.above, accepted, profiles, unconfirmed);
    std::copy_n(over.above.data(), size, heights_m.data);
    std::fill_n(variance.data(), size, SEEN_STD_M * SEEN_STD_M);
    for_marked(unconfirmed, [&](std::size_t at) {
        weight[at] = UNCONFIRMED_WEIGHT;
        heights_m[at] = 0.0f;
        variance[at] = LEVEL_M * LEVEL_M;
    });
    // 3. Interpolate heights above the base and their variance.
    Buffer<float> scratch(4 * size + 3 * (n + 2));
    fill({n, heights_m.data, weight.data(), variance.data()}, node_m, scratch);
    add_base(over.base.data(), variance.data(), size, heights_m.data, std_m.data);
    for_marked(unconfirmed, [&](std::size_t at) {
        heights_m[at] = walked_m[at];
        std_m[at] = SEEN_STD_M;
    });
}

void find_unconfirmed_levels(const Lattice& lattice, View1<const float> walked_m, View1<const bool> accepted,
                             const Plane& carrier, View1<bool> unconfirmed) {
    const OverBase over(lattice, walked_m, accepted, carrier);
    find_unconfirmed(lattice, over.above, accepted, find_profiles(lattice, over.above, accepted), unconfirmed);
}

}  // namespace viewshed
