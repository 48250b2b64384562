#include "height_map.hpp"

#include <cmath>
#include <limits>

#include "stages.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// A coordinate in nodes, within [0, last]; 0 where it is not a number.
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

void bind_height_map(nb::module_& m) {
    m.def(
        "lattice_positions",
        [](In2<float> xy, float half_extent_m, std::size_t nodes) {
            require(xy.shape(1) >= 2, "xy must have at least two columns");
            require(nodes >= 2 && nodes <= 16384, "a lattice must have 2 to 16384 nodes a side");
            require(std::isfinite(half_extent_m) && half_extent_m > 0, "half_extent_m must be positive and finite");
            LatticePositions at = lattice_positions(view(xy), half_extent_m, nodes);
            return nb::make_tuple(std::move(at.node).array(), std::move(at.down).array(), std::move(at.right).array());
        },
        "xy"_a.noconvert(), "half_extent_m"_a, "nodes"_a,
        "Node (N,) before each of N points, and how far beyond it in i and in j (N,), of a lattice.");
    m.def(
        "interpolate",
        [](In2<float> heights_m, In1<std::int32_t> node, In1<double> down, In1<double> right) {
            const std::size_t nodes = heights_m.shape(0), count = node.shape(0);
            require(nodes >= 2 && nodes <= 16384 && heights_m.shape(1) == nodes,
                    "heights_m must have shape (nodes, nodes), 2 to 16384 of them");
            require(down.shape(0) == count && right.shape(0) == count, "node, down and right must be as long");
            const Buffer<std::int32_t> before =
                indices_of<std::int32_t>(view(node), 0, std::int32_t(nodes * nodes - nodes - 2), "node");
            Buffer<float> out(count);
            interpolate(view(heights_m), before, view(down), view(right), out);
            return std::move(out).array();
        },
        "heights_m"_a.noconvert(), "node"_a.noconvert(), "down"_a.noconvert(), "right"_a.noconvert(),
        "Heights (N,) at positions of a lattice, bilinear.");
}

}  // namespace viewshed
