// The envelope: beams that are sent through a target in each cell, less those that a return blocks before it.
//
// Which beams are sent follows from what is given (beam table, attitude, height, ground), never from returns. A return only ever
// blocks, and a beam without one does not, so that the counts fall with every point that is added.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// The columns of azimuth that fall on a target in each cell; the same for every sweep. A beam is a ring in a column.
struct TargetColumns {
    // `width` columns from `begin` on have their middles within the target's width, `firings` of them surely; a return nearer
    // than `near_m` blocks. No firings where nothing can be sent.
    struct Window {
        std::uint32_t begin, width;
        std::int32_t firings;
        float near_m;
    };

    // Ranges and azimuths of the cells (rows, columns).
    TargetColumns(View2<const float> range_m, View2<const float> azimuth, std::size_t rings, std::size_t columns, double cell_m,
                  double width_m, double farthest_m);

    std::size_t rows, grid_columns, rings, columns;
    std::vector<float> range_m, azimuth;  // (cells,)
    std::vector<Window> windows;          // (cells,)
};

// The rings [ring, ring_end) that pass between a target's foot and its top in each cell.
struct SentBeams {
    // The least and the greatest height at which a beam meets a target in each cell, slopes (sectors, rings) of the beams by
    // azimuth, and the heights (rings,) at which they start. Raises where rings cross.
    SentBeams(std::shared_ptr<const TargetColumns> columns, View2<const float> low_m, View2<const float> high_m,
              View2<const float> slope, View1<const float> start_m);

    std::shared_ptr<const TargetColumns> of;
    Buffer<std::uint16_t> ring, ring_end;  // (cells,)
};

// What an attack changes: cells of a margin below `least` that it opens, or claims that it may have opened.
struct Attack {
    std::int32_t least;
    bool opens;

    // How many of the beams that can change must, in a cell of this margin: those that are blocked where it opens, else those
    // that are not; 0 where none need to.
    std::int32_t needed(std::int32_t margin) const {
        const std::int64_t apart = opens ? std::int64_t(least) - margin : std::int64_t(margin) - least + 1;
        return std::int32_t(std::clamp<std::int64_t>(apart, 0, INT32_MAX));
    }
};

// The horizontal range of the nearest return of each beam (rings, 2 * columns), the circle twice, so that no window is cut; +inf
// for none. `ring` (N,) are the points' rings, or empty: then the beam counts that passes nearest, by tangents of elevation and
// heights of origin (rings,). `turn` (9,) rotates to the level frame. Returns outside (near_m, far_m) are none.
Buffer<float> nearest_returns(View2<const float> points, View1<const std::int16_t> ring, View1<const float> turn,
                              View1<const float> tangent, View1<const float> origin_m, std::size_t columns, double near_m,
                              double far_m);

// This many columns of a ring without a near return are closed between two that have one.
constexpr std::size_t GAP = 4;

// Nearest ranges (rings, 2 * columns) with gaps of up to GAP columns closed.
//
// A gap takes the farther one of the nearest ranges at its two sides, which blocks what both of them block: a grey closing along
// the ring, a maximum over minima, so that it is nowhere farther and falls where a range falls.
Buffer<float> without_gaps(View2<const float> nearest);

// The margins (cells,): over the rings that pass, the firings sent less the beams blocked, not below 0; and whether the same is
// `least` or more where gaps are closed.
std::pair<Buffer<std::int32_t>, Buffer<bool>> envelope_margins(const SentBeams& sent, View2<const float> nearest,
                                                               std::int32_t least);

// For each beam (rings, columns), the sum over the cells that count and need at most `most` beams, of 1 / the number needed,
// where it is one of those that can change.
Buffer<double> cells_of_beams(const SentBeams& sent, View2<const float> nearest, View1<const std::int32_t> margin,
                              View1<const bool> counts, const Attack& rule, std::int32_t most);

// The most cells that one wedge of `wide` columns changes, and which any does.
std::int64_t wedge_changes(const SentBeams& sent, View2<const float> nearest, View1<const std::int32_t> margin,
                           View1<const bool> counts, const Attack& rule, std::size_t wide, View1<bool> changes);

}  // namespace viewshed
