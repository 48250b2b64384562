// The range image of a sweep: which beam measured each return, and which returns nothing around confirms.
#pragma once

#include <optional>

#include "arrays.hpp"

namespace viewshed {

// Pixels count their returns up to this number.
constexpr std::uint8_t FULL_COUNT = 255;

// Throw std::invalid_argument unless an image has pixels, and no more than the densest sensor's by far.
void require_image(std::size_t rings, std::size_t columns);

// The N returns of a sweep on an image of rings × columns; viewshed.preprocess.range_image.RangeImage says what each is.
struct RangeImage {
    std::size_t rings, columns;
    Buffer<std::int32_t> column;
    Buffer<std::uint8_t> counts;
    Buffer<float> nearest_m2, phase;
    Buffer<bool> isolated, behind;
    std::optional<Buffer<bool>> clutter;
    bool has_full_rings;  // as full as the columns are many
};

// Put points on their pixels. Column 0 begins behind the sensor, and columns count counter-clockwise; a point without a ring
// (-1) has column -1. The phase says where in its columns a ring fires, so that a firing just at an edge does not fall
// into either column by chance. Returns outside of [near_m, far_m] confirm none and are not isolated.
RangeImage range_image(View2<const float> points, View1<const std::int16_t> ring, std::size_t columns,
                       std::size_t rings, float near_m, float far_m);

// The columns (columns,) that returned from less than half as many rings as the median of those that did. They were dropped,
// or lie at the edge of a dropped sector, whatever a few points in them say.
Buffer<bool> silent_columns(View2<const std::uint8_t> counts);

// Take returns out of their pixels, in place. Pixels that were full stay so: how many more returns they hold is not known.
void take_out(View1<const std::int16_t> ring, View1<const bool> left_out, View1<std::int32_t> column,
              View2<std::uint8_t> counts);

}  // namespace viewshed
