// Range image of a sweep: the pixel of each return, and the returns that no neighbor confirms.
#pragma once

#include <optional>

#include "arrays.hpp"

namespace viewshed {

// Return counts of a pixel saturate at this number.
constexpr std::uint8_t FULL_COUNT = 255;

// Throw std::invalid_argument if an image has no pixels, or far more than the densest sensor's.
void require_image(std::size_t rings, std::size_t columns);

// The N returns of a sweep on an image (rings, columns); the fields are documented in
// viewshed.preprocess.range_image.RangeImage.
struct RangeImage {
    std::size_t rings, columns;
    Buffer<std::int32_t> column;
    Buffer<std::uint8_t> counts;
    Buffer<float> nearest_m2, phase;
    Buffer<bool> isolated, behind;
    std::optional<Buffer<bool>> clutter;
    bool has_full_rings;  // about one return per column
};

// Assign points to pixels. Column 0 begins behind the sensor, and columns count counter-clockwise; a point without a
// ring (-1) has column -1. The phase is where in its columns a ring fires; it keeps firings near an edge from falling
// into either column by chance. Returns outside [near_m, far_m] confirm no others and are not isolated.
RangeImage range_image(View2<const float> points, View1<const std::int16_t> ring, std::size_t columns,
                       std::size_t rings, float near_m, float far_m);

// Mark the columns (columns,) with returns in less than half as many rings as the median of non-empty columns. They
// were dropped or lie at the edge of a dropped sector, even if they hold a few points.
Buffer<bool> silent_columns(View2<const std::uint8_t> counts);

// Remove returns from their pixels, in place. Saturated pixels keep their count: their number of returns is unknown.
void take_out(View1<const std::int16_t> ring, View1<const bool> left_out, View1<std::int32_t> column,
              View2<std::uint8_t> counts);

}  // namespace viewshed
