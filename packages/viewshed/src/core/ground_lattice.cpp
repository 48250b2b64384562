#include "ground_lattice.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <numbers>
#include <numeric>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Beyond PLANE_M the carrier plane's slope fades over TILT_M: land is mostly level.
constexpr float PLANE_M = 30.0f, TILT_M = 20.0f;

// Lower bound of the range: with an odd number of nodes one lies at range 0.
constexpr float MIN_RANGE_M = 1e-6f;

// Size of the lattice cache.
constexpr std::size_t CACHE_SIZE = 4;

Lattice make_lattice(std::size_t n, double half_m) {
    const double node_m = 2.0 * half_m / double(n), center = double(n) / 2;
    Lattice lattice{n, half_m, node_m, std::vector<float>(n), {}, {}, {}, {}, std::size_t(0.75 * double(n)) + 1,
                 {}, {}, {}, {}, {}};
    for (std::size_t i = 0; i < n; ++i) lattice.middle_m[i] = float((double(i) + 0.5) * node_m - half_m);

    // 1. Range, sector and bin of each node.
    for (auto* of_node : {&lattice.range_m, &lattice.fade, &lattice.azimuth, &lattice.range_nodes}) of_node->resize(n * n);
    for (auto* of_node : {&lattice.bin, &lattice.first, &lattice.last}) of_node->resize(n * n);
    for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < n; ++j) {
            const std::size_t at = i * n + j;
            const float range_m = std::hypot(lattice.middle_m[i], lattice.middle_m[j]);
            const float beyond_m = std::max(range_m - PLANE_M, 0.0f);
            lattice.range_m[at] = range_m;
            lattice.fade[at] = 1.0f - (beyond_m + TILT_M * std::expm1(-beyond_m / TILT_M)) / std::max(range_m, MIN_RANGE_M);
            const float u = float(double(i) + 0.5 - center), v = float(double(j) + 0.5 - center);
            const float azimuth = (std::atan2(v, u) + PI) * float(SECTORS / (2 * std::numbers::pi));
            const float range = std::sqrt(u * u + v * v);
            lattice.azimuth[at] = azimuth;
            lattice.range_nodes[at] = range;
            lattice.bin[at] = std::int16_t(std::min(int(range), int(lattice.bins) - 1));
            lattice.first[at] = std::int16_t(std::floor(azimuth - half_width(range)));
            lattice.last[at] = std::int16_t(std::floor(azimuth + half_width(range)));
        }
    }

    // 2. Sort by range, stable.
    std::vector<double> distance(n * n);
    for (std::size_t at = 0; at < n * n; ++at) {
        distance[at] = std::hypot(double(at / n) - (center - 0.5), double(at % n) - (center - 0.5));
    }
    std::vector<std::uint32_t>& order = lattice.order;
    order.resize(n * n);
    std::iota(order.begin(), order.end(), 0u);
    std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return distance[a] < distance[b]; });
    for (const std::uint32_t at : order) {
        lattice.padded.push_back(std::uint32_t((at / n + 1) * (n + 2) + at % n + 1));
    }
    return lattice;
}

}  // namespace

void require_lattice(std::size_t nodes, double half_m) {
    require(nodes >= 2 && nodes <= 1024, "a lattice must have 2 to 1024 nodes a side");
    require(half_m >= 0.01 && half_m <= double(MAX_M), "half_m must lie in [0.01, 1e6] m");
}

void require_bounded(View1<const float> values, const char* rule) {
    for (const float value : values) require(std::fabs(value) <= MAX_M, rule);
}

std::shared_ptr<const Lattice> lattice_of(std::size_t nodes, double half_m) {
    static std::mutex mutex;
    static std::vector<std::shared_ptr<const Lattice>> cache;
    std::lock_guard lock(mutex);
    for (const auto& one : cache) {
        if (one->nodes == nodes && one->half_m == half_m) return one;
    }
    if (cache.size() == CACHE_SIZE) cache.erase(cache.begin());
    return cache.emplace_back(std::make_shared<const Lattice>(make_lattice(nodes, half_m)));
}

}  // namespace viewshed
