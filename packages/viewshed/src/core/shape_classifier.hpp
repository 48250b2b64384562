// A small network on the shapes of candidates: standardization, two hidden layers, softmax.
#pragma once

#include <array>

#include "arrays.hpp"

namespace viewshed {

// Largest number of units of a layer.
constexpr std::size_t MAX_UNITS = 128;

struct Layer {
    View2<const float> weights;  // (in, out)
    View1<const float> bias;     // (out,)
};

struct ShapeNetwork {
    View1<const float> mean, scale;  // (S,) of the shapes, for standardization
    const std::array<Layer, 3>& layers;
};

// Write the class probabilities (C, classes) of shapes (C, S). Layers have at most MAX_UNITS units.
void classify_shapes(View2<const float> shapes, const ShapeNetwork& network, View1<float> prob);

}  // namespace viewshed
