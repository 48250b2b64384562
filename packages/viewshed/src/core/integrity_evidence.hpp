// What one sweep tells against itself: returns that the beams forbid, rings that jump together, noise that is not the
// sensor's. Each answer is by sector of azimuth; viewshed.monitor.evidence says what each is evidence of.
#pragma once

#include "arrays.hpp"

namespace viewshed {

// The returns of a sweep by ring and column, without the rings that hardly returned; A rings are left, the lowest first.
struct BeamImage {
    std::size_t rings, columns;
    Buffer<float> range_m, farthest_m;  // (A, columns) nearest and farthest return of each pixel; +inf for none
    Buffer<float> height_m;             // (A, columns) of the nearest return above local ground; NaN for none
};

// Put leveled returns on their pixels: rows (M,) of points (N, 3), which have a ring and a column (N,) or -1, and a height
// above local ground (M,).
BeamImage beam_image(View2<const float> points, View1<const std::int16_t> ring, View1<const std::int32_t> column,
                     View1<const std::int32_t> rows, View1<const float> height_m, std::size_t rings,
                     std::size_t columns);

// Ranges (A, columns) in meters of a beam image, +inf for none, and the sector of each column.
struct Image {
    View2<const float> range_m;
    Buffer<std::int16_t> sector;
};

// By sector: pixels of something, and those that they are a share of.
struct Counts {
    View1<std::int32_t> some, all;
};

// Count the points (N, 3) that are chosen (N,), and all.
void count_chosen(View2<const float> points, View1<const bool> chosen, const Counts& counts);

// Count the pixels that look through the surface which surrounds them on all eight sides, and those so surrounded.
void count_holes(const Image& image, const Counts& counts);

// Count the pixels that returned before all their neighbors, but from where another such pixel near them did, and all.
void count_specks(const Image& image, const Counts& counts);

// Count the pixels with returns at two ranges (farthest_m as range_m), none of which is a neighbor's, and all.
void count_double_returns(const Image& image, View2<const float> farthest_m, const Counts& counts);

// Write the lower quartile of the noise of range in meters along rings, by sector and band of rings (3, sectors, bands): of
// ground (height_m as range_m), of near returns, of all; NaN for too few stretches.
void measure_noise(const Image& image, View2<const float> height_m, View3<float> noise_m);

// Write the largest common jump of the ground rings between two columns of each sector, in units of its spread.
void measure_steps(const Image& image, View2<const float> height_m, View1<float> steps);

// Write the largest share of rings that break off between two columns of each sector.
void measure_breaks(const Image& image, View1<float> breaks);

// Write the longest run of empty columns through each sector, in radians.
void measure_empty_runs(const Image& image, View1<float> runs);

// Mark the leveled returns (M,), rows (M,) of points (N, 3), whose elevation is neither that of their ring (N,) nor that of
// a neighbor (column (N,) of columns). Beams start origin_m (rings,) above the sensor.
void find_off_beam(View2<const float> points, View1<const std::int16_t> ring, View1<const std::int32_t> column,
                   View1<const double> origin_m, View1<const std::int32_t> rows, std::size_t columns,
                   View1<bool> off_beam);

// Write the offset of range in meters by sector at which the ground in level points (M, 3) is flattest; NaN for too little
// ground.
void measure_range_offset(View2<const float> points, float sensor_height_m, View1<float> offset_m);

}  // namespace viewshed
