#include "lowest_returns.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "ego_vehicle.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();

// Fewest points for which a part pays for its thread.
constexpr std::size_t PART = 16384;

// Parameters of the test for candidates.
struct Rule {
    float rotation[9];
    float near2, far2, half_m, nodes_per_m, cosine, sine;
    std::int32_t side;
};

// Write the node and z of each point of a block; -1 for points that are no candidates for ground: outside the lattice
// or the range limits, isolated, or on hood or roof of the vehicle. Branch-free, so that it vectorizes.
MULTIVERSION void candidates_of_block(const float* points, const std::uint8_t* isolated, std::size_t count, const Rule& rule,
                              std::int32_t* nodes, float* heights) {
    const float xx = rule.rotation[0], xy = rule.rotation[1], xz = rule.rotation[2];
    const float yx = rule.rotation[3], yy = rule.rotation[4], yz = rule.rotation[5];
    const float zx = rule.rotation[6], zy = rule.rotation[7], zz = rule.rotation[8];
    const float near2 = rule.near2, far2 = rule.far2, half_m = rule.half_m, per_m = rule.nodes_per_m;
    const float cosine = rule.cosine, sine = rule.sine;
    const float hood_x = float(EGO_LENGTH_M), hood_y = float(EGO_WIDTH_M), hood_z = -float(MIN_EGO_HEIGHT_M);
    const std::int32_t side = rule.side;
    const float last = float(side);
    float px[BLOCK], py[BLOCK], pz[BLOCK];
    std::int32_t out[BLOCK];
    for (std::size_t k = 0; k < count; ++k) {
        px[k] = points[3 * k];
        py[k] = points[3 * k + 1];
        pz[k] = points[3 * k + 2];
    }
    for (std::size_t k = 0; k < count; ++k) out[k] = isolated[k];
    for (std::size_t k = 0; k < count; ++k) {
        const float d2 = px[k] * px[k] + py[k] * py[k] + pz[k] * pz[k];
        const float x = xx * px[k] + xy * py[k] + xz * pz[k], y = yx * px[k] + yy * py[k] + yz * pz[k];
        const float z = zx * px[k] + zy * py[k] + zz * pz[k];
        const float u = (x + half_m) * per_m, v = (y + half_m) * per_m;
        const bool hood = (std::fabs(cosine * x + sine * y) < hood_x) & (std::fabs(cosine * y - sine * x) < hood_y) &
                          (z > hood_z);
        const bool inside = (d2 >= near2) & (d2 <= far2) & (u >= 0) & (v >= 0) & (u < last) & (v < last) & !hood &
                            (out[k] == 0);
        const auto i = std::int32_t(inside ? u : 0.0f), j = std::int32_t(inside ? v : 0.0f);
        nodes[k] = inside ? i * side + j : -1;
        heights[k] = z;
    }
}

// The two lowest heights of a node, and the highest.
struct Heights {
    float lowest = NONE, second = NONE, highest = -NONE;
};

// The two lowest points of a node.
struct Lowest {
    float height[2] = {NONE, NONE};
    std::int32_t point[2] = {0, 0};
};

// Check if point k with height z is lower than the other; ties are broken by x and y, not by order.
INLINE bool is_before(View2<const float> points, std::size_t k, float z, std::int32_t other, float low) {
    if (z != low) return z < low;
    if (points(k, 0) != points(std::size_t(other), 0)) return points(k, 0) < points(std::size_t(other), 0);
    return points(k, 1) < points(std::size_t(other), 1);
}

