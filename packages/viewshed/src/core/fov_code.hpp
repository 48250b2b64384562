// Compress a field of view: the state of each cell, its probability in 16 levels and its standard deviation in 8.
#pragma once

#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Largest number of rows and columns of a coded view.
constexpr std::size_t MAX_CELLS = 512;

// Numbers of states, probability levels and deviation levels of a cell.
constexpr int STATES = 4, LEVELS = 16, DEVIATIONS = 9;

// Cells of a view, row i forward and column j left.
struct CodedCells {
    View2<const std::uint8_t> state;      // CellState, 0…3
    View2<const std::uint8_t> level;      // of the probability, 0…15; from 8 on it reaches the threshold
    View2<const std::uint8_t> deviation;  // 0…7, 8 for none; shape (0, 0) if no cell has one
};

// The sensor's cell, or the nearest one.
struct SensorCell {
    std::size_t row, column;
};

// Values of the levels of probability (16) and standard deviation (9).
struct LevelValues {
    const float *prob, *std;
};

// A decoded view; std is (0, 0) if the code has no deviations.
struct DecodedView {
    View2<std::uint8_t> state;
    View2<float> prob, std;
};

// Encode a view without loss. Cells are coded outward from the sensor, row by row, in the context of their four coded
// neighbors: most equal the one toward the sensor. Empty if a view is too irregular: decoding is bounded.
std::vector<std::uint8_t> encode_view(const CodedCells& cells, SensorCell sensor);

// Decode a view; false if the bytes are no code of such a view.
bool decode_view(View1<const std::uint8_t> code, SensorCell sensor, const LevelValues& values, const DecodedView& view);

}  // namespace viewshed
