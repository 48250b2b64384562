#include "polar_ground.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Directions of the sectors' middles, and the ranges.
struct Directions {
    double cos[GROUND_SECTORS], sin[GROUND_SECTORS], range_m[GROUND_RANGES];

    Directions() {
        for (std::size_t s = 0; s < GROUND_SECTORS; ++s) {
            const double azimuth = (double(s) + 0.5) * (2 * std::numbers::pi / GROUND_SECTORS) - std::numbers::pi;
            cos[s] = std::cos(azimuth), sin[s] = std::sin(azimuth);
        }
        for (std::size_t k = 0; k < GROUND_RANGES; ++k) range_m[k] = std::exp2(double(k) / 16.0);
    }
};

// Write the slopes to the ground at one range.
MULTIVERSION void slopes_at(const Directions& directions, double range_m, const Ground& ground, float sensor_height_m,
                            float* slope) {
    const auto n = std::int32_t(ground.heights_m.rows);
    const float half_m = ground.half_extent_m;
    const double nodes_per_m = n / (2.0 * double(half_m)), last = n - 1.001;
    std::int32_t node[GROUND_SECTORS];
    double down[GROUND_SECTORS], right[GROUND_SECTORS];
    for (std::size_t s = 0; s < GROUND_SECTORS; ++s) {
        const float x = float(directions.cos[s] * range_m), y = float(directions.sin[s] * range_m);
        double u = double(x + half_m) * nodes_per_m - 0.5, v = double(y + half_m) * nodes_per_m - 0.5;
        u = u > 0.0 ? u : 0.0, v = v > 0.0 ? v : 0.0;
        u = u < last ? u : last, v = v < last ? v : last;
        const auto i = std::int32_t(u), j = std::int32_t(v);
        node[s] = i * n + j;
        down[s] = u - i, right[s] = v - j;
    }
    const float* heights = ground.heights_m.data;
    for (std::size_t s = 0; s < GROUND_SECTORS; ++s) {
        const float *at = heights + node[s], *under = at + n;
        const double low = at[0] * (1 - right[s]) + at[1] * right[s];
        const double high = under[0] * (1 - right[s]) + under[1] * right[s];
        const float height_m = float(low * (1 - down[s]) + high * down[s]);
        slope[s] = (height_m - sensor_height_m) / float(range_m);
    }
}

MULTIVERSION void raise_to(const float* slope, float more, float* most) {
    for (std::size_t s = 0; s < GROUND_SECTORS; ++s) {
        const float raised = slope[s] + more;
        most[s] = raised > most[s] ? raised : most[s];
    }
}

}  // namespace

void find_polar_ground(const Ground& ground, float sensor_height_m, double top_m, PolarGround& polar) {
    static const Directions directions;
    polar.top.fill(-std::numeric_limits<float>::infinity());
    for (std::size_t k = 0; k < GROUND_RANGES; ++k) {
        polar.range_m[k] = directions.range_m[k];
        float* steepest = polar.steepest[k].data();
        slopes_at(directions, directions.range_m[k], ground, sensor_height_m, steepest);
        raise_to(steepest, float(top_m / directions.range_m[k]), polar.top.data());
        if (k > 0) raise_to(polar.steepest[k - 1].data(), 0.0f, steepest);
    }
}

float meet_ground(const PolarGround& polar, std::size_t sector, float slope, std::size_t& at) {
    const auto steepest = [&](std::size_t k) { return polar.steepest[k][sector]; };
    if (!(steepest(GROUND_RANGES - 1) >= slope)) return std::numeric_limits<float>::infinity();
    // The first range from which on the ground is as steep: it ascends.
    std::size_t k = std::min(at, GROUND_RANGES - 1);
    while (k > 0 && steepest(k - 1) >= slope) --k;
    while (k + 1 < GROUND_RANGES && steepest(k) < slope) ++k;
    at = k;
    if (k == 0) return float(polar.range_m[0]);
    const double before = polar.range_m[k - 1];
    const double part = double(slope - steepest(k - 1)) / std::max(double(steepest(k) - steepest(k - 1)), 1e-9);
    return float(before + part * (polar.range_m[k] - before));
}

}  // namespace viewshed
