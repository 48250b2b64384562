#include "shape_classifier.hpp"

#include <array>

#include "bindings.hpp"

namespace viewshed {

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
                require(size > 0 && size <= MAX_UNITS, "a layer must have 1 to 128 units");
            }
            require(inputs <= MAX_UNITS, "shapes must have at most 128 columns");
            Buffer<float> prob(count * classes);
            without_lock([&] { classify_shapes(view(shapes), {view(mean), view(scale), layers}, prob); });
            return array(std::move(prob), {count, classes});
        },
        "shapes"_in, "mean"_in, "scale"_in, "first"_in, "first_bias"_in, "second"_in, "second_bias"_in, "third"_in,
        "third_bias"_in, "Return class probabilities (C, classes) of shapes (C, S), by a network of three layers.");
}

}  // namespace viewshed
