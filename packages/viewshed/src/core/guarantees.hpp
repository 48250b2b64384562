// The envelope: beams that are sent through a target in each cell, less those that a return blocks before it.
//
// Which beams are sent follows from what is given (beam table, attitude, height, ground), never from returns. A return only ever
// blocks, and a beam without one does not, so that the counts fall with every point that is added.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

// What is given: the same for every sweep that is compared.
class SentBeams {
public:
    // The beams that may meet a target in a cell: those of the rings in [ring, ring_end) that pass between its foot and its top,
    // in `width` columns from `begin` on, of which `firings` surely lie within the target's width. A return nearer than
    // `near_m` blocks. No firings where nothing is sent.
    struct Window {
        std::uint32_t begin, width;
        std::int32_t firings;
        float near_m;
        std::uint16_t ring, ring_end;
    };

    // The windows of the cells, no ring in any. Ranges and azimuths of the cells (rows, columns); which columns are fired (rings,
    // columns), or no data for all.
    SentBeams(View2<const float> range_m, View2<const float> azimuth, View2<const std::uint8_t> fired, std::size_t rings,
              std::size_t columns, double cell_m, double width_m, double farthest_m);

    // The same with the rings that pass: the least and the greatest height at which a beam meets a target in each cell, slopes
    // (rings, sectors) of the beams by azimuth, and the heights (rings,) at which they start.
    SentBeams aimed(View2<const float> low_m, View2<const float> high_m, View2<const float> slope,
                    View1<const float> start_m) const;

    // Whether a ring passes between a target's foot and its top.
    bool passes(std::size_t cell, std::size_t ring) const { return (ring_bits[cell * words + ring / 64] >> (ring % 64)) & 1; }
    // The firings of a ring in a window.
    std::int32_t firings(const Window& at, std::size_t ring) const {
        if (fired_before.empty()) return at.firings;
        const std::uint32_t* const before = &fired_before[ring * (2 * columns + 1)];
        return std::min(at.firings, std::int32_t(before[at.begin + at.width] - before[at.begin]));
    }

    std::vector<float> range_m, azimuth;    // (cells,)
    std::size_t rows, grid_columns, rings, columns, words;
    std::vector<Window> windows;            // (cells,)
    std::vector<std::uint64_t> ring_bits;   // (cells, words)
    std::vector<std::uint32_t> fired_before;  // (rings, 2 * columns + 1) fired columns before each, or empty
};

void bind_guarantees(nb::module_& m);

}  // namespace viewshed
