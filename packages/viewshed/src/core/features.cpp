#include "features.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include "azimuth_bins.hpp"
#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Heights above local ground that the lowest and the highest return resolve.
constexpr float LOW_M = -2.0f, HIGH_M = 4.0f;

// Expected returns that codes resolve, and steps of their table for each.
constexpr int MOST_RETURNS = 127, STEPS = 16;

// Distances that codes resolve, and steps of their table a meter.
constexpr float FARTHEST_M = 100.0f;
constexpr int STEPS_A_METER = 32;

// Standard deviations of the ground that codes resolve.
constexpr float LEAST_STD_M = 0.05f, MOST_STD_M = 5.0f;

// Cells of a part that is worth a thread.
constexpr std::size_t PART = 16384;

// log(1 + x) for x in [0, 2^23), without branches: fdlibm's log1pf (Sun Microsystems 1993), digit for digit.
INLINE float log1p_of(float x) {
    // 1 + x = 2^k (1 + f) with 1 + f in [√½, √2); what rounding 1 + x lost is c. Below √2 - 1 it is k = 0, f = x.
    const float sum = 1.0f + x;
    const auto bits = std::bit_cast<std::int32_t>(sum);
    const std::int32_t fraction = bits & 0x007fffff, exponent = (bits >> 23) - 127;
    const bool is_small = x < 0x1.a827aep-2f, is_upper = fraction >= 0x003504f7;
    const float scaled = std::bit_cast<float>(fraction | (is_upper ? 0x3f000000 : 0x3f800000));
    const float f = is_small ? x : scaled - 1.0f, k = is_small ? 0.0f : float(exponent + (is_upper ? 1 : 0));
    const float lost = (exponent > 0 ? 1.0f - (sum - x) : x - (sum - 1.0f)) / sum, c = is_small ? 0.0f : lost;
    // log(1 + f) = f - f²/2 + s (f²/2 + R(s²)) with s = f / (2 + f).
    const float half = 0.5f * f * f, s = f / (2.0f + f), z = s * s;
    float r = z * 1.4798198640e-01f + 1.5313838422e-01f;
    r = z * r + 1.8183572590e-01f;
    r = z * r + 2.2222198546e-01f;
    r = z * r + 2.8571429849e-01f;
    r = z * r + 4.0000000596e-01f;
    r = z * (z * r + 6.6666668653e-01f);
    const float without_k = f - (half - s * (half + r));
    const float with_k = k * 6.9313812256e-01f - ((half - (s * (half + r) + (k * 9.0580006145e-06f + c))) - f);
    return is_small ? without_k : with_k;
}

// Code of expected returns by their step: their logarithm, 255 from MOST_RETURNS on.
struct ReturnsTable {
    static constexpr int LAST = MOST_RETURNS * STEPS;
    std::array<std::uint8_t, LAST + 1> code;

    ReturnsTable() {
        for (int k = 0; k <= LAST; ++k) {
            const double size = 255.0 * std::log1p(double(k) / STEPS) / std::log1p(double(MOST_RETURNS));
            code[std::size_t(k)] = std::uint8_t(std::nearbyint(size));
        }
    }
};

// 128.5, more or less the logarithm of a signed distance, cut to a whole number.
std::uint8_t away_code(float away_m) {
    const float scale = float(127.0 / std::log1p(double(FARTHEST_M)));
    const float size = log1p_of(std::min(std::fabs(away_m), FARTHEST_M)) * scale;
    return std::uint8_t(128.5f + std::copysign(size, away_m));
}

// Code at each step of distance from -FARTHEST_M on, and the distances where codes begin. A step is shorter than any
// code is wide, so that a distance has the code of its step or the next one.
struct AwayTable {
    static constexpr std::size_t SIZE = std::size_t(2 * FARTHEST_M) * STEPS_A_METER + 1;
    std::array<std::uint8_t, SIZE> code;
    std::array<float, 257> begin;

