#include "shape_classifier.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Fewest candidates for which a part pays for its thread.
constexpr std::size_t PART = 128;

// Compute out = in · weights + bias, with ReLU for hidden layers. Sums follow the order of the inputs.
MULTIVERSION void apply(const float* in, const Layer& layer, bool is_hidden, float* out) {
    const std::size_t units = layer.bias.size;
    for (std::size_t u = 0; u < units; ++u) out[u] = layer.bias.data[u];
    for (std::size_t k = 0; k < layer.weights.rows; ++k) {
        const float value = in[k];
        const float* row = layer.weights.data + k * units;
        for (std::size_t u = 0; u < units; ++u) out[u] += value * row[u];
    }
    if (!is_hidden) return;
    for (std::size_t u = 0; u < units; ++u) out[u] = out[u] > 0.0f ? out[u] : 0.0f;
}

}  // namespace

void classify_shapes(View2<const float> shapes, const ShapeNetwork& network, View1<float> prob) {
    const std::size_t count = shapes.rows, inputs = shapes.columns, classes = network.layers[2].bias.size;
    for_ranges(count, count_parts(count, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        std::array<float, MAX_UNITS> one, other;
        for (std::size_t n = begin; n < end; ++n) {
            const float* row = shapes[n];
            for (std::size_t k = 0; k < inputs; ++k) {
                const float value = (row[k] - network.mean[k]) * network.scale[k];
                one[k] = value > -MAX_DEVIATIONS ? (value < MAX_DEVIATIONS ? value : MAX_DEVIATIONS) : -MAX_DEVIATIONS;
            }
            apply(one.data(), network.layers[0], true, other.data());
            apply(other.data(), network.layers[1], true, one.data());
            apply(one.data(), network.layers[2], false, other.data());
            const float top = *std::max_element(other.data(), other.data() + classes);
            float* out = prob.data + n * classes;
            float sum = 0.0f;
            for (std::size_t u = 0; u < classes; ++u) sum += out[u] = std::exp(other[u] - top);
            for (std::size_t u = 0; u < classes; ++u) out[u] /= sum;
        }
    });
}

}  // namespace viewshed
