// Recover the range image of a sweep from its points: the beam and the column of each return.
#pragma once

#include <optional>

#include "beam_matching.hpp"

namespace viewshed {

// Source of the rings of a sweep.
enum class RingSource { FILE, FILE_ORDER, BEAM_TABLE, ELEVATION_CLUSTERS, ELEVATION_BINS };

// Rings (N,) of returns, 0 the lowest, -1 for none, and the number of rings.
struct Rings {
    Buffer<std::int16_t> ring;
    std::size_t count;
};

// Return rings by the order of the points, or none if they are not stored ring by ring.
//
// Rings begin behind or in front of the sensor. Counted from the wrong side, each holds halves of two rings, and its
// slope changes by a whole step within: the candidate whose slope changes least within a ring is right.
std::optional<Rings> rings_by_order(View2<const float> points);

// Return the lower median, ignoring NaN; NaN for none.
double lower_median(const float* values, std::size_t count);

// Return the median (the mean of the two middle values for an even count); NaN for none.
double median_of(std::vector<double> values);

// Beam and column of each return; the fields are documented in viewshed.preprocess.ring_recovery.RingAssignment.
struct RingAssignment {
    Buffer<std::int16_t> ring;
    Buffer<std::int32_t> column;
    std::size_t columns;
    Buffer<double> elevation;
    std::size_t placed, alone;
    RingSource source;
};

// Recover rings from the first source that works: known rings (N,); the order of the points; with a table, its nearest
// beams if the elevations cluster at them; without one, elevation clusters; else elevation bins.
RingAssignment recover_rings(View2<const float> points, std::optional<View1<const std::int16_t>> known,
                             const BeamTable* table);

}  // namespace viewshed
