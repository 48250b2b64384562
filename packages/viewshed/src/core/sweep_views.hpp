// The view of a sweep, to be compared with sweeps before and after it.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "arrays.hpp"

namespace viewshed {

struct Point3 {
    float x, y, z;
};

// Return the bin of a position, clamped to [0, count); 0 for NaN.
inline int bin_of(float position, int count) {
    return position > 0.0f ? (position < float(count) ? int(position) : count - 1) : 0;
}

// Rotation and shift (3, 4) from one frame to another.
struct Transform {
    std::array<float, 12> m;

    Point3 operator()(Point3 p) const {
        return {m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
                m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
    }
};

// State of a place as seen by another sweep: an obstacle near it, free passage far beyond it, or unknown (occluded, not
// scanned, without a return, at an edge).
enum class Seen : std::uint8_t { UNKNOWN, OCCUPIED, FREE };

// Range image of a sweep, its obstacles, and the free distance at their heights by azimuth.
class SweepView {
public:
    // Take squared_m2 (rings, columns) and phase (rings,) of the range image; elevation (rings,) in radians and
    // origin_m (rings,), the height of the beams' start above the sensor's origin; points (M, 3) in the level frame
    // with height_m above the ground, horizontal range_m, azimuth and isolated mask (M,); and the transform
    // sensor_from_level.
    SweepView(View2<const float> squared_m2, View1<const float> phase, View1<const float> elevation,
              View1<const float> origin_m, View2<const float> points, View1<const float> height_m, View1<const float> range_m,
              View1<const float> azimuth, View1<const bool> isolated, const Transform& sensor_from_level);

    std::size_t rings() const { return rings_; }
    std::size_t columns() const { return columns_; }
    const std::vector<Point3>& obstacles() const { return obstacles_; }
    // Number of returns that each obstacle stands for.
    std::size_t obstacle_step() const { return obstacle_step_; }
    const float* ring(std::size_t r) const { return range_m_.data() + r * columns_; }

    // Pixel whose beam points at p in the sensor's frame; ring -1 for none.
    struct Pixel {
        int ring, column;
        float aside;  // offset from the column's center, in columns, -0.5 to 0.5
        float range_m;
    };
    Pixel pixel_of(Point3 p) const;

    // Return the vertical area in m² that one pixel covers at p.
    float area_of_pixel(Point3 p) const;

    // Return the point on the beam of a pixel at a range, in the sensor's frame.
    Point3 at(int ring, int column, float range_m) const;

    // Return the state of a place p in the sensor's frame.
    Seen look_at(Point3 p) const;

    // Check if most beams of the ring at p end far beyond it; not all, since an attacker may control some.
    bool is_passed(Point3 p) const;

    // Return the range difference from this sweep's surface to p, interpolated between the two beams beside p; NaN if
    // they do not end on one surface near p.
    float range_difference(Point3 p) const;

    // Return the horizontal distance from p to the nearest cover, where something may have been: at or behind an
    // obstacle, in an unseen area, or too near to the sensor. 0 if p itself is in cover.
    float distance_to_cover(Point3 p) const;

    // Rotate p from the sensor's frame to level; the origin stays at the sensor.
    Point3 leveled(Point3 p) const;

    // Return the azimuth sector in the level frame, of `sectors` from -π on, of p in the sensor's frame.
    int sector_of(Point3 p, int sectors) const;

private:
    int wrapped(int column) const {
        const int columns = int(columns_);
        return column < 0 ? column + columns : (column >= columns ? column - columns : column);
    }

    int ring_at(float sine) const { return ring_of_sine_[std::size_t(bin_of((sine + 1.0f) * (SINES / 2), SINES))]; }

    // Size of the table from sine of elevation to ring.
    static constexpr int SINES = 4096;

    std::size_t rings_, columns_;
    std::vector<float> range_m_, phase_, sine_, cosine_, spacing_, origin_m_;
    std::vector<std::int16_t> ring_of_sine_;
    std::vector<float> cover_m_;
    std::vector<Point3> obstacles_;
    std::size_t obstacle_step_ = 1;
    Transform sensor_from_level_;
};

}  // namespace viewshed
