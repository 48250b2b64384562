#include "fov_code.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>

#include "range_coder.hpp"

namespace viewshed {
namespace {

// Cells of a row that one decision may declare equal to their surroundings.
constexpr std::size_t GROUP = 8;

// Upper bound of the decisions in a code, per cell and in addition, to bound the decoding.
constexpr std::size_t DECISIONS_PER_CELL = 4, MORE_DECISIONS = 4096;

// 16-bit end marker of a code: a desynchronized decoder does not find it.
constexpr std::uint32_t END_MARKER = 0x5a3c;
constexpr int END_BITS = 16;

// Depth of a level: distance from the expected level, the highest for visible states (FREE 1, SURFACE 2), else the
// lowest.
constexpr int depth_of(int state, int level) { return state == 1 || state == 2 ? LEVELS - 1 - level : level; }

// A symbol combines the state and the level of a cell.
constexpr int symbol_of(int state, int level) { return state * LEVELS + level; }
constexpr int state_of(int symbol) { return symbol >> 4; }
constexpr int level_of(int symbol) { return symbol & 15; }

MULTIVERSION void split_symbols(const std::uint8_t* symbols, std::size_t count, const float* prob, std::uint8_t* state,
                                float* probs) {
    for (std::size_t j = 0; j < count; ++j) state[j] = std::uint8_t(state_of(symbols[j]));
    for (std::size_t j = 0; j < count; ++j) probs[j] = prob[level_of(symbols[j])];
}

MULTIVERSION void look_up(const std::uint8_t* levels, std::size_t count, const float* values, float* found) {
    for (std::size_t j = 0; j < count; ++j) found[j] = values[levels[j]];
}

// Classes of depths.
constexpr std::array<std::uint8_t, LEVELS> DEPTH_CLASS{0, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 3, 3};
constexpr int DEPTH_CLASSES = 4;

// Classes of the weighted sum of four neighbors' depths, 0…90.
constexpr int SUM_CLASSES = 10;
constexpr std::array<std::uint8_t, 91> SUM_CLASS = [] {
    constexpr int starts[SUM_CLASSES - 1] = {1, 3, 6, 12, 18, 26, 36, 50, 70};
    std::array<std::uint8_t, 91> table{};
    for (int sum = 0; sum <= 90; ++sum) {
        for (const int start : starts) table[sum] = std::uint8_t(table[sum] + (sum >= start));
    }
    return table;
}();

// Initial probabilities in percent, from real views: a cell equals the predicted one, by the number of neighbors that
// do; its state differs, by the number of neighbors with the predicted state; its depth is above 0, by the class of the
// neighbors' sum.
constexpr std::array<int, 5> LIKE_PREDICTED{40, 40, 55, 83, 96}, OTHER_STATE{80, 80, 74, 57, 10};
constexpr std::array<int, SUM_CLASSES> DEEPER{3, 14, 18, 71, 82, 93, 95, 93, 93, 83};
constexpr BitModel expecting(int percent) { return {std::uint16_t(percent * 65536 / 100), 2}; }

// Contexts of the predicted cell's depth: up to 8, or none if the state differs.
constexpr int PREDICTED_DEPTHS = 10;

// A plane of bytes with an extra column on either side that repeats the outermost one, and space for a group beyond.
class Plane {
public:
    explicit Plane(std::size_t cells)
        : cells_(cells), data_(cells * (cells + 2) + 2 * GROUP), nothing_(cells + 2 + 2 * GROUP, 0) {}

    std::uint8_t* row(std::size_t i) { return data_.data() + i * (cells_ + 2) + 1; }
    // The row before the first one: all UNKNOWN.
    const std::uint8_t* nothing() const { return nothing_.data() + 1; }
    void close(std::size_t i) {
        row(i)[-1] = row(i)[0];
        row(i)[cells_] = row(i)[cells_ - 1];
    }

private:
    std::size_t cells_;
    Buffer<std::uint8_t> data_, nothing_;
};

// Neighbor of a cell toward the sensor: in the same row, in the row before, or diagonal.
enum Toward { BESIDE, BELOW, DIAGONAL };
constexpr int TOWARDS = 3;

// A cell to be coded, column j of a row. `below` is the row coded before it, and the row is coded in direction `step`.
// The first cell of a row has no coded neighbor beside it.
struct Place {
    std::uint8_t* row;
    const std::uint8_t* below;
    std::ptrdiff_t j, step;
    bool first;
    Toward toward;

