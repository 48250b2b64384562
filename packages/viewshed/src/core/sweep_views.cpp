#include "sweep_views.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "vectors.hpp"

namespace viewshed {
namespace {

constexpr float NONE = std::numeric_limits<float>::infinity();

// Height limits of obstacles above the ground; at most MAX_OBSTACLES of a sweep are compared.
constexpr float MIN_HEIGHT_M = 0.3f, MAX_HEIGHT_M = 3.0f;
constexpr std::size_t MAX_OBSTACLES = 2200;

// Number of azimuth directions for the free distance.
constexpr int DIRECTIONS = 360;

// Things nearer to the sensor are not seen.
constexpr float BLIND_M = 2.5f;

// Tolerance of one surface, and margin beyond a place for beams that pass it; each a distance plus a share of the
// range.
constexpr float SAME_M = 0.5f, SAME_SHARE = 0.02f, BEYOND_M = 1.0f, BEYOND_SHARE = 0.04f;

// Half width of the free passage around a place, and the most columns to either side.
constexpr float HALF_WIDTH_M = 0.4f;
constexpr int MAX_COLUMNS = 4;

// Fewest returns beyond a place for free passage, in total and in its own ring.
constexpr int MIN_BEYOND = 4, MIN_IN_RING = 2;

// Share of the returns around a place that must lie beyond it if most beams pass.
constexpr float PASSED_SHARE = 0.6f;

// A return farther than this from its neighbors lies on another surface.
constexpr float NEAR_M = 1.0f;

int direction_of(Point3 level) {
    return bin_of((azimuth_of(level.y, level.x) + PI) * (float(DIRECTIONS) / (2 * PI)), DIRECTIONS);
}

}  // namespace

SweepView::SweepView(View2<const float> squared_m2, View1<const float> phase, View1<const float> elevation,
                     View1<const float> origin_m, View2<const float> points, View1<const float> height_m, View1<const float> range_m,
                     View1<const float> azimuth, View1<const bool> isolated, const Transform& sensor_from_level)
    : rings_(squared_m2.rows),
      columns_(squared_m2.columns),
      range_m_(squared_m2.size()),
      phase_(phase.begin(), phase.end()),
      sine_(rings_),
      cosine_(rings_),
      spacing_(rings_),
      origin_m_(origin_m.begin(), origin_m.end()),
      ring_of_sine_(SINES, -1),
      cover_m_(DIRECTIONS, NONE),
      sensor_from_level_(sensor_from_level) {
    // 1. Pixel ranges, and the table from elevation to the nearest ring within the ring spacing.
    for (std::size_t k = 0; k < range_m_.size(); ++k) range_m_[k] = std::sqrt(squared_m2.data[k]);
    std::vector<std::pair<float, std::int16_t>> order;
    for (std::size_t r = 0; r < rings_; ++r) {
        sine_[r] = std::sin(elevation[r]);
        cosine_[r] = std::cos(elevation[r]);
        order.emplace_back(sine_[r], std::int16_t(r));
    }
    std::sort(order.begin(), order.end());
    for (std::size_t k = 0; k < order.size(); ++k) {
        const float sine = order[k].first;
        const float below = k > 0 ? sine - order[k - 1].first : NONE;
        const float above = k + 1 < order.size() ? order[k + 1].first - sine : NONE;
        const float alone = order.size() > 1 ? std::min(below, above) : 0.02f;
        const float low = sine - 0.5f * (below < NONE ? below : alone);
        const float high = sine + 0.5f * (above < NONE ? above : alone);
        spacing_[std::size_t(order[k].second)] = high - low;
        const int first = std::clamp(int(std::ceil((low + 1.0f) * (SINES / 2))), 0, SINES - 1);
        const int last = std::clamp(int(std::floor((high + 1.0f) * (SINES / 2))), 0, SINES - 1);
        for (int s = first; s <= last; ++s) ring_of_sine_[std::size_t(s)] = order[k].second;
    }

    // 2. Obstacles, and by direction the nearest obstacle, or the farthest ground without one.
    std::vector<float> ground_m(DIRECTIONS, 0.0f);
    std::vector<std::size_t> rows;
    constexpr float per_rad = float(DIRECTIONS) / (2 * PI);
    for (std::size_t n = 0; n < points.rows; ++n) {
        const auto direction = std::size_t(bin_of((azimuth[n] + PI) * per_rad, DIRECTIONS));
        if (height_m[n] <= MIN_HEIGHT_M) {
            ground_m[direction] = std::max(ground_m[direction], range_m[n]);
        } else if (height_m[n] < MAX_HEIGHT_M) {
            cover_m_[direction] = std::min(cover_m_[direction], range_m[n]);
            if (!isolated[n]) rows.push_back(n);
        }
    }
    for (std::size_t k = 0; k < DIRECTIONS; ++k) {
        if (cover_m_[k] == NONE) cover_m_[k] = ground_m[k];
    }
    obstacle_step_ = rows.size() / MAX_OBSTACLES + 1;
    obstacles_.reserve(rows.size() / obstacle_step_ + 1);
    // Sample one of each step at random: a fixed one would select certain rings or columns only.
    std::uint32_t random = 1;
    for (std::size_t k = 0; k < rows.size(); k += obstacle_step_) {
        random = random * 1664525u + 1013904223u;
        const float* p = points[rows[std::min(k + (random >> 16) % obstacle_step_, rows.size() - 1)]];
        obstacles_.push_back(sensor_from_level({p[0], p[1], p[2]}));
    }
}

SweepView::Pixel SweepView::pixel_of(Point3 p) const {
    const float range_m = std::sqrt(p.x * p.x + p.y * p.y + p.z * p.z);
    if (!(range_m > 1e-3f && range_m < 1e6f)) return {-1, 0, 0.0f, range_m};
    // Look the ring up from the sensor's origin, then from that ring's own origin.
    int ring = ring_at(p.z / range_m);
    if (ring < 0) return {-1, 0, 0.0f, range_m};
    if (origin_m_[std::size_t(ring)] != 0.0f) {
        const float z = p.z - origin_m_[std::size_t(ring)];
        ring = ring_at(z / std::sqrt(p.x * p.x + p.y * p.y + z * z));
        if (ring < 0) return {-1, 0, 0.0f, range_m};
    }
    const float column = (azimuth_of(p.y, p.x) + PI) * (float(columns_) / (2 * PI)) + 0.5f - phase_[std::size_t(ring)];
    const float whole = std::floor(column);
    return {ring, wrapped(int(whole)), column - whole - 0.5f, range_m};
}

float SweepView::area_of_pixel(Point3 p) const {
    const Pixel pixel = pixel_of(p);
    if (pixel.ring < 0) return 0.0f;
    return pixel.range_m * pixel.range_m * (2 * PI / float(columns_)) * spacing_[std::size_t(pixel.ring)];
}

Point3 SweepView::at(int ring, int column, float range_m) const {
    const auto r = std::size_t(ring);
    const float azimuth = (float(column) + phase_[r]) * (2 * PI / float(columns_)) - PI;
    const float level_m = range_m * cosine_[r];
    return {level_m * std::cos(azimuth), level_m * std::sin(azimuth), range_m * sine_[r] + origin_m_[r]};
}

Seen SweepView::look_at(Point3 p) const {
    const Pixel pixel = pixel_of(p);
    if (pixel.ring < 0) return Seen::UNKNOWN;
    // Shortcut: most places lie on a surface seen with the same beam.
    const float same_m = SAME_M + SAME_SHARE * pixel.range_m;
    if (std::fabs(ring(std::size_t(pixel.ring))[pixel.column] - pixel.range_m) <= same_m) return Seen::OCCUPIED;
    // Check the ring at the place and the one above, over a width of HALF_WIDTH_M to either side. The ring below may
    // hit the ground.
    const float step_m = pixel.range_m * (2 * PI / float(columns_));
    const int half = std::clamp(int(std::ceil(HALF_WIDTH_M / step_m)), 1, MAX_COLUMNS);
    const float beyond_m = pixel.range_m + BEYOND_M + BEYOND_SHARE * pixel.range_m;
    int returns = 0, beyond = 0, beyond_in_ring = 0;
    float nearest_m = NONE, farthest_m = 0.0f;
    for (int r = pixel.ring; r <= std::min(pixel.ring + 1, int(rings_) - 1); ++r) {
        const float* row = ring(std::size_t(r));
        for (int k = -half; k <= half; ++k) {
            const float range_m = row[wrapped(pixel.column + k)];
            if (range_m == NONE) continue;
            ++returns;
            beyond += range_m > beyond_m;
            beyond_in_ring += range_m > beyond_m && r == pixel.ring;
            nearest_m = std::min(nearest_m, range_m);
            farthest_m = std::max(farthest_m, range_m);
        }
    }
    if (returns == 0) return Seen::UNKNOWN;
    if (nearest_m <= pixel.range_m + same_m && farthest_m >= pixel.range_m - same_m) return Seen::OCCUPIED;
    if (beyond == returns && beyond >= MIN_BEYOND && beyond_in_ring >= MIN_IN_RING) return Seen::FREE;
    return Seen::UNKNOWN;
}

bool SweepView::is_passed(Point3 p) const {
    const Pixel pixel = pixel_of(p);
    if (pixel.ring < 0) return false;
    const float step_m = pixel.range_m * (2 * PI / float(columns_));
    const int half = std::clamp(int(std::ceil(HALF_WIDTH_M / step_m)), 1, MAX_COLUMNS);
    const float beyond_m = pixel.range_m + BEYOND_M + BEYOND_SHARE * pixel.range_m;
    const float* row = ring(std::size_t(pixel.ring));
    int returns = 0, beyond = 0;
    for (int k = -half; k <= half; ++k) {
        const float range_m = row[wrapped(pixel.column + k)];
        returns += range_m < NONE;
        beyond += range_m > beyond_m && range_m < NONE;
    }
    return beyond >= 2 && beyond >= PASSED_SHARE * float(returns);
}

float SweepView::range_difference(Point3 p) const {
    const Pixel pixel = pixel_of(p);
    if (pixel.ring < 0) return std::numeric_limits<float>::quiet_NaN();
    const float* row = ring(std::size_t(pixel.ring));
    const float own_m = row[pixel.column], next_m = row[wrapped(pixel.column + (pixel.aside < 0.0f ? -1 : 1))];
    const float difference = pixel.range_m - (own_m + (next_m - own_m) * std::fabs(pixel.aside));
    const bool is_one = std::fabs(next_m - own_m) < SAME_M && std::fabs(difference) < NEAR_M;
    return is_one ? difference : std::numeric_limits<float>::quiet_NaN();
}

Point3 SweepView::leveled(Point3 p) const {
    const auto& m = sensor_from_level_.m;  // apply its transposed rotation
    return {m[0] * p.x + m[4] * p.y + m[8] * p.z, m[1] * p.x + m[5] * p.y + m[9] * p.z,
            m[2] * p.x + m[6] * p.y + m[10] * p.z};
}

int SweepView::sector_of(Point3 p, int sectors) const {
    const Point3 level = leveled(p);
    return bin_of((azimuth_of(level.y, level.x) + PI) * (float(sectors) / (2 * PI)), sectors);
}

float SweepView::distance_to_cover(Point3 p) const {
    const Point3 level = leveled(p);
    const float range_m = std::sqrt(level.x * level.x + level.y * level.y);
    const int middle = direction_of(level);
    float nearest_cover_m = std::min(cover_m_[std::size_t(middle)] - range_m, range_m - BLIND_M);
    // Search directions to either side until the distance to their lines exceeds the minimum.
    for (int k = 1; k <= DIRECTIONS / 2 && nearest_cover_m > 0.0f; ++k) {
        const float turn = float(k) * (2 * PI / float(DIRECTIONS));
        const float aside = k < DIRECTIONS / 4 ? range_m * std::sin(turn) : range_m;
        if (aside >= nearest_cover_m) break;
        const float along = range_m * std::cos(turn);
        for (const int direction : {middle - k, middle + k}) {
            const float cover_m = cover_m_[std::size_t((direction + DIRECTIONS) % DIRECTIONS)];
            const float ahead = std::max(cover_m - along, 0.0f);
            const float across = range_m * std::sin(turn);
            nearest_cover_m = std::min(nearest_cover_m, std::sqrt(ahead * ahead + across * across));
        }
    }
    return std::max(nearest_cover_m, 0.0f);
}

}  // namespace viewshed
