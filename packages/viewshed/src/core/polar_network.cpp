#include "polar_network.hpp"

#include <algorithm>
#include <utility>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr std::size_t LENGTH = PolarNetwork::LENGTH;
typedef PolarNetwork::Vector Vector;

// Most output channels of a convolution.
constexpr std::size_t MAX_VECTORS = 8;

// Fewest pixels for which a part pays for its thread.
constexpr std::size_t PART = 96;

// Return a copy with a border of one pixel: the last azimuths before the first, the edge ranges repeated.
PolarImage bordered(const PolarImage& image) {
    const std::size_t rows = image.azimuths, columns = image.ranges, channels = image.channels;
    PolarImage wide(rows + 2, columns + 2, channels);
    for (std::size_t i = 0; i < rows + 2; ++i) {
        const std::size_t row = (i + rows - 1) % rows;
        std::copy_n(image(row, 0), channels, wide(i, 0));
        std::copy_n(image(row, 0), columns * channels, wide(i, 1));
        std::copy_n(image(row, columns - 1), channels, wide(i, columns + 1));
    }
    return wide;
}

// One row of a convolution: inputs of `size` rows (columns + size - 1, channels), outputs (columns, 8 · vectors).
struct RowOf {
    const float* rows[3];
    std::size_t size, length;  // rows of the window, and inputs in each: size · channels
    std::size_t columns, channels;
    const PolarNetwork::Element *weight, *bias;
    bool is_cut;  // at 0
};

// Sum PIXELS pixels at once: their sums stay in registers while the weights pass.
template <std::size_t VECTORS, std::size_t PIXELS>
INLINE void sum_pixels(const RowOf& of, std::size_t column, float* out) {
    Vector sums[PIXELS][VECTORS];
    for (std::size_t p = 0; p < PIXELS; ++p) {
        for (std::size_t v = 0; v < VECTORS; ++v) sums[p][v] = of.bias[v].lanes;
    }
    const PolarNetwork::Element* weight = of.weight;
    for (std::size_t row = 0; row < of.size; ++row) {
        const float* const in = of.rows[row] + column * of.channels;
        for (std::size_t k = 0; k < of.length; ++k, weight += VECTORS) {
            for (std::size_t p = 0; p < PIXELS; ++p) {
                for (std::size_t v = 0; v < VECTORS; ++v) sums[p][v] += in[p * of.channels + k] * weight[v].lanes;
            }
        }
    }
    for (std::size_t p = 0; p < PIXELS; ++p) {
        for (std::size_t v = 0; v < VECTORS; ++v) {
            const Vector sum = sums[p][v], zero{};
            const Vector kept = of.is_cut ? (sum > zero ? sum : zero) : sum;
            __builtin_memcpy(out + (column + p) * VECTORS * LENGTH + v * LENGTH, &kept, sizeof kept);
        }
    }
}

template <std::size_t VECTORS, std::size_t PIXELS>
INLINE void sum_row(const RowOf& of, float* out) {
    std::size_t column = 0;
    for (; column + PIXELS <= of.columns; column += PIXELS) sum_pixels<VECTORS, PIXELS>(of, column, out);
    for (; column < of.columns; ++column) sum_pixels<VECTORS, 1>(of, column, out);
}

MULTIVERSION void sum_row(const RowOf& of, std::size_t vectors, float* out) {
    switch (vectors) {
        case 1: return sum_row<1, 6>(of, out);
        case 2: return sum_row<2, 6>(of, out);
        case 3: return sum_row<3, 4>(of, out);
        case 4: return sum_row<4, 3>(of, out);
        case 5: return sum_row<5, 2>(of, out);
        case 6: return sum_row<6, 2>(of, out);
        case 7: return sum_row<7, 1>(of, out);
        default: return sum_row<8, 1>(of, out);
    }
}