    AwayTable() {
        for (std::size_t k = 0; k < SIZE; ++k) {
            const float step_m = float(k) / float(STEPS_A_METER) - FARTHEST_M;
            code[k] = away_code(std::max(step_m - 1e-4f, -FARTHEST_M));
        }
        for (int c = 0; c < 256; ++c) {
            float low = -FARTHEST_M, high = FARTHEST_M;
            for (int halving = 0; halving < 64; ++halving) {
                const float middle = (low + high) / 2.0f;
                (away_code(middle) >= c ? high : low) = middle;
            }
            begin[std::size_t(c)] = high;
        }
        begin[256] = std::numeric_limits<float>::infinity();
    }
};

// What is calculated becomes vectors, what is looked up does not: each loop does one of them.
MULTIVERSION void find_steps(const float* values, const float* further, std::size_t count, std::int32_t* step) {
    constexpr float LAST = float(ReturnsTable::LAST);
    for (std::size_t k = 0; k < count; ++k) {
        const float sum = further == nullptr ? values[k] : values[k] + further[k];
        const float at = sum * float(STEPS) < LAST ? sum * float(STEPS) : LAST;
        step[k] = std::int32_t(at > 0.0f ? at : 0.0f);
    }
}

void code_returns(const float* values, const float* further, std::size_t count, const ReturnsTable& table,
                  std::uint8_t* codes) {
    std::int32_t step[MOST_CELLS];
    find_steps(values, further, count, step);
    for (std::size_t k = 0; k < count; ++k) codes[k] = table.code[std::size_t(step[k])];
}

// The logarithm of standard deviations of the ground: 255 from MOST_STD_M on.
MULTIVERSION void code_deviations(const float* std_m, std::size_t count, float* codes) {
    const float scale = float(255.0 / std::log1p(double(MOST_STD_M / LEAST_STD_M)));
    for (std::size_t k = 0; k < count; ++k) {
        const float most_m = std_m[k] < MOST_STD_M ? std_m[k] : MOST_STD_M;
        codes[k] = log1p_of(most_m * float(1.0 / LEAST_STD_M)) * scale;
    }
}

MULTIVERSION void code_probabilities(const float* prob, std::size_t count, std::uint8_t* codes) {
    for (std::size_t k = 0; k < count; ++k) codes[k] = std::uint8_t(std::int32_t(prob[k] * 255.0f));
}

MULTIVERSION void code_ranges(const float* range_m, std::size_t count, std::uint8_t* codes) {
    for (std::size_t k = 0; k < count; ++k) {
        const float code = range_m[k] * float(255.0 / FARTHEST_M);
        codes[k] = std::uint8_t(std::int32_t(code < 255.0f ? code : 255.0f));
    }
}

// Turn limits into how far they lie beyond each cell, and the steps of that.
MULTIVERSION void find_steps_beyond(const float* range_m, std::size_t count, float* away_m, std::int32_t* step) {
    for (std::size_t k = 0; k < count; ++k) {
        float away = away_m[k] - range_m[k];
        away = away > -FARTHEST_M ? away : -FARTHEST_M;
        away_m[k] = away < FARTHEST_M ? away : FARTHEST_M;
        step[k] = std::int32_t((away_m[k] + FARTHEST_M) * float(STEPS_A_METER));
    }
}

void code_beyond(const float* limit_m, const std::int16_t* bin, const float* range_m, std::size_t count,
                 const AwayTable& table, std::uint8_t* codes) {
    float away_m[MOST_CELLS];
    std::int32_t step[MOST_CELLS];
    for (std::size_t k = 0; k < count; ++k) away_m[k] = limit_m[std::size_t(bin[k])];
    find_steps_beyond(range_m, count, away_m, step);
    for (std::size_t k = 0; k < count; ++k) {
        const std::size_t code = table.code[std::size_t(step[k])];
        codes[k] = std::uint8_t(code + (away_m[k] >= table.begin[code + 1]));
    }
}

MULTIVERSION void blend_rows(const double* low, const double* high, double down, std::size_t count,
                             std::uint8_t* codes) {
    for (std::size_t k = 0; k < count; ++k) {
        codes[k] = std::uint8_t(std::int32_t(float(low[k] * (1 - down) + high[k] * down)));
    }
}

