// A small network over the shapes of candidates: standardized, two hidden layers, softmax.
#include <algorithm>
#include <array>
#include <cmath>

#include "parallel.hpp"
#include "stages.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Standardized shapes are cut off here, so that one that was never seen does not outweigh all others.
constexpr float MOST = 6.0f;

// Units of a layer at most, and candidates of a part that is worth a thread.
constexpr std::size_t MOST_UNITS = 128, PART = 128;

struct Layer {
    View2<const float> weights;  // (in, out)
    View1<const float> bias;     // (out,)
};

// out = in · weights + bias, without negative values where the layer is a hidden one. Sums go in the order of the inputs.
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

void bind_shape_classifier(nb::module_& m) {
    m.def(
        "shape_probabilities",
        [](In2<float> shapes, In1<float> mean, In1<float> scale, In2<float> first, In1<float> first_bias,
           In2<float> second, In1<float> second_bias, In2<float> third, In1<float> third_bias) {
            const std::array<Layer, 3> layers{Layer{view(first), view(first_bias)}, Layer{view(second), view(second_bias)},
                                              Layer{view(third), view(third_bias)}};
            const std::size_t count = shapes.shape(0), inputs = shapes.shape(1), classes = third_bias.shape(0);
            require(mean.shape(0) == inputs && scale.shape(0) == inputs, "mean and scale must be as long as a row of shapes");
            std::size_t size = inputs;
            for (const Layer& layer : layers) {
                require(layer.weights.rows == size && layer.weights.columns == layer.bias.size, "layers must fit each other");
                size = layer.bias.size;
                require(size > 0 && size <= MOST_UNITS, "a layer must have 1 to 128 units");
            }
            require(inputs <= MOST_UNITS, "shapes must have at most 128 columns");
            Buffer<float> prob(count * classes);
            {
                nb::gil_scoped_release unlocked;
                for_ranges(count, count_parts(count, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
                    std::array<float, MOST_UNITS> one, other;
                    for (std::size_t n = begin; n < end; ++n) {
                        const float* row = shapes.data() + n * inputs;
                        for (std::size_t k = 0; k < inputs; ++k) {
                            const float value = (row[k] - mean.data()[k]) * scale.data()[k];
                            one[k] = value > -MOST ? (value < MOST ? value : MOST) : -MOST;
                        }
                        apply(one.data(), layers[0], true, other.data());
                        apply(other.data(), layers[1], true, one.data());
                        apply(one.data(), layers[2], false, other.data());
                        const float top = *std::max_element(other.data(), other.data() + classes);
                        float* out = prob.data() + n * classes;
                        float sum = 0.0f;
                        for (std::size_t u = 0; u < classes; ++u) sum += out[u] = std::exp(other[u] - top);
                        for (std::size_t u = 0; u < classes; ++u) out[u] /= sum;
                    }
                });
            }
            return std::move(prob).array({count, classes});
        },
        "shapes"_a.noconvert(), "mean"_a.noconvert(), "scale"_a.noconvert(), "first"_a.noconvert(),
        "first_bias"_a.noconvert(), "second"_a.noconvert(), "second_bias"_a.noconvert(), "third"_a.noconvert(),
        "third_bias"_a.noconvert(), "Probability (C, classes) of each class for shapes (C, S), by a network of three layers.");
}

}  // namespace viewshed
