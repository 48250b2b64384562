// The lattice about the sensor on which ground is estimated: what depends on its size alone, computed once.
#pragma once

#include <cstdint>
#include <memory>
#include <numbers>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Sectors of azimuth into which what is seen of the ground is sorted.
constexpr int SECTORS = 256;

// n × n nodes over ±half_m in x and y, row by row; the sensor stands above the middle.
struct Lattice {
    std::size_t nodes;  // n
    double half_m;
    double node_m;           // side of a node
    std::vector<float> middle_m;  // (n,) x or y of the nodes' middles
    std::vector<float> range_m;   // (n, n) from the sensor to the node's middle
    std::vector<float> fade;      // (n, n) share of the carrier's slope that is left there
    // (n, n) the nodes in the order of their range, the nearest first, and where they are on a lattice with a border of one.
    std::vector<std::uint32_t> order, padded;

    // Where a node lies among sectors of azimuth and bins of range of one node each.
    std::size_t bins;
    std::vector<float> azimuth;             // (n, n) in sectors, from 0
    std::vector<float> range_nodes;         // (n, n) in nodes
    std::vector<std::int16_t> bin;          // (n, n)
    std::vector<std::int16_t> first, last;  // (n, n) sectors that the node lies in; first may be negative

    std::size_t size() const { return nodes * nodes; }
};

// The lattice with this number of nodes a side, from a small cache.
std::shared_ptr<const Lattice> lattice_of(std::size_t nodes, double half_m);

// Lengths in meters up to this are accepted: no sum or product of them overflows.
constexpr float MOST_M = 1e6f;

// Raise ValueError unless there are as many nodes as a lattice may have, and its extent is one.
void require_lattice(std::size_t nodes, double half_m);

// Raise ValueError unless all values lie in [-MOST_M, MOST_M].
void require_bounded(View1<const float> values, const char* rule);

// Half the width in sectors of a node at a range in nodes.
inline float half_width(float range_nodes) {
    constexpr float AT_ONE_NODE = float(0.6 * SECTORS / (2 * std::numbers::pi));
    return AT_ONE_NODE / (range_nodes > 1.0f ? range_nodes : 1.0f);
}

}  // namespace viewshed