    int beside() const { return first ? below[j] : row[j - step]; }
    int predicted() const { return toward == BESIDE ? beside() : toward == BELOW ? below[j] : below[j - step]; }
};

// Check if the coded cells around a group are all equal. They are below[j - 1…j + 8] outward.
INLINE bool is_even_about(const Place& at) {
    std::uint64_t left, right;
    const std::uint8_t* low = at.below + (at.step > 0 ? at.j - 1 : at.j - std::ptrdiff_t(GROUP));
    std::memcpy(&left, low, sizeof left);
    std::memcpy(&right, low + 2, sizeof right);
    const std::uint64_t same = at.below[at.j] * 0x0101010101010101ull;
    return left == same && right == same && at.beside() == at.below[at.j];
}

// Return the cells of a group, from low to high columns.
INLINE std::uint8_t* group_of(const Place& at) { return at.row + (at.step > 0 ? at.j : at.j - std::ptrdiff_t(GROUP) + 1); }

// Codes planes of cells: a decoder writes them, an encoder reads them.
template <typename Coder>
class ViewCoder {
public:
    ViewCoder(Coder& coder, std::size_t cells, SensorCell sensor) : coder_(coder), cells_(cells), sensor_(sensor) {
        for (std::size_t k = 0; k < copy_models_.size(); ++k) {
            const unsigned agreeing = unsigned(k / (STATES * DEPTH_CLASSES * TOWARDS));
            copy_models_[k] = expecting(LIKE_PREDICTED[std::popcount(agreeing)]);
        }
        for (int k = 0; k < TOWARDS * STATES * STATES * STATES * STATES; ++k) {
            const std::array<int, 4> neighbors{k >> 6 & 3, k >> 4 & 3, k >> 2 & 3, k & 3};  // beside … other
            const auto agreeing = std::count(neighbors.begin(), neighbors.end(), neighbors[k >> 8]);
            state_models_[4 * k] = expecting(OTHER_STATE[agreeing]);
        }
        for (std::size_t k = 0; k < depth_models_.size(); k += 16) {
            depth_models_[k] = expecting(DEEPER[k / (16 * PREDICTED_DEPTHS) % SUM_CLASSES]);
        }
    }

    // Code the symbols of all cells; false if the code is invalid.
    bool code_symbols(Plane& symbols) {
        return walk(symbols, [this](const Place& at, std::size_t) { return code_symbol(at); },
                    [this](const Place& at, std::size_t) { return &group_models_[at.below[at.j]]; });
    }

    // Code the deviations of all cells, after their symbols.
    bool code_deviations(Plane& deviations, Plane& symbols) {
        return walk(deviations, [&](const Place& at, std::size_t i) { return code_deviation(at, symbols.row(i)[at.j]); },
                    [&](const Place& at, std::size_t i) {
                        const int symbol = symbols.row(i)[at.j];
                        const int depth = depth_of(state_of(symbol), level_of(symbol));
                        return &deviation_group_models_[at.below[at.j] * DEPTH_CLASSES + DEPTH_CLASS[depth]];
                    });
    }

private:
    // Code rows outward from the sensor, first forward, then backward, and each row from the sensor to either side.
    template <typename Cell, typename GroupModel>
    INLINE bool walk(Plane& plane, const Cell& code_cell, const GroupModel& group_model) {
        const auto code_row = [&](std::size_t i, const std::uint8_t* below, std::size_t a) {
            Place at{plane.row(i), below, 0, 1, true, BESIDE};
            for (const bool left : {true, false}) {
                const std::size_t count = left ? cells_ - sensor_.column : sensor_.column;
                at.j = std::ptrdiff_t(sensor_.column) - (left ? 0 : 1);
                at.step = left ? 1 : -1;
                for (std::size_t b = 0; b < count;) {
                    at.first = left && b == 0;
                    if (b % GROUP == 0 && b + GROUP <= count && is_even_about(at) && code_group(at, *group_model(at, i))) {
                        b += GROUP;
                        at.j += at.step * std::ptrdiff_t(GROUP);
                        continue;
                    }
                    at.toward = b > 2 * a ? BESIDE : a > 2 * b ? BELOW : DIAGONAL;
                    if (!code_cell(at, i)) return false;
                    ++b;
                    at.j += at.step;
                }
            }
            plane.close(i);
            return !coder_.failed() && coder_.decisions() <= DECISIONS_PER_CELL * cells_ * cells_ + MORE_DECISIONS;
        };
        for (std::size_t i = sensor_.row; i < cells_; ++i) {
            if (!code_row(i, i == sensor_.row ? plane.nothing() : plane.row(i - 1), i - sensor_.row)) return false;
        }
        for (std::size_t i = sensor_.row; i-- > 0;) {
            if (!code_row(i, plane.row(i + 1), sensor_.row - 1 - i)) return false;
        }
        return true;
    }

