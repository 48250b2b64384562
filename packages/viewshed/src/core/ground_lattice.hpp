// Lattice around the sensor for ground estimation, with all data that depends on its size alone.
#pragma once

#include <cstdint>
#include <memory>
#include <numbers>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Standard deviation of nodes with returns on the ground.
constexpr float SEEN_STD_M = 0.05f;

// Azimuth sectors of the seen ground.
constexpr int SECTORS = 256;

// n × n nodes over ±half_m in x and y, row by row, centered below the sensor.
struct Lattice {
    std::size_t nodes;  // n
    double half_m;
    double node_m;           // side of a node
    std::vector<float> middle_m;  // (n,) x or y of the nodes' centers
    std::vector<float> range_m;   // (n, n) from the sensor to the node's center
    std::vector<float> fade;      // (n, n) remaining share of the carrier's slope
    // Nodes (n, n) by ascending range, and their indices on a lattice with a border of one.
    std::vector<std::uint32_t> order, padded;

    // Position of each node among azimuth sectors and range bins of one node each.
    std::size_t bins;
    std::vector<float> azimuth;             // (n, n) in sectors, from 0
    std::vector<float> range_nodes;         // (n, n) in nodes
    std::vector<std::int16_t> bin;          // (n, n)
    std::vector<std::int16_t> first, last;  // (n, n) sectors that the node covers; first may be negative

    std::size_t size() const { return nodes * nodes; }
};

// Return a lattice with this number of nodes per side, from a small cache.
std::shared_ptr<const Lattice> lattice_of(std::size_t nodes, double half_m);

// Largest accepted length in meters: no sum or product overflows.
constexpr float MAX_M = 1e6f;

// Throw std::invalid_argument unless the number of nodes and the extent are valid.
void require_lattice(std::size_t nodes, double half_m);

// Throw std::invalid_argument unless all values lie in [-MAX_M, MAX_M].
void require_bounded(View1<const float> values, const char* rule);

// Return half the width of a node in sectors, at a range in nodes.
inline float half_width(float range_nodes) {
    constexpr float AT_ONE_NODE = float(0.6 * SECTORS / (2 * std::numbers::pi));
    return AT_ONE_NODE / (range_nodes > 1.0f ? range_nodes : 1.0f);
}

}  // namespace viewshed