// A position on the lattice: the node before it, and how far beyond that; at the edge beyond it.
struct Position {
    std::size_t node;
    double part;
};

Position locate(float at_m, float half_extent_m, std::size_t nodes) {
    const double nodes_per_m = double(nodes) / (2.0 * double(half_extent_m));
    double u = double(at_m + half_extent_m) * nodes_per_m - 0.5;
    u = u > 0.0 ? std::min(u, double(nodes) - 1.001) : 0.0;
    return {std::size_t(u), u - double(std::size_t(u))};
}

// The ground's deviation: codes at the nodes, which are fewer than the cells, and bilinear in between. Rows are asked
// for in ascending order, and each row of nodes is interpolated once.
class DeviationRows {
public:
    DeviationRows(View2<const float> std_m, const GridCells& cells, float half_extent_m)
        : std_m_(std_m), cells_(cells), half_extent_m_(half_extent_m), codes_(std_m.columns), low_(cells.y_m.size),
          high_(cells.y_m.size) {
        for (const float y_m : cells.y_m) columns_.push_back(locate(y_m, half_extent_m, std_m.columns));
    }

    void write(std::size_t i, std::uint8_t* codes) {
        const Position row = locate(cells_.x_m[i], half_extent_m_, std_m_.rows);
        if (row.node != node_) {
            if (row.node == node_ + 1) {
                std::swap(low_, high_);
            } else {
                interpolate(row.node, low_);
            }
            interpolate(row.node + 1, high_);
            node_ = row.node;
        }
        blend_rows(low_.data(), high_.data(), row.part, cells_.y_m.size, codes);
    }

private:
    void interpolate(std::size_t node, Buffer<double>& line) {
        code_deviations(std_m_[node], std_m_.columns, codes_.data());
        for (std::size_t j = 0; j < line.size(); ++j) {
            const auto [node_before, part] = columns_[j];
            line[j] = codes_[node_before] * (1 - part) + codes_[node_before + 1] * part;
        }
    }

    View2<const float> std_m_;
    const GridCells& cells_;
    float half_extent_m_;
    std::vector<Position> columns_;
    Buffer<float> codes_;
    Buffer<double> low_, high_;
    std::size_t node_ = std::numeric_limits<std::size_t>::max() - 1;  // of no row
};

// Write the codes (cells,) of row i; deviations have rows of their own.
void write_row(const Feature& feature, const GridCells& cells, std::size_t i, DeviationRows* deviations,
               std::uint8_t* codes) {
    static const ReturnsTable of_returns;
    static const AwayTable of_distances;
    const std::size_t count = cells.y_m.size;
    switch (feature.coding) {
        case Coding::BYTES:
            std::memcpy(codes, feature.bytes[i], count);
            break;
        case Coding::RETURNS:
            code_returns(feature.values[i], feature.further.data ? feature.further[i] : nullptr, count, of_returns,
                         codes);
            break;
        case Coding::PROBABILITY:
            code_probabilities(feature.values[i], count, codes);
            break;
        case Coding::BEYOND:
            code_beyond(feature.limit_m.data, cells.bin[i], cells.range_m[i], count, of_distances, codes);
            break;
        case Coding::RANGE:
            code_ranges(cells.range_m[i], count, codes);
            break;
        case Coding::DEVIATION:
            deviations->write(i, codes);
            break;
    }
}

// Move a row of codes to its blocks: what lies side by side in a row of a block at once.
template <std::size_t FOLD>
void fold_row(const std::uint8_t* codes, std::size_t blocks, std::size_t block_size, std::uint8_t* out) {
    for (std::size_t b = 0; b < blocks; ++b) std::memcpy(out + b * block_size, codes + b * FOLD, FOLD);
}

void fold_row(const std::uint8_t* codes, std::size_t fold, std::size_t blocks, std::size_t block_size,
              std::uint8_t* out) {
    switch (fold) {
        case 2: return fold_row<2>(codes, blocks, block_size, out);
        case 4: return fold_row<4>(codes, blocks, block_size, out);
        case 8: return fold_row<8>(codes, blocks, block_size, out);
        default:
            for (std::size_t b = 0; b < blocks; ++b) std::memcpy(out + b * block_size, codes + b * fold, fold);
    }
}