// Find the heights of the nodes from `first` on. Adjacent points fall into the same node and would wait for each other,
// so points from four places of the sweep are interleaved.
void find_heights(View1<const std::int32_t> node, const float* height, std::size_t first, View1<Heights> heights) {
    constexpr std::size_t PLACES = 4;
    const auto add = [&](std::size_t k) {
        const std::size_t own = std::size_t(std::uint32_t(node[k])) - first;  // wraps to a huge value for -1 and for nodes of other parts
        if (own >= heights.size) return;
        Heights& here = heights[own];
        here.second = std::min(here.second, std::max(here.lowest, height[k]));
        here.lowest = std::min(here.lowest, height[k]);
        here.highest = std::max(here.highest, height[k]);
    };
    const std::size_t part = node.size / PLACES;
    for (std::size_t k = 0; k < part; ++k) {
        for (std::size_t place = 0; place < PLACES; ++place) add(place * part + k);
    }
    for (std::size_t k = PLACES * part; k < node.size; ++k) add(k);
}

// Insert a point into the two lowest.
void insert(View2<const float> points, std::size_t k, float z, Lowest& lowest) {
    if (!is_before(points, k, z, lowest.point[1], lowest.height[1])) return;
    int rank = 1;
    if (is_before(points, k, z, lowest.point[0], lowest.height[0])) {
        lowest.height[1] = lowest.height[0];
        lowest.point[1] = lowest.point[0];
        rank = 0;
    }
    lowest.height[rank] = z;
    lowest.point[rank] = std::int32_t(k);
}

}  // namespace

Lows lowest_returns(View2<const float> points, View1<const bool> isolated, View2<const float> rotation, float near_m,
                    float far_m, double heading, float half_m, std::size_t nodes) {
    const std::size_t count = points.rows;
    Rule rule{{}, near_m * near_m, far_m * far_m, half_m, float(nodes) / (2.0f * half_m), float(std::cos(heading)),
              float(std::sin(heading)), std::int32_t(nodes)};
    std::copy_n(rotation.data, 9, rule.rotation);

    // 1. Compute the node and z of each point.
    const std::size_t parts = count_parts(count, PART);
    Buffer<std::int32_t> node(count);
    Buffer<float> height(count);
    const auto* left_out = reinterpret_cast<const std::uint8_t*>(isolated.data);  // bytes vectorize, bools do not
    for_ranges(count, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t start = begin; start < end; start += BLOCK) {
            const std::size_t size = std::min(BLOCK, end - start);
            candidates_of_block(points[start], left_out + start, size, rule, &node[start], &height[start]);
        }
    });

    // 2. Find the lowest heights of each node, then their (few) points. Each part handles its own nodes.
    Lows lows(nodes);
    for_ranges(nodes * nodes, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        Buffer<Heights> heights(end - begin, Heights{});
        find_heights({node.data(), count}, height.data(), begin, heights);
        Buffer<Lowest> lowest(end - begin, Lowest{});
        for (std::size_t k = 0; k < count; ++k) {
            const std::size_t own = std::size_t(std::uint32_t(node[k])) - begin;
            if (own < end - begin && height[k] <= heights[own].second) insert(points, k, height[k], lowest[own]);
        }
        for (std::size_t at = begin; at < end; ++at) {
            const Lowest& here = lowest[at - begin];
            const int rank = here.height[1] < NONE ? 1 : 0;
            lows.z_m[at] = here.height[rank];
            lows.x_m[at] = lows.y_m[at] = lows.rise_m[at] = 0.0f;
            if (here.height[rank] == NONE) continue;
            const float* p = points[std::size_t(here.point[rank])];
            const float* turn = rule.rotation;
            lows.x_m[at] = turn[0] * p[0] + turn[1] * p[1] + turn[2] * p[2];
            lows.y_m[at] = turn[3] * p[0] + turn[4] * p[1] + turn[5] * p[2];
            lows.rise_m[at] = heights[at - begin].highest - here.height[rank];
        }
    });
    lows.occupied.resize(nodes * nodes);
    std::size_t count_occupied = 0;
    for (std::size_t at = 0; at < nodes * nodes; ++at) {
        lows.occupied[count_occupied] = std::int32_t(at);
        count_occupied += lows.z_m[at] < NONE;
    }
    lows.occupied.resize(count_occupied);
    return lows;
}

}  // namespace viewshed