    // Code whether a group equals its surroundings.
    INLINE bool code_group(const Place& at, BitModel& model) {
        const std::uint8_t value = at.below[at.j];
        std::uint8_t* const cells = group_of(at);
        bool same = false;
        if constexpr (!Coder::DECODES) same = std::all_of(cells, cells + GROUP, [&](auto cell) { return cell == value; });
        same = coder_.bit(model, same);
        if constexpr (Coder::DECODES) {
            if (same) std::fill_n(cells, GROUP, value);
        }
        return same;
    }

    INLINE bool code_symbol(const Place& at) {
        const int beside = at.beside(), below = at.below[at.j];
        const int diagonal = at.below[at.j - at.step], other = at.below[at.j + at.step];
        const int predicted = at.predicted();
        const int state_p = state_of(predicted), depth_p = depth_of(state_p, level_of(predicted));
        int symbol = 0, state = 0, depth = 0;
        if constexpr (!Coder::DECODES) {
            symbol = at.row[at.j];
            state = state_of(symbol);
            depth = depth_of(state, level_of(symbol));
        }

        // 1. Equality with the predicted cell, which is most frequent.
        const int agreeing = (beside == predicted) | (below == predicted) << 1 | (other == predicted) << 2 |
                             (diagonal == predicted) << 3;
        const int copying = ((agreeing * STATES + state_p) * DEPTH_CLASSES + DEPTH_CLASS[depth_p]) * TOWARDS + at.toward;
        if (coder_.bit(copy_models_[copying], symbol == predicted)) {
            if constexpr (Coder::DECODES) at.row[at.j] = std::uint8_t(predicted);
            return true;
        }

        // 2. The state, as bit flips of the predicted one.
        const int states = (((at.toward * STATES + state_of(beside)) * STATES + state_of(below)) * STATES +
                            state_of(diagonal)) * STATES + state_of(other);
        BitModel* const turned = &state_models_[states * 4];
        int turn = state ^ state_p;
        if (!coder_.bit(turned[0], turn != 0)) {
            turn = 0;
        } else if (!coder_.bit(turned[1], turn != 1)) {
            turn = 1;
        } else {
            turn = coder_.bit(turned[2], turn == 3) ? 3 : 2;
        }
        state = state_p ^ turn;

        // 3. The depth of the level, by the neighbors' depths: 0, or depth - 1 in three bits, where 7 adds three more.
        const auto depth_here = [&](int neighbor) { return depth_of(state, level_of(neighbor)); };
        const int sum = 2 * depth_here(beside) + 2 * depth_here(below) + depth_here(diagonal) + depth_here(other);
        const int known = turn == 0 ? 1 + std::min(depth_p, PREDICTED_DEPTHS - 2) : 0;
        BitModel* const model = &depth_models_[((state * SUM_CLASSES + SUM_CLASS[sum]) * PREDICTED_DEPTHS + known) * 16];
        // In the predicted state the predicted level is excluded.
        const bool surely_deeper = turn == 0 && depth_p == 0;
        if (surely_deeper || coder_.bit(model[0], depth != 0)) {
            int found = code_three(model, std::min(depth - 1, 7));
            if (found == 7) found += code_three(model + 8, depth - 8);
            depth = found + 1;
        } else {
            depth = 0;
        }
        if constexpr (Coder::DECODES) {
            if (depth >= LEVELS || (turn == 0 && depth == depth_p)) return false;
            at.row[at.j] = std::uint8_t(symbol_of(state, depth_of(state, depth)));
        }
        return true;
    }

