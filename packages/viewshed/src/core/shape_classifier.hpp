// A small network over the shapes of candidates: standardized, two hidden layers, softmax.
#pragma once

#include <array>

#include "arrays.hpp"

namespace viewshed {

// Units of a layer at most.
constexpr std::size_t MOST_UNITS = 128;

struct Layer {
    View2<const float> weights;  // (in, out)
    View1<const float> bias;     // (out,)
};

struct ShapeNetwork {
    View1<const float> mean, scale;  // (S,) by which shapes are standardized
    const std::array<Layer, 3>& layers;
};

// Write the probability (C, classes) of each class for shapes (C, S). Layers have at most MOST_UNITS units.
void classify_shapes(View2<const float> shapes, const ShapeNetwork& network, View1<float> prob);

}  // namespace viewshed
