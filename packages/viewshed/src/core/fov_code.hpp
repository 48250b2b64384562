// A field of view in few bytes: the state of each cell, its probability in 16 levels and its deviation in 8.
#pragma once

#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// The most rows and columns of a view in a code.
constexpr std::size_t MOST_CELLS = 512;

// States, levels of the probability and of the deviation of a cell.
constexpr int STATES = 4, LEVELS = 16, DEVIATIONS = 9;

// The cells of a view, row i forward and column j left.
struct CodedCells {
    View2<const std::uint8_t> state;      // CellState, 0…3
    View2<const std::uint8_t> level;      // of the probability, 0…15; from 8 on it reaches the threshold
    View2<const std::uint8_t> deviation;  // 0…7, 8 where there is none; (0, 0) where no cell has one
};

// The cell that the sensor stands in, or the nearest to it.
struct SensorCell {
    std::size_t row, column;
};

// What levels of probability (16) and of deviation (9) stand for.
struct LevelValues {
    const float *prob, *std;
};

// A view as it comes back; std is (0, 0) where the code has no deviations.
struct DecodedView {
    View2<std::uint8_t> state;
    View2<float> prob, std;
};

// The code of a view, which keeps each number. Cells are coded from the sensor outward, row by row, by their four coded
// neighbors: mostly a cell is like the one toward the sensor. Empty where a view is too irregular: decoding is bounded.
std::vector<std::uint8_t> encode_view(const CodedCells& cells, SensorCell sensor);

// Write the view that a code stands for; false where the bytes are no code of such a view.
bool decode_view(View1<const std::uint8_t> code, SensorCell sensor, const LevelValues& values, const DecodedView& view);

}  // namespace viewshed