// Return the largest of each 2 × 2 pixels.
PolarImage halved(const PolarImage& image) {
    PolarImage half(image.azimuths / 2, image.ranges / 2, image.channels);
    for (std::size_t i = 0; i < half.azimuths; ++i) {
        for (std::size_t j = 0; j < half.ranges; ++j) {
            const float *a = image(2 * i, 2 * j), *b = image(2 * i, 2 * j + 1), *c = image(2 * i + 1, 2 * j);
            const float* d = image(2 * i + 1, 2 * j + 1);
            float* to = half(i, j);
            for (std::size_t k = 0; k < image.channels; ++k) to[k] = std::max(std::max(a[k], b[k]), std::max(c[k], d[k]));
        }
    }
    return half;
}

// Return an image whose pixels are repeated to the size of another, followed by the channels of that one.
PolarImage doubled_beside(const PolarImage& image, const PolarImage& other) {
    PolarImage both(other.azimuths, other.ranges, image.channels + other.channels);
    for (std::size_t i = 0; i < both.azimuths; ++i) {
        for (std::size_t j = 0; j < both.ranges; ++j) {
            std::copy_n(image(i / 2, j / 2), image.channels, both(i, j));
            std::copy_n(other(i, j), other.channels, both(i, j) + image.channels);
        }
    }
    return both;
}

}  // namespace

PolarNetwork::Layer::Layer(const Convolution& of)
    : size(of.size), inputs(of.inputs), vectors((of.outputs + LENGTH - 1) / LENGTH),
      weight(size * size * inputs * vectors, Element{}), bias(vectors, Element{}) {
    require(vectors <= MAX_VECTORS, "a convolution must have at most 64 outputs");
    for (std::size_t k = 0; k < of.outputs; ++k) {
        bias[k / LENGTH].lanes[k % LENGTH] = of.bias[k];
        for (std::size_t row = 0; row < size * size * inputs; ++row) {
            weight[row * vectors + k / LENGTH].lanes[k % LENGTH] = of.scale[k] * float(of.weight[row * of.outputs + k]);
        }
    }
}

PolarImage PolarNetwork::Layer::operator()(const PolarImage& image, bool is_cut) const {
    require(inputs == image.channels, "an image must have as many channels as its convolution has inputs");
    const PolarImage wide = size > 1 ? bordered(image) : PolarImage(0, 0, 0);
    const PolarImage& in = size > 1 ? wide : image;
    PolarImage out(image.azimuths, image.ranges, vectors * LENGTH);
    const std::size_t parts = count_parts(image.azimuths * image.ranges, PART);
    for_ranges(image.azimuths, parts, [&](std::size_t, std::size_t begin, std::size_t end) {
        RowOf row{{}, size, size * inputs, image.ranges, inputs, weight.data(), bias.data(), is_cut};
        for (std::size_t i = begin; i < end; ++i) {
            for (std::size_t r = 0; r < size; ++r) row.rows[r] = in(i + r, 0);
            sum_row(row, vectors, out(i, 0));
        }
    });
    return out;
}

PolarNetwork::PolarNetwork(const std::vector<Convolution>& convolutions)
    : levels_(convolutions.size() / 4), layers_(convolutions.begin(), convolutions.end()) {
    require(levels_ >= 1 && convolutions.size() == 4 * levels_, "a network must have four convolutions a level");
}

PolarImage PolarNetwork::run(const PolarImage& input) const {
    auto layer = layers_.begin();
    PolarImage image = (*layer++)(input);
    std::vector<PolarImage> beside;
    for (std::size_t level = 0; level < levels_; ++level) {
        if (level > 0) image = halved(beside.back());
        image = (*layer++)(image);
        beside.push_back((*layer++)(image));
    }
    image = std::move(beside.back());
    for (std::size_t level = levels_ - 1; level-- > 0;) {
        image = (*layer++)(doubled_beside(image, beside[level]));
        image = (*layer++)(image);
    }
    return (*layer)(image, false);
}

}  // namespace viewshed
