#include "ground_lattice.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <numbers>
#include <numeric>

#include "vectors.hpp"

namespace viewshed {
namespace {

// Size of the lattice cache.
constexpr std::size_t CACHE_SIZE = 4;

Lattice make_lattice(std::size_t n, double half_m) {
    const double node_m = 2.0 * half_m / double(n), center = double(n) / 2;
    Lattice lattice{n, half_m, node_m, std::vector<float>(n * n), std::vector<float>(n * n), {}, {}};

    // 1. Range and sector of each node.
    for (std::size_t at = 0; at < n * n; ++at) {
        const float u = float(double(at / n) + 0.5 - center), v = float(double(at % n) + 0.5 - center);
        lattice.range_m[at] = std::hypot(u, v) * float(node_m);
        lattice.azimuth[at] = (std::atan2(v, u) + PI) * float(SECTORS / (2 * std::numbers::pi));
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