    // Code a three-bit number by a tree of seven models with root model[1].
    INLINE int code_three(BitModel* model, int value) {
        int node = 1;
        for (int k = 2; k >= 0; --k) node = 2 * node + coder_.bit(model[node], (value >> k) & 1);
        return node - 8;
    }

    // Code a deviation in unary, by those of the neighbors and the depth of the cell's level.
    INLINE bool code_deviation(const Place& at, int symbol) {
        const int sum = 2 * at.beside() + 2 * at.below[at.j] + at.below[at.j - at.step] + at.below[at.j + at.step];
        const int depth = depth_of(state_of(symbol), level_of(symbol));
        BitModel* const model = &deviation_models_[((sum + 1) / 2 * DEPTH_CLASSES + DEPTH_CLASS[depth]) * DEVIATIONS];
        int value = 0, found = 0;
        if constexpr (!Coder::DECODES) value = at.row[at.j];
        while (found < DEVIATIONS - 1 && coder_.bit(model[found], value > found)) ++found;
        if constexpr (Coder::DECODES) at.row[at.j] = std::uint8_t(found);
        return true;
    }

    Coder& coder_;
    std::size_t cells_;
    SensorCell sensor_;
    std::array<BitModel, STATES * LEVELS> group_models_{};
    std::array<BitModel, 16 * STATES * DEPTH_CLASSES * TOWARDS> copy_models_{};
    std::array<BitModel, TOWARDS * STATES * STATES * STATES * STATES * 4> state_models_{};
    std::array<BitModel, STATES * SUM_CLASSES * PREDICTED_DEPTHS * 16> depth_models_{};
    std::array<BitModel, DEVIATIONS * DEPTH_CLASSES> deviation_group_models_{};
    std::array<BitModel, (3 * (DEVIATIONS - 1) + 1) * DEPTH_CLASSES * DEVIATIONS> deviation_models_{};
};

}  // namespace

std::vector<std::uint8_t> encode_view(const CodedCells& cells, SensorCell sensor) {
    const std::size_t count = cells.state.rows;
    Plane symbols(count), deviations(cells.deviation.rows);
    for (std::size_t i = 0; i < count; ++i) {
        for (std::size_t j = 0; j < count; ++j) {
            symbols.row(i)[j] = std::uint8_t(symbol_of(cells.state(i, j), cells.level(i, j)));
        }
    }
    for (std::size_t i = 0; i < cells.deviation.rows; ++i) {
        std::copy_n(cells.deviation[i], count, deviations.row(i));
    }
    RangeEncoder encoder;
    ViewCoder<RangeEncoder> coder(encoder, count, sensor);
    if (!coder.code_symbols(symbols)) return {};
    if (cells.deviation.rows > 0 && !coder.code_deviations(deviations, symbols)) return {};
    encoder.plain(END_MARKER, END_BITS);
    return encoder.finish();
}

bool decode_view(View1<const std::uint8_t> code, SensorCell sensor, const LevelValues& values, const DecodedView& view) {
    const std::size_t count = view.state.rows;
    Plane symbols(count), deviations(view.std.rows);
    RangeDecoder decoder(code);
    ViewCoder<RangeDecoder> coder(decoder, count, sensor);
    if (!coder.code_symbols(symbols)) return false;
    if (view.std.rows > 0 && !coder.code_deviations(deviations, symbols)) return false;
    if (decoder.plain(0, END_BITS) != END_MARKER || !decoder.ended()) return false;
    for (std::size_t i = 0; i < count; ++i) split_symbols(symbols.row(i), count, values.prob, view.state[i], view.prob[i]);
    for (std::size_t i = 0; i < view.std.rows; ++i) look_up(deviations.row(i), count, values.std, view.std[i]);
    return true;
}

}  // namespace viewshed
