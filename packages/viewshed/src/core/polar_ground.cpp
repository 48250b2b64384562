#include "polar_ground.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "height_map.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr std::size_t PLACES = GROUND_RANGES * GROUND_SECTORS;

double range_at(std::size_t k) { return std::exp2(double(k) / 16.0); }

// Return x and y (PLACES, 2) of the sectors' centers, range by range.
std::array<float, 2 * PLACES> places() {
    std::array<float, 2 * PLACES> xy;
    for (std::size_t n = 0; n < PLACES; ++n) {
        const double azimuth = (double(n % GROUND_SECTORS) + 0.5) * (2 * std::numbers::pi / GROUND_SECTORS) - std::numbers::pi;
        xy[2 * n] = float(std::cos(azimuth) * range_at(n / GROUND_SECTORS));
        xy[2 * n + 1] = float(std::sin(azimuth) * range_at(n / GROUND_SECTORS));
    }
    return xy;
}

MULTIVERSION void raise_to(const float* slope, float more, float* max_slope) {
    for (std::size_t s = 0; s < GROUND_SECTORS; ++s) {
        const float raised = slope[s] + more;
        max_slope[s] = raised > max_slope[s] ? raised : max_slope[s];
    }
}

}  // namespace

void find_polar_ground(const Ground& ground, float sensor_height_m, double top_m, PolarGround& polar) {
    static const std::array<float, 2 * PLACES> xy = places();
    const LatticePositions at = lattice_positions({xy.data(), PLACES, 2}, ground.half_extent_m, ground.heights_m.rows);
    Buffer<float> height_m(PLACES);
    interpolate(ground.heights_m, at.node, at.down, at.right, height_m);
    polar.top.fill(-std::numeric_limits<float>::infinity());
    for (std::size_t k = 0; k < GROUND_RANGES; ++k) {
        polar.range_m[k] = range_at(k);
        float* steepest = polar.steepest[k].data();
        for (std::size_t s = 0; s < GROUND_SECTORS; ++s) {
            steepest[s] = (height_m[k * GROUND_SECTORS + s] - sensor_height_m) / float(polar.range_m[k]);
        }
        raise_to(steepest, float(top_m / polar.range_m[k]), polar.top.data());
        if (k > 0) raise_to(polar.steepest[k - 1].data(), 0.0f, steepest);
    }
}

float meet_ground(const PolarGround& polar, std::size_t sector, float slope, std::size_t& at) {
    const auto steepest = [&](std::size_t k) { return polar.steepest[k][sector]; };
    if (!(steepest(GROUND_RANGES - 1) >= slope)) return std::numeric_limits<float>::infinity();
    // Search for the first range with ground this steep: `steepest` ascends.
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
