#include "height_map.hpp"

#include "vectors.hpp"

namespace viewshed {
namespace {

// Clamp a coordinate to [0, last]; NaN becomes 0.
INLINE double clamped(double at, double last) {
    at = at > 0.0 ? at : 0.0;
    return at < last ? at : last;
}

MULTIVERSION void locate(const float* xy, std::size_t count, std::size_t step, float half_extent_m, std::int32_t nodes,
                         std::int32_t* node, double* down, double* right) {
    const double nodes_per_m = nodes / (2.0 * double(half_extent_m)), last = nodes - 1.001;
    for (std::size_t k = 0; k < count; ++k) {
        const double u = clamped(double(xy[k * step] + half_extent_m) * nodes_per_m - 0.5, last);
        const double v = clamped(double(xy[k * step + 1] + half_extent_m) * nodes_per_m - 0.5, last);
        const auto i = std::int32_t(u), j = std::int32_t(v);
        node[k] = i * nodes + j;
        down[k] = u - i;
        right[k] = v - j;
    }
}

MULTIVERSION void mix(const float* heights_m, std::uint32_t nodes, std::size_t count, const std::int32_t* node,
                      const double* down, const double* right, float* out) {
    for (std::size_t k = 0; k < count; ++k) {
        const auto at = std::uint32_t(node[k]), under = at + nodes;
        const double part = right[k];
        const double low = heights_m[at] * (1 - part) + heights_m[at + 1] * part;
        const double high = heights_m[under] * (1 - part) + heights_m[under + 1] * part;
        out[k] = float(low * (1 - down[k]) + high * down[k]);
    }
}

}  // namespace

LatticePositions lattice_positions(View2<const float> xy, float half_extent_m, std::size_t nodes) {
    LatticePositions at{Buffer<std::int32_t>(xy.rows), Buffer<double>(xy.rows), Buffer<double>(xy.rows)};
    locate(xy.data, xy.rows, xy.columns, half_extent_m, std::int32_t(nodes), at.node.data(), at.down.data(),
           at.right.data());
    return at;
}

void interpolate(View2<const float> heights_m, View1<const std::int32_t> node, View1<const double> down,
                 View1<const double> right, View1<float> out) {
    mix(heights_m.data, std::uint32_t(heights_m.columns), node.size, node.data, down.data, right.data, out.data);
}

}  // namespace viewshed
