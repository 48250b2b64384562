// Which beam and which column each return belongs to: the range image of a sweep, recovered from its points.
#pragma once

#include <optional>

#include "beam_matching.hpp"

namespace viewshed {

// What shows the rings of a sweep.
enum class RingSource { FILE, FILE_ORDER, BEAM_TABLE, ELEVATION_CLUSTERS, ELEVATION_BINS };

// Rings (N,) of returns, 0 the lowest, -1 for none, and how many there are.
struct Rings {
    Buffer<std::int16_t> ring;
    std::size_t count;
};

// The rings that the order of the points tells, or none where they are not stored ring after ring.
//
// Rings begin behind or before the sensor. Counted from the wrong side each holds halves of two, and its slope changes by
// a whole step on the way: the rings whose slope changes less are right.
std::optional<Rings> rings_by_order(View2<const float> points);

// The lower median of some numbers; NaN are left out, NaN for none.
double lower_median(const float* values, std::size_t count);

// The median, of an even number the mean of the two in the middle; NaN for none.
double median_of(std::vector<double> values);

// The beam and the column of each return; viewshed.preprocess.ring_recovery.RingAssignment says what each is.
struct RingAssignment {
    Buffer<std::int16_t> ring;
    Buffer<std::int32_t> column;
    std::size_t columns;
    Buffer<double> elevation;
    std::size_t placed, alone;
    RingSource source;
};

// Rings are the known ones (N,), else those of the order of the points, else those nearest to the beams of a table, if
// the elevations gather at them, else, without a table, those at which the returns themselves gather, else bins.
RingAssignment recover_rings(View2<const float> points, std::optional<View1<const std::int16_t>> known,
                             const BeamTable* table);

}  // namespace viewshed
