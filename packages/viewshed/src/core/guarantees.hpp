// The envelope: beams sent through a target in each cell, minus those that a return blocks before it.
//
// The sent beams follow from given data (beam table, attitude, height, ground), never from returns. A return only ever
// blocks and a missing return never does, so the counts fall with every added point.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// Azimuth columns that fall on a target in each cell; the same for every sweep. A beam is a ring in a column.
struct TargetColumns {
    // `width` columns from `begin` on have their centers within the target's width, and at least `firings` of them are
    // sent. Returns nearer than `near_m` block. `firings` is 0 if nothing can be sent.
    struct Window {
        std::uint32_t begin, width;
        std::int32_t firings;
        float near_m;
    };

    // Take ranges and azimuths of the cells (rows, columns).
    TargetColumns(View2<const float> range_m, View2<const float> azimuth, std::size_t rings, std::size_t columns, double cell_m,
                  double width_m, double farthest_m);

    std::size_t rows, grid_columns, rings, columns;
    std::vector<float> range_m, azimuth;  // (cells,)
    std::vector<Window> windows;          // (cells,)
};

// Rings [ring, ring_end) that pass between a target's foot and its top in each cell.
struct SentBeams {
    // Take the lowest and the highest height at which a beam meets a target in each cell, slopes (sectors, rings) of
    // the beams by azimuth, and the heights (rings,) of their origins. Throws if rings cross.
    SentBeams(std::shared_ptr<const TargetColumns> columns, View2<const float> low_m, View2<const float> high_m,
              View2<const float> slope, View1<const float> start_m);

    std::shared_ptr<const TargetColumns> of;
    Buffer<std::uint16_t> ring, ring_end;  // (cells,)
};

// What an attack changes: it opens cells with a margin below `least`, or makes claims that it may have opened.
struct Attack {
    std::int32_t least;
    bool opens;

    // Return how many beams (blocked ones if the attack opens, else the others) must change at this margin; 0 if none.
    std::int32_t needed(std::int32_t margin) const {
        const std::int64_t apart = opens ? std::int64_t(least) - margin : std::int64_t(margin) - least + 1;
        return std::int32_t(std::clamp<std::int64_t>(apart, 0, INT32_MAX));
    }
};

// Return the horizontal range of the nearest return of each beam (rings, 2 * columns), +inf for none; the columns are
// repeated once so that no window wraps. `ring` (N,) are the points' rings. If it is empty, a point belongs to the beam
// that passes nearest, by tangents of elevation and origin heights (rings,). `turn` (9,) rotates to the level frame.
// Returns outside (near_m, far_m) are ignored.
Buffer<float> nearest_returns(View2<const float> points, View1<const std::int16_t> ring, View1<const float> turn,
                              View1<const float> tangent, View1<const float> origin_m, std::size_t columns, double near_m,
                              double far_m);

// Longest gap in a ring, in columns, that is closed between two near returns.
constexpr std::size_t GAP = 4;

// Return nearest ranges (rings, 2 * columns) with gaps of up to GAP columns closed.
//
// A gap takes the farther of the nearest ranges at its two sides, so it blocks what both sides block. This is a
// morphological closing along the ring (maximum of minima): it is nowhere farther, and falls where a range falls.
Buffer<float> without_gaps(View2<const float> nearest);

// Return the margins (cells,), the sum over passing rings of max(firings sent - beams blocked, 0), and a mask of cells
// whose margin with closed gaps is at least `least`.
std::pair<Buffer<std::int32_t>, Buffer<bool>> envelope_margins(const SentBeams& sent, View2<const float> nearest,
                                                               std::int32_t least);

// Return for each beam (rings, columns) the sum of 1 / (number of needed beams) over the counted cells that need at
// most `most` beams and where this beam can change.
Buffer<double> cells_of_beams(const SentBeams& sent, View2<const float> nearest, View1<const std::int32_t> margin,
                              View1<const bool> counts, const Attack& rule, std::int32_t most);

// Return the largest number of cells that one wedge of `wide` columns changes; mark the cells that any wedge changes.
std::int64_t wedge_changes(const SentBeams& sent, View2<const float> nearest, View1<const std::int32_t> margin,
                           View1<const bool> counts, const Attack& rule, std::size_t wide, View1<bool> changes);

}  // namespace viewshed
