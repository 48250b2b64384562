// Convolutional network on a polar image: azimuths wrap around the turn, ranges end at the edge.
#pragma once

#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// An image (azimuths, ranges, channels).
struct PolarImage {
    PolarImage(std::size_t azimuths_, std::size_t ranges_, std::size_t channels_)
        : azimuths(azimuths_), ranges(ranges_), channels(channels_), values(azimuths * ranges * channels) {}

    std::size_t azimuths, ranges, channels;
    Buffer<float> values;

    float* operator()(std::size_t azimuth, std::size_t range) { return &values[(azimuth * ranges + range) * channels]; }
    const float* operator()(std::size_t azimuth, std::size_t range) const {
        return &values[(azimuth * ranges + range) * channels];
    }
};

// Weights of a convolution over size × size pixels: bytes (size · size · inputs, outputs) to be multiplied by a scale for
// each output, and a bias for each output.
struct Convolution {
    std::size_t size, inputs, outputs;
    const std::int8_t* weight;
    const float *scale, *bias;
};

// A U-Net. The convolutions, in this order: the first, of one pixel; two of 3 × 3 pixels for each level, finest first;
// two for each level on the way up, coarsest first; the last, of one pixel. All but the last are followed by max(0, x).
// Between levels, the largest of 2 × 2 pixels goes down; each pixel is repeated on the way up, and the image of that
// level is put beside it.
class PolarNetwork {
public:
    // Outputs are computed in vectors of this length; their number is padded to a multiple of it.
    static constexpr std::size_t LENGTH = 8;
    typedef float Vector __attribute__((vector_size(LENGTH * sizeof(float))));
    // As an element of std::vector: without AVX the compiler aligns a vector of 32 bytes to 16, with AVX it expects 32.
    struct alignas(LENGTH * sizeof(float)) Element {
        Vector lanes;
    };

    explicit PolarNetwork(const std::vector<Convolution>& convolutions);

    // Return the output image. It does not depend on the processor or on the number of threads.
    PolarImage run(const PolarImage& input) const;

private:
    struct Layer {
        explicit Layer(const Convolution& of);
        // Return the convolved image.
        PolarImage operator()(const PolarImage& image, bool is_cut = true) const;

        std::size_t size, inputs, vectors;
        std::vector<Element> weight, bias;  // (size · size · inputs, vectors), (vectors,)
    };

    std::size_t levels_;
    std::vector<Layer> layers_;
};

}  // namespace viewshed
