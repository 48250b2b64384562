// The envelope: beams that are sent through a target in each cell, less those that a return blocks before it.
//
// Which beams are sent follows from what is given (beam table, attitude, height, ground), never from returns. A return only ever
// blocks, and a beam without one does not, so that the counts fall with every point that is added.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
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

    // Ranges and azimuths of the cells (rows, columns); which columns are fired (rings, columns), or no data for all.
    TargetColumns(View2<const float> range_m, View2<const float> azimuth, View2<const std::uint8_t> fired, std::size_t rings,
                  std::size_t columns, double cell_m, double width_m, double farthest_m);

    // The firings of a ring in a window.
    std::int32_t firings(const Window& at, std::size_t ring) const {
        if (fired_before.empty()) return at.firings;
        const std::uint32_t* const before = &fired_before[ring * (2 * columns + 1)];
        return std::min(at.firings, std::int32_t(before[at.begin + at.width] - before[at.begin]));
    }

    std::size_t rows, grid_columns, rings, columns;
    std::vector<float> range_m, azimuth;      // (cells,)
    std::vector<Window> windows;              // (cells,)
    std::vector<std::uint32_t> fired_before;  // (rings, 2 * columns + 1) fired columns before each, or empty
};

// The rings that pass between a target's foot and its top in each cell: those in [ring, ring_end) whose bit is set.
struct SentBeams {
    // The least and the greatest height at which a beam meets a target in each cell, slopes (sectors, rings) of the beams by
    // azimuth, and the heights (rings,) at which they start.
    SentBeams(std::shared_ptr<const TargetColumns> columns, View2<const float> low_m, View2<const float> high_m,
              View2<const float> slope, View1<const float> start_m);

    bool passes(std::size_t cell, std::size_t r) const { return (bits[cell * words + r / 64] >> (r % 64)) & 1; }

    std::shared_ptr<const TargetColumns> of;
    std::size_t words;
    Buffer<std::uint64_t> bits;               // (cells, words)
    Buffer<std::uint16_t> ring, ring_end;     // (cells,)
};

void bind_guarantees(nb::module_& m);

}  // namespace viewshed
