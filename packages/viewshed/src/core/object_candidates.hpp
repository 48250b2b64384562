// Object candidates: clusters of returns at several nested distances, with boxes and shape features.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Shape features of a candidate, in the column order of Python (viewshed.objects.candidates).
enum Shape {
    LOG_RETURNS, LOG_RANGE, LEVEL,                                   // how many, how far, linked at which distance
    LONG_M, SHORT_M, TOP_M, BOTTOM_M, MEAN_M, DEVIATION_M,           // sides of the box, and heights above the ground
    OVERHEAD, SHARE_LOW, SHARE_MIDDLE, SHARE_HIGH, SHARE_TALL,       // share of returns by height
    UPPER_LONG_M, UPPER_SHORT_M, LOWER_LONG_M, LOWER_SHORT_M,        // sides of what is above and below .6 of the top
    EDGE_M, EDGE_SHARE, FACE_M, FACE_SHARE,                          // how near to any side, and to the two near sides
    ALIGNMENT, FILL, MIDDLE_RISE_M, MAJOR_M, MINOR_M, LOG_LAYERS,    // line of sight, cells, profile, moments, rings
    HIDDEN_LEFT, HIDDEN_RIGHT, PARENT_SHARE, PARENT_M,               // something nearer at its ends; the next larger one
    SHAPES
};

// C candidates over P returns that stand on the ground.
struct Candidates {
    std::vector<std::int32_t> rows;          // (P,) rows of the points, sorted so that each candidate is a range
    std::vector<std::int32_t> first, last;   // (C,) each candidate's range of `rows`
    std::vector<std::int32_t> parent;        // (C,) the smallest larger candidate that contains it, -1 for none
    std::vector<std::array<float, 6>> sides; // (C,) heading of the long side, least and greatest coordinate along it,
                                             // the same across it, and 1 or 2 if only its left or right end is hidden,
                                             // else 0
    std::vector<std::array<float, SHAPES>> shapes;  // (C,)
};

// Find candidates among points (N, 3) in the level frame, with heights above the ground (N,) and horizontal ranges
// (N,).
//
// Returns are pooled in cells. Cells are linked at LEVELS distances that grow with range, and linked cells form
// components. A component is a candidate if it is larger than its parts at the next smaller distance. At most
// MAX_CELLS cells (the nearest) and MAX_CANDIDATES candidates (those with most returns) are used.
Candidates find_candidates(View2<const float> points, View1<const float> height_m, View1<const float> range_m,
                           float sensor_height_m);

}  // namespace viewshed