// Write the cell of each point of a block, cells · cells outside, and the code of its height.
MULTIVERSION void place_heights(const float* points, const float* height_m, std::size_t count, float x0_m, float y0_m,
                                float cells_per_m, float side, std::int32_t* cell, std::uint8_t* code) {
    constexpr float SCALE = 254.0f / (HIGH_M - LOW_M);
    for (std::size_t k = 0; k < count; ++k) {
        const float u = (points[3 * k] - x0_m) * cells_per_m, v = (points[3 * k + 1] - y0_m) * cells_per_m;
        const bool inside = (u >= 0.0f) & (v >= 0.0f) & (u < side) & (v < side);
        cell[k] = std::int32_t(inside ? u : side) * std::int32_t(side) + std::int32_t(inside ? v : 0.0f);
    }
    for (std::size_t k = 0; k < count; ++k) {
        float above_m = height_m[k] - LOW_M;
        above_m = above_m > 0.0f ? above_m : 0.0f;
        code[k] = std::uint8_t(1 + std::int32_t((above_m < HIGH_M - LOW_M ? above_m : HIGH_M - LOW_M) * SCALE));
    }
}

}  // namespace

void write_features(const std::vector<Feature>& features, const GridCells& cells, float half_extent_m, std::size_t fold,
                    View1<std::uint8_t> codes) {
    const std::size_t side = cells.x_m.size, height = std::max<std::size_t>(fold, 1);
    const std::size_t blocks = side / height, block_size = features.size() * height * height;
    for_ranges(blocks, count_parts(side * side, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t f = 0; f < features.size(); ++f) {
            std::optional<DeviationRows> deviations;
            if (features[f].coding == Coding::DEVIATION) deviations.emplace(features[f].values, cells, half_extent_m);
            std::uint8_t row[MOST_CELLS];
            for (std::size_t i = begin * height; i < end * height; ++i) {
                if (fold == 0) {
                    write_row(features[f], cells, i, &*deviations, &codes[(f * side + i) * side]);
                    continue;
                }
                write_row(features[f], cells, i, &*deviations, row);
                fold_row(row, fold, blocks, block_size,
                         &codes[i / fold * blocks * block_size + (f * fold + i % fold) * fold]);
            }
        }
    });
}

void write_heights(View2<const float> points, View1<const float> height_m, float x0_m, float y0_m, float cells_per_m,
                   std::size_t cells, View1<std::uint8_t> lowest, View1<std::uint8_t> highest) {
    // One cell more than the grid has takes the returns outside.
    Buffer<std::uint8_t> low(cells * cells + 1, 0), high(cells * cells + 1, 0);
    std::int32_t cell[BLOCK];
    std::uint8_t code[BLOCK];
    for (std::size_t start = 0; start < points.rows; start += BLOCK) {
        const std::size_t size = std::min(BLOCK, points.rows - start);
        place_heights(points[start], &height_m[start], size, x0_m, y0_m, cells_per_m, float(cells), cell, code);
        for (std::size_t k = 0; k < size; ++k) {
            const auto c = std::size_t(cell[k]);
            high[c] = std::max(high[c], code[k]);
            low[c] = std::max(low[c], std::uint8_t(-code[k]));  // 256 less the code, so that 0 is none here as well
        }
    }
    for (std::size_t c = 0; c < cells * cells; ++c) lowest[c] = std::uint8_t(-low[c]);
    std::copy_n(high.data(), cells * cells, highest.data);
}

void fold_maps(View3<const std::uint8_t> maps, std::size_t fold, View1<std::uint8_t> blocks) {
    const std::size_t features = maps.planes, cells = maps.rows, side = cells / fold, block_size = features * fold * fold;
    for (std::size_t i = 0; i < cells; ++i) {
        for (std::size_t f = 0; f < features; ++f) {
            fold_row(maps[f][i], fold, side, block_size, &blocks[i / fold * side * block_size + (f * fold + i % fold) * fold]);
        }
    }
}

}  // namespace viewshed
