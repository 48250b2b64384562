#include "boxes.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "parallel.hpp"
#include "vectors.hpp"

namespace viewshed {
namespace {

// Azimuth columns by which beams are sorted.
constexpr std::size_t COLUMNS = 2048;
constexpr double PER_RAD = COLUMNS / (2 * std::numbers::pi);

// A return this close to a box's face belongs to it: range noise.
constexpr float NOISE_M = 0.1f;

// Lower bound of a direction component, so that its inverse is finite.
constexpr float MIN_COMPONENT = 1e-12f;

// Upper bound of the range in a box.
constexpr float FARTHEST_M = 1e30f;

// Fewest boxes for which a part pays for its thread.
constexpr std::size_t PART = 32;

std::size_t column_of(double azimuth) {
    const double turns = (azimuth + std::numbers::pi) / (2 * std::numbers::pi);
    const auto column = std::size_t((turns - std::floor(turns)) * COLUMNS);
    return std::min(column, COLUMNS - 1);
}

// Return the inverse of a direction component; large but finite near 0.
INLINE float inverse(float part) { return 1.0f / (std::fabs(part) < MIN_COMPONENT ? MIN_COMPONENT : part); }

// Clip the range interval of a beam to a slab of ±half around 0 (slab method). The beam starts at `from` and takes
// `per_part` meters of range per meter across the slab.
INLINE void cross_slab(float from, float per_part, float half, float& enters, float& leaves) {
    const float one = (-half - from) * per_part, other = (half - from) * per_part;
    const float low = one < other ? one : other, high = one < other ? other : one;
    enters = low > enters ? low : enters;
    leaves = high < leaves ? high : leaves;
}

// Count the beams that meet a box: with leave_out_own those that enter it, else those that pass through it.
MULTIVERSION std::int32_t count_meeting(const float* x, const float* y, const float* per_rise, const float* depth_m,
                                        std::size_t count, const SeenBox& seen, bool leave_out_own) {
    const SeenBox box = seen;
    const float entering = leave_out_own ? 1.0f : 0.0f, noise_m = leave_out_own ? -NOISE_M : NOISE_M;
    std::int32_t meeting = 0;
    for (std::size_t n = 0; n < count; ++n) {
        float enters = 0.0f, leaves = FARTHEST_M;
        cross_slab(box.from_x, inverse(x[n] * box.cosine + y[n] * box.sine), box.half_x, enters, leaves);
        cross_slab(box.from_y, inverse(y[n] * box.cosine - x[n] * box.sine), box.half_y, enters, leaves);
        cross_slab(box.from_z, per_rise[n], box.half_z, enters, leaves);
        const float needed_m = entering * enters + (1.0f - entering) * leaves + noise_m;
        const bool meets = (enters <= leaves) & (leaves > 0.0f) & (depth_m[n] >= needed_m);
        meeting += meets ? 1 : 0;
    }
    return meeting;
}

}  // namespace

BeamsByAzimuth::BeamsByAzimuth(View1<const float> azimuth, View1<const float> slope, View1<const float> depth_m)
    : first_(COLUMNS + 1, 0), x_(azimuth.size), y_(azimuth.size), per_rise_(azimuth.size), depth_m_(azimuth.size) {
    // Beams with infinite slope or invalid direction meet nothing.
    Buffer<std::uint16_t> column(azimuth.size);
    for (std::size_t n = 0; n < azimuth.size; ++n) {
        const bool counts = std::isfinite(slope[n]) && std::isfinite(azimuth[n]) && depth_m[n] > 0;
        column[n] = std::uint16_t(counts ? column_of(azimuth[n]) : COLUMNS);
        if (column[n] < COLUMNS) ++first_[column[n] + 1];
    }
    for (std::size_t c = 0; c < COLUMNS; ++c) first_[c + 1] += first_[c];
    std::vector<std::size_t> next = first_;
    for (std::size_t n = 0; n < azimuth.size; ++n) {
        if (column[n] == COLUMNS) continue;
        const std::size_t k = next[column[n]]++;
        x_[k] = std::cos(azimuth[n]);
        y_[k] = std::sin(azimuth[n]);
        per_rise_[k] = inverse(slope[n]);
        depth_m_[k] = depth_m[n];
    }
}

// Count the beams from a sensor height that meet one box.
std::int32_t BeamsByAzimuth::count_one(const float* box, float sensor_height_m, bool leave_out_own) const {
    // Columns that the box's corners span, plus one on either side; all columns if it contains the sensor.
    const double c = std::cos(double(box[6])), s = std::sin(double(box[6])), middle = std::atan2(box[1], box[0]);
    double min_offset = 0.0, max_offset = 0.0;
    for (const double along : {-0.5, 0.5}) {
        for (const double across : {-0.5, 0.5}) {
            const double x = box[0] + along * box[3] * c - across * box[4] * s;
            const double y = box[1] + along * box[3] * s + across * box[4] * c;
            const double away = std::remainder(std::atan2(y, x) - middle, 2 * std::numbers::pi);
            min_offset = std::min(min_offset, away);
            max_offset = std::max(max_offset, away);
        }
    }
    const bool is_around = std::fabs(box[0] * c + box[1] * s) <= 0.5 * box[3] &&
                           std::fabs(box[1] * c - box[0] * s) <= 0.5 * box[4];
    const std::size_t span = std::size_t((max_offset - min_offset) * PER_RAD) + 4;
    const SeenBox seen{-(box[0] * float(c) + box[1] * float(s)), box[0] * float(s) - box[1] * float(c),
                       sensor_height_m - box[2], 0.5f * box[3], 0.5f * box[4], 0.5f * box[5], float(c), float(s)};
    if (is_around || span >= COLUMNS) return count_within(0, first_[COLUMNS], seen, leave_out_own);
    const std::size_t begin = (column_of(middle + min_offset) + COLUMNS - 1) % COLUMNS, end = begin + span;
    if (end <= COLUMNS) return count_within(first_[begin], first_[end], seen, leave_out_own);
    return count_within(first_[begin], first_[COLUMNS], seen, leave_out_own) +
           count_within(0, first_[end - COLUMNS], seen, leave_out_own);
}

std::int32_t BeamsByAzimuth::count_within(std::size_t begin, std::size_t end, const SeenBox& seen, bool leave_out_own) const {
    return count_meeting(&x_[begin], &y_[begin], &per_rise_[begin], &depth_m_[begin], end - begin, seen, leave_out_own);
}

void BeamsByAzimuth::count(View2<const float> boxes, float sensor_height_m, bool leave_out_own,
                           View1<std::int32_t> returns) const {
    for_ranges(boxes.rows, count_parts(boxes.rows, PART), [&](std::size_t, std::size_t begin, std::size_t end) {
        for (std::size_t k = begin; k < end; ++k) returns[k] = count_one(boxes[k], sensor_height_m, leave_out_own);
    });
}

}  // namespace viewshed
