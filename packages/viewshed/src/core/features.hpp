// What the networks are shown: maps of one byte a cell.
#pragma once

#include <optional>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// The most cells of a side: a row fits on the stack.
constexpr std::size_t MOST_CELLS = 4096;

// How a feature's codes are made.
enum class Coding {
    BYTES,        // they are bytes
    RETURNS,      // logarithm of expected returns, or of the sum of two kinds of them
    PROBABILITY,  // probabilities in [0, 1]
    BEYOND,       // how far a limit by azimuth bin lies beyond each cell; 128 where they meet
    RANGE,        // how far the cell is away
    DEVIATION,    // logarithm of the ground's standard deviation
};

// One feature, and the array that its coding asks for.
struct Feature {
    Coding coding;
    View2<const std::uint8_t> bytes;     // (cells, cells)
    View2<const float> values, further;  // (cells, cells); deviations (nodes, nodes); further may be empty
    View1<const float> limit_m;          // (bins,) meters
};

// The grid's cells: range and azimuth bin (cells, cells), x and y of their rows and columns (cells,).
struct GridCells {
    View2<const float> range_m;
    View2<const std::int16_t> bin;
    View1<const float> x_m, y_m;
};

// Write the codes of features: maps (features, cells, cells), or of fold > 0 blocks (cells / fold, cells / fold,
// features · fold²), ordered by feature, row and column. The ground's lattice spans ± half_extent_m.
void write_features(const std::vector<Feature>& features, const GridCells& cells, float half_extent_m, std::size_t fold,
                    View1<std::uint8_t> codes);

// Write maps (features, cells, cells) as such blocks.
void fold_maps(View3<const std::uint8_t> maps, std::size_t fold, View1<std::uint8_t> blocks);

// Write the codes (cells · cells,) of the lowest and the highest return of each cell of a grid: 0 for none, 1 to 255
// upwards. Points (M, 3) by x and y, and height_m (M,) above local ground.
void write_heights(View2<const float> points, View1<const float> height_m, float x0_m, float y0_m, float cells_per_m,
                   std::size_t cells, View1<std::uint8_t> lowest, View1<std::uint8_t> highest);

}  // namespace viewshed
