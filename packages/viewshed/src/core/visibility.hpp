// How many beams would return from a target in each cell: the definition of visible, counted.
//
// Beams are counted in (azimuth column, range bin), summed over the columns before; then the beams that a target in a cell
// spans are the difference of two sums, at the two ends of its window of azimuth. All kinds of beams, and several heights
// of the ground, are summed at once, a lane each.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"
#include "polar_ground.hpp"

namespace viewshed {

// Straight beams (B,) from the sensor in the level frame; viewshed.fov.visibility.Beams says what each array is.
struct Beams {
    View1<const float> azimuth, slope, depth_m;
};

// Beams (B,) without a return: they went that far likely, at least early, and at most late.
constexpr std::size_t DEPTHS = 3;
struct LostBeams {
    View1<const float> azimuth, slope;
    std::array<View1<const float>, DEPTHS> depth_m;
};

// The ground on a lattice of nodes × nodes that spans ±half_extent_m, its standard deviation, and the sensor's height. A
// deviation that is not there (no data) is 0.
struct TargetGround {
    View2<const float> heights_m, std_m;
    float half_extent_m, sensor_height_m;
};

// Sums side by side, a lane each. The target's returns by measured beams, and by those without a return to each of their
// depths; those by measured ones and likely depths where the ground lies lower and higher; and the beams that aim at it,
// whatever their depth.
enum Lane { MEASURED, INFERRED, EARLY, LATE, LOWER, HIGHER, AIMED, LANES };

// Four of them, a vector on every processor.
constexpr std::size_t FOUR = 4;
typedef float Four __attribute__((vector_size(FOUR * sizeof(float))));

// The sums of a cell or of a bin, in the order of the lanes, and one that is not used: the widest vector of most processors.
constexpr std::size_t EIGHT = 8;
typedef float Row __attribute__((vector_size(EIGHT * sizeof(float))));

// Columns of azimuth in which beams are counted, and parts of the turn that are summed each by itself, so that threads
// share nothing and sums do not depend on how many there are.
constexpr std::size_t AZIMUTH_COLUMNS = 2048, SEGMENTS = 8, SEGMENT_COLUMNS = AZIMUTH_COLUMNS / SEGMENTS;

// Columns of a sector in which the local ground is looked up.
constexpr std::size_t SECTOR_COLUMNS = AZIMUTH_COLUMNS / GROUND_SECTORS;

// The windows of azimuth of a target in each of N cells; made once for a grid and a width.
class CellWindows {
public:
    // One end of a window: its cell (or row, see Crossing), its range bin, and how far into its column it lies, in [0, 1).
    struct End {
        std::uint32_t row, bin;
        float part;
    };
    // A window that crosses into another segment: its end is summed in row `cells` + k for the k-th of them, and the
    // sums of `count` whole segments from `first` on are added.
    struct Crossing {
        std::uint32_t cell, bin;
        std::uint32_t first, count;
    };

    // Range in meters and azimuth of the cells of a grid, each `cell_m` wide; the width that a target turns to the sensor.
    CellWindows(View2<const float> range_m, View2<const float> azimuth, double cell_m, double width_m);

    std::size_t cells() const { return cell_range_m.size(); }
    std::size_t rows() const { return cells() + crossings.size(); }

    std::size_t grid_rows, grid_columns;
    float cell_m;
    std::size_t bins, stride;                    // range bins of a cell's length; as many, in whole vectors
    std::vector<float> cell_range_m;             // (N,)
    std::vector<std::int16_t> cell_bin;          // (N,) of the NARROWEST_BINS of azimuth
    std::vector<float> bin_range_m, per_range;   // (stride,) the middles of the bins, and 1 / m
    std::vector<End> begins, ends;               // by column
    std::vector<std::uint32_t> first_begin, first_end;  // (AZIMUTH_COLUMNS + 1,)
    std::vector<Crossing> crossings;             // by cell
};

// The sums of one sweep at all cells.
struct CellCounts {
    const CellWindows* windows;
    Buffer<Row> rows;    // (windows.rows(),), and some more to be read in whole blocks
    Buffer<Row> totals;  // (SEGMENTS, windows.bins)

    // Write `count` cells from `first` on, a lane after the other, into (LANES, BLOCK).
    static constexpr std::size_t BLOCK = 512;
    void read(std::size_t first, std::size_t count, float (*lanes)[BLOCK]) const;
};

// Count beams. With `deviations`, also where the ground lies that many standard deviations higher; else those lanes are 0.
CellCounts count_beams(const CellWindows& windows, const Beams& measured, const LostBeams& lost, const TargetGround& ground,
                       float target_height_m, const std::array<float, 2>* deviations);

}  // namespace viewshed
