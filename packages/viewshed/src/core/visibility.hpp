// Count the beams that would return from a target in each cell: the definition of visible.
//
// Beams are counted by (azimuth column, range bin) and summed cumulatively over the columns. The beams that a target in
// a cell spans are then the difference of two sums, at the two ends of its azimuth window. All kinds of beams and
// several ground heights are summed at once, one vector lane each.
#pragma once

#include <array>
#include <vector>

#include "arrays.hpp"
#include "polar_ground.hpp"

namespace viewshed {

// Straight beams (B,) from the sensor in the level frame; the fields are documented in viewshed.fov.visibility.Beams.
struct Beams {
    View1<const float> azimuth, slope, depth_m;
};

// Beams (B,) without a return, each with three candidate depths: likely, early (shortest) and late (longest).
constexpr std::size_t DEPTHS = 3;
struct LostBeams {
    View1<const float> azimuth, slope;
    std::array<View1<const float>, DEPTHS> depth_m;
};

// Ground heights and their standard deviations on a lattice (nodes, nodes) that spans ±half_extent_m, and the sensor's
// height. Without data, std_m counts as 0.
struct TargetGround {
    View2<const float> heights_m, std_m;
    float half_extent_m, sensor_height_m;
};

// Lanes of a sum. MEASURED: returns of measured beams from the target. INFERRED, EARLY, LATE: returns of no-return
// beams at each of their depths. LOWER, HIGHER: returns of measured beams and of likely depths over lower and higher
// ground. AIMED: beams that aim at the target, whatever their depth.
enum Lane { MEASURED, INFERRED, EARLY, LATE, LOWER, HIGHER, AIMED, LANES };

// Four lanes: a vector register on every processor.
constexpr std::size_t FOUR = 4;
typedef float Four __attribute__((vector_size(FOUR * sizeof(float))));

// Sums of a cell or a range bin, by Lane, plus one unused lane: the widest vector register of most processors.
constexpr std::size_t EIGHT = 8;
typedef float Row __attribute__((vector_size(EIGHT * sizeof(float))));

// Azimuth columns in which beams are counted, and segments of the turn that are summed separately: threads share no
// sums, so the sums do not depend on the number of threads.
constexpr std::size_t AZIMUTH_COLUMNS = 2048, SEGMENTS = 8, SEGMENT_COLUMNS = AZIMUTH_COLUMNS / SEGMENTS;

// Azimuth columns of each sector of the local ground.
constexpr std::size_t SECTOR_COLUMNS = AZIMUTH_COLUMNS / GROUND_SECTORS;

// Azimuth windows of a target in each of N cells; computed once for a grid and a target width.
class CellWindows {
public:
    // One end of a window: cell (or row, see Crossing), range bin, and position within its column, in [0, 1).
    struct End {
        std::uint32_t row, bin;
        float part;
    };
    // A window that crosses into another segment. The end of the k-th crossing window is summed in row `cells` + k, and
    // the totals of `count` whole segments from `first` on are added.
    struct Crossing {
        std::uint32_t cell, bin;
        std::uint32_t first, count;
    };

    // Take the ranges and azimuths of grid cells, the cell size, and the target's width across the line of sight.
    CellWindows(View2<const float> range_m, View2<const float> azimuth, double cell_m, double width_m);

    std::size_t cells() const { return cell_range_m.size(); }
    std::size_t rows() const { return cells() + crossings.size(); }

    std::size_t grid_rows, grid_columns;
    float cell_m;
    std::size_t bins, stride;                    // range bins, each one cell long; the same, padded to whole vectors
    std::vector<float> cell_range_m;             // (N,)
    std::vector<std::int16_t> cell_bin;          // (N,) index among the NARROWEST_BINS of azimuth
    std::vector<float> bin_range_m, per_range;   // (stride,) centers of the bins in m, and their inverses
    std::vector<End> begins, ends;               // by column
    std::vector<std::uint32_t> first_begin, first_end;  // (AZIMUTH_COLUMNS + 1,)
    std::vector<Crossing> crossings;             // by cell
};

// Cumulative sums of one sweep at all cells.
struct CellCounts {
    const CellWindows* windows;
    Buffer<Row> rows;    // (windows.rows(),), padded to be read in whole blocks
    Buffer<Row> totals;  // (SEGMENTS, windows.bins)

    // Write the counts of cells [first, first + count), lane by lane, into (LANES, BLOCK).
    static constexpr std::size_t BLOCK = 512;
    void read(std::size_t first, std::size_t count, float (*lanes)[BLOCK]) const;
};

// Count beams. `deviations` shift the ground of LOWER and HIGHER in standard deviations; without, these lanes are 0.
CellCounts count_beams(const CellWindows& windows, const Beams& measured, const LostBeams& lost, const TargetGround& ground,
                       float target_height_m, const std::array<float, 2>* deviations);

}  // namespace viewshed
