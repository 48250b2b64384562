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

// Azimuth sectors of a turn.
constexpr int SECTORS = 256;

// n × n nodes over ±half_m in x and y, row by row, centered below the sensor.
struct Lattice {
    std::size_t nodes;  // n
    double half_m;
    double node_m;                        // side of a node
    std::vector<float> range_m, azimuth;  // (n, n) of the nodes' centers; azimuth in sectors, from 0
    // Nodes (n, n) by ascending range, and their indices on a lattice with a border of one.
    std::vector<std::uint32_t> order, padded;

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

}  // namespace viewshed
