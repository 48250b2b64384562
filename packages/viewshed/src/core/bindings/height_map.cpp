#include "height_map.hpp"

#include <cmath>

#include "bindings.hpp"

namespace viewshed {

void bind_height_map(nb::module_& m) {
    m.def(
        "lattice_positions",
        [](In2<float> xy, float half_extent_m, std::size_t nodes) {
            require(xy.shape(1) >= 2, "xy must have at least two columns");
            require(nodes >= 2 && nodes <= 16384, "a lattice must have 2 to 16384 nodes a side");
            require(std::isfinite(half_extent_m) && half_extent_m > 0, "half_extent_m must be positive and finite");
            LatticePositions at = without_lock([&] { return lattice_positions(view(xy), half_extent_m, nodes); });
            return tuple_of(array(std::move(at.node)), array(std::move(at.down)), array(std::move(at.right)));
        },
        "xy"_in, "half_extent_m"_a, "nodes"_a,
        "Return the lattice node (N,) before each of N points, and its fractional offsets in i and j (N,).");
    m.def(
        "interpolate",
        [](In2<float> heights_m, In1<std::int32_t> node, In1<double> down, In1<double> right) {
            const std::size_t nodes = heights_m.shape(0), count = node.shape(0);
            require(nodes >= 2 && nodes <= 16384 && heights_m.shape(1) == nodes,
                    "heights_m must have shape (nodes, nodes), 2 to 16384 of them");
            require(are_as_long(node, down, right), "node, down and right must be as long");
            const Buffer<std::int32_t> before =
                indices_of<std::int32_t>(view(node), 0, std::int32_t(nodes * nodes - nodes - 2), "node");
            Buffer<float> out(count);
            without_lock([&] { interpolate(view(heights_m), before, view(down), view(right), out); });
            return array(std::move(out));
        },
        "heights_m"_in, "node"_in, "down"_in, "right"_in,
        "Return heights (N,) at positions of a lattice, bilinear.");
}

}  // namespace viewshed
